"""Fewest registers for a pipeline of one slot a cycle: operations start as late as it takes, and no later.

A value's registers are its width times the cycles from its birth to its last use; the sum over all values is a convex
function of the start times (L-natural convex: a linear program whose corners are integers). So from the earliest schedule,
moves of a whole set of operations to a later cycle lead to the optimum, as long as one saves registers. The set that saves
most is a maximum closure: an operation earns its own result's width, costs that of operands of which it is the last reader,
and takes with it the readers that follow without a gap. A minimum cut finds it (Picard 1976).
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from math import inf

from rtl.culling.dataflow import Node


class _Cut:
    """A network whose minimum cut is wanted: Dinic's algorithm."""

    def __init__(self) -> None:
        self.room: dict[Hashable, dict[Hashable, float]] = defaultdict(dict)

    def edge(self, a: Hashable, b: Hashable, capacity: float) -> None:
        """Adds capacity from a to b."""
        self.room[a][b] = self.room[a].get(b, 0) + capacity
        self.room[b].setdefault(a, 0)

    def reached(self, source: Hashable) -> dict[Hashable, int]:
        """Distances over edges with room."""
        level, queue = {source: 0}, deque([source])
        while queue:
            a = queue.popleft()
            for b, room in self.room[a].items():
                if room > 0 and b not in level:
                    level[b] = level[a] + 1
                    queue.append(b)
        return level

    def fill(self, source: Hashable, sink: Hashable) -> None:
        """Pushes the largest flow."""
        while sink in (level := self.reached(source)):
            edges = {a: iter(list(self.room[a])) for a in level}
            while self._push(source, sink, inf, level, edges):
                pass

    def _push(self, a: Hashable, sink: Hashable, flow: float, level: dict, edges: dict) -> float:
        if a == sink:
            return flow
        for b in edges[a]:
            if self.room[a][b] > 0 and level.get(b) == level[a] + 1:
                pushed = self._push(b, sink, min(flow, self.room[a][b]), level, edges)
                if pushed:
                    self.room[a][b] -= pushed
                    self.room[b][a] += pushed
                    edges[a] = _before(b, edges[a])  # it may have room for more
                    return pushed
        return 0


def _before(first: Hashable, rest: Iterator[Hashable]) -> Iterator[Hashable]:
    yield first
    yield from rest


def fewest_registers(
    timed: Sequence[Node], readers: Mapping[Node, Sequence[Node]], start: dict[Node, int], birth: Callable[[Node], int],
    first_use: Callable[[Node], int], length: int,
) -> None:
    """Moves the nodes of an earliest schedule, in place, to where the fewest registers are needed.

    Args:
        timed: nodes that have a start.
        readers: of every value, inputs included, the nodes that read it; not empty.
        start: their starts.
        birth, first_use: cycles of a value under `start`.
        length: the cycle at which all values must be born.
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
    """The nodes that save most when they start a cycle later; empty where no set saves anything."""
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
