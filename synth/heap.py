"""Bit heaps: sums of products as trees of the library's full adder, which Yosys and ABC do not infer.

A full adder removes one bit, so a heap of n bits and m results needs n - m of them in whatever order; what an order
decides is depth, half adders and polarity. Columns are reduced from the lowest up, the three earliest bits first
(Oklobdzija's three-greedy approach), down to one bit: the carry ripple emerges as the latest bit of each column.

The library's adder has inverted outputs, and complementing all five pins of a full adder leaves it a full adder. So
an adder is used *straight* (true in, inverted out) or *flipped* (inverted in, true out), and an inverter is needed only
where two straight or two flipped adders meet. Flips are chosen to leave few.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field

SUM_DELAY, CARRY_DELAY = 50.0, 32.0  # ps under a typical load; they decide orders only, timing is checked afterwards


@dataclass(eq=False)
class Bit:
    """A bit of the heap: an external net, or an output of an adder.

    Attributes:
        net: external net (an integer of the netlist or a constant "0", "1"), None for adder outputs and products.
        product: two nets whose AND this bit is; either polarity of it costs the same.
        inverted: the external net holds the complement.
        source: the adder that drives it.
        time: estimated arrival.
    """

    net: int | str | None = None
    product: tuple[int, int] | None = None
    inverted: bool = False
    source: Adder | None = None
    time: float = 0.0


@dataclass(eq=False)
class Adder:
    """A full adder of three bits, or of two bits and 0."""

    inputs: list[Bit]
    flipped: bool = False
    sum: Bit = field(default_factory=Bit)
    carry: Bit = field(default_factory=Bit)

    def __post_init__(self) -> None:
        latest = max(bit.time for bit in self.inputs)
        self.sum.source = self.carry.source = self
        self.sum.time, self.carry.time = latest + SUM_DELAY, latest + CARRY_DELAY


def reduce(columns: list[list[Bit]]) -> tuple[list[Bit | None], list[Adder]]:
    """Sum the columns, lowest first, modulo their number; one bit (None: zero) a column, and the adders in order."""
    adders: list[Adder] = []
    results: list[Bit | None] = []
    columns = [list(column) for column in columns]
    for c, column in enumerate(columns):
        while len(column) > 1:
            column.sort(key=lambda bit: bit.time)
            count = 3 if len(column) > 2 else 2
            adder = Adder(column[:count])
            adders.append(adder)
            column[:count] = [adder.sum]
            if c + 1 < len(columns):
                columns[c + 1].append(adder.carry)
        results.append(column[0] if column else None)
    return results, adders


def choose_flips(adders: list[Adder], seed: int = 1) -> int:
    """Set `flipped` of every adder so that few inverters are needed; returns how many are. Deterministic.

    Minimising them is a maximum cut of the adders' graph: annealing from alternating levels.
    """
    neighbours: dict[int, list[int]] = {i: [] for i in range(len(adders))}
    index = {id(adder): i for i, adder in enumerate(adders)}
    for i, adder in enumerate(adders):
        for bit in adder.inputs:
            if id(bit.source) in index:
                j = index[id(bit.source)]
                neighbours[i].append(j)
                neighbours[j].append(i)
    flips = [False] * len(adders)
    for i, adder in enumerate(adders):
        votes = [not flips[index[id(bit.source)]] for bit in adder.inputs if id(bit.source) in index]
        flips[i] = sum(votes) * 2 > len(votes)
    rng = random.Random(seed)
    cost = sum(flips[i] == flips[j] for i, others in neighbours.items() for j in others) // 2
    best, best_cost = list(flips), cost
    steps = 400 * len(adders)
    for step in range(steps):
        i = rng.randrange(len(adders))
        gain = sum(1 if flips[i] == flips[j] else -1 for j in neighbours[i])
        temperature = 1.0 * (1 - step / steps) + 1e-3
        if gain >= 0 or rng.random() < 2.718 ** (gain / temperature):
            flips[i] = not flips[i]
            cost -= gain
            if cost < best_cost:
                best, best_cost = list(flips), cost
    for adder, flip in zip(adders, best, strict=True):
        adder.flipped = flip
    return best_cost
