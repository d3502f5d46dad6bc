"""The one writer of Markdown tables and pages: reports, and tables that are filled in between markers of a page.

A page shows a generated table between the lines `<!-- table:NAME -->` and `<!-- end -->`.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from golden.scenes.files import atomic_output
from msv2.studies.report import html_page
from spec.errors import InputError

ABSENT = "(not measured yet)"
"""What stands where a table has no rows."""

_MARKED = re.compile(r"(<!-- table:(\w+) -->\n).*?(<!-- end -->)", re.DOTALL)

Table = Callable[[], str | None]
"""Makes a table's text; None where its report is not there: what the page shows then stays."""


def table(
    head: Sequence[str], rows: Iterable[Sequence[object]], left: int | None = None, words: Iterable[str] = (),
    empty: str = ABSENT,
) -> str:
    """A Markdown table without a line break at its end.

    Args:
        head: names of the columns.
        rows: cells of each row, shown by `str`.
        left: number of columns whose text begins at the left; the others are aligned right. None: no column is.
        words: names of further columns that are not aligned right.
        empty: the whole text where there is no row.

    Raises:
        ValueError: a row has more or fewer cells than the head.
    """
    lines = [f"| {' | '.join(map(str, row))} |" for row in map(tuple, rows) if _fits(row, head)]
    if not lines:
        return empty
    plain = len(head) if left is None else left
    rule = ("---" if column < plain or name in set(words) else "---:" for column, name in enumerate(head))
    return "\n".join([f"| {' | '.join(head)} |", f"| {' | '.join(rule)} |", *lines])


def _fits(row: Sequence[object], head: Sequence[str]) -> bool:
    if len(row) != len(head):
        raise ValueError(f"a row of {len(row)} cells does not fit a head of {len(head)}: {row!r}")
    return True


def write_page(path: Path, text: str) -> None:
    """Writes a page of UTF-8 text that ends with one line break, complete or not at all.

    Raises:
        InputError: the folder does not exist or is not writable.
    """
    with atomic_output(path) as file:
        file.write(f"{text.rstrip()}\n".encode())


def write_html(path: Path, title: str, text: str, pictures: Iterable[Path] = ()) -> None:
    """Writes Markdown as one HTML page; pictures that it shows by the names of these files are put inside it.

    Raises:
        InputError: the folder does not exist or is not writable.
    """
    made = html_page.page(title, text)
    for picture in pictures:
        inside = base64.b64encode(picture.read_bytes()).decode()
        made = made.replace(f'src="{picture.name}"', f'src="data:image/png;base64,{inside}"')
    write_page(path, made)


def fill(path: Path, tables: Mapping[str, Table], *, check: bool = False, complete: bool = False) -> int:
    """Rewrites the generated tables of a page; with `check` nothing is written, and 1 is returned where it would change.

    Args:
        path: of the page.
        tables: by the name in the marker.
        check: change nothing.
        complete: every table must have a marker.

    Raises:
        InputError: the page has a marker of a table that there is not, or, with `complete`, lacks one.
    """
    old = path.read_text(encoding="utf-8")
    missing = sorted(set(tables) - set(marked_tables(old))) if complete else []
    if missing:
        raise InputError(f"{path.name}: it has no place for the table {missing[0]!r}: the line <!-- table:{missing[0]} --> "
                         "and the line <!-- end --> are needed")
    unknown = sorted({name for _, name, _ in _MARKED.findall(old)} - set(tables))
    if unknown:
        raise InputError(f"{path.name}: table {unknown[0]!r} is not known: {', '.join(sorted(tables))} are")

    def filled(match: re.Match[str]) -> str:
        made = tables[match[2]]()
        return match[0] if made is None else f"{match[1]}{made.rstrip()}\n{match[3]}"

    new = _MARKED.sub(filled, old)
    if new != old and not check:
        write_page(path, new)
    return int(check and new != old)


def marked_tables(text: str) -> list[str]:
    """Names of the generated tables that a page shows, in order."""
    return [name for _, name, _ in _MARKED.findall(text)]
