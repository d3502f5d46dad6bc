"""The tile merge unit against the golden rules, its threshold against exact fractions."""

from __future__ import annotations

import itertools
import random
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import pytest
from amaranth.hdl import ResetInserter, Signal
from amaranth.sim import Simulator

from golden.msv2_ref.tile_merge import auto_beta, count_tiles, tile_groups
from rtl.sort_tmu.auto_beta import AutoBeta
from rtl.sort_tmu.tile_counters import TileCounters
from rtl.sort_tmu.tile_merge import TileMergeUnit
from spec.config import TINY
from spec.records import COUNT_BITS, frame_tiles, intersection_tile, tile_group
from tests.helpers.rtl_streams import assert_rejected, exchange

SMALL = TINY.with_(row_width=64, sort_buffer_bytes=256)  # 16 tiles, beta at most 16
HIT, GROUP = intersection_tile(SMALL), tile_group(SMALL)


@dataclass(frozen=True)
class Job:
    """A frame to count: the tile of every entry, the frame's shape, the threshold (None: auto)."""

    hits: tuple[int, ...]
    tiles_x: int = 4
    tiles: int = 16
    beta: int | None = 5

    def items(self) -> list[int]:
        """What the unit takes."""
        return [*(HIT.pack({"tile": tile, "end": 0}) for tile in self.hits), HIT.pack({"tile": 0, "end": 1})]

    def groups(self, count_bits: int = COUNT_BITS) -> list[int]:
        """What it must give."""
        counts, _, _ = count_tiles(np.array(self.hits, int), self.tiles, count_bits)
        return [GROUP.pack(row) for row in tile_groups(SMALL, counts, self.tiles_x, self.beta)]

    def settings(self, ctx, dut) -> None:
        """Drives the unit's settings."""
        ctx.set(dut.tiles_x, self.tiles_x)
        ctx.set(dut.tile_count, self.tiles)
        ctx.set(dut.auto, self.beta is None)
        ctx.set(dut.beta, self.beta or 0)


def play(jobs: list[Job], *, count_bits: int = COUNT_BITS, **options) -> list[int]:
    """Frames of one shape back to back; returns the cycle of every group."""
    dut = TileMergeUnit(SMALL, count_bits=count_bits)
    expected = [group for job in jobs for group in job.groups(count_bits)]
    got, cycles = exchange(
        dut, {dut.hits: [item for job in jobs for item in job.items()]}, dut.groups, len(expected),
        setup=lambda ctx: jobs[0].settings(ctx, dut), **options)
    assert got == expected
    return cycles


def random_tiles(rng: random.Random, tiles: int, count: int) -> tuple[int, ...]:
    """Tiles of `count` entries: bursts of one tile, neighbours, and empty tiles among them."""
    used, hits = rng.sample(range(tiles), rng.randint(1, tiles)), []
    while len(hits) < count:
        hits += [rng.choice(used)] * rng.choice([1, 1, 1, 2, 3, 9])
    return tuple(hits[:count])


@pytest.mark.parametrize("pauses", [0, 0.4])
def test_every_order_of_hits_on_neighbouring_cycles(pauses):
    """The counter read may be one or two cycles old: all sequences of six hits on three tiles, in frames of their own."""
    sequences = itertools.product(range(3), repeat=6) if not pauses else itertools.product(range(2), repeat=6)
    play([Job(hits, tiles_x=3, tiles=3, beta=1) for hits in sequences], pauses=pauses)


@pytest.mark.parametrize("pauses", [0, 0.3, 0.8])
@pytest.mark.parametrize("beta", [None, 0, 1, 2, 7, 16, 100, (1 << 24) - 1])
def test_random_frames_back_to_back(beta, pauses):
    rng = random.Random(f"{beta} {pauses}")
    for tiles_x, rows in ((4, 4), (1, 5), (5, 1), (3, 2), (1, 1)):
        tiles = tiles_x * rows
        frames = [random_tiles(rng, tiles, rng.choice([0, 1, 20, 60])) for _ in range(4)]
        play([Job(hits, tiles_x, tiles, beta) for hits in frames], pauses=pauses, seed=3)


@pytest.mark.parametrize(("counts", "tiles_x", "beta"), [
    ((3, 3, 3, 3), 4, 7), ((3, 4, 3, 4), 4, 7), ((9, 0, 1, 0), 4, 7), ((0, 0, 9, 1), 4, 7), ((1, 0, 9, 1), 4, 7),
    ((1, 1, 1, 1), 2, 100), ((1, 7, 1, 1), 4, 7), ((1, 6, 6, 1), 4, 7), ((2, 0, 0, 5), 4, 7), ((1, 1, 1), 2, 9),
    ((0, 0, 0, 0), 2, 5), ((0, 0, 5, 5), 2, 5), ((4, 1, 4, 1), 2, 5), ((5, 0, 0, 5), 4, 5)])
