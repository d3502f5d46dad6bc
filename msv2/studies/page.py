"""Writes Markdown tables and pages. All reports use this module, and so do the generated tables in other pages.

A generated table stands between the lines `<!-- table:NAME -->` and `<!-- end -->` of its page.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from golden.scenes.files import atomic_output
from msv2.studies.destination import place
from spec.errors import InputError

ABSENT = "(not measured yet)"
"""The text in place of a table that has no rows."""

_MARKED = re.compile(r"(<!-- table:(\w+) -->\n).*?(<!-- end -->)", re.DOTALL)

Table = Callable[[], str | None]
"""A function that makes a table's text. It returns None if its report is missing, and then the page keeps its table."""


def table(
    head: Sequence[str], rows: Iterable[Sequence[object]], left: int | None = None, words: Iterable[str] = (),
    empty: str = ABSENT,
) -> str:
    """A Markdown table without a line break at its end.

    Args:
        head: the names of the columns.
        rows: the cells of each row; they are converted by `str`.
        left: how many of the first columns are aligned left; the others are aligned right. None aligns no column right.
        words: the names of further columns that are not aligned right.
        empty: the whole text if there is no row.

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
    """Writes a page as UTF-8 text that ends with one line break. The file is written completely or not at all. For a page in
    reports/ or docs/, see `msv2.studies.destination`.

    Raises:
        InputError: the folder does not exist or is not writable.
    """
    with atomic_output(place(path)) as file:
        file.write(f"{text.rstrip()}\n".encode())


def fill(path: Path, tables: Mapping[str, Table], *, check: bool = False, complete: bool = False) -> int:
    """Rewrites the generated tables of a page.

    Args:
        path: the path of the page.
        tables: the functions that make the tables, by the name in the marker.
        check: write nothing, and only find out whether the page would change.
        complete: require a marker for every table.

    Returns:
        1 if `check` is set and the page would change, else 0.

    Raises:
        InputError: the page has a marker for an unknown table, or `complete` is set and a marker is missing.
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
    """The names of the generated tables of a page, in their order on the page."""
    return [name for _, name, _ in _MARKED.findall(text)]
