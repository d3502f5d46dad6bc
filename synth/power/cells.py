"""Library cells as power analysis needs them: functions, capacitances, tables of delay, slew and energy, and leakage.

The units of the liberty file are kept: ps, fF, fJ (1 fF at 1 V squared) and pW. The file gives an `internal_power` group for
each supply. Only the groups of VDD are read, because what flows into ground came out of VDD. Over a rise and a fall they add up
to the energy that the cell dissipates in addition to the energy of its load.
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
        kind, name: kind and name of the group.
        values: the group's attributes by name, as text.
        groups: the groups inside it.
    """

    kind: str
    name: str
    values: dict[str, str] = field(default_factory=dict)
    groups: list[Group] = field(default_factory=list)

    def all(self, kind: str) -> Iterator[Group]:
        """The groups of this kind directly inside."""
        return (group for group in self.groups if group.kind == kind)


@dataclass(frozen=True)
class Table:
    """A table over input slew (ps) and load (fF); over slew alone if `loads` is empty."""

    slews: np.ndarray
    loads: np.ndarray
    values: np.ndarray

    def at(self, slew: float) -> float:
        """The interpolated value of a table over slew alone."""
        return float(np.interp(slew, self.slews, self.values))


NOTHING = Table(np.array([5.0, 320.0]), np.empty(0), np.zeros(2))
"""The energy table of a pin for which the library states none."""


@dataclass(frozen=True)
class Arc:
    """The arc from an input pin to an output pin; rise and fall are averaged."""

    delay: Table
    slew: Table


@dataclass(frozen=True)
class Output:
    """An output pin.

    Attributes:
        truth: value for each combination of inputs, the first pin as lowest bit; None for a flip-flop or a clock gate.
        arcs: the arc from each input pin.
        energy: for each input pin, energy in fJ of a toggle that it causes: mean of rise and fall, without the load's energy.
    """

    truth: np.ndarray | None
    arcs: dict[str, Arc]
    energy: dict[str, Table]


@dataclass(frozen=True)
class Cell:
    """A library cell.

    Attributes:
        name, area: name of the cell, and its area in um2.
        kind: "logic", "flop" or "gate" (a clock gate).
        inputs: names of the input pins.
        capacitance: capacitance of each input pin in fF, mean of rise and fall.
        outputs: the output pins by name.
        passive: for each input pin, energy in fJ over slew of a toggle that leaves the outputs unchanged: mean over states. For
            a clock pin it is the energy of a whole cycle.
        edge: the same for a clock pin's rise alone; `Output.energy` includes it when the output follows the edge.
        leakage: pW, mean over states as the library states it.
        inverted: the output of a flip-flop is the complement of its data.
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
    """Read the wanted cells from liberty files, plain or gzipped; KeyError names the cells that no file has."""
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
    """Parses the first group of a text; ValueError if it is not closed."""
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
    """The mean of all tables of these kinds in the groups. Scalars are left out; they stand for states that cannot occur."""
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
    """The energy of an input pin: for a clock pin the sum over the kinds, for others their mean."""
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
