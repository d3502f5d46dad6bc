"""The warp unit in Verilator against the golden renderer; divider, disparities and medians by themselves; faults put there on
purpose.

The other machines and the scenes are long.
"""

from __future__ import annotations

import random
import re
from dataclasses import replace

import numpy as np
import pytest
from amaranth.hdl import Module
from amaranth.sim import Simulator

from golden.msv2_ref.warp import warp_pixels
from rtl.emit import to_rtlil
from rtl.units import emit
from rtl.warp_unit.delay import Delay
from rtl.warp_unit.disparity import Disparity, carried_cycles, carried_layout, disparity_latency
from rtl.warp_unit.divider import Divider
from rtl.warp_unit.fill import FILL_LATENCY, Fill
from rtl.warp_unit.warp_unit import WarpUnit
from spec.config import PAPER, TINY
from spec.constants import TILE
from spec.memory import display_pixel, write_request
from spec.packing import unpack
from tb.common.exact import problems
from tb.vrc_array.pixel_writer_stimuli import memory_of
from tb.warp_unit import suite
from tb.warp_unit.cones import cones_folder, psnr_of_cones
from tb.warp_unit.device import warped_tile
from tb.warp_unit.stimuli import anything, writes_of
from tests.helpers.rtl_streams import assert_rejected, exchange

STEREO = TINY.with_(stereo=True, row_width=256)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """Plan and outcome of TINY with shorter rows: its strips build, and clear, faster."""
    plan = [*suite.directed_plan(STEREO, 0), *suite.unit_plan(STEREO, 0), *suite.rate_plan(STEREO, 0)]
    return plan, suite.run_plan(STEREO, plan, tmp_path_factory.mktemp("warp"))


def test_tiny_is_exact_and_fast_enough(tiny):
    plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 10_000


@pytest.mark.parametrize("changes", [
    {"warp_lanes": 4, "warp_veiled": True}, pytest.param({"warp_lanes": 2, "warp_fill": "interior"}, marks=pytest.mark.long)],
    ids=["4 lanes, veiled", "2 lanes, interior"])
def test_other_lanes_and_rules_are_exact(changes, tmp_path):
    """Rows side by side, borders and corners of strips among them; what is warped and filled otherwise."""
    config = STEREO.with_(**changes)
    plan = suite.directed_plan(config, 1)
    outcome = suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(plan)
    events = {item.name: item.observed for item in plan}
    assert events["every border"]["filled"] >= (4 if config.warp_fill == "interior" else 4 * (10 + 5 + 1) + 8)


def test_every_case_occurs(tiny):
    """Holes filled and left, tiles with and without them, rows that wait for the strip before."""
    plan, outcome = tiny
    events = {item.name: item.observed for item in plan}
    every = events["every neighbourhood"]
    assert every["filled"] >= 4 * (56 + 28 + 8 + 1) and every["invalid_tiles"] > 0  # sets of 5, 6, 7 and 8 of 8 neighbours
    border = events["every border"]
    assert border["filled"] >= 4 * (10 + 5 + 1) + 8 and border["invalid_tiles"] > 0  # of 3, 4 and 5 of 5; of both of 2
    assert events["background"]["warped"] == 40 * 37 and events["background"]["invalid_tiles"] == 0
    assert events["all holes"]["warped"] == 0 and events["all holes"]["invalid_tiles"] == 9
    assert events["no depth, left"]["warped"] == 0
    assert 0 < events["many to one, left, every 1"]["warped"] < 67 * 32 // 2
    assert outcome.recordings["rate, 128 x 64"].stalls["rows"] > 0
    for item in plan:
        if item.name.startswith("reached"):  # columns that nothing reaches, and some that pixels from far away do
            assert 0 < item.observed["warped"] < item.run.settings["width"] * item.run.settings["height"]


def test_faults_are_found(tiny):
    plan, outcome = tiny
    item = next(item for item in plan if item.name == "31 x 49")
    recording = outcome.recordings[item.name]
    assert problems(item, recording) == []
    for port, record in (("writes", write_request(STEREO)), ("tiles", warped_tile(STEREO))):
        for name in record.dtype.names:
            rows = item.expected[port].copy()
            rows[name][3] ^= 1
            assert problems(replace(item, expected={port: rows}), recording)[0].startswith(f"{port} 3: ")
    for name in item.observed:
        assert problems(replace(item, observed={name: item.observed[name] + 1}), recording)


@pytest.mark.parametrize(("width", "height"), suite.SIZES)
def test_memory_has_every_pixel_once_and_nothing_else(tiny, width, height):
    """Whatever the order of the beats."""
    plan, outcome = tiny
    name = f"{width} x {height}"
    item = next(item for item in plan if item.name == name)
    words, times = memory_of(
        outcome.recordings[name].outputs["writes"], item.run.settings["target_frame_base"], width * height)
    expected, _ = memory_of(item.expected["writes"], item.run.settings["target_frame_base"], width * height)
    assert (times == 1).all() and np.array_equal(words, expected)