def test_merging_by_hand(counts, tiles_x, beta):
    hits = tuple(tile for tile, count in enumerate(counts) for _ in range(count))
    play([Job(hits, tiles_x, len(counts), beta)])


def test_a_hit_and_a_tile_a_cycle():
    jobs = [Job(random_tiles(random.Random(0), 16, 200), beta=8) for _ in range(3)]
    cycles = play(jobs)
    for frame in range(3):
        first, last = cycles[16 * frame], cycles[16 * frame + 15]
        assert last - first <= 15 + 4  # a row's end does not wait for the next tile, so it may leave early
    assert cycles[32] - cycles[16] <= 201 + 16 + 8


def test_counters_saturate_and_say_so():
    for top, full in ((7, False), (8, True), (20, True)):
        hits = (2,) * top + (1, 3)
        dut = run_frames([Job(hits), Job((1,))], count_bits=3)
        assert dut[0]["saturated"] == full and not dut[1]["saturated"] and not dut[0]["outside"]
        assert dut[0]["saturated"] == count_tiles(np.array(hits), 16, 3)[1]


def test_a_saturated_frames_threshold_follows_its_counters():
    hits = (2,) * 30 + (1, 3)
    counts = count_tiles(np.array(hits), 16, 3)[0]
    assert run_frames([Job(hits, beta=None)], count_bits=3)[0]["beta"] == auto_beta(counts, SMALL) == 6


def test_a_frame_that_ends_early_does_not_move_the_threshold_of_groups_still_leaving():
    jobs = [Job(tuple(range(16)) * 2, beta=None), Job((0,) * 9, beta=None)]  # thresholds 4 and 16
    dut, items, found = TileMergeUnit(SMALL), [item for job in jobs for item in job.items()], []

    async def bench(ctx):
        jobs[0].settings(ctx, dut)
        for cycle in range(2200):
            ctx.set(dut.groups.ready, cycle % 60 == 0)
            ctx.set(dut.hits.valid, bool(items))
            if items:
                ctx.set(dut.hits.payload, dut.hits.payload.shape().from_bits(items[0]))
                if ctx.get(dut.hits.ready):
                    items.pop(0)
            if ctx.get(dut.groups.valid) and cycle % 60 == 0:
                found.append(ctx.get(dut.groups.payload).as_bits())
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    assert found == [group for job in jobs for group in job.groups()]


def test_tiles_outside_the_frame_are_not_counted_and_said_so():
    inside = run_frames([Job((0, 11, 3), tiles_x=4, tiles=12), Job((0, 15, 12, 3), 4, 12), Job((15, 12, 12, 3), 4, 16)])
    assert [frame["outside"] for frame in inside] == [False, True, False]


def run_frames(jobs: list[Job], *, count_bits: int = COUNT_BITS, cut: dict[int, int] | None = None) -> list[dict]:
    """Frames with settings of their own, each begun where the unit is no longer busy; `cut`: reset after so many cycles."""
    dut, reset, seen = TileMergeUnit(SMALL, count_bits=count_bits), Signal(), []

    async def frame(ctx, job, limit):
        job.settings(ctx, dut)
        items, found = job.items(), []
        ctx.set(dut.groups.ready, 1)
        for cycle in range(limit or 2000):
            ctx.set(dut.hits.valid, bool(items))
            if items:
                ctx.set(dut.hits.payload, dut.hits.payload.shape().from_bits(items[0]))
                if ctx.get(dut.hits.ready):
                    items.pop(0)
            if ctx.get(dut.groups.valid):
                found.append(ctx.get(dut.groups.payload).as_bits())
            await ctx.tick()
            if cycle > 3 and not items and not ctx.get(dut.busy):
                break
        return found

    async def bench(ctx):
        for number, job in enumerate(jobs):
            limit = (cut or {}).get(number)
            found = await frame(ctx, job, limit)
            if limit:
                ctx.set(reset, 1)
                ctx.set(dut.hits.valid, 0)
                await ctx.tick()
                ctx.set(reset, 0)
            else:
                assert found == job.groups(count_bits), number
            seen.append({name: bool(ctx.get(getattr(dut, name))) for name in ("saturated", "outside")}
                        | {"beta": ctx.get(dut.beta_used)})

    simulator = Simulator(ResetInserter(reset)(dut))
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    return seen


