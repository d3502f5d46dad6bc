"""Finds the schedule with the fewest registers for a pipeline that takes one slot per cycle.

A value needs its width times the cycles from its birth to its last use in register bits. The sum over all values is a convex
function of the start times (L-natural convex: a linear program whose corners are integers). So the optimum is reached from the
earliest schedule by moving sets of operations to a later cycle as long as a move saves registers. The set that saves most is a
maximum closure: moving an operation saves the width of its result, costs the width of the operands that it reads last, and also
moves the readers that follow without a gap. A minimum cut finds this set (Picard 1976).
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from math import inf
from typing import Any

from rtl.culling.dataflow import Node


class _Cut:
    """A network, and Dinic's algorithm to find its minimum cut. `room` holds the residual capacities."""

    def __init__(self) -> None:
        self.room: dict[Hashable, dict[Hashable, float]] = defaultdict(dict)

    def edge(self, a: Hashable, b: Hashable, capacity: float) -> None:
        """Adds capacity to the edge from a to b."""
        self.room[a][b] = self.room[a].get(b, 0) + capacity
        self.room[b].setdefault(a, 0)

    def reached(self, source: Hashable) -> dict[Hashable, int]:
        """The distances from `source` over edges with residual capacity, for all nodes that are reached."""
        level, queue = {source: 0}, deque([source])
        while queue:
            a = queue.popleft()
            for b, room in self.room[a].items():
                if room > 0 and b not in level:
                    level[b] = level[a] + 1
                    queue.append(b)
        return level

    def fill(self, source: Hashable, sink: Hashable) -> None:
        """Pushes the maximum flow from `source` to `sink`."""
        while sink in (level := self.reached(source)):
            edges = {a: iter(list(self.room[a])) for a in level}
            while self._push(source, sink, inf, level, edges):
                pass

    def _push(self, a: Hashable, sink: Hashable, flow: float, level: dict[Hashable, int], edges: dict[Hashable, Any]) -> float:
        if a == sink:
            return flow
        for b in edges[a]:
            if self.room[a][b] > 0 and level.get(b) == level[a] + 1:
                pushed = self._push(b, sink, min(flow, self.room[a][b]), level, edges)
                if pushed:
                    self.room[a][b] -= pushed
                    self.room[b][a] += pushed
                    edges[a] = _before(b, edges[a])  # this edge may have residual capacity for more
                    return pushed
        return 0


def _before(first: Hashable, rest: Iterator[Hashable]) -> Iterator[Hashable]:
    yield first
    yield from rest


def fewest_registers(
    timed: Sequence[Node], readers: Mapping[Node, Sequence[Node]], start: dict[Node, int], birth: Callable[[Node], int],
    first_use: Callable[[Node], int], length: int,
) -> None:
    """Moves the nodes of an earliest schedule, in place, to the start times that need the fewest registers.

    Args:
        timed: the nodes that have a start time.
        readers: for every value, inputs included, the nodes that read it; values without readers are ignored.
        start: the start times, which are changed.
        birth, first_use: functions that give, under `start`, a value's birth and the first cycle in which it can be read.
        length: the cycle by which all values must be born.
    """
    values = [value for value in readers if readers[value]]
    while moved := _closure(timed, values, readers, start, birth, first_use, length):
        step = min((length - birth(node) for node in moved), default=0)
        for value in values:
            last = max(start[reader] for reader in readers[value])
            ends_later = any(start[reader] == last for reader in readers[value] if reader in moved)
            for reader in readers[value]:
                if value in moved and reader not in moved:
                    step = min(step, start[reader] - first_use(value))
                if reader in moved and not ends_later:
                    step = min(step, last - start[reader])
        for node in moved:
            start[node] += step


def _closure(
    timed: Sequence[Node], values: Sequence[Node], readers: Mapping[Node, Sequence[Node]], start: dict[Node, int],
    birth: Callable[[Node], int], first_use: Callable[[Node], int], length: int,
) -> set[Node]:
    """The set of nodes that saves most registers when it starts a cycle later; empty where no set saves any."""
    cut = _Cut()
    for node in timed:
        if birth(node) >= length:
            cut.edge(node, "sink", inf)
    for value in values:
        if value in start:
            cut.edge("source", value, value.width)
        last = max(start[reader] for reader in readers[value])
        cut.edge(("registers", value), "sink", value.width)
        for reader in readers[value]:
            if start[reader] == last:
                cut.edge(reader, ("registers", value), inf)
            if value in start and start[reader] == first_use(value):
                cut.edge(value, reader, inf)
    cut.fill("source", "sink")
    found = cut.reached("source")
    return {node for node in timed if node in found}