def test_beats_hold_the_golden_pixels():
    rng = np.random.default_rng(0)
    pixels = anything(STEREO, rng, 21, 19).warped(STEREO).pixels
    words, times = memory_of(writes_of(STEREO, pixels, 77), 77, pixels.size)
    got = unpack(display_pixel(STEREO), words.astype("<u4").view(np.uint8).reshape(pixels.size, -1))
    assert (times == 1).all() and np.array_equal(got, pixels.reshape(-1))


def in_step(dut, feed, result, count, latency):
    """Values of `result` for `count` operands, fed one a cycle by `feed(ctx, i)`, each `latency` cycles later."""
    found = []

    async def bench(ctx):
        for cycle in range(count + latency):
            feed(ctx, min(cycle, count - 1))
            await ctx.tick()
            if cycle >= latency - 1 and len(found) < count:
                found.append(result(ctx))

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    return found


@pytest.mark.parametrize(("numerator", "divisor", "quotient"), [(6, 3, 3), (6, 3, 4), (5, 4, 3), (7, 2, 2), (36, 18, 19)])
def test_divider_is_exact(numerator, divisor, quotient):
    """Every operand where they are few; else small, large and just at a multiple of the divisor."""
    rng = random.Random(numerator)
    pairs = [(n, d) for n in range(1 << numerator) for d in range(1 << divisor)] if numerator < 8 else [
        (max(0, rng.randrange(1 << rng.randint(1, quotient)) * d + rng.choice((-1, 0, d - 1))) % (1 << numerator), d)
        for d in (rng.randrange(1 << rng.randint(0, divisor)) for _ in range(800))]
    overs = []
    for check in ("over", "quotient"):
        dut = Divider(numerator_bits=numerator, divisor_bits=divisor, quotient_bits=quotient)

        def feed(ctx, i, dut=dut):
            ctx.set(dut.load, 1)
            ctx.set(dut.numerator, pairs[i][0])
            ctx.set(dut.divisor, pairs[i][1])

        got = in_step(dut, feed, lambda ctx, dut=dut, check=check: ctx.get(getattr(dut, check)), len(pairs),
                      1 if check == "over" else quotient)
        if check == "over":
            overs = got
            assert overs == [int(d == 0 or n // d >= 1 << quotient) for n, d in pairs]
        else:
            assert all(over or q == n // d for over, q, (n, d) in zip(overs, got, pairs, strict=True))
    assert 0 < sum(overs) < len(overs)


@pytest.mark.parametrize("right", [False, True], ids=["left", "right"])
def test_disparities_are_the_golden_ones(right):
    """A row of pixels, one a cycle, and each exactly `disparity_latency` cycles later."""
    rng, dut, m = np.random.default_rng(right), Disparity(STEREO), Module()
    m.submodules.dut, m.submodules.delay = dut, Delay(carried_layout(STEREO), carried_cycles(STEREO))
    delay = m.submodules.delay
    m.d.comb += [delay.load.eq(dut.carries), delay.early.eq(dut.early), dut.late.eq(delay.late)]
    source, columns = anything(STEREO, rng, 250, 1, right), STEREO.warp_columns
    source = replace(source, scale=9000)
    pixels, moved = source.pixels[0], warp_pixels(STEREO, source.pixels, source.scale, right)[0]

    def feed(ctx, i):
        for port, value in ((dut.load, 1), (dut.last, 249), (dut.disparity_scale, source.scale), (dut.source_right, right),
                            (dut.place.x, i), (dut.place.slot, i % columns // TILE), (dut.pixel.depth, int(pixels["depth"][i])),
                            (dut.pixel.transmittance, int(pixels["transmittance"][i])),
                            *((dut.pixel.colour[c], int(pixels["colour"][i][c])) for c in range(3))):
            ctx.set(port, value)

    def result(ctx):
        keep, out = ctx.get(dut.moved.keep), ctx.get(dut.moved)
        return (1, out.place.x, out.key, [out.colour[c] for c in range(3)]) if keep else (0, 0, 0, [0, 0, 0])

    got = in_step(m, feed, result, len(pixels), disparity_latency(STEREO))
    assert got == [(row["keep"], row["x"] % columns, row["key"], row["colour"].tolist()) for row in moved]
    assert 30 < sum(row[0] for row in got) < 220


@pytest.mark.parametrize("pauses", [0.0, 0.4])
def test_medians(pauses):
    """Of 1 to 8 neighbours, often equal; the rest passes through; a slot a cycle where nothing pauses."""
    rng, dut = random.Random(1), Fill(STEREO)
    shape, slots, wanted = dut.slots.payload.shape(), [], []
    for _ in range(300):
        valid = rng.sample(range(8), rng.randint(1, 8))
        top = rng.choice((2, 255))
        around = [{"colour": [rng.randint(0, top) for _ in range(3)], "valid": int(i in valid)} for i in range(8)]
        painted = {"colour": [rng.randrange(256) for _ in range(3)], "covered": rng.randrange(2)}
        group = {"pixels": [painted], "holes": 1, "fills": 1, "lane": 0, "last": rng.randrange(2), "left": rng.randrange(2),
                 "warped": rng.randrange(2)}
        slots.append(shape.const({**group, "around": around, "rank": (len(valid) - 1) // 2}).as_bits())
        median = [sorted(around[i]["colour"][c] for i in valid)[(len(valid) - 1) // 2] for c in range(3)]
        wanted.append(dut.filled.payload.shape().const({**group, "colour": median}).as_bits())
    got, cycles = exchange(dut, {dut.slots: slots}, dut.filled, len(wanted), pauses=pauses)
    assert got == wanted
    if not pauses:
        assert cycles == list(range(cycles[0], cycles[0] + len(wanted))) and cycles[0] <= FILL_LATENCY + 1


def test_storage_is_what_is_stated():
    """Ring, queues, beats, mask: bits of PAPER's memories."""
    text = to_rtlil(WarpUnit(PAPER.with_(stereo=True)), "warp_unit")
    once = sum(int(width) * int(words) for width, words in re.findall(r"memory width (\d+) size (\d+)", text))
    ring, queues, beats, division, mask = 16 * 512 * (25 + 17), 4 * 4 * 1271, 16 * 2 * 8 * 25, 4 * 45 * 18, 120 * 120
    assert once == (ring + queues) // 4 + beats + division + mask  # every lane's bank and queue are one module
    assert "344,064 for PAPER" in WarpUnit.__doc__ and ring == 344_064


def test_verilog():
    text = emit("warp_unit", STEREO)
    assert "module warp_unit(" in text and emit("warp_unit", STEREO) == text


def test_bad_parameters_are_rejected():
    assert_rejected(lambda: WarpUnit("tiny"), TypeError, "tiny")
    assert_rejected(lambda: WarpUnit(TINY), ValueError, TINY)
    assert_rejected(lambda: Delay(8, 2.0), TypeError, 2.0)
    assert_rejected(lambda: Delay(8, 1), ValueError, 1)
    assert_rejected(lambda: Divider(numerator_bits=8, divisor_bits=4, quotient_bits=True), TypeError, True)
    assert_rejected(lambda: Divider(numerator_bits=8, divisor_bits=0, quotient_bits=4), ValueError, 0)
    assert_rejected(lambda: Divider(numerator_bits=4, divisor_bits=4, quotient_bits=4), ValueError, 4)


def test_traced_frames_of_the_embedded_scene(monkeypatch, tmp_path):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path / "absent"))
    plan = suite.traced_plan(STEREO, "53x41")
    assert len(plan) == 1 + 4 and suite.run_plan(STEREO, plan, tmp_path / "run").failures == {}


@pytest.mark.long
@pytest.mark.parametrize("name", suite.DISTINCT)
def test_scenes_and_other_machines_are_exact(name, tmp_path):
    """The embedded scene always, trained ones where they are."""
    config = suite.VARIANTS[name]
    plan = suite.full_plan(config, 1)
    outcome = suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and len(suite.figures(config, plan, outcome)) >= 5


@pytest.mark.long
@pytest.mark.data
def test_middlebury_cones_through_the_unit(data_dir, monkeypatch, tmp_path, record_property):
    """The left photograph, warped by its true disparities, against the right one."""
    monkeypatch.setenv("MSV2_DATA", str(data_dir))
    folder, config = cones_folder(), STEREO.with_(row_width=512)
    if folder is None:
        pytest.skip(f"no Middlebury cones at {data_dir}")
    plan = suite.cones_plan(config)
    outcome = suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and [item.name for item in plan][1:] == [suite.CONES]
    recording = outcome.recordings[suite.CONES]
    seen = psnr_of_cones(config, folder, recording.outputs["writes"], plan[1].run.settings["target_frame_base"])
    for name, value in seen.items():
        record_property(name, value)
    print(f"cones: {seen['warped_db']:.2f} dB warped, {seen['unwarped_db']:.2f} dB not, over {seen['share']:.1%} of the pixels")
    assert seen["share"] > 0.7 and seen["warped_db"] > seen["unwarped_db"] + 8
    assert any(line.startswith(f"{suite.CONES} against") for line in suite.figures(config, plan, outcome))
