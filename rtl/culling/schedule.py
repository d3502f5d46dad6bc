"""Schedules a graph: in which cycle after its slot entered each operation starts, and which instance of an operator does it.

At most one slot enters every `interval` cycles. Two operations can share an instance if their start times differ modulo the
interval, because then they never meet, whichever slots they belong to. (This is modulo scheduling; as the graph has no loops,
every interval is feasible.) The birth of a value is the cycle in which it is first available. A value that is born in cycle b
and last read in cycle u is held by a chain of ceil((u - b) / interval) registers, each of which moves once per interval.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil
from typing import Any

from rtl.culling.dataflow import Dataflow, Node, Operator
from rtl.culling.retime import fewest_registers

_PASSES = 20


@dataclass(frozen=True)
class Schedule:
    """The schedule of a graph at an interval. All cycles are counted from the entry of a slot.

    Attributes:
        graph, interval: what was scheduled.
        start: cycle in which each node, an operation or logic, takes its operands.
        instance: number of the operator instance that does each operation, from 0 for each kind of operator.
        length: cycle in which the last output is born and written to the output queue.
    """

    graph: Dataflow
    interval: int
    start: dict[Node, int]
    instance: dict[Node, int]
    length: int

    def birth(self, node: Node) -> int:
        """The cycle in which a value is first available: that of an operation at its unit's output, others before their
        register."""
        return _birth(node.stored, self.start)

    def place(self, node: Node, cycle: int) -> int:
        """The number of registers between a value's source and the place where it is read in that cycle."""
        return 0 if node.stored.steady else ceil((cycle - self.birth(node)) / self.interval)

    def copies(self) -> dict[Node, int]:
        """The number of registers of every value that is held."""
        found: dict[Node, int] = defaultdict(int)
        for node, start in self.start.items():
            for operand in node.operands:
                if not operand.stored.steady:
                    found[operand.stored] = max(found[operand.stored], self.place(operand, start))
        return found

    @property
    def instances(self) -> dict[Operator, list[list[Node]]]:
        """The operations of every instance, for every kind of operator."""
        found: dict[Operator, list[list[Node]]] = {}
        for node, number in self.instance.items():
            users = found.setdefault(_operator(node), [])
            users.extend([] for _ in range(number + 1 - len(users)))
            users[number].append(node)
        return found

    @property
    def depth(self) -> int:
        """Rows of the output queue: the number of slots between entry and the output register at full rate."""
        return ceil((self.length + 2) / self.interval)


@dataclass(frozen=True)
class Cost:
    """Estimate of the hardware that a schedule needs, before synthesis.

    Attributes:
        operators: number of instances by kind of unit.
        register_bits: register bits that hold values outside the operators.
        mux_bits: number of two-to-one multiplexers of one bit before the operators.
        queue_bits: bits of memory for outputs and carried data.
        latency: least number of cycles from entry to the source.
    """

    operators: dict[str, int]
    register_bits: int
    mux_bits: int
    queue_bits: int
    latency: int


def cost(schedule: Schedule, carried_bits: int = 0) -> Cost:
    """The cost of a schedule; `carried_bits` is the width of the data that is carried beside the graph."""
    operators: Counter[str] = Counter()
    mux_bits = 0
    for kind, users in schedule.instances.items():
        operators[kind.unit.__name__] += len(users)
        for nodes in users:
            for port, number in enumerate(kind.operands):
                sources = {source(schedule, node, port) for node in nodes}
                mux_bits += (len(sources) - 1) * number.width
    register_bits = sum(count * node.width for node, count in schedule.copies().items())
    queue_bits = schedule.depth * (carried_bits + sum(node.width for node in schedule.graph.outputs.values()))
    return Cost(dict(sorted(operators.items())), register_bits, mux_bits, queue_bits, schedule.length + 2)


def source(schedule: Schedule, node: Node, port: int) -> tuple[Node, int]:
    """Where an operation reads an operand: the node, and the number of registers behind it."""
    operand = node.operands[port]
    return operand, schedule.place(operand, schedule.start[node])


def _duration(node: Node) -> int:
    """Cycles from the start of a node to the birth of its value."""
    return node.operator.latency if node.operator else 0


def _birth(node: Node, start: dict[Node, int]) -> int:
    return start.get(node, 0) + _duration(node)


def _first_use(node: Node, start: dict[Node, int]) -> int:
    """The first cycle in which other nodes can read a node's value; inputs and logic are registered before that."""
    node = node.stored
    return 0 if node.steady else _birth(node, start) + (node.operator is None)


