"""The results of the cases and of the seeded faults, as text for the screen and as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from golden.scenes.request import write_json
from msv2.cases.case import COLUMNS, Case
from msv2.cases.check import Cell

HEADINGS = {"oracle": "oracle", "golden": "golden", "gradient": "gradient", "rtl": "RTL"}


@dataclass(frozen=True)
class Row:
    """A case and its cells by column; columns that were not run are absent."""

    case: Case
    cells: Mapping[str, Cell]

    @property
    def failed(self) -> bool:
        """Whether the case failed in some column."""
        return any(cell.outcome == "FAIL" for cell in self.cells.values())

    @property
    def worst(self) -> float | None:
        """The largest difference of a column's image to the oracle's, in 1/255."""
        errors = [cell.error for name, cell in self.cells.items() if cell.error is not None and name != "rtl"]
        return 255 * max(errors) if errors else None


@dataclass(frozen=True)
class FaultRow:
    """A seeded fault: the column whose guard is removed, the case that must fail, whether it did, and its message."""

    name: str
    column: str
    case: str
    caught: bool
    words: str


@dataclass(frozen=True)
class Result:
    """All results of a run."""

    rows: Sequence[Row]
    faults: Sequence[FaultRow]
    seconds: float

    @property
    def failed(self) -> int:
        """Number of cases that failed in some column."""
        return sum(row.failed for row in self.rows)

    @property
    def missed(self) -> int:
        """Number of faults that no case noticed."""
        return sum(not fault.caught for fault in self.faults)

    @property
    def record(self) -> dict[str, object]:
        """The content of stability.json."""
        return {
            "cases": len(self.rows), "failed": self.failed, "seeded_faults": len(self.faults),
            "seeded_faults_caught": len(self.faults) - self.missed, "columns": list(self.columns),
            "seconds": round(self.seconds, 1),
            "results": {row.case.id: {
                "what": row.case.what, "expected": row.case.expected, "worst_error_255": row.worst,
                "columns": {name: asdict(cell) for name, cell in row.cells.items()}} for row in self.rows},
            "faults": [asdict(fault) for fault in self.faults]}

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that were run."""
        return tuple(name for name in COLUMNS if any(name in row.cells for row in self.rows))


def read_record(folder: Path) -> dict[str, object]:
    """The content of a folder's stability.json; empty where there is none."""
    path = folder / "stability.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def added(cases: Sequence[Case], before: Mapping[str, object], now: Result) -> Result:
    """A new result combined with an earlier one: cells and faults of columns that were not run now are taken from the
    earlier."""
    new = {row.case.id: row.cells for row in now.rows}
    rows = []
    for case in cases:
        old = before.get("results", {}).get(case.id, {}).get("columns", {})
        cells = {name: Cell(**values) for name, values in old.items()} | dict(new.get(case.id, {}))
        if cells:
            rows.append(Row(case, cells))
    run = {(fault.column, fault.name) for fault in now.faults}
    faults = [FaultRow(**fault) for fault in before.get("faults", ()) if (fault["column"], fault["name"]) not in run]
    return Result(rows, [*faults, *now.faults], now.seconds + before.get("seconds", 0.0))


def _error(row: Row) -> str:
    return "" if row.worst is None else f"{row.worst:.3f}"


def table(result: Result) -> list[str]:
    """The lines of the table for the screen."""
    width = max(len(row.case.id) for row in result.rows)
    lines = [f"{'case':<{width}}  " + "".join(f"{HEADINGS[name]:<10}" for name in result.columns) + "worst error, 1/255"]
    for row in result.rows:
        outcomes = "".join(f"{row.cells[name].outcome if name in row.cells else '':<10}" for name in result.columns)
        lines.append(f"{row.case.id:<{width}}  {outcomes}{_error(row)}".rstrip())
    for row in result.rows:
        lines += [f"{row.case.id}, {HEADINGS[name]}: {cell.words}"
                  for name, cell in row.cells.items() if cell.outcome == "FAIL"]
    for fault in result.faults:
        if not fault.caught:
            lines.append(f"not caught: {fault.name} ({fault.column}), by {fault.case}: {fault.words}")
    return [*lines, summary(result)]


def summary(result: Result) -> str:
    """A summary in one line."""
    caught = f"; {len(result.faults) - result.missed} of {len(result.faults)} seeded faults caught" if result.faults else ""
    return f"{len(result.rows)} cases, {result.failed} failed{caught}; {result.seconds / 60:.1f} minutes"


def write(result: Result, folder: Path) -> None:
    """Writes stability.json, from which the study `stability` makes a page and a picture."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "stability.json", result.record)
