"""Splat fetch in Verilator: every suite's runs, and faults put there on purpose; ports and small FIFOs in Amaranth's simulator.

Traced trained scenes and the other machines are long.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from amaranth.lib import memory
from amaranth.sim import Simulator

from golden.msv2_ref.fetch import find_misses
from rtl.emit import to_rtlil, to_verilog
from rtl.units import emit
from rtl.vrc_array.splat_fetch import LATENCY, SplatFetch
from rtl.vrc_array.splat_tags import SplatTags
from spec.config import PAPER, TINY
from spec.memory import read_data
from spec.queues import CACHE_WAYS, VIEWS_PENDING
from spec.records import array_splat, chunk_item, tile_use
from tb.common import exact
from tb.common.exact import problems
from tb.vrc_array import fetch_suite
from tb.vrc_array.fetch_device import FetchBench, playback
from tb.vrc_array.fetch_stimuli import DIRECTED, random_case
from tests.helpers.rtl_streams import assert_rejected, exchange

SMALL = TINY.with_(splat_cache_lines=32)


def quick_plan(config):
    return [*fetch_suite.unit_plan(config, 0), *fetch_suite.rate_plan(config, 0)]


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """TINY's plan and outcome."""
    plan = quick_plan(TINY)
    return plan, fetch_suite.run_plan(TINY, plan, tmp_path_factory.mktemp("fetch"))


def test_tiny_is_exact_and_fast_enough(tiny):
    plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 40_000


