"""Which ways are taken at the choices of a unit, by Verilator's counts: both values of every select, and every case.

A choice is a `?:` of the unit's Verilog, of which the condition is true or false, or a `casez`, of which one case is taken.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from msv2.cases.counts import Point
from spec.paths import ROOT

WAYS = {"cond_then": "true", "cond_else": "false", "if": "true", "else": "false", "elsif": "true", "case": "taken"}
"""Ways at a choice, by Verilator's word for the point."""

_SOURCE = re.compile(r'\(\* src = "([^"]*?):(\d+)[^"]*" \*\)\s*')
_BEFORE = re.compile(r"^(?:assign \\?\S+ *(?:\[[^]]*\] *)?= |(?:else )?if \()")
_AFTER = re.compile(r"(?: \? .*|\)|:)$")
_UNNAMED = re.compile(r"_\d+_")

LONGEST = 60
"""Letters of a condition that are shown."""


@dataclass(frozen=True)
class Way:
    """A way at a choice.

    Attributes:
        module: the module. line: the line of its Verilog, from 1 on.
        condition: the condition that is true or false, or the case that is taken.
        way: one of the values of WAYS.
        source: the line of Python, "rtl/x.py:7", or "" where the Verilog does not name it.
        taken: whether it was taken.
    """

    module: str
    line: int
    condition: str
    way: str
    source: str
    taken: bool


def ways(points: Iterable[Point], verilog: str) -> list[Way]:
    """The ways of the counts, in the order of the Verilog. Instances of a module are counted together."""
    sums: dict[tuple[int, int, str, str], int] = defaultdict(int)
    for point in points:
        if point.kind in ("branch", "line") and point.what in WAYS:
            sums[point.line, point.column, point.module, WAYS[point.what]] += point.count
    lines = verilog.splitlines()
    made_by = unnamed(lines)
    return [Way(module, line, condition(lines[line - 1], made_by[line - 1]), way, source(lines[line - 1]), count > 0)
            for (line, _, module, way), count in sorted(sums.items())]


def unnamed(lines: Sequence[str]) -> list[Mapping[str, str]]:
    """For every line, what the nets without a name are in its module, `_12_` to "a & b"."""
    found: list[Mapping[str, str]] = []
    here: dict[str, str] = {}
    for line in lines:
        if line.startswith("module "):
            here = {}
        if made := re.match(r"\s*assign (_\d+_) = (.*);$", line):
            here[made[1]] = _SOURCE.sub("", made[2])
        found.append(here)
    return found


def condition(line: str, made_by: Mapping[str, str]) -> str:
    """The condition in a line of Verilog with a choice, or its case, without attributes. Of a net that has no name it is what
    the net is made of."""
    text = _AFTER.sub("", _BEFORE.sub("", _SOURCE.sub("", line).strip())).strip()
    if _UNNAMED.fullmatch(text):
        text = made_by.get(text, text)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def source(line: str) -> str:
    """The line of Python that a line of Verilog names, with its path below the project, or ""."""
    found = _SOURCE.search(line)
    if not found:
        return ""
    path = found[1].removeprefix(f"{ROOT}/")
    return f"{path.rpartition('site-packages/')[2]}:{found[2]}"


def lines_of(found: Iterable[Way]) -> dict[str, bool]:
    """The lines of Python with choices, and whether every way at them was taken."""
    whole: dict[str, bool] = {}
    for way in found:
        if way.source:
            whole[way.source] = whole.get(way.source, True) and way.taken
    return whole


def holes(found: Iterable[Way]) -> list[str]:
    """The ways that were not taken, as "module: condition is never true (rtl/x.py:7)"."""
    return [f"{way.module}: {way.condition} is never {way.way}" + (f" ({way.source})" if way.source else "")
            for way in found if not way.taken]
