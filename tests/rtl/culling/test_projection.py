"""The projection unit in Verilator against the golden renderer, and the logic between its operations in Amaranth's simulator.

PAPER, PAPER_SMALL, DEFAULT, and the trained scenes, are long.
"""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest
from amaranth.hdl import Module, Signal, unsigned
from amaranth.sim import Simulator

from golden.msv2_ref.projection import FAINT, NEAR, VISIBLE, project
from rtl.culling.near import limit_format
from rtl.culling.projection_unit import ProjectionUnit
from rtl.culling.values import at_least_smallest, clamp, doubled, order, rescale, widen
from spec.config import DEFAULT, PAPER, PAPER_SMALL, SHORT_FORMATS, TINY
from spec.formats import SmallFloat
from tb.common.exact import problems
from tb.culling import projection_suite
from tb.culling.projection_stimuli import guard_band_case, guard_band_ends
from tests.helpers.rtl_streams import assert_rejected

N = PAPER.formats


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """The plan for TINY and its outcome."""
    plan = [*projection_suite.unit_plan(TINY, 0), *projection_suite.rate_plan(TINY, 0)]
    return plan, projection_suite.run_plan(TINY, plan, tmp_path_factory.mktemp("tiny"))


def test_tiny_is_exact_and_fast_enough(tiny):
    plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 7000
    assert len(projection_suite.figures(TINY, plan, outcome)) == 4


def test_the_plan_meets_every_limit_of_the_formats(tiny):
    """Stimuli that met none of them would prove nothing."""
    plan, _ = tiny
    splats = np.concatenate([item.expected["source"] for item in plan])
    splats = splats[splats["end"] == 0]
    assert (splats["depth"] == N.depth.raw_max).any() and (splats["depth_key"] == N.depth_key.raw_max).any()
    for raw in (N.mean2d.raw_min, N.mean2d.raw_max):
        assert not (splats["mean2d"] == raw).any()
        assert (splats["mean2d"] == raw + (1 if raw < 0 else -1)).any(axis=0).all()  # the outermost means that are drawn
    assert (splats["conic"][:, [0, 2]] == 1 << (N.conic.sig_bits - 1)).any()  # the smallest positive number
    assert (splats["conic"][:, 1] == 0).any()
    counts = {name: sum(item.observed[name] for item in plan) for name in projection_suite.REASONS}
    assert min(counts.values()) > 500, counts
    assert sum(item.observed["saturated_means"] for item in plan) > 500


def test_means_at_every_end_of_the_guard_band_are_met():
    """On both axes, on both sides, at the end and an ulp inside and outside of it; only those inside are drawn."""
    met, rng, to = set(), np.random.default_rng(0), N.mean2d
    for number in range(len(guard_band_ends(TINY))):
        case = guard_band_case(TINY, rng, number)
        projected = project(TINY, case.frames[0], case.registers)
        offset = N.position.to_float(case.frames[0].geometry["mean"])
        raw = 256 * offset[:, :2] / offset[:, 2:] * 2**to.frac_bits + case.registers.centre
        assert np.array_equal(raw, np.floor(raw)) and (offset[:, 2] == 2).all()
        assert np.array_equal(projected.mean2d, np.clip(raw, to.raw_min, to.raw_max))
        beyond = ((raw <= to.raw_min) | (raw >= to.raw_max)).any(axis=1)
        clear, boxed = ~np.isin(projected.reason, (FAINT, NEAR)), (projected.box[:, ::2] <= projected.box[:, 1::2]).all(axis=1)
        assert ((projected.reason == VISIBLE) == (clear & boxed & ~beyond)).all() and (boxed & beyond & clear).sum() > 20
        met |= {(axis, int(value)) for axis in range(2) for value in raw[boxed & clear, axis]}
    assert met >= {(axis, end) for axis in range(2) for end in guard_band_ends(TINY)}


def test_faults_are_found(tiny):
    plan, outcome = tiny
    item = next(item for item in plan if item.name.startswith("ordinary"))
    recording = outcome.recordings[item.name]
    assert problems(item, recording) == []
    for name in item.expected["source"].dtype.names:
        rows = item.expected["source"].copy()
        rows[name].flat[0] ^= 1
        wrong = problems(replace(item, expected={"source": rows}), recording)
        assert len(wrong) == 1 and wrong[0].startswith("source 0: "), name
    for name in projection_suite.COUNTS:
        observed = {**item.observed, name: item.observed[name] + 1}
        assert problems(replace(item, observed=observed), recording)[0].startswith(name)
    assert problems(replace(item, most_cycles=recording.cycles - 1), recording)


