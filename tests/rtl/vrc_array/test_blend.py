"""Blend weights and level blending against docs/array.md in Python integers."""

from __future__ import annotations

import random

import pytest
from amaranth.sim import Simulator

from rtl.vrc_array.blend import BLEND_LATENCY, Blend, BlendWeights, weights_latency
from spec.config import PAPER_SMALL, TINY, NumberFormats
from spec.formats import SQ
from spec.tables import BLEND_INDEX_BITS, smoothstep_table
from tests.helpers.rtl_streams import assert_rejected

N = PAPER_SMALL.formats
ONE = 1 << N.plane.frac_bits


def weight(blend: int, t: int) -> int:
    if not blend or t < 0:
        return 0
    return 256 if t >= ONE else int(smoothstep_table(N)[t >> N.plane.frac_bits - BLEND_INDEX_BITS])


def run(dut, inputs: list[dict], latency: int, read) -> list:
    """`read(ctx)` `latency` cycles after each of the inputs, one a cycle with gaps."""
    found, rng = [], random.Random(4)

    async def bench(ctx):
        due = []
        for item in [*inputs, *[None] * latency]:
            while item is not None and rng.random() < 0.2:
                await step(ctx, due, None)
            await step(ctx, due, item)

    async def step(ctx, due, item):
        ctx.set(dut.valid, item is not None)
        for name, value in (item or {}).items():
            ctx.set(getattr(dut, name), value)
        due.append(item is not None)
        await ctx.tick()
        if len(due) >= latency and due[-latency]:
            found.append(read(ctx))

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    return found


@pytest.mark.parametrize("config", [PAPER_SMALL, TINY, TINY.with_(cores_x=2)], ids=lambda config: str(config.cores_x))
def test_weights(config):
    rng, items = random.Random(1), []
    for i in range(300):
        limit = (ONE // 16, ONE, N.plane.raw_max)[i % 3]
        plane = [rng.randint(-limit - 1, limit) for _ in range(3)]
        place = {"row": rng.randrange(16), "column": rng.randrange(0, 16, config.cores_x)}
        items.append({"blend": i % 7 > 0, "plane": plane, **place})
    for corner in ([0, 0, 0], [ONE - 1, 0, 0], [ONE, 0, 0], [-1, 0, 0], [N.plane.raw_min] * 3, [N.plane.raw_max] * 3):
        items.append({"blend": 1, "plane": corner, "row": 15, "column": 16 - config.cores_x})
    dut = BlendWeights(config)
    found = run(dut, items, weights_latency(config), lambda ctx: list(ctx.get(dut.weights)))

    def t(item: dict, x: int) -> int:
        return item["plane"][0] + (item["column"] + x) * item["plane"][1] + item["row"] * item["plane"][2]

    assert found == [[weight(item["blend"], t(item, x)) for x in range(config.cores_x)] for item in items]
    assert {0, 256} < {w for row in found for w in row}


@pytest.mark.parametrize("config", [TINY, TINY.with_(depth=False)], ids=["depth", "flat"])
def test_mixing(config):
    rng, lanes = random.Random(2), config.cores_x
    tops = {"colour": N.accumulator.raw_max, "depth": N.depth_accumulator.raw_max, "transmittance": N.transmittance.raw_max}

    def state() -> dict:
        def number(top: int) -> int:
            return rng.choice((0, top, rng.randint(0, top)))
        return {"colour": [number(tops["colour"]) for _ in range(3)], "depth": number(tops["depth"]),
                "transmittance": number(tops["transmittance"])}

    items = [{
        "pixels": [[state(), state()] for _ in range(lanes)],
        "weights": [rng.choice((0, 1, 255, 256, rng.randint(0, 256))) for _ in range(lanes)],
    } for _ in range(200)]
    dut = Blend(config)
    found = run(dut, items, BLEND_LATENCY, lambda ctx: [
        {"colour": list(pixel.colour), "depth": pixel.depth, "transmittance": pixel.transmittance}
        for pixel in ctx.get(dut.mixed)
    ])

    def mix(a: int, b: int, w: int) -> int:
        return a + ((b - a) * w + 128 >> 8)

    expected = [[{
        "colour": [mix(a["colour"][c], b["colour"][c], w) for c in range(3)],
        "depth": mix(a["depth"], b["depth"], w) if config.depth else 0,
        "transmittance": mix(a["transmittance"], b["transmittance"], w),
    } for (a, b), w in zip(item["pixels"], item["weights"], strict=True)] for item in items]
    assert found == expected


@pytest.mark.parametrize("unit", [Blend, BlendWeights])
def test_bad_parameters_are_rejected(unit):
    assert_rejected(lambda: unit("tiny"), TypeError, "tiny")
    assert_rejected(lambda: unit(TINY.with_(levels=1)), ValueError, 1)
    coarse = SQ(6, BLEND_INDEX_BITS - 1)
    assert_rejected(lambda: unit(TINY.with_(formats=NumberFormats(plane=coarse))), ValueError, coarse)
