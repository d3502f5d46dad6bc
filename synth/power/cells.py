"""Library cells as power analysis sees them: functions, capacitances, delay, slew and energy tables, leakage.

The liberty's units are kept: ps, fF, fJ (1 fF at 1 V squared) and pW. An `internal_power` group is given for each supply; what
flows into ground is what came out of VDD, so that only the groups of VDD are read: over a rise and a fall they sum to what
the cell dissipates beside its load's energy.
"""

from __future__ import annotations

import gzip
import itertools
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass
class Group:
    """A liberty group: `kind (name) { ... }`.

    Attributes:
        kind, name: of the group.
        values: attributes by name, as text.
        groups: those inside.
    """

    kind: str
    name: str
    values: dict[str, str] = field(default_factory=dict)
    groups: list[Group] = field(default_factory=list)

    def all(self, kind: str) -> Iterator[Group]:
        """Groups of a kind inside."""
        return (group for group in self.groups if group.kind == kind)


@dataclass(frozen=True)
class Table:
    """A table over input slew (ps) and load (fF); of one dimension where `loads` is empty."""

    slews: np.ndarray
    loads: np.ndarray
    values: np.ndarray

    def at(self, slew: float) -> float:
        """Of a table of one dimension."""
        return float(np.interp(slew, self.slews, self.values))


NOTHING = Table(np.array([5.0, 320.0]), np.empty(0), np.zeros(2))
"""The energy of a pin that the library gives none."""


@dataclass(frozen=True)
class Arc:
    """An input pin's way to an output pin, rise and fall averaged."""

    delay: Table
    slew: Table


@dataclass(frozen=True)
class Output:
    """An output pin.

    Attributes:
        truth: by the inputs' bits, first pin lowest; None of a flip-flop and a clock gate.
        arcs: by input pin.
        energy: of a toggle, fJ, by input pin: mean of rise and fall. Without the load's.
    """

    truth: np.ndarray | None
    arcs: dict[str, Arc]
    energy: dict[str, Table]


@dataclass(frozen=True)
class Cell:
    """A library cell.

    Attributes:
        name, area: of the cell, um2.
        kind: "logic", "flop" or "gate" (of a clock).
        inputs: pins.
        capacitance: of input pins, fF: mean of rise and fall.
        outputs: by pin.
        passive: energy, fJ by slew, of an input pin that toggles, the outputs keeping still: mean over states. Of a clock pin
            that of a whole cycle.
        edge: of a clock pin's rise alone, which `Output.energy` has in it where the output follows.
        leakage: pW, mean over states as the library states it.
        inverted: of a flip-flop, the output is the complement.
    """

    name: str
    area: float
    kind: str
    inputs: tuple[str, ...]
    capacitance: dict[str, float]
    outputs: dict[str, Output]
    passive: dict[str, Table]
    edge: Table
    leakage: float
    inverted: bool = False


def read_cells(paths: Iterable[Path], wanted: Iterable[str]) -> dict[str, Cell]:
    """The wanted cells of some liberty files, plain or gzipped; KeyError names those that none has."""
    wanted, found = set(wanted), {}
    for path in paths:
        text = gzip.open(path, "rt").read() if path.suffix == ".gz" else path.read_text()
        starts = [(match[1], match.start()) for match in re.finditer(r"(?m)^\s*cell \((\w+)\) \{", text)]
        for (name, start), (_, end) in itertools.pairwise([*starts, ("", len(text))]):
            if name in wanted:
                found[name] = _cell(_parse(text[start:end]))
    missing = wanted - found.keys()
    if missing:
        raise KeyError(f"liberty files must have {', '.join(sorted(missing))}")
    return found


def _parse(text: str) -> Group:
    """The first group of a text."""
    text = re.sub(r"(?s)\bstatetable \(.*?\}", "", re.sub(r"\\\s*\n", " ", text))
    stack: list[Group] = []
    for line in text.splitlines():
        line = line.strip()
        if opened := re.match(r'(\w+)\s*\((.*?)\)\s*\{', line):
            group = Group(opened[1], opened[2].strip('" '))
            if stack:
                stack[-1].groups.append(group)
            stack.append(group)
        elif line.startswith("}"):
            done = stack.pop()
            if not stack:
                return done
        elif pair := re.match(r"(\w+)\s*:\s*(.*?)\s*;?$", line):
            stack[-1].values[pair[1]] = pair[2].strip('"')
        elif pair := re.match(r"(\w+)\s*\((.*)\)\s*;", line):
            stack[-1].values[pair[1]] = pair[2]
    raise ValueError("liberty text must close its groups")


