"""The budget rule: what leaves one unit late must be wanted late by the next, so that both fit into one clock.

    late(budget(interfaces), clock_ps=1000.0, uncertainty=0.05)

It adds up the stored interfaces of the units (`synth.interfaces`), port by port: an output's arrival, the ways through the
modules in between, and what the input at the end needs. That takes seconds and neither OpenSTA nor a cell library. A bus counts
as one port with the times of its slowest bits, so a way that no signal takes may be added up: the rule can be stricter than the
run over the linked machine (`synth.linked`). It is laxer where a port drives more than the load that units are measured with.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from synth import timing
from synth.interfaces import Interface
from synth.machine import UNIT_GROUPS, label

PORTS = "ports"
"""The name of what is outside the machine."""

Node = tuple[str, str]
"""A port of a module: the module's path below the machine, and the port's name."""


@dataclass(frozen=True)
class Late:
    """A pair of units of which one sends later than the other allows.

    Attributes:
        start, end: the units; "ports" is what is outside the machine.
        excess_ps: by how much the worst way is longer than the clock allows.
        inputs: the number of inputs of `end` at which ways from `start` are too long; 0 for a way inside one module.
        way: the ports on the worst way, each as its module's path and its name; for a way inside a module, its path.
    """

    start: str
    end: str
    excess_ps: int
    inputs: int
    way: tuple[str, ...]


@dataclass
class Graph:
    """The ports of a machine: where ways begin and end, and how they go on; times in ps.

    Attributes:
        inside: for a module's path, its unit and the longest way between its own registers and memories.
        begins, ends: for a port, the unit and the time from the clock, or to it.
        steps: for a port, the ports behind it and the time to each.
    """

    inside: dict[str, tuple[str, int]] = field(default_factory=dict)
    begins: dict[Node, list[tuple[str, int]]] = field(default_factory=dict)
    ends: dict[Node, list[tuple[str, int]]] = field(default_factory=dict)
    steps: dict[Node, dict[Node, int]] = field(default_factory=dict)


def unit_name(path: str, kind: str) -> str:
    """The name of a module in reports: the unit's, or its kind behind that of the unit that holds it."""
    units = {label(unit): unit or label("") for unit in UNIT_GROUPS}
    return units.get(kind) or f"{re.sub(r'[.]?[^.]+$', '', path)}.{kind}".lstrip(".")


def graph(interfaces: Mapping[str, Interface], top: str, clock_ps: float) -> Graph:
    """The ports of the machine `top`, whose own ports have the shares of the clock that units' ports are synthesised with."""
    found = Graph()
    _add(found, interfaces, "", top)
    own = interfaces[top]
    for port in {*own.needed, *own.through}:
        if not any(port.startswith(f"{inner}.") for inner in own.below):
            found.begins.setdefault(("", port), []).append((PORTS, round(timing.INPUT_DELAY * clock_ps)))
    for port in {*own.arrives, *(end for ends in own.through.values() for end in ends)}:
        if not any(port.startswith(f"{inner}.") for inner in own.below):
            found.ends.setdefault(("", port), []).append((PORTS, round(timing.OUTPUT_DELAY * clock_ps)))
    return found


def _add(found: Graph, interfaces: Mapping[str, Interface], path: str, kind: str) -> None:
    """Add a module and the modules inside it."""
    own, name = interfaces[kind], unit_name(path, kind)

    def node(port: str) -> Node:
        inner = max((inner for inner in own.below if port.startswith(f"{inner}.")), key=len, default=None)
        return (path, port) if inner is None else (f"{path}.{inner}".lstrip("."), port[len(inner) + 1:])

    found.inside[path] = name, own.inside
    for port, time in own.arrives.items():
        found.begins.setdefault(node(port), []).append((name, time))
    for port, time in own.needed.items():
        found.ends.setdefault(node(port), []).append((name, time))
    for start, ends in own.through.items():
        into = found.steps.setdefault(node(start), {})
        for end, time in ends.items():
            into[node(end)] = max(time, into.get(node(end), 0))
    for inner, below in own.below.items():
        _add(found, interfaces, f"{path}.{inner}".lstrip("."), below)


