"""Block sequencer and expansion: the first row of every block, against the polynomial of docs/array.md."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest
from amaranth.hdl import Module
from amaranth.sim import Simulator

from rtl.vrc_array.blocks import BlockSequencer
from rtl.vrc_array.expand import Expand, latency
from spec.config import PAPER_SMALL, TINY
from spec.constants import TILE
from spec.records import pixel_op
from tests.helpers.rtl_streams import assert_rejected

N = PAPER_SMALL.formats
FLAGS = ("outer", "first", "last", "drain")


def an_op(rng: random.Random) -> dict:
    """An op whose polynomial fits the formats all over the tile: small terms, or one large one."""
    def up_to(limit: float, number) -> int:
        return rng.randint(-int(limit * (1 << number.frac_bits)), int(limit * (1 << number.frac_bits)))

    kind = rng.randrange(4)
    slope, curve = ((30, 1), (63, 0), (1, 3.9), (127.9, 0))[kind]
    only = kind == 3 and rng.choice(("slope_x", "slope_y"))
    op = {"exponent": up_to(100 if kind < 3 else 2000 - 127.9 * 15, N.exponent)}
    op |= {name: up_to(slope if only in (False, name) else 0, N.slope) for name in ("slope_x", "slope_y")}
    op |= {name: up_to(curve, N.curvature) for name in ("curve_xx", "curve_xy", "curve_yy")}
    return op | {
        "cut": up_to(7, N.cut), "colour": [rng.randint(0, N.colour.raw_max) for _ in range(3)],
        "depth": rng.randint(0, N.depth.raw_max), "bank": rng.getrandbits(1), **{name: rng.getrandbits(1) for name in FLAGS},
    }


def exponent(op: dict, x: int, y: int) -> int:
    return (op["exponent"] + x * op["slope_x"] + y * op["slope_y"] + x * (x - 1) // 2 * op["curve_xx"]
            + y * (y - 1) // 2 * op["curve_yy"] + x * y * op["curve_xy"])


def wrapped(value: int, number) -> int:
    return (value - number.raw_min) % (1 << number.width) + number.raw_min


def expected_rows(config, op: dict) -> list[dict]:
    """What the first row of cores gets for each block."""
    rows, levels = [], config.level_banks
    for y in range(0, TILE, config.cores_y):
        for x in range(0, TILE, config.cores_x):
            columns = range(x, x + config.cores_x)
            rows.append({
                "exponents": [exponent(op, column, y) for column in columns],
                "slopes": [wrapped(exponent(op, column, y + 1) - exponent(op, column, y), N.slope) for column in columns],
                "bank": len(rows) * levels + (op["bank"] if levels == 2 else 0),
                **{name: op[name] for name in ("curve_yy", "cut", "colour", "depth", *FLAGS)},
            })
    return rows


def simulate(config, ops: list[dict], spacing: int = 0, idle: float = 0.0) -> tuple[list[dict], list[int]]:
    """(the first row's inputs, their cycles); drains are allowed `spacing` cycles apart."""
    m, record, rng = Module(), pixel_op(config), random.Random(5)
    m.submodules.sequencer = sequencer = BlockSequencer(config)
    m.submodules.expand = expand = Expand(config)
    m.d.comb += expand.issue.eq(sequencer.issue)
    rows, cycles, total = [], [], len(ops) * config.blocks

    async def feed(ctx):
        port = sequencer.ops
        for op in ops:
            while rng.random() < idle:
                await ctx.tick()
            ctx.set(port.payload, port.payload.shape().from_bits(record.pack(op)))
            ctx.set(port.valid, 1)
            await ctx.tick().until(port.ready)
            ctx.set(port.valid, 0)

    async def watch(ctx):
        drained = -1000
        for cycle in range(40 * total + 100):
            ctx.set(sequencer.may_drain, cycle - drained >= spacing)
            drained = cycle if ctx.get(sequencer.draining) else drained
            if ctx.get(expand.op.valid):
                op = ctx.get(expand.op)
                rows.append({
                    "exponents": list(ctx.get(expand.exponents)), "slopes": list(ctx.get(expand.slopes)), "bank": op.bank,
                    "colour": list(op.colour), **{name: op[name] for name in ("curve_yy", "cut", "depth", *FLAGS)},
                })
                cycles.append(cycle)
            if len(rows) == total:
                return
            await ctx.tick()

    simulator = Simulator(m)
    simulator.add_clock(1e-9)
    simulator.add_process(feed)
    simulator.add_testbench(watch)
    simulator.run()
    return rows, cycles


SHAPES = [
    PAPER_SMALL, TINY, PAPER_SMALL.with_(cores_x=8, levels=1), PAPER_SMALL.with_(cores_y=2), TINY.with_(cores_x=2, cores_y=16),
]


@pytest.mark.parametrize("config", SHAPES, ids=lambda c: f"{c.cores_x}x{c.cores_y}-{c.level_banks}")
@pytest.mark.parametrize("idle", [0.0, 0.5])
def test_every_block_of_every_op(config, idle):
    rng = random.Random(1)
    ops = [an_op(rng) for _ in range(12 + 100 // config.blocks)]
    rows, _ = simulate(config, ops, spacing=config.cores_y if idle else 0, idle=idle)
    assert rows == [row for op in ops for row in expected_rows(config, op)]


@pytest.mark.parametrize("config", [PAPER_SMALL, TINY], ids=lambda config: config.name)
def test_no_gap_without_drains(config):
    rng = random.Random(2)
    ops = [an_op(rng) | {"drain": 0} for _ in range(20)]
    _, cycles = simulate(config, ops)
    assert cycles == list(range(cycles[0], cycles[0] + len(cycles)))
    assert cycles[0] == (1 if config.blocks == 1 else 3) + latency(config)


def test_drains_keep_their_distance():
    rng = random.Random(3)
    ops = [an_op(rng) | {"drain": i % 2} for i in range(10)]
    rows, cycles = simulate(PAPER_SMALL, ops, spacing=16)
    drains = [cycle for cycle, row in zip(cycles, rows, strict=True) if row["drain"]]
    assert min(b - a for a, b in pairwise(drains)) == 16


@pytest.mark.parametrize("unit", [BlockSequencer, Expand])
def test_config_must_be_one(unit):
    assert_rejected(lambda: unit(None), TypeError, None)
