"""Bit heaps: builds sums of products as trees of the library's full adder, which Yosys and ABC do not infer.

A full adder removes one bit from the heap, so a heap of n bits and m results needs n - m of them in any order. The order
decides depth, half adders and polarity. The columns are reduced to two bits each, from the lowest column up, always adding the
three bits that arrive first (Oklobdzija's three-greedy approach). A ripple chain adds the two remaining rows. If that is too
slow, the top of the chain is cut into blocks that are added without a carry in and then incremented by the carry that arrives.
Where that is too slow as well, the carry skips a block in one gate, behind gates that tell beforehand whether all of its bits
are ones.

The library's adder has inverted outputs, and complementing all five pins of a full adder leaves it a full adder. So an adder is
used either *straight* (true inputs, inverted outputs) or *flipped* (inverted inputs, true outputs), and an inverter is needed
only where two straight or two flipped adders meet. Flips are chosen to need few inverters.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple

SUM_DELAY, CARRY_DELAY, GATE_DELAY = 60.0, 36.0, 25.0  # ps under a typical load; they only decide orders
BLOCK_GATE_DELAY = 28.0  # ps of the wide gates behind a block; it decides where blocks are cut
SMALLEST_BLOCK, LARGEST_BLOCK = 3, 16
CHAIN_WEIGHT = 3  # an inverter in the carry chain costs time as well as area


@dataclass(eq=False)
class Bit:
    """A bit of the heap: an external net, a product, or an output of a node.

    Attributes:
        net: the external net (an integer of the netlist, or a constant "0" or "1").
        product: two nets whose AND is this bit; both polarities of it cost the same.
        inverted: the external net, or the product, is the complement of the bit.
        source: the node that drives the bit.
        time: estimated arrival time in ps.
    """

    net: int | str | None = None
    product: tuple[int, int] | None = None
    inverted: bool = False
    source: Adder | Gate | None = None
    time: float = 0.0


@dataclass(eq=False)
class Adder:
    """A full adder of three bits, or of two bits and a constant 0."""

    inputs: list[Bit]
    flipped: bool = False
    sum: Bit = field(default_factory=Bit)
    carry: Bit = field(default_factory=Bit)

    def __post_init__(self) -> None:
        latest = max(bit.time for bit in self.inputs)
        self.sum.source = self.carry.source = self
        self.sum.time, self.carry.time = latest + SUM_DELAY, latest + CARRY_DELAY


@dataclass(eq=False)
class Gate:
    """A simple gate: ANDn, XOR2, or AO21 (the AND of the first two inputs, ORed with the third). Its output is not inverted."""

    kind: str
    inputs: list[Bit]
    output: Bit = field(default_factory=Bit)

    def __post_init__(self) -> None:
        self.output.source = self
        self.output.time = max(bit.time for bit in self.inputs) + GATE_DELAY


Node = Adder | Gate


def add_up(
    columns: list[list[Bit]], blocks: Sequence[int] = (), in_levels: bool = False, skips: bool = False,
) -> tuple[list[Bit | None], list[Node]]:
    """Add the columns, lowest first, modulo 2 to the power of their number.

    Returns one bit per column, None for zero, and the nodes in an order in which inputs come first.

    `blocks`: sizes of the incremented blocks at the top of the carry chain, lowest first.
    `in_levels`: all columns are reduced at the same time, as Dadda did, with some half adders; no carry ripples through the
    tree.
    `skips`: the carry passes each block in one gate.

    Raises:
        ValueError: the blocks have more bits than there are columns.
    """
    if sum(blocks) > len(columns):
        raise ValueError(f"blocks must have at most {len(columns)} bits, not {tuple(blocks)!r}")
    rows, carry, nodes = _reduced(columns, in_levels)
    start = len(rows) - sum(blocks)
    results, carry = _ripple(rows[:start], carry, nodes)
    for size in blocks:
        partial, partial_carry = _ripple(rows[start:start + size], None, nodes)
        if carry is None:
            results, carry = results + partial, partial_carry
        else:
            incremented, carry = _increment(partial, partial_carry, carry, skips, nodes)
            results += incremented
        start += size
    return results, nodes


class Cut(NamedTuple):
    """How a sum is added (`blocks`, `in_levels` and `skips` of `add_up`), and its estimated arrival time in ps."""

    time: float
    blocks: tuple[int, ...] = ()
    in_levels: bool = False
    skips: bool = False


def choose_blocks(columns: list[list[Bit]], budget: float) -> Cut:
    """A way to finish a sum within `budget` ps with few incremented bits; the fastest way found if none is fast enough. Ways
    that take fewer cells are tried first."""
    found = []
    for in_levels in (False, True):
        rows, carry, _ = _reduced(columns, in_levels)
        for skips in (False, True):
            found.append(Cut(*_cut(rows, carry, budget, skips), in_levels, skips))
            if found[-1].time <= budget:
                return found[-1]
    return min(found)


def _cut(rows: list[list[Bit]], carry: Bit | None, budget: float, skips: bool) -> tuple[float, tuple[int, ...]]:
    """The blocks of a carry chain, and the time when the sum is finished.

    The search tries every column in which the blocks could begin, from the top down. The blocks above it follow by dynamic
    programming: the earliest carry into a column follows from the earliest carry into a lower column and the block between.
    """
    ripple = _ripple_times(rows, carry)
    best = (max((total for total, _ in ripple), default=0.0), ())
    spans = [_ripple_times(rows[start:], None) for start in range(len(rows))]
    for start in range(len(rows) - SMALLEST_BLOCK, 1, -1):
        if best[0] <= budget:
            break
        below = max(total for total, _ in ripple[:start])
        time, blocks = _fastest(spans, start, ripple[start - 1][1], skips)
        best = min(best, (max(time, below), blocks), key=lambda found: found[0])
    return best


def _ripple_times(rows: list[list[Bit]], carry: Bit | None) -> list[tuple[float, float]]:
    """For every column of a ripple chain, from the lowest, the times when its sum and its carry out are ready."""
    nodes: list[Node] = []
    results, _ = _ripple(rows, carry, nodes)
    carries = {id(node.sum): node.carry.time for node in nodes}
    return [(0.0, 0.0) if bit is None else (bit.time, carries.get(id(bit), bit.time)) for bit in results]


def _fastest(
    spans: list[list[tuple[float, float]]], start: int, arrives: float, skips: bool,
) -> tuple[float, tuple[int, ...]]:
    """The earliest time at which the columns from `start` can be finished, and the blocks for it.

    `arrives` is the time of the carry into column `start`.
    """
    width = len(spans)
    # by column: when the carry into it arrives, when all bits below are there, and the blocks below
    carry: dict[int, tuple[float, float, tuple[int, ...]]] = {start: (arrives, 0.0, ())}
    for end in range(start + 1, width + 1):
        found = []
        for begin in range(max(start, end - LARGEST_BLOCK), end):
            if begin in carry and (end - begin >= SMALLEST_BLOCK or end == width):
                into, done, sizes = carry[begin]
                sums = max(total for total, _ in spans[begin][:end - begin])
                levels = 2 + (end - begin - 1) // 4
                bits = max(into, sums) + levels * BLOCK_GATE_DELAY
                passed = max(into, sums + (levels - 1) * BLOCK_GATE_DELAY) + BLOCK_GATE_DELAY if skips else bits
                out = max(passed, spans[begin][end - begin - 1][1] + BLOCK_GATE_DELAY)
                found.append((out, max(done, bits if skips else out), (*sizes, end - begin)))
        if found:
            carry[end] = min(found, key=lambda f: f[1::-1] if end == width else f)
    _, time, blocks = carry.get(width, (inf, inf, ()))
    return time, blocks


def _reduced(columns: list[list[Bit]], in_levels: bool) -> tuple[list[list[Bit]], Bit | None, list[Node]]:
    """Columns of at most two bits, a carry into the lowest column, and the adders that made them."""
    nodes: list[Node] = []
    rows = [list(column) for column in columns]
    carry = next((bit for bit in rows[0] if bit.net == "1"), None)
    if carry is not None:
        rows[0].remove(carry)
    if in_levels:
        _reduce_in_levels(rows, nodes)
    for c, column in enumerate(rows):
        while len(column) > 2:
            column.sort(key=lambda bit: bit.time)
            adder = Adder(column[:3])
            nodes.append(adder)
            column[:3] = [adder.sum]
            if c + 1 < len(rows):
                rows[c + 1].append(adder.carry)
    return rows, carry, nodes


def _reduce_in_levels(rows: list[list[Bit]], nodes: list[Node]) -> None:
    """Reduce columns to at most two bits, in place; a carry is first used in the level after the one that makes it."""
    heights = [2]
    while heights[-1] * 3 // 2 < max(map(len, rows)):
        heights.append(heights[-1] * 3 // 2)
    for height in reversed(heights):
        carries: list[Bit] = []
        for column in rows:
            arrived, carries = carries, []
            column.sort(key=lambda bit: bit.time)
            sums: list[Bit] = []
            while len(column) + len(sums) + len(arrived) > height and len(column) > 1:
                adder = Adder(column[:3] if len(column) + len(sums) + len(arrived) > height + 1 else column[:2])
                nodes.append(adder)
                del column[:len(adder.inputs)]
                sums.append(adder.sum)
                carries.append(adder.carry)
            column += sums + arrived


def _ripple(rows: list[list[Bit]], carry: Bit | None, nodes: list[Node]) -> tuple[list[Bit | None], Bit | None]:
    """Add two rows (at most two bits per column) and a carry; returns the sum and the last carry."""
    results: list[Bit | None] = []
    for row in rows:
        bits = row + ([carry] if carry is not None else [])
        carry = None
        if len(bits) > 1:
            adder = Adder(bits)
            nodes.append(adder)
            bits, carry = [adder.sum], adder.carry
        results.append(bits[0] if bits else None)
    return results, carry


def _increment(
    partial: list[Bit | None], partial_carry: Bit | None, carry: Bit, skips: bool, nodes: list[Node],
) -> tuple[list[Bit], Bit]:
    """Add a carry to the sum of a block, with at most five bits behind one gate; returns the sum and the carry out."""
    results: list[Bit | None] = []
    ripple, ones = carry, []  # the carry into the next bit is the AND of `ripple` and all of `ones`
    for bit in partial:
        into = _gate(f"AND{len(ones) + 1}", [ripple, *ones], nodes) if ones else ripple
        if bit is None:  # the bit is 0, so the carry ends here
            return [*results, into, *partial[len(results) + 1:]], partial_carry
        if len(ones) == 4:
            ripple, ones = into, []
        results.append(_gate("XOR2", [bit, into], nodes))
        ones.append(bit)
    if skips:
        ripple, ones = carry, [_all(partial, nodes)]
    if partial_carry is None:
        return results, _gate(f"AND{len(ones) + 1}", [ripple, *ones], nodes)
    *most, last = ripple, *ones
    first = most[0] if len(most) == 1 else _gate(f"AND{len(most)}", most, nodes)
    return results, _gate("AO21", [first, last, partial_carry], nodes)


def _all(bits: list[Bit], nodes: list[Node]) -> Bit:
    """Whether all bits are ones."""
    while len(bits) > 1:
        parts = [bits[i : i + 5] for i in range(0, len(bits), 5)]
        bits = [part[0] if len(part) == 1 else _gate(f"AND{len(part)}", part, nodes) for part in parts]
    return bits[0]


def _gate(kind: str, inputs: list[Bit], nodes: list[Node]) -> Bit:
    gate = Gate(kind, inputs)
    nodes.append(gate)
    return gate.output


def choose_flips(adders: list[Adder], gates: list[Gate], seed: int = 1) -> None:
    """Set `flipped` of every adder so that few inverters are needed; the result is deterministic.

    The fewest inverters correspond to a maximum cut of the adders' graph, with a preference for flipped adders where they feed
    gates. The search is simulated annealing.
    """
    index = {id(adder): i for i, adder in enumerate(adders)}
    neighbours: list[list[tuple[int, int]]] = [[] for _ in adders]
    pull = [0] * len(adders)  # preference for flipped, whose outputs are not inverted
    for i, adder in enumerate(adders):
        for bit in adder.inputs:
            if id(bit.source) in index:
                j = index[id(bit.source)]
                weight = CHAIN_WEIGHT if bit is bit.source.carry and bit is adder.inputs[-1] else 1
                neighbours[i].append((j, weight))
                neighbours[j].append((i, weight))
    for gate in gates:
        for bit in gate.inputs:
            if id(bit.source) in index and gate.kind != "XOR2":
                pull[index[id(bit.source)]] += 1
    rng = random.Random(seed)
    flips = [False] * len(adders)
    cost, best, best_cost = 0, list(flips), 0
    steps = 600 * len(adders)
    for step in range(steps):
        i = rng.randrange(len(adders))
        gain = sum(weight if flips[i] == flips[j] else -weight for j, weight in neighbours[i])
        gain += -pull[i] if flips[i] else pull[i]
        temperature = 1.5 * (1 - step / steps) + 1e-3
        if gain >= 0 or rng.random() < 2.718 ** (gain / temperature):
            flips[i] = not flips[i]
            cost -= gain
            if cost < best_cost:
                best, best_cost = list(flips), cost
    for adder, flip in zip(adders, best, strict=True):
        adder.flipped = flip
