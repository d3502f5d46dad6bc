"""The chunk test in Verilator, and the level bounds in Amaranth's simulator, against the golden renderer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from amaranth.sim import Simulator

from golden.msv2_ref.chunk_test import level_bounds
from rtl.chunks.chunk_test import ChunkTest
from rtl.chunks.level_bounds import SIDES, LevelBounds
from spec.config import PAPER, TINY, TINY_EYES, TINY_V3, V3_RECORDS
from tb.chunks import chunk_graph_suite, chunk_test_suite
from tb.common.exact import problems
from tests.helpers.rtl_streams import assert_rejected


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """The plan for V3_RECORDS and its outcome."""
    plan = chunk_test_suite.full_plan(V3_RECORDS, 0)
    return plan, chunk_test_suite.run_plan(V3_RECORDS, plan, tmp_path_factory.mktemp("v3_records"))


def test_headers_and_counters_are_the_golden_ones(played):
    plan, outcome = played
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 3000
    assert len(chunk_test_suite.figures(V3_RECORDS, plan, outcome)) == 2
    counts = [sum(item.observed[name] for item in plan) for name in chunk_test_suite.COUNTERS]
    assert min(counts) > 2000, counts


def test_faults_are_found(played):
    plan, outcome = played
    item = next(item for item in plan if item.name == "rate read")
    recording = outcome.recordings[item.name]
    assert problems(item, recording) == []
    rows = item.expected["tested"].copy()
    rows["low"][0, 1] ^= 1
    assert problems(replace(item, expected={"tested": rows}), recording)[0].startswith("tested 0: ")
    for name in chunk_test_suite.COUNTERS:
        observed = {**item.observed, name: item.observed[name] + 1}
        assert problems(replace(item, observed=observed), recording)[0].startswith(name)


def test_every_reason_and_every_box_is_the_golden_one(tmp_path):
    plan = chunk_graph_suite.full_plan(V3_RECORDS, 1)
    assert chunk_graph_suite.run_plan(V3_RECORDS, plan, tmp_path).failures == {}
    rows = np.concatenate([item.expected["source"] for item in plan])
    for name in ("behind", "outside_x", "filtered", "nothing", "astray", "skipped"):
        assert 50 < rows[name].sum() < len(rows) - 50, name


def test_joint_frames_read_what_either_eye_asks_for(tmp_path):
    plan = [*chunk_test_suite.unit_plan(TINY_EYES, 4)[::3], *chunk_test_suite.joint_plan(TINY_EYES, 4)]
    outcome = chunk_test_suite.run_plan(TINY_EYES, plan, tmp_path)
    assert outcome.failures == {} and outcome.items > 2000


@pytest.mark.long
def test_chunks_keep_their_numbers_with_super_tiles(tmp_path):
    plan = chunk_test_suite.full_plan(TINY_V3, 3)
    assert chunk_test_suite.run_plan(TINY_V3, plan, tmp_path).failures == {}
    numbers = np.concatenate([item.expected["tested"]["number"] for item in plan])
    assert numbers.max() > 900


@pytest.mark.long
def test_a_narrow_machine_of_wide_records_is_exact(tmp_path):
    config = chunk_test_suite.NARROW
    for suite in (chunk_test_suite, chunk_graph_suite):
        assert suite.run_plan(config, suite.full_plan(config, 2), tmp_path / suite.__name__).failures == {}


def test_other_machines_are_refused():
    assert_rejected(lambda: ChunkTest("v3"), TypeError, "v3")
    assert_rejected(lambda: ChunkTest(PAPER), ValueError, "paper")
    assert_rejected(lambda: LevelBounds(3), TypeError, 3)


def watched(config, passes):
    """The bounds after each pass, (present, least, most) by bound. A pass is (levels, rendered, columns, pauses)."""
    dut, found = LevelBounds(config), []

    async def bench(ctx):
        for levels, rendered, columns, pauses in passes:
            ctx.set(dut.tiles_x, columns)
            ctx.set(dut.clear, 1)
            await ctx.tick()
            ctx.set(dut.clear, 0)
            for level, use, pause in zip(levels, rendered, pauses, strict=True):
                mask = {"rendered": int(use)} if config.stereo else {}
                if config.joint:  # tiles of the other eye are among them
                    ctx.set(dut.other, 1)
                    ctx.set(dut.item, {"tile": 0, "level": 3 - int(level), "blend": 0})
                    ctx.set(dut.taken, 1)
                    await ctx.tick().repeat(1 + int(level))
                    ctx.set(dut.other, 0)
                ctx.set(dut.item, {"tile": 0, "level": int(level), "blend": 0} | mask)
                ctx.set(dut.taken, 0)
                await ctx.tick().repeat(pause + 1) if pause else None
                ctx.set(dut.taken, 1)
                await ctx.tick()
            ctx.set(dut.taken, 0)
            await ctx.tick()
            found.append([(ctx.get(o.present), [ctx.get(o.least[s]) for s in SIDES], [ctx.get(o.most[s]) for s in SIDES])
                          for o in dut.bounds])

    sim = Simulator(dut)
    sim.add_clock(1e-9)
    sim.add_testbench(bench)
    sim.run()
    return found


@pytest.mark.parametrize("config", [TINY, PAPER.with_(stereo=True), TINY_EYES], ids=lambda c: c.name)
def test_octagons_are_the_golden_ones(config):
    rng, passes = np.random.default_rng(7), []
    for columns, rows in ((1, 1), (5, 3), (32, 2), (3, 20), (7, 7), (4, 4)):
        count = columns * rows
        levels = np.minimum(rng.integers(0, 4) + rng.integers(0, 3, count), 3)
        rendered = rng.random(count) < rng.choice([0.1, 0.9]) if config.stereo else np.ones(count, bool)
        passes.append((levels, rendered, columns, rng.integers(0, 2, count) * (rng.random() < 0.5)))
    for (levels, rendered, columns, _), octagons in zip(passes, watched(config, passes), strict=True):
        wanted = level_bounds(levels, columns, rendered)
        for bound, (present, least, most) in enumerate(octagons):
            assert present == wanted.present[bound]
            if present:
                assert (least, most) == (wanted.least[bound].tolist(), wanted.most[bound].tolist())