@pytest.mark.parametrize("after", [3, 17, 18, 40, 70, 80, 85, 90, 100])
def test_reset_in_mid_frame_leaves_nothing_behind(after):
    """While clearing, counting, dividing and sweeping."""
    rng = random.Random(after)
    jobs = [Job(random_tiles(rng, 16, 50), beta=None) for _ in range(3)]
    run_frames(jobs, cut={0: after})
    run_frames(jobs, cut={1: after})


def test_frames_change_shape_and_threshold():
    rng, jobs = random.Random(5), []
    for tiles_x, rows, beta in ((4, 4, None), (2, 3, 4), (1, 1, 0), (4, 4, 9), (3, 5, None), (16, 1, 30), (1, 16, None)):
        jobs.append(Job(random_tiles(rng, tiles_x * rows, 40), tiles_x, tiles_x * rows, beta))
    for job, seen in zip(jobs, run_frames(jobs), strict=True):
        counts = count_tiles(np.array(job.hits), job.tiles)[0]
        assert seen["beta"] == (auto_beta(counts, SMALL) if job.beta is None else max(job.beta, 1))


def test_largest_frame_of_tiny():
    rng, tiles = random.Random(1), frame_tiles(TINY)
    record, group = intersection_tile(TINY), tile_group(TINY)
    hits = np.array([rng.choice([rng.randrange(tiles), rng.randrange(40)]) for _ in range(3000)])
    dut = TileMergeUnit(TINY)
    items = [*(record.pack({"tile": int(tile), "end": 0}) for tile in hits), record.pack({"tile": 0, "end": 1})]
    expected = [group.pack(row) for row in tile_groups(TINY, count_tiles(hits, tiles)[0], 32, None)]

    def setup(ctx):
        ctx.set(dut.tiles_x, 32)
        ctx.set(dut.tile_count, tiles)
        ctx.set(dut.auto, 1)

    got, cycles = exchange(dut, {dut.hits: items}, dut.groups, tiles, setup=setup)
    assert got == expected
    assert cycles[-1] < tiles + len(items) + tiles + 60  # cleared, counted, swept


def beta_of(total: int, filled: int, cap: int) -> int:
    """The golden's rule in exact arithmetic: Python rounds a Fraction's ties to even."""
    return min(round(Fraction(2 * total, filled)), cap) if filled else 1


def test_automatic_beta_is_exact():
    dut, rng, cases = AutoBeta(SMALL), random.Random(2), [(0, 0)]
    cases += [(total, filled) for filled in (1, 2, 3, 4, 5, 8, 16) for total in range(filled, 12 * filled, 1 + filled // 4)]
    cases += [(rng.randrange(16 * ((1 << COUNT_BITS) - 1)), 16) for _ in range(10)]
    cases += [(16 * ((1 << COUNT_BITS) - 1), 16), ((1 << COUNT_BITS) - 1, 1)]

    async def bench(ctx):
        for total, filled in cases:
            ctx.set(dut.total, total)
            ctx.set(dut.filled, filled)
            ctx.set(dut.start, 1)
            await ctx.tick()
            ctx.set(dut.start, 0)
            for _ in range(len(dut.total) + 1):
                assert not ctx.get(dut.done)
                await ctx.tick()
            assert ctx.get(dut.done)
            assert ctx.get(dut.beta) == beta_of(total, filled, 16), (total, filled)

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()


def test_the_goldens_beta_is_the_exact_one():
    """Float64 rounds the quotient once more; never visibly, at the ties and next to them."""
    cap, tiles = TINY.sort_chunk, 14_400
    for filled in (1, 2, 3, 7, 8, 1023, 4096, tiles - 1, tiles):
        for twice in range(1, 2 * cap + 4, 37):  # 2 total / filled near twice / 2
            for total in {twice * filled // 4 + d for d in (-1, 0, 1)}:
                if filled <= total:
                    counts = np.zeros(tiles, np.int64)
                    counts[:filled] = total // filled
                    counts[: total % filled] += 1
                    assert auto_beta(counts, TINY) == beta_of(total, filled, cap)


def test_bad_parameters_are_rejected():
    for make in (TileMergeUnit, TileCounters, AutoBeta):
        assert_rejected(lambda make=make: make("tiny"), TypeError, "tiny")
    assert_rejected(lambda: TileMergeUnit(SMALL, count_bits=25), ValueError, 25)
    assert_rejected(lambda: TileCounters(SMALL, count_bits=0), ValueError, 0)
    assert_rejected(lambda: TileCounters(SMALL, count_bits=True), TypeError, True)