def order(steps: Mapping[Node, Mapping[Node, int]]) -> list[Node]:
    """The ports, each before those behind it.

    Raises:
        ValueError: ways go in a circle; the message has its ports.
    """
    done: list[Node] = []
    state: dict[Node, int] = {}
    for start in steps:
        trail = [(start, iter(steps[start]))] if start not in state else []
        state.setdefault(start, 1)
        while trail:
            node, rest = trail[-1]
            following = next(rest, None)
            if following is None:
                done.append(node)
                state[node] = 2
                trail.pop()
            elif following not in state:
                state[following] = 1
                trail.append((following, iter(steps.get(following, {}))))
            elif state[following] == 1:
                circle = [f"{path}.{port}" for path, port in (step for step, _ in trail)]
                raise ValueError(f"ways through units must not go in a circle: {', '.join(circle)}")
    return done[::-1]


def late(found: Graph, clock_ps: float, uncertainty: float) -> list[Late]:
    """The pairs of units that do not fit into the clock, the worst first."""
    limit = round(clock_ps * (1 - uncertainty))
    arrived: dict[Node, dict[str, tuple[int, Node | None]]] = {}
    for node, begins in found.begins.items():
        for unit, time in begins:
            _later(arrived, node, unit, time, None)
    for node in order(found.steps):
        for following, time in found.steps.get(node, {}).items():
            for unit, (before, _) in arrived.get(node, {}).items():
                _later(arrived, following, unit, before + time, node)
    worst: dict[tuple[str, str], list[tuple[int, Node]]] = {}
    for node, ends in found.ends.items():
        for unit, time in ends:
            for start, (before, _) in arrived.get(node, {}).items():
                if before + time > limit:
                    worst.setdefault((start, unit), []).append((before + time - limit, node))
    pairs = [Late(unit, unit, time - limit, 0, (path,)) for path, (unit, time) in found.inside.items() if time > limit]
    for (start, end), ways in worst.items():
        excess, node = max(ways)
        pairs.append(Late(start, end, excess, len({node for _, node in ways}), _way(arrived, node, start)))
    latest: dict[tuple[str, str], Late] = {}
    for pair in sorted(pairs, key=lambda pair: (-pair.excess_ps, pair.start, pair.end)):
        latest.setdefault((pair.start, pair.end), pair)
    return list(latest.values())


def _later(
    arrived: dict[Node, dict[str, tuple[int, Node | None]]], node: Node, unit: str, time: int, before: Node | None,
) -> None:
    at = arrived.setdefault(node, {})
    if unit not in at or time > at[unit][0]:
        at[unit] = time, before


def _way(arrived: Mapping[Node, Mapping[str, tuple[int, Node | None]]], node: Node, unit: str) -> tuple[str, ...]:
    way: list[str] = []
    step: Node | None = node
    while step is not None:
        way.append(".".join(filter(None, step)))
        step = arrived[step][unit][1]
    return tuple(reversed(way))


def compare(found: list[Late], known: Mapping[tuple[str, str], int]) -> list[str]:
    """What the pairs that are late have against the list of those that are known, in sentences; empty if they agree.

    The list may only shrink: a pair must not be later than its entry, and an entry must not allow more than its pair needs.
    """
    excess = {(pair.start, pair.end): pair.excess_ps for pair in found}
    said = [f"{start} to {end} is {time} ps late, and {known.get((start, end), 0)} are known: cut the way, or show why it is so"
            for (start, end), time in excess.items() if time > known.get((start, end), 0)]
    return said + [
        f"{start} to {end} is known as {time} ps late, and is {excess.get((start, end), 0)}: lower or remove the entry"
        for (start, end), time in known.items() if time > excess.get((start, end), 0)]
