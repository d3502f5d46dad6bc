"""The colour unit: its operator and its protocol in Amaranth's simulator, every bit in Verilator.

PAPER, PAPER_SMALL, units of lower degrees and the trained scenes take a build each: they are long.
"""

from __future__ import annotations

import itertools
import random
from dataclasses import replace

import numpy as np
import pytest
from amaranth.sim import Simulator

from golden.msv2_ref.colour import survivor_records
from rtl.chunks import decode_colour
from rtl.culling import compact_sum, compact_views
from rtl.culling.colour import LEAST_INTERVAL, ColourUnit, carried_layout, splat_interval
from rtl.culling.colour_sum import record_steps
from rtl.culling.compact_sum import CompactColourSum, band_of, lane_groups
from rtl.culling.fixed_multiply import FixedMul
from rtl.culling.harmonics import harmonics_graph
from rtl.culling.schedule import cost, schedule
from rtl.emit import to_verilog
from spec import harmonics
from spec.compact import BAND_BITS, OPACITY_LOG2
from spec.config import CONFIGS, PAPER, PAPER_SMALL, TINY, V3_RECORDS
from spec.formats import SQ, UQ
from spec.harmonics import terms
from tb.common import exact
from tb.common.exact import problems
from tb.culling import TINY_RECORDS, colour_device, colour_suite
from tb.culling.colour_stimuli import fine_case, random_case
from tests.helpers.rtl_streams import assert_rejected


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """TINY's plan and outcome."""
    plan = [*colour_suite.unit_plan(TINY, 0), *colour_suite.rate_plan(TINY, 0)]
    return plan, colour_suite.run_plan(TINY, plan, tmp_path_factory.mktemp("tiny"))


def test_tiny_is_exact_and_fast_enough(tiny):
    plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 30_000
    lines = colour_suite.figures(TINY, plan, outcome)
    assert len(lines) == 4 and all("300 splats, 300 views" in line for line in lines)


def test_faults_are_found(tiny):
    plan, outcome = tiny
    item = next(item for item in plan if item.name == "extremes of degree 3")
    recording = outcome.recordings[item.name]
    assert problems(item, recording) == []
    for port, name in (("reads", "beat"), ("writes", "beat"), ("writes", "word"), ("writes", "strobe")):
        rows = item.expected[port].copy()
        rows[name][3] ^= 1
        wrong = problems(replace(item, expected={**item.expected, port: rows}), recording)
        assert len(wrong) == 1 and wrong[0].startswith(f"{port} 3: ")
    assert problems(replace(item, observed={"error": 1}), recording) == ["error is 0, not 1"]


@pytest.fixture(scope="module")
def v3(tmp_path_factory):
    """V3_RECORDS's plan and outcome."""
    plan = [*colour_suite.unit_plan(V3_RECORDS, 0), *colour_suite.rate_plan(V3_RECORDS, 0)]
    return plan, colour_suite.run_plan(V3_RECORDS, plan, tmp_path_factory.mktemp("v3_records"))


def test_compact_records_are_exact_and_fast_enough(v3):
    """A splat every two cycles, or one level a cycle."""
    plan, outcome = v3
    assert outcome.failures == {} and outcome.items > 30_000
    assert len(colour_suite.figures(V3_RECORDS, plan, outcome)) == 8


def test_compact_stimuli_reach_every_end(v3):
    """Fine and coarse records, every range of base colours, linear and logarithmic opacities, exponents beyond the largest, and
    colours at both ends and between."""
    plan, _ = v3
    case = random_case(V3_RECORDS, 3, 3, [150])
    words = case.records[0]
    assert set(words.coarse) == {True, False} and set(words.colour["dc_range"]) == {0, 1, 2, 3}
    assert (words.colour["opacity"] > 255).any() and (words.harmonics["exponent"].max(axis=0) > 7).all()
    colour = fine_case(V3_RECORDS, 0, 3, 1500).expected(V3_RECORDS)["writes"]
    assert len(np.unique(colour["word"])) > 10_000
    item = next(item for item in plan if item.name == "extremes of degree 3")
    assert set(item.run.inputs["survivors"]["levels"]) == set(range(16))


def test_faults_in_compact_records_are_found(v3):
    """A bit of every field that the unit reads changes what it must write; bits that it must not read do not."""
    case = random_case(V3_RECORDS, 5, 3, [40])
    right = case.expected(V3_RECORDS)["writes"]["word"]
    for name in ("dc_range", "opacity", "dc"):
        words = replace(case.records[0], colour=case.records[0].colour.copy())
        words.colour[name] ^= 1
        assert (replace(case, records=[words]).expected(V3_RECORDS)["writes"]["word"] != right).any(), name
    words = replace(case.records[0], colour=case.records[0].colour.copy())
    words.colour["position"] ^= 1
    assert (replace(case, records=[words]).expected(V3_RECORDS)["writes"]["word"] == right).all()


