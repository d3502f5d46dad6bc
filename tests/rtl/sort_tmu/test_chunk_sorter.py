"""The merge sorter: its stages against runs merged by Python, the whole against sorted()."""

from __future__ import annotations

import random
import re
from itertools import chain, pairwise, product

import pytest
from amaranth.hdl import Module, ResetInserter, Signal
from amaranth.sim import Simulator

from rtl.emit import to_rtlil
from rtl.sort_tmu.chunk_sorter import ChunkSorter
from rtl.sort_tmu.merge_stage import Kind, MergeStage, item_layout
from rtl.sort_tmu.order import less
from spec.config import PAPER, PAPER_SMALL, TINY
from spec.records import chunk_item, intersection
from tests.helpers.rtl_streams import assert_rejected, exchange

SMALL = TINY.with_(row_width=64, sort_buffer_bytes=256)  # chunks of up to 16
RECORD = chunk_item(SMALL)
ORDERS = ("random", "ties", "sorted", "reversed", "equal", "zigzag")
Entry = tuple[int, int, int]
"""Tile, depth key, index: the order of the tuple is the order wanted."""


def entries(rng: random.Random, count: int, order: str) -> list[Entry]:
    """Entries of one chunk; indices differ as those of a tile do."""
    keys, tiles = (2, 2) if order == "ties" else (1 << 24, 16)
    drawn = [(rng.randrange(tiles), rng.randrange(keys), index) for index in rng.sample(range(1 << 24), count)]
    if order == "equal":
        return drawn[:1] * count
    if order in ("sorted", "reversed"):
        return sorted(drawn, reverse=order == "reversed")
    if order == "zigzag":  # the smallest, the largest, the next smallest
        drawn.sort()
        return [drawn[-1 - i // 2] if i % 2 else drawn[i // 2] for i in range(count)]
    return drawn


def words(chunks: list[list[Entry]]) -> list[int]:
    """The chunks as the sorter takes them."""
    items = []
    for chunk in chunks:
        for place, (tile, key, index) in enumerate(chunk, 1):
            last = int(place == len(chunk))
            items.append(RECORD.pack({"tile": tile, "depth_key": key, "index": index, "last": last, "empty": 0}))
        if not chunk:
            items.append(RECORD.pack({"tile": 0, "depth_key": 0, "index": 0, "last": 1, "empty": 1}))
    return items


def sort(chunks: list[list[Entry]], **options) -> list[int]:
    """Sends the chunks through a small sorter; returns the cycle of each transfer at its output."""
    dut, expected = ChunkSorter(SMALL), words([sorted(chunk) for chunk in chunks])
    got, cycles = exchange(dut, {dut.chunks: words(chunks)}, dut.sorted, len(expected), **options)
    assert got == expected
    return cycles


@pytest.mark.parametrize("pauses", [0, 0.2, 0.7])
@pytest.mark.parametrize("order", ORDERS)
def test_every_length_in_every_order(order, pauses):
    rng = random.Random(f"{order} {pauses}")
    lengths = [*range(17), *rng.sample(range(17), 17)]
    sort([entries(rng, length, order) for length in lengths], pauses=pauses, seed=1)


@pytest.mark.parametrize("seed", range(3))
def test_short_and_empty_chunks_follow_long_ones(seed):
    rng = random.Random(seed)
    sort([entries(rng, rng.choice([0, 0, 1, 1, 2, 3, 8, 9, 16]), rng.choice(ORDERS)) for _ in range(60)], pauses=seed / 4)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("length", [9, 12, 16])
def test_no_cycle_is_lost_between_entries_or_chunks(length, order):
    rng = random.Random(length)
    cycles = sort([entries(rng, length, order) for _ in range(20)])
    assert cycles[-1] - cycles[0] == 20 * length - 1


def test_latency():
    """A full chunk's first entry leaves after the chunk's own length and a cycle a stage, at most."""
    assert sort([entries(random.Random(0), 16, "random")])[0] <= 16 + 4


@pytest.mark.parametrize(("config", "capacity", "bits"), [
    (TINY, 256, 510 * 61), (PAPER_SMALL, 4096, 8190 * 64), (PAPER, 4096, 532_350),
], ids=["tiny", "paper_small", "paper"])
def test_sizes(config, capacity, bits):
    assert config.sort_chunk == capacity
    memories = re.findall(r"memory width (\d+) size (\d+)", to_rtlil(ChunkSorter(config), "sorter"))
    assert sum(int(width) * int(depth) for width, depth in memories) == bits


async def cycle(ctx, dut, chunks: list[int], found: list[int]) -> bool:
    """One cycle: the first of `chunks` is offered, what leaves is added to `found`; whether `oversize` was high."""
    ctx.set(dut.sorted.ready, 1)
    ctx.set(dut.chunks.valid, bool(chunks))
    if chunks:
        ctx.set(dut.chunks.payload, dut.chunks.payload.shape().from_bits(chunks[0]))
    oversize = ctx.get(dut.oversize)
    ready, valid, payload = ctx.get(dut.chunks.ready), ctx.get(dut.sorted.valid), ctx.get(dut.sorted.payload)
    if chunks and ready:
        chunks.pop(0)
    if valid:
        found.append(payload.as_bits())
    await ctx.tick()
    return oversize


def simulate(dut, bench, design=None) -> None:
    simulator = Simulator(design or dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()


def test_a_chunk_too_long_leaves_as_sorted_runs_and_says_so():
    rng, dut, found, strobes = random.Random(1), ChunkSorter(SMALL), [], []
    chunk, after = entries(rng, 39, "random"), entries(rng, 5, "random")

    async def bench(ctx):
        feed = words([chunk, after])
        for _ in range(150):
            strobes.append(await cycle(ctx, dut, feed, found))
        assert not ctx.get(dut.busy)

    simulate(dut, bench)
    runs = [sorted(chunk[i : i + 16]) for i in range(0, 39, 16)]
    assert found == words([[*runs[0], *runs[1], *runs[2]], sorted(after)])
    assert sum(strobes) == 39 - 16


@pytest.mark.parametrize("after", [1, 7, 16, 23, 40])
def test_reset_forgets_what_was_inside(after):
    rng, dut, reset, found = random.Random(after), ChunkSorter(SMALL), Signal(), []
    chunks = [entries(rng, length, "random") for length in (16, 3, 0, 11)]

    async def bench(ctx):
        feed = words([entries(rng, length, "random") for length in (16, 16, 16)])
        for _ in range(after):
            await cycle(ctx, dut, feed, [])
        assert ctx.get(dut.busy)
        ctx.set(reset, 1)
        await ctx.tick()
        ctx.set(reset, 0)
        assert not ctx.get(dut.busy) and not ctx.get(dut.sorted.valid)
        feed = words(chunks)
        for _ in range(100):
            await cycle(ctx, dut, feed, found)

    simulate(dut, bench, ResetInserter(reset)(dut))
    assert found == words([sorted(chunk) for chunk in chunks])


def run_kinds(runs: list[list[int]]) -> list[Kind]:
    """Kinds of a chunk's runs."""
    if runs == [[]]:
        return [Kind.EMPTY]
    return [Kind.WHOLE] if len(runs) == 1 else [Kind(number % 2) for number in range(len(runs))]


def stage_items(shape, chunks: list[list[list[int]]]) -> list[int]:
    """Chunks of runs as a stage takes them."""
    items = []
    for runs in chunks:
        for number, (run, kind) in enumerate(zip(runs, run_kinds(runs), strict=True), 1):
            for place, word in enumerate(run or [0], 1):
                last = number == len(runs) and place == max(len(run), 1)
                items.append(shape.const({"word": word, "last": last, "kind": kind}).as_bits())
    return items


@pytest.mark.parametrize("pauses", [0, 0.5])
@pytest.mark.parametrize("run", [1, 2, 4])
def test_a_stage_merges_pairs_and_marks_its_runs(run, pauses):
    rng, chunks, merged = random.Random(run), [], []
    for _ in range(60):
        length = rng.choice([0, 1, run, 2 * run, 2 * run + 1, rng.randrange(6 * run)])
        bounds = [*range(0, length, run), length] if length else [0, 0]
        chunks.append([sorted(rng.randrange(8) for _ in range(b - a)) for a, b in pairwise(bounds)])
        pairs = [chunks[-1][i : i + 2] for i in range(0, len(chunks[-1]), 2)]
        merged.append([sorted(chain(*pair)) for pair in pairs])
    dut, shape = MergeStage(3, run), item_layout(3)
    # The kind of a chunk's only run may come out as FIRST: it was not known in time that no second follows.
    expected = [shape.from_bits(bits) for bits in stage_items(shape, merged)]
    got, _ = exchange(dut, {dut.sink: stage_items(shape, chunks)}, dut.source, len(expected), pauses=pauses)
    for bits, wanted in zip(got, expected, strict=True):
        item = shape.from_bits(bits)
        assert (item.word, item.last) == (wanted.word, wanted.last)
        assert item.kind == wanted.kind or (item.kind, wanted.kind) == (Kind.FIRST, Kind.WHOLE)


def test_a_whole_chunk_passes_a_stage_in_a_cycle():
    dut, shape = MergeStage(8, 64), item_layout(8)
    items = [shape.const({"word": word, "last": word == 19, "kind": Kind.WHOLE}).as_bits() for word in range(20)]
    got, cycles = exchange(dut, {dut.sink: items}, dut.source, 20)
    assert got == items and cycles == list(range(cycles[0], cycles[0] + 20)) and cycles[0] <= 2


def test_bad_parameters_are_rejected():
    for run, error in ((3, ValueError), (0, ValueError), (True, TypeError), (2.0, TypeError)):
        assert_rejected(lambda run=run: MergeStage(8, run), error, run)
    for width, error in ((0, ValueError), ("8", TypeError)):
        assert_rejected(lambda width=width: MergeStage(width, 1), error, width)
    assert_rejected(lambda: ChunkSorter("paper"), TypeError, "paper")
    assert_rejected(lambda: ChunkSorter(PAPER.with_(row_width=8192)), ValueError, 8192)


def test_an_item_is_compared_as_one_number():
    """Field 0 lowest: the tile decides first, then the key, then the index."""
    low, high = {"index": (1 << 24) - 1, "depth_key": 5, "tile": 2}, {"index": 0, "depth_key": 6, "tile": 2}
    record = intersection(SMALL)
    assert record.pack(low) < record.pack(high) < record.pack(low | {"tile": 3})


@pytest.mark.parametrize("width", [1, 2, 3, 4, 65])
def test_words_are_compared_as_numbers(width):
    rng, pairs = random.Random(width), list(product(range(1 << width), repeat=2)) if width < 5 else []
    for bit in range(width):  # words that differ from some bit on
        base = rng.getrandbits(width)
        pairs += [(base, base), (base, base ^ 1 << bit), (base, base ^ rng.getrandbits(bit + 1))]
    m, a, b, out = Module(), Signal(width), Signal(width), Signal()
    m.d.comb += out.eq(less(a, b))

    async def bench(ctx):
        for left, right in pairs:
            ctx.set(a, left)
            ctx.set(b, right)
            assert ctx.get(out) == (left < right)

    simulator = Simulator(m)
    simulator.add_testbench(bench)
    simulator.run()


def test_words_of_different_widths_are_not_compared():
    for widths in ((3, 4), (4, 3), (0, 0)):
        with pytest.raises(ValueError, match=f"not {widths[0]} and {widths[1]}$"):
            less(*(Signal(width) for width in widths))