def test_runs_show_something(tiny):
    """Hits and misses both, and back to back what was kept is found again."""
    plan, _ = tiny
    wanted = {item.name: (len(item.expected["entries"]), len(item.expected["reads"])) for item in plan}
    assert all(misses < entries for name, (entries, misses) in wanted.items() if name.startswith(("the same", "conflicts")))
    assert wanted["rate, hits"][1] == 0 and wanted["rate, misses"] == (3000, 3000)
    kept = [misses for name, (_, misses) in wanted.items() if name.startswith("back to back, kept")]
    assert kept == [TINY.splat_cache_lines // 2, 0, 0, 0]


def test_faults_are_found(tiny):
    plan, outcome = tiny
    item = next(item for item in plan if item.name.startswith("random, 30"))
    recording = outcome.recordings[item.name]
    assert problems(item, recording) == []
    for port, rows in item.expected.items():
        for name in rows.dtype.names:
            wrong = rows.copy()
            wrong[name][3] ^= 1
            assert problems(replace(item, expected=item.expected | {port: wrong}), recording)[0].startswith(f"{port} 3: ")
    assert problems(replace(item, observed={"hits": item.observed["hits"] + 1}), recording)
    assert problems(replace(item, most_cycles=recording.cycles - 1), recording)


@pytest.mark.parametrize(("name", "lines", "ways", "keep_used"), [
    ("every line", 128, CACHE_WAYS, False), ("every line", 32, CACHE_WAYS, False), ("conflicts", 64, 2, False),
    ("conflicts", 64, 8, False),
    ("conflicts", 64, CACHE_WAYS, True),
])
def test_another_cache_is_told_apart(tiny, name, lines, ways, keep_used):
    case = next(case for case in (make(TINY) for make in DIRECTED) if case.name == name)
    reads = tiny[1].recordings[f"{name}, 0 cycles"].outputs["reads"]
    assert len(reads) == find_misses(case.index, case.level, TINY.splat_cache_lines, CACHE_WAYS, False, False).sum()
    assert len(reads) != find_misses(case.index, case.level, lines, ways, keep_used, False).sum()


def test_a_tag_written_in_the_cycle_of_its_reading_must_be_seen(monkeypatch, tmp_path):
    """Without that a second miss is sent for a view that is on its way."""
    read_port = memory.Memory.read_port
    with monkeypatch.context() as patch:
        patch.setattr(memory.Memory, "read_port", lambda self, **options: read_port(self, **options | {"transparent_for": ()}))
        faulty = replace(playback(TINY), name="fetch-faulty", verilog=to_verilog(FetchBench(TINY), "fetch_bench"))
    plan = fetch_suite.Plan(TINY, 0)
    for make in DIRECTED:
        plan.add(make(TINY))
    outcome = exact.run_plan(faulty, plan.runs, tmp_path)
    assert "the same splat again" in outcome.failures


def small(case) -> tuple[list[int], list[int], list[int], list[int]]:
    """Sorted items, tiles, data and entries of a case as bit patterns."""
    missed = find_misses(case.index, case.level, SMALL.splat_cache_lines, CACHE_WAYS, False, False)
    data = fetch_suite.beats_of(SMALL, case.views[missed], np.random.default_rng(0))
    return tuple([record(SMALL).pack(row) for row in rows] for record, rows in (
        (chunk_item, case.sorted), (tile_use, case.tiles), (read_data, data), (array_splat, case.entries)))


@pytest.mark.parametrize("pauses", [0, 0.4])
@pytest.mark.parametrize("pending", [1, 2, 3, 17])
def test_every_depth_of_pending(pending, pauses):
    items, tiles, beats, expected = small(random_case(SMALL, "", pending, tiles=12, mean_count=10))
    dut = SplatFetch(SMALL, pending=pending)
    got, _ = exchange(
        dut, {dut.sorted: items, dut.tiles: tiles, dut.data: beats}, dut.entries, len(expected), pauses=pauses,
        setup=lambda ctx: ctx.set(dut.reads.ready, 1))
    assert got == expected


def test_latency_and_the_cycles_of_clearing():
    """A hit takes LATENCY cycles; after `clear`, as after a reset, nothing is taken for a cycle a set."""
    dut, waits, latencies, missed = SplatFetch(SMALL), [], [], []

    async def send(ctx) -> None:
        """One entry of index 5, and its beat at once if it is wanted."""
        ctx.set(dut.tiles.payload.count, 1)
        ctx.set(dut.tiles.valid, 1)
        await ctx.tick().until(dut.tiles.ready)
        ctx.set(dut.tiles.valid, 0)
        ctx.set(dut.sorted.payload.index, 5)
        ctx.set(dut.sorted.valid, 1)
        wait = 0
        while not ctx.get(dut.sorted.ready):
            await ctx.tick()
            wait += 1
        waits.append(wait)
        before, cycles = ctx.get(dut.misses), 0
        while not ctx.get(dut.entries.valid):
            await ctx.tick()
            ctx.set(dut.sorted.valid, 0)
            cycles += 1
        missed.append(ctx.get(dut.misses) - before)
        latencies.append(cycles)
        await ctx.tick()
        assert not ctx.get(dut.busy)

    async def bench(ctx):
        for port in (dut.reads.ready, dut.entries.ready, dut.data.valid):
            ctx.set(port, 1)
        await ctx.tick()  # one of the cycles of clearing; another is the tile's
        await send(ctx)
        await send(ctx)
        ctx.set(dut.clear, 1)
        await ctx.tick()
        ctx.set(dut.clear, 0)
        assert ctx.get(dut.busy) and not ctx.get(dut.misses)
        await send(ctx)

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    assert missed == [1, 0, 1] and waits == [6, 0, 7]
    assert latencies[1] == LATENCY


def test_storage():
    memories = re.findall(r"memory width (\d+) size (\d+)", to_rtlil(SplatFetch(PAPER), "fetch"))
    pending = (15, VIEWS_PENDING - 1)  # one waits in a register
    assert sorted((int(width), int(depth)) for width, depth in memories) == [pending, (74, 512), (222, 2048)]


def test_verilog():
    text = emit("splat_fetch", TINY)
    assert "module splat_fetch(" in text and emit("splat_fetch", TINY) == text


def test_no_counters_where_there_are_none(tmp_path):
    config = SMALL.with_(counters=False)
    dut = SplatFetch(config)
    items, tiles, beats, expected = small(random_case(config, "", 1, tiles=6))
    seen = []

    def setup(ctx):
        ctx.set(dut.reads.ready, 1)
        seen.append((ctx.get(dut.hits), ctx.get(dut.misses)))

    got, _ = exchange(
        dut, {dut.sorted: items, dut.tiles: tiles, dut.data: beats}, dut.entries, len(expected), setup=setup)
    assert got == expected and "32" not in re.findall(r"wire width (\d+) output \d+ \\(?:hits|misses)", to_rtlil(dut, "f"))


def test_bad_parameters_are_rejected():
    for pending, error in ((0, ValueError), ("8", TypeError), (True, TypeError)):
        assert_rejected(lambda pending=pending: SplatFetch(TINY, pending=pending), error, pending)
    assert_rejected(lambda: SplatFetch("tiny"), TypeError, "tiny")
    assert_rejected(lambda: SplatTags("tiny"), TypeError, "tiny")


@pytest.mark.parametrize(("ways", "keep_used", "misses"), [(1, False, 6), (2, False, 5), (2, True, 4)])
def test_the_model_of_caches(ways, keep_used, misses):
    """Two sets of one line, or one set of two: 0 2 0 4 0 2."""
    index = np.array([0, 2, 0, 4, 0, 2])
    assert find_misses(index, np.zeros(6, np.int64), 2, ways, keep_used, False).sum() == misses


def test_levels_are_told_apart_by_the_model():
    assert find_misses(np.array([1, 1, 1]), np.array([0, 1, 1]), 64, 1, False, False).tolist() == [True, True, False]


def test_traced_frames_of_the_embedded_scene(monkeypatch, tmp_path):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path / "absent"))
    plan = fetch_suite.traced_plan(TINY, "64x48")
    assert len(plan) == 2 and fetch_suite.run_plan(TINY, plan, tmp_path / "run").failures == {}


@pytest.mark.long
@pytest.mark.parametrize("name", fetch_suite.DISTINCT)
def test_scenes_and_other_machines_are_exact(name, tmp_path):
    """The embedded scene always, trained ones where they are."""
    config = fetch_suite.VARIANTS[name]
    plan = fetch_suite.full_plan(config, 1)
    outcome = fetch_suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and len(fetch_suite.figures(config, plan, outcome)) >= 5
