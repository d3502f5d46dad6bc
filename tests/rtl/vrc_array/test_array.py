"""The array as a whole: every configuration is emitted, and the collection of rows keeps order, room and distance."""

from __future__ import annotations

import random
import re
from itertools import pairwise, product
from typing import NamedTuple

import pytest
from amaranth.sim import Simulator

from rtl.units import emit
from rtl.vrc_array.array import VrcArray
from rtl.vrc_array.blend import BLEND_LATENCY
from rtl.vrc_array.collect import Collect
from rtl.vrc_array.expand import latency
from rtl.vrc_array.row import PIPELINE, SUMS_LATER
from spec.config import PAPER_SMALL, TINY
from spec.constants import TILE
from spec.records import array_splat, pixel_row, tile_header
from tests.helpers.rtl_streams import assert_rejected

PLAIN = TINY.with_(levels=1)
BASELINE = TINY.with_(incremental=False)


@pytest.mark.parametrize("config", [
    TINY, BASELINE, PLAIN.with_(depth=False, support_sigma=None), PAPER_SMALL.with_(cores_x=8, cores_y=2),
    TINY.with_(cores_x=2, cores_y=16),
    pytest.param(PAPER_SMALL, marks=pytest.mark.long),
], ids=lambda c: f"{c.cores_x}x{c.cores_y}-{c.level_banks}{'' if c.incremental else '-baseline'}")
def test_verilog(config):
    text = emit("vrc_array", config)
    modules = re.findall(r"^module (\S+?)\s?\(", text, re.MULTILINE)
    assert len(modules) == len(set(modules))
    assert {"vrc_array", "vrc_row", "pixel_core"} <= set(modules)
    assert len(re.findall(r"^\s*vrc_row row\d+ ", text, re.MULTILINE)) == config.cores_y
    for port, record in (("entries", array_splat), ("tiles", tile_header), ("pixels", pixel_row)):
        assert f"put [{record(config).width - 1}:0] {port}__payload;" in text
    if config is TINY:
        assert emit("vrc_array", config) == text


def test_bad_parameters_are_rejected():
    assert_rejected(lambda: VrcArray("tiny"), TypeError, "tiny")
    assert_rejected(lambda: Collect(None), TypeError, None)
    assert_rejected(lambda: Collect(TINY, lines=3), ValueError, 3)
    assert_rejected(lambda: Collect(TINY, lines=4.0), TypeError, 4.0)
    assert_rejected(lambda: Collect(BASELINE, lines=128), ValueError, 128)


def some_pixels(config, rng: random.Random) -> list[dict]:
    """One pixel for each column."""
    n = config.formats
    return [{
        "colour": [rng.randint(0, n.accumulator.raw_max) for _ in range(3)],
        "depth": rng.randint(0, n.depth_accumulator.raw_max),
        "transmittance": rng.randint(0, n.transmittance.raw_max),
    } for _ in range(config.cores_x)]


class Drained(NamedTuple):
    """Expected pixel rows, those collected, cycles of the drains and of the rows' leaving."""

    expected: list[dict]
    rows: list[dict]
    issued: list[int]
    left: list[int]