class _Scheduler:
    """The algorithm of `schedule`: list scheduling, then moves of operations that save registers."""

    def __init__(self, graph: Dataflow, interval: int) -> None:
        self.graph, self.interval = graph, interval
        live = _live(graph)
        self.timed = [node for node in graph.nodes if node.kind in ("operation", "logic") and node in live]
        self.readers: dict[Node, list[Node]] = defaultdict(list)
        for node in self.timed:
            for stored in _sources(node):
                self.readers[stored].append(node)
        self.start: dict[Node, int] = {}
        counts = Counter(node.operator for node in self.timed if node.operator)
        self.instances = {kind: ceil(count / interval) for kind, count in counts.items()}
        self.busy: Counter[tuple[Operator, int]] = Counter()

    def earliest(self, node: Node) -> int:
        return max((_first_use(operand, self.start) for operand in node.operands), default=1)

    def free(self, node: Node, cycle: int) -> bool:
        kind = node.operator
        return kind is None or self.busy[kind, cycle % self.interval] < self.instances[kind]

    def put(self, node: Node, cycle: int) -> None:
        self.start[node] = cycle
        if node.operator:
            self.busy[node.operator, cycle % self.interval] += 1

    def take(self, node: Node) -> int:
        cycle = self.start.pop(node)
        if node.operator:
            self.busy[node.operator, cycle % self.interval] -= 1
        return cycle

    def place_all(self) -> None:
        """Places the most urgent nodes first, each in the earliest cycle in which an instance is free."""
        urgency: dict[Node, int] = {}
        for node in reversed(self.timed):
            after = max((urgency[reader] for reader in self.readers[node]), default=0)
            urgency[node] = after + _duration(node) + (node.operator is None)
        waiting = list(self.timed)
        while waiting:
            ready = [n for n in waiting if all(s in self.start for s in _sources(n) if s.kind != "input")]
            node = min(ready, key=lambda n: (self.earliest(n) - urgency[n], self.earliest(n)))
            self.put(node, next(c for c in range(self.earliest(node), 1 << 30) if self.free(node, c)))
            waiting.remove(node)

    def length(self) -> int:
        """The cycle in which the last output is born."""
        return max(_birth(node.stored, self.start) for node in self.graph.outputs.values())

    def latest(self, node: Node, length: int) -> int:
        """The last cycle in which a node can start so that all its readers have its value in time."""
        limits = [self.start[reader] - (node.operator is None) for reader in self.readers[node]]
        return min(limits, default=length) - _duration(node)

    def bits(self, values: set[Node]) -> int:
        """The register bits that hold these values."""
        total = 0
        for value in values:
            uses = [self.start[reader] for reader in self.readers[value] if reader in self.start]
            total += value.width * ceil((max(uses) - _birth(value, self.start)) / self.interval) if uses else 0
        return total

    def improve(self) -> None:
        """Saves registers: finds the least number at interval 1, or moves single nodes where operators are shared."""
        if self.interval == 1:
            fewest_registers(
                self.timed, self.readers, self.start, lambda node: _birth(node, self.start),
                lambda node: _first_use(node, self.start), self.length())
            return
        length, best = self.length(), (self.bits(set(self.readers)), dict(self.start))
        for _ in range(_PASSES):
            for node in sorted(self.timed, key=lambda node: -self.start[node]):
                self.improve_one(node, length)
            best = min(best, (self.bits(set(self.readers)), dict(self.start)), key=lambda found: found[0])
        self.start = best[1]

    def improve_one(self, node: Node, length: int) -> None:
        """Moves a node to the cycle with the fewest registers; of several, to the latest, which leaves its operands more
        freedom."""
        touched: set[Node] = {node, *_sources(node)}
        best: tuple[int, int] | None = None
        self.take(node)
        for cycle in range(self.earliest(node), self.latest(node, length) + 1):
            if self.free(node, cycle):
                self.start[node] = cycle
                now = (self.bits(touched), -cycle)
                best = min(best or now, now)
        assert best is not None, f"{node.name} fits in no cycle"
        self.put(node, -best[1])

    def assign(self) -> dict[Node, int]:
        """Chooses instances: an operation goes to the free instance whose ports already read most of its operands' places."""
        made = Schedule(self.graph, self.interval, self.start, {}, 0)
        instance: dict[Node, int] = {}
        taken: set[tuple[Any, int, int]] = set()
        known: dict[Any, set[Any]] = defaultdict(set)
        for node in sorted((n for n in self.timed if n.operator), key=lambda n: self.start[n]):
            kind, phase = _operator(node), self.start[node] % self.interval
            places = {(port, *source(made, node, port)) for port in range(len(node.operands))}
            choices = [i for i in range(self.instances[kind]) if (kind, i, phase) not in taken]
            number = min(choices, key=lambda i: (len(places - known[kind, i]), len(known[kind, i])))
            taken.add((kind, number, phase))
            known[kind, number] |= places
            instance[node] = number
        return instance


def _operator(node: Node) -> Operator:
    assert node.operator, f"{node.name} is no operation"
    return node.operator


def _sources(node: Node) -> Iterator[Node]:
    """The nodes whose registers a node reads; settings and constants have none."""
    return (operand.stored for operand in node.operands if not operand.stored.steady)


def _live(graph: Dataflow) -> set[Node]:
    """The nodes on which an output depends."""
    found, todo = set(), list(graph.outputs.values())
    while todo:
        node = todo.pop()
        if node not in found:
            found.add(node)
            todo += node.operands
    return found


def schedule(graph: Dataflow, interval: int) -> Schedule:
    """Schedules a graph for one slot every `interval` cycles. The result is deterministic.

    Raises:
        TypeError, ValueError: a bad interval, or a graph without outputs.
    """
    if not isinstance(interval, int) or isinstance(interval, bool):
        raise TypeError(f"interval must be an integer, not {interval!r}")
    if interval < 1:
        raise ValueError(f"interval must be at least 1, not {interval!r}")
    if not graph.outputs:
        raise ValueError(f"graph must have an output, not {graph.outputs!r}")
    work = _Scheduler(graph, interval)
    work.place_all()
    work.improve()
    return Schedule(graph, interval, dict(work.start), work.assign(), work.length())