def _cell(group: Group) -> Cell:
    pins = {pin.name: pin for pin in group.all("pin")}
    inputs = tuple(name for name, pin in pins.items() if pin.values.get("direction") == "input")
    flop = next(group.all("ff"), None)
    kind = "flop" if flop else "gate" if "clock_gating_integrated_cell" in group.values else "logic"
    outputs = {
        name: _output(pin, inputs, kind) for name, pin in pins.items() if pin.values.get("direction") == "output"}
    leakage = next(
        float(g.values["value"]) for g in group.all("leakage_power") if "when" not in g.values and _of_supply(g))
    inverted = False
    if flop:
        (pin,) = (pins[name] for name in outputs)
        variables = [name.strip() for name in flop.name.split(",")]
        inverted = (pin.values["function"] == variables[1]) != flop.values["next_state"].startswith("!")
    return Cell(
        group.name, float(group.values["area"]), kind, inputs,
        {name: (float(pins[name].values["rise_capacitance"]) + float(pins[name].values["fall_capacitance"])) / 2
         for name in inputs},
        outputs, {name: _passive(pins[name], ("rise_power", "fall_power")) for name in inputs},
        _passive(pins["CLK"], ("rise_power",)) if "CLK" in pins else NOTHING, leakage, inverted)


def _of_supply(group: Group) -> bool:
    return group.values.get("related_pg_pin", "VDD") == "VDD"


def _output(pin: Group, inputs: tuple[str, ...], kind: str) -> Output:
    arcs: dict[str, list[Group]] = {}
    for timing in pin.all("timing"):
        if any(timing.all("cell_rise")) or any(timing.all("cell_fall")):
            arcs.setdefault(timing.values["related_pin"], []).append(timing)
    powers: dict[str, list[Group]] = {}
    for power in pin.all("internal_power"):
        if _of_supply(power):
            powers.setdefault(power.values["related_pin"], []).append(power)
    return Output(
        _truth(pin.values["function"], inputs) if kind == "logic" else None,
        {name: Arc(_mean(groups, "cell_rise", "cell_fall"), _mean(groups, "rise_transition", "fall_transition"))
         for name, groups in arcs.items()},
        {name: _mean(groups, "rise_power", "fall_power") for name, groups in powers.items()})


def _mean(groups: Iterable[Group], *kinds: str) -> Table:
    """The mean of all tables of the kinds in the groups; scalars, which stand for states that cannot be, are left out."""
    tables = [_table(table) for group in groups for kind in kinds for table in group.all(kind) if table.name != "scalar"]
    return Table(tables[0].slews, tables[0].loads, np.mean([table.values for table in tables], axis=0))


def _table(group: Group) -> Table:
    rows = [_numbers(row) for row in re.findall(r'"([^"]*)"', group.values["values"])]
    loads = _numbers(group.values["index_2"].strip('"')) if "index_2" in group.values else np.empty(0)
    values = np.array(rows) if len(loads) else np.array(rows).ravel()
    return Table(_numbers(group.values["index_1"].strip('"')), loads, values)


def _numbers(text: str) -> np.ndarray:
    return np.array([float(number) for number in text.split(",")])


def _passive(pin: Group, kinds: tuple[str, ...]) -> Table:
    """Of a clock pin the sum over the kinds, of others the mean."""
    groups = [group for group in pin.all("internal_power") if _of_supply(group)]
    clock = pin.values.get("clock") == "true" or "clock_gate_clock_pin" in pin.values
    tables = [[_table(t) for group in groups for t in group.all(kind) if t.name != "scalar"] for kind in kinds]
    if not all(tables):
        return NOTHING
    means = [np.mean([table.values for table in some], axis=0) for some in tables]
    return Table(tables[0][0].slews, np.empty(0), sum(means) if clock else sum(means) / len(means))


def _truth(function: str, inputs: tuple[str, ...]) -> np.ndarray:
    if not re.fullmatch(r"[\w!*+() ]+", function):
        raise ValueError(f"function must be of names, !, *, + and parentheses, not {function!r}")
    code = compile(function.replace("!", " not ").replace("*", " and ").replace("+", " or ").strip(), "function", "eval")
    rows = range(1 << len(inputs))
    return np.array([
        bool(eval(code, {"__builtins__": {}}, {pin: bool(row >> i & 1) for i, pin in enumerate(inputs)})) for row in rows],
        np.uint8)