def test_the_stimuli_reach_every_end(tiny):
    """Every mask of levels; colours at both ends, and most of them between."""
    plan, _ = tiny
    item = next(item for item in plan if item.name == "extremes of degree 3")
    assert set(item.run.inputs["survivors"]["levels"]) == set(range(16))
    case = fine_case(TINY, 0, 3, 1500)
    colour = survivor_records(TINY, case.frames[0], case.records[0], 3, case.view_shift)[0]["colour"]
    top = TINY.formats.colour.raw_max
    assert len(np.unique(colour)) > top * 0.95 and 0.4 < ((colour > 0) & (colour < top)).mean() < 0.95


@pytest.mark.long
@pytest.mark.parametrize("config", [TINY, PAPER_SMALL, PAPER, V3_RECORDS], ids=lambda config: config.name)
def test_scenes_and_every_machine_are_exact(config, tmp_path):
    """The embedded scene always, trained ones where they are; rates are held by the plan."""
    plan = colour_suite.full_plan(config, 1)
    outcome = colour_suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and len(colour_suite.figures(config, plan, outcome)) >= 6


@pytest.mark.long
@pytest.mark.parametrize("sh_degree", [0, 1, 2])
@pytest.mark.parametrize("units", [1, 4, 8])
@pytest.mark.parametrize("base", [TINY, TINY_RECORDS], ids=lambda config: config.records)
def test_units_of_lower_degrees_and_other_intervals(base, sh_degree, units, tmp_path):
    config = base.with_(culling_units=units)
    outcome = colour_suite.run_plan(config, colour_suite.unit_plan(config, 2, sh_degree), tmp_path, sh_degree=sh_degree)
    assert outcome.failures == {}


@pytest.mark.long
def test_faults_in_the_rtl_are_caught(monkeypatch, tmp_path):
    """A factor, and a table's entry, off by their last bit."""
    clean, plan = colour_device.playback(TINY), [colour_suite.plan_of(TINY, fine_case(TINY, 7, 3, 20_000))]
    factors, (roots, inverses) = harmonics.factors(TINY.formats), harmonics.root_seeds(TINY.formats)
    inverses[40] -= 1
    faults = {"factors": factors._replace(polar=factors.polar + 1), "root_seeds": (roots, inverses)}
    for name, fault in faults.items():
        with monkeypatch.context() as patch:
            patch.setattr(harmonics, name, lambda formats, fault=fault: fault)
            broken = replace(clean, verilog=to_verilog(colour_device.ColourBench(TINY), "colour_bench"))
        assert broken.verilog != clean.verilog
        failures = exact.run_plan(broken, plan, tmp_path / name).failures
        assert list(failures) == [plan[0].name] and all(line.startswith("writes") for line in failures[plan[0].name])


