"""Where the files of reports go. One rule holds for all studies:

A study writes into `build/`, and what would be a kept report or a page of docs/ goes to `build/reports` as well. Only with
`--keep`, or where `--out` names the folder, is it written where the project keeps it: in `reports/`, or in the tables of docs/.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path

from spec.paths import BUILD, DOCS, REPORTS, ROOT, short_path

AWAY = BUILD / "reports"
"""The folder for reports that are not kept."""

KEEP = "--keep"
"""The option of every study that writes its reports where the project keeps them."""

HELP = f"every study: without {KEEP}, reports and filled pages go to {short_path(AWAY)}; with it, to reports/ and docs/"


@dataclass
class _Told:
    """What the command line said, and the files that have been written beside the kept ones."""

    keep: bool = False
    named: bool = False
    away: set[Path] = field(default_factory=set)


_told = _Told()


def tell(*, keep: bool, named: bool) -> None:
    """Sets what the command line said: `--keep`, or a folder by `--out`."""
    _told.keep, _told.named = keep, named
    _told.away.clear()


def keeping() -> bool:
    """Whether the command line said `--keep`."""
    return _told.keep


def place(path: Path) -> Path:
    """The path under which a file of a report is written: `path`, or one in AWAY where the project's own would change."""
    whole = path.absolute()
    kept = whole.parent == REPORTS or whole.is_relative_to(DOCS) or (whole.parent == ROOT and whole.suffix == ".md")
    if not kept or _told.keep or _told.named:
        return path
    if not _told.away:
        print(f"reports go to {short_path(AWAY)}; {KEEP} writes them into reports/ and docs/", file=sys.stderr)
    AWAY.mkdir(parents=True, exist_ok=True)
    _told.away.add(AWAY / path.name)
    return AWAY / path.name


def newest(path: Path) -> Path:
    """The file that this run has written for the kept report `path`; `path` where it has written none."""
    return AWAY / path.name if AWAY / path.name in _told.away else path