def drains(config, *, tiles: int, lines: int | None, takes: float) -> Drained:
    """Drains as fast as they are allowed, of made-up pixels."""
    dut, rng, record, issued = Collect(config, lines=lines), random.Random(3), pixel_row(config), []
    rows, left = [], []
    delay = 1 + latency(config) + PIPELINE
    order = list(product(range(tiles), range(0, TILE, config.cores_y), range(0, TILE, config.cores_x)))
    pixels = [[some_pixels(config, rng) for _ in range(config.cores_y)] for _ in order]
    expected = [{
        "tile_x": 5 + tile, "tile_y": 2 * tile, "row": y + row, "column": x,
        "colour": [c for pixel in pixels[i][row] for c in pixel["colour"]],
        "depth": [pixel["depth"] for pixel in pixels[i][row]],
        "transmittance": [pixel["transmittance"] for pixel in pixels[i][row]],
    } for i, (tile, y, x) in enumerate(order) for row in range(config.cores_y)]

    def show(ctx, y: int, cycle: int) -> None:
        """Row y's ports: what a drain finishes in this cycle, and junk elsewhere."""
        draining, drained = cycle - delay - y, cycle - delay - y - SUMS_LATER
        state = [[junk] * config.level_banks for junk in some_pixels(config, rng)]
        for strobe, names in ((draining, ("transmittance",)), (drained, ("colour", "depth"))):
            if strobe in issued:
                of_row = pixels[issued.index(strobe)][y]
                for bank, pixel in zip(state, of_row, strict=True):
                    bank[0] = bank[0] | {name: pixel[name] for name in names}
        ctx.set(dut.rows[y].draining, draining in issued)
        ctx.set(dut.rows[y].drained, drained in issued)
        if draining in issued or drained in issued:
            ctx.set(dut.rows[y].pixels, state)

    async def bench(ctx):
        tile = 0
        for cycle in range(6000):
            if ctx.get(dut.may_drain) and len(issued) < len(order):
                issued.append(cycle)
            ctx.set(dut.draining, issued[-1:] == [cycle])
            ctx.set(dut.places.valid, tile < tiles)
            ctx.set(dut.places.payload, {"tile_x": 5 + tile, "tile_y": 2 * tile, "blend": 0, "plane": [0, 0, 0]})
            ctx.set(dut.pixels.ready, rng.random() < takes)
            for y in range(config.cores_y):
                show(ctx, y, cycle)
            if ctx.get(dut.pixels.valid) and ctx.get(dut.pixels.ready):
                rows.append(record.unpack(ctx.get(dut.pixels.payload).as_bits()))
                left.append(cycle)
            tile += ctx.get(dut.places.ready)
            await ctx.tick()
            if len(rows) == len(expected):
                assert not ctx.get(dut.busy)
                return

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    return Drained(expected, rows, issued, left)


@pytest.mark.parametrize(("config", "lines", "takes"), [
    (TINY, 16, 0.4), (TINY, None, 0.8), (PLAIN, 16, 1.0),
    (PLAIN.with_(cores_y=16), 17, 0.7), (PLAIN.with_(cores_y=16), None, 0.7),
    (TINY.with_(cores_x=8, cores_y=2), 2, 1.0), (BASELINE, None, 0.4), (BASELINE, None, 1.0),
    (BASELINE.with_(levels=1, cores_y=16), None, 0.7), (BASELINE.with_(cores_x=16, cores_y=2, depth=False), None, 0.8),
])
def test_rows_are_collected_in_order_and_none_is_lost(config, lines, takes):
    made = drains(config, tiles=4, lines=lines, takes=takes)
    if not config.depth:
        for row in made.expected:
            row["depth"] = [0] * config.cores_x
    assert made.rows == made.expected


@pytest.mark.parametrize("config", [PLAIN.with_(cores_y=16), PAPER_SMALL.with_(cores_x=2, levels=1)], ids=["4x16", "2x16"])
def test_drains_follow_without_a_pause_where_the_buffer_holds_two(config):
    issued = drains(config, tiles=2, lines=2 * config.cores_y, takes=1.0).issued
    assert [b - a for a, b in pairwise(issued)] == [config.cores_y] * (len(issued) - 1)


@pytest.mark.parametrize("config", [TINY, PLAIN.with_(cores_y=16)], ids=["4x4", "4x16"])
def test_the_least_buffer_holds_a_drain(config):
    """A drain waits until the rows of the one before have left, at once where they are taken at once."""
    made = drains(config, tiles=2, lines=None, takes=1.0)
    for drain in range(1, len(made.issued)):
        assert made.issued[drain] == made.left[drain * config.cores_y - 1] + 1


@pytest.mark.parametrize("takes", [0.3, 1.0])
@pytest.mark.parametrize("config", [BASELINE, BASELINE.with_(levels=1, cores_x=8, cores_y=16)], ids=["4x4", "8x16"])
def test_the_baseline_hands_over_whole_tiles(config, takes):
    """A tile's first row leaves once its last one is in, and the next but one tile begins when it has gone."""
    made, each = drains(config, tiles=5, lines=None, takes=takes), TILE * TILE // config.cores_x
    blocks = config.blocks
    in_after = latency(config) + PIPELINE + SUMS_LATER + 3 + (BLEND_LATENCY if config.levels > 1 else 0) + config.cores_y
    for tile in range(5):
        first, last, all_in = made.left[tile * each], made.left[tile * each + each - 1], made.issued[tile * blocks + blocks - 1]
        assert first >= all_in + in_after
        assert takes < 1 or tile or first == all_in + in_after
        if tile + 2 < 5:
            assert made.issued[(tile + 2) * blocks] > last