@pytest.mark.long
def test_faults_in_the_rtl_of_compact_records_are_caught(monkeypatch, tmp_path):
    """The value of one opacity, the largest exponent of a band, and the bound of coarse records."""
    clean = colour_device.playback(TINY_RECORDS)
    plan = [colour_suite.plan_of(TINY_RECORDS, random_case(TINY_RECORDS, 8, 3, [2000]))]
    opacities = list(OPACITY_LOG2)
    opacities[100] += 1
    for module, name, fault in (
        (decode_colour, "OPACITY_LOG2", tuple(opacities)), (compact_sum, "BAND_EXPONENT_MOST", (5, 7, 6)),
        (compact_views, "COARSE_BOUND", 2),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(module, name, fault)
            broken = replace(clean, verilog=to_verilog(colour_device.ColourBench(TINY_RECORDS), "colour_bench"))
        failures = exact.run_plan(broken, plan, tmp_path / name).failures
        assert list(failures) == [plan[0].name] and all(line.startswith("writes") for line in failures[plan[0].name])


@pytest.mark.parametrize(("a", "b", "result"), [
    (SQ(2, 3), SQ(1, 2), SQ(2, 3)), (SQ(1, 3), SQ(2, 2), SQ(1, 1)), (SQ(0, 4), SQ(0, 3), SQ(0, 6)),
    (SQ(3, 1), SQ(0, 3), SQ(1, 0)),
], ids=str)
def test_products_are_rounded(a, b, result):
    """All operands: HALF_UP, modulo the format, with a flag where it does not fit."""
    dut = FixedMul(a=a, b=b, result=result)
    pairs = list(itertools.product(range(a.raw_min, a.raw_max + 1), range(b.raw_min, b.raw_max + 1)))
    drop = a.frac_bits + b.frac_bits - result.frac_bits
    found = []

    async def bench(ctx):
        ctx.set(dut.valid, 1)
        for x, y in (*pairs, *[(0, 0)] * dut.latency):
            ctx.set(dut.a, x)
            ctx.set(dut.b, y)
            if ctx.get(dut.result_valid):
                found.append((ctx.get(dut.result), ctx.get(dut.saturated)))
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    expected = []
    for x, y in pairs:
        exact = (x * y + (1 << drop - 1)) >> drop
        wrapped = int(result.from_bits(exact & (1 << result.width) - 1))
        expected.append((wrapped, exact != wrapped))
    assert found == expected


def test_operators():
    """One multiplier a culling unit."""
    for config, multipliers, most in ((TINY, 1, 820), (PAPER_SMALL, 2, 820), (PAPER, 8, 820), (V3_RECORDS, 15, 1400)):
        found = cost(schedule(harmonics_graph(config, 3), splat_interval(config)))
        assert found.operators == {"FixedMul": multipliers} and found.register_bits < most
    products = [len(harmonics_graph(PAPER, degree).nodes) for degree in (1, 2, 3)]
    assert products == sorted(products)
    assert all(splat_interval(config) == config.colour_interval for config in CONFIGS.values())
    assert (splat_interval(PAPER), splat_interval(V3_RECORDS)) == (LEAST_INTERVAL["wide"], LEAST_INTERVAL["compact"]) == (4, 2)


@pytest.mark.parametrize("config", [TINY, TINY_RECORDS, V3_RECORDS], ids=lambda config: config.name)
def test_end_of_a_frame(config):
    """`finished` waits for the last write to be taken, falls with the next frame's first item, and takes `error` with it."""
    dut, rng = ColourUnit(config, sh_degree=1), random.Random(0)
    frames = [[1, 8, 3], [], [15]]

    async def bench(ctx):
        for name, value in (("sh_degree", 1), ("view_shift", 2)):
            ctx.set(getattr(dut, name), value)
        ctx.set(dut.reads.ready, 1)
        assert not ctx.get(dut.finished)
        pending, log = 0, []
        ctx.set(dut.writes.ready, 0)
        for number, levels in enumerate(frames):
            items = [{"levels": mask, "index": rng.randrange(100), "end": 0} for mask in levels] + [{"end": 1}]
            writes = sum(mask.bit_count() for mask in levels)
            first = True
            for _ in range(600):
                ctx.set(dut.survivors.valid, bool(items))
                if items:
                    ctx.set(dut.survivors.payload, items[0])
                ctx.set(dut.data.valid, pending > 0)
                ctx.set(dut.data.payload, {"word": [0] * 8, "error": number == 0})
                ctx.set(dut.writes.ready, rng.random() < 0.2)
                taken = bool(items) and ctx.get(dut.survivors.ready)
                pending += ctx.get(dut.reads.valid) - (pending > 0 and ctx.get(dut.data.ready))
                writes -= ctx.get(dut.writes.valid) and ctx.get(dut.writes.ready)
                await ctx.tick()
                if taken:
                    items.pop(0)
                    assert not ctx.get(dut.finished)
                    assert not first or not ctx.get(dut.error)
                    first = False
                if not first and ctx.get(dut.finished):
                    break
            assert (items, writes, pending) == ([], 0, 0)
            assert ctx.get(dut.finished) and ctx.get(dut.error) == (number == 0)
            for _ in range(rng.randrange(50)):
                ctx.set(dut.survivors.valid, 0)
                await ctx.tick()
                assert ctx.get(dut.finished) and not ctx.get(dut.writes.valid)
            log.append(number)
        assert log == [0, 1, 2]

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()


def test_steps_read_two_beats():
    steps = record_steps(PAPER, 3, 4)
    assert [(list(s.terms), s.base, s.end) for s in steps] == [
        ([0, 1, 2, 3], 0, (1, 2, 2, 2)), ([4, 5, 6, 7], 1, (1, 2, 2, 2)), ([8, 9, 10, 11], 1, (1, 2, 2, 3)),
        ([12, 13, 14], 2, (1, 2, 2, 3))]
    assert len(record_steps(PAPER, 0, 0)) == 1 and len(record_steps(TINY, 3, 1)) == 15
    assert_rejected(lambda: record_steps(PAPER, 3, 15), ValueError, 15)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("interval", [2, 4, 8, 16])
def test_lanes_of_a_group_multiply_a_single_band(degree, interval):
    count = terms(degree)
    lanes = -(-count // interval)
    groups = lane_groups(degree, lanes)
    assert [lane for group in groups for lane in group.lanes] == list(range(lanes))
    for step in range(0, count, lanes):
        for group in groups:
            bands = {band_of(step + lane) for lane in group.lanes if step + lane < count}
            assert len(bands) <= 1 and all(BAND_BITS[band] <= group.bits for band in bands)
    carried = carried_layout(V3_RECORDS)
    assert_rejected(lambda: CompactColourSum(V3_RECORDS, sh_degree=degree, lanes=count, carried=carried), ValueError, count)


def test_bad_parameters_are_rejected():
    assert_rejected(lambda: ColourUnit("paper"), TypeError, "paper")
    for degree, error in ((4, ValueError), (-1, ValueError), (True, TypeError), (2.0, TypeError)):
        assert_rejected(lambda degree=degree: ColourUnit(TINY, sh_degree=degree), error, degree)
    good = {"a": SQ(1, 4), "b": SQ(1, 4), "result": SQ(1, 4)}
    for name in good:
        assert_rejected(lambda name=name: FixedMul(**good | {name: 4}), TypeError, 4)
        assert_rejected(lambda name=name: FixedMul(**good | {name: UQ(1, 3)}), ValueError, UQ(1, 3))
    assert_rejected(lambda: FixedMul(**good | {"result": SQ(1, 8)}), ValueError, SQ(1, 8))