def test_words_shorter_than_what_enters_them_are_exact(tmp_path):
    """Quaternions and limits have more significant bits than the presets' `work` format: they are rounded into it."""
    config = TINY.with_(name="tiny_short", formats=SHORT_FORMATS)
    n = config.formats
    assert n.work.sig_bits < min(n.quaternion.frac_bits, limit_format(n).width)
    plan = projection_suite.unit_plan(config, 0)[:14]
    assert projection_suite.run_plan(config, plan, tmp_path).failures == {}


def test_points_of_the_embedded_scene(monkeypatch, tmp_path):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path / "absent"))
    plan = projection_suite.traced_plan(TINY, "96x64", 1500)
    assert projection_suite.run_plan(TINY, plan, tmp_path / "run").failures == {}
    assert all(len(item.expected["source"]) > 300 for item in plan)


@pytest.mark.long
@pytest.mark.parametrize("config", [TINY, PAPER_SMALL, DEFAULT, PAPER], ids=lambda config: config.name)
def test_scenes_are_exact(config, tmp_path):
    """The embedded scene always, trained ones where they are; rates are held by the plan."""
    plan = projection_suite.full_plan(config, 1)
    outcome = projection_suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and len(projection_suite.figures(config, plan, outcome)) >= 5


def evaluate(logic, widths: tuple[int, ...], rows: list[tuple[int, ...]]) -> list[int]:
    """Values of combinational logic."""
    m, operands = Module(), [Signal(width) for width in widths]

    def let(name, value):
        wire = Signal(value.shape(), name=name)
        m.d.comb += wire.eq(value)
        return wire

    result, got = logic(let, *operands), []
    out = Signal(unsigned(len(result)))
    m.d.comb += out.eq(result)

    async def bench(ctx):
        for row in rows:
            for signal, value in zip(operands, row, strict=True):
                ctx.set(signal, value)
            got.append(ctx.get(out))

    simulator = Simulator(m)
    simulator.add_testbench(bench)
    simulator.run()
    return got


def patterns(number: SmallFloat, rng: random.Random, count: int) -> list[int]:
    """Numbers of a format, its ends and zero among them."""
    least, top = 1 << (number.sig_bits - 1), 1 << (number.width - number.signed)
    signs = (0, top) if number.signed else (0,)
    return [0, *(rng.choice([least, least + 1, top - 1, rng.randrange(least, top)]) | rng.choice(signs) for _ in range(count))]


@pytest.mark.parametrize(("number", "to"), [(N.view, N.work), (N.work, N.conic), (SmallFloat(5, 3, 2), SmallFloat(3, 2, 1))])
def test_a_number_in_another_format(number, to):
    rows = patterns(number, random.Random(1), 2000)
    got = evaluate(lambda let, x: rescale(let, x, number, to), (number.width,), [(x,) for x in rows])
    assert got == to.quantise(number.to_float(rows)).tolist()
    got = evaluate(lambda let, x: rescale(let, x, number, to, negate=True), (number.width,), [(x,) for x in rows])
    assert got == to.quantise(-number.to_float(rows)).tolist()


def test_exact_changes_of_numbers():
    rng = random.Random(2)
    rows = [x % (1 << N.scale.width) for x in patterns(N.scale, rng, 500)]
    got = evaluate(lambda _, x: widen(x, N.scale, N.work), (N.scale.width,), [(x,) for x in [*rows, 1, 5]])
    assert got == N.work.quantise(N.scale.to_float([*rows, 0, 0])).tolist()
    values = N.work.quantise([0.0, 1.0, -0.75, 2.0**-13, -1.0]).tolist()
    got = evaluate(lambda _, x: doubled(x, N.work), (N.work.width,), [(x,) for x in values])
    assert got == N.work.quantise(2 * N.work.to_float(values)).tolist()
    got = evaluate(lambda _, x: at_least_smallest(x, N.conic), (N.conic.width,), [(0,), (1 << 15,), (1 << 18,)])
    assert got == [1 << 15, 1 << 15, 1 << 18]


def test_order_and_clamp_are_those_of_values():
    rng, number = random.Random(3), SmallFloat(4, 3, 3)
    triples = [tuple(rng.choice(patterns(number, rng, 3)) for _ in range(3)) for _ in range(2000)]
    triples = [(x, *sorted(ends, key=number.to_float)) for x, *ends in triples]
    less = evaluate(lambda _, a, b: order(a) < order(b), (number.width,) * 2, [t[:2] for t in triples])
    assert less == [int(number.to_float(a) < number.to_float(b)) for a, b, _ in triples]
    got = evaluate(lambda _, *t: clamp(*t), (number.width,) * 3, triples)
    assert got == number.quantise(np.clip(*(number.to_float(side) for side in np.transpose(triples)))).tolist()


def test_bad_parameters_are_rejected():
    assert_rejected(lambda: ProjectionUnit("paper"), TypeError, "paper")
