"""The pixel core in Amaranth's own simulator against a small integer model of docs/array.md."""

from __future__ import annotations

import random
import re
from dataclasses import dataclass, field, replace

import pytest
from amaranth.sim import Simulator

from rtl.emit import Emission, to_verilog
from rtl.vrc_array.memory_row import MemoryCore, MemoryRow
from rtl.vrc_array.pixel_core import PixelCore
from rtl.vrc_array.row import PIPELINE, VrcRow
from spec.config import PAPER_SMALL, TINY, AcceleratorConfig
from spec.formats import SQ, UQ
from spec.tables import EXP2_SLOPE_FRAC, alpha_max_l1, exp2_segments, log2_alpha_min, t_stop

pytestmark = pytest.mark.filterwarnings("ignore:.*created but never used")  # constructors that raise

N = PAPER_SMALL.formats
CUT_MIN = log2_alpha_min(N)
PLAIN = PAPER_SMALL.with_(cores_x=2)


@dataclass(frozen=True)
class Op:
    """An op with the exponents of every core of the row."""

    e: tuple[int, ...]
    cut: int
    bank: int = 0
    outer: int = 1
    first: int = 0
    last: int = 0
    drain: int = 0
    colour: tuple[int, int, int] = (0, 0, 0)
    depth: int = 0
    slope: int = 0
    curve: int = 0
    valid: int = 1


@dataclass
class Pixel:
    """State of one pixel in one bank, and docs/array.md's rules for it."""

    depth_present: bool
    depth_weight_bits: int = N.weight.frac_bits
    transmittance: int = 0
    sums: list[int] = field(default_factory=lambda: [0] * 4)

    def apply(self, op: Op, e: int) -> None:
        if op.first:
            self.transmittance, self.sums = N.transmittance.raw_max, [0] * 4
        t = e >> N.exponent.frac_bits - N.cut.frac_bits
        if not (op.last or (t >= op.cut and self.transmittance >= t_stop(N))):
            return
        alpha = alpha_of(t, op.outer, op.last)
        after = round_shift(self.transmittance * ((1 << N.alpha.frac_bits) - alpha), N.alpha.frac_bits)
        drop = N.transmittance.frac_bits - N.weight.frac_bits
        weight = (self.transmittance >> drop) - (after >> drop)
        for i, value in enumerate(op.colour):
            self.sums[i] += round_shift(weight * value, N.weight.frac_bits + N.colour.frac_bits - N.accumulator.frac_bits)
        if self.depth_present:
            drop = N.transmittance.frac_bits - self.depth_weight_bits
            weight = (self.transmittance >> drop) - (after >> drop)
            self.sums[3] += round_shift(
                weight * op.depth, self.depth_weight_bits + N.depth.frac_bits - N.depth_accumulator.frac_bits)
        if not op.last:
            self.transmittance = after


def round_shift(x: int, n: int) -> int:
    return (x + (1 << n - 1)) >> n


def alpha_of(t: int, outer: int, last: int) -> int:
    one = 1 << N.alpha.frac_bits
    if last:
        return one
    alpha = one
    if t < 0:
        base, slope = exp2_segments(N)
        f, i = t & (1 << N.cut.frac_bits) - 1, t >> N.cut.frac_bits
        per_segment = (1 << N.cut.frac_bits) // N.exp2_segments
        s, r = divmod(f, per_segment)
        alpha = -(-int(base[s] + (slope[s] * r >> EXP2_SLOPE_FRAC + N.cut.frac_bits - N.alpha.frac_bits)) >> -i)
    return alpha if outer else min(alpha, alpha_max_l1(N))


def run(config: AcceleratorConfig, ops: list[Op], rows: int = 1) -> tuple[list[tuple], list[tuple], list[list[int]]]:
    """(expected, seen, stopped): per drained op, block, [column][level] of (transmittance, colour sums, depth)."""
    row = (MemoryRow if config.bank_memories else VrcRow)(config)
    lanes, seen, stopped = range(config.cores_x), [], []
    blank = Op(e=(0,) * config.cores_x, cut=0, valid=0, drain=1)

    async def bench(ctx) -> None:
        early: list[tuple] = []
        for op in [*ops, *[blank] * 6]:
            for name in ("valid", "cut", "bank", "outer", "first", "last", "drain", "depth"):
                ctx.set(getattr(row.op_in, name), getattr(op, name))
            ctx.set(row.op_in.curve_yy, op.curve)
            for c in range(3):
                ctx.set(row.op_in.colour[c], op.colour[c])
            for x in lanes:
                ctx.set(row.exponent_in[x], op.e[x])
                ctx.set(row.slope_in[x], op.slope)
            if ctx.get(row.drained):
                kept = early.pop(0)
                sums = [[(*(ctx.get(c) for c in p.colour), ctx.get(p.depth)) for p in row.pixels[x]] for x in lanes]
                seen.append((kept[0], ctx.get(row.drained_block), kept[1], sums))
            if ctx.get(row.draining):
                early.append((ctx.get(row.draining_block), [[ctx.get(p.transmittance) for p in row.pixels[x]] for x in lanes]))
            stopped.append([ctx.get(s) for s in row.stopped])
            await ctx.tick()
            if op.valid:
                check_below(ctx, row, op, lanes)

    def check_below(ctx, row, op, lanes) -> None:
        for x in lanes:
            assert ctx.get(row.exponent_out[x]) == wrap(op.e[x] + op.slope, N.exponent.width)
            assert ctx.get(row.slope_out[x]) == wrap(op.slope + op.curve, N.slope.width)
        assert ctx.get(row.op_out.valid) and ctx.get(row.op_out.cut) == op.cut

    simulator = Simulator(row)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()

    state = [[Pixel(config.depth, config.depth_weight.frac_bits) for _ in range(config.banks)] for _ in lanes]
    expected, levels = [], config.level_banks
    for op in (op for op in ops if op.valid):
        for x in lanes:
            state[x][op.bank].apply(op, op.e[x])
        if op.drain:
            block = op.bank // levels
            banks = [[state[x][block * levels + level] for level in range(levels)] for x in lanes]
            left = [[p.transmittance for p in b] for b in banks]
            expected.append((block, block, left, [[tuple(p.sums) for p in b] for b in banks]))
    return expected, seen, stopped


def wrap(x: int, width: int) -> int:
    return (x + (1 << width - 1) & (1 << width) - 1) - (1 << width - 1)


def level_exponent(t: int, ulp: int = 0) -> int:
    """Exponent whose `cut` resolution value is t."""
    return (t << N.exponent.frac_bits - N.cut.frac_bits) + ulp


def white(t: int, **fields: object) -> Op:
    """An op of exponent t in both lanes (an ulp of the exponent below the next t in the second), full colours."""
    fields = {"cut": CUT_MIN, "colour": (1023, 512, 1), "depth": N.depth.raw_max, **fields}
    return Op(e=(level_exponent(t), level_exponent(t, 15)), **fields)


EDGES = (CUT_MIN, -64, -1024, -1025, -2048, -15, -14, 0, 30)
NEAR_EDGES = sorted({t + d for t in EDGES for d in range(-3, 4)} | set(range(CUT_MIN, 0, 61)))
FAR = [1024, (1 << 21) - 1, -(1 << 21), -(1 << 21) + 8000, -9 * 1024, -65536]


def check_alpha(outer: int, exponents: list[int]) -> None:
    """Each op starts and drains a tile: transmittance and sums show alpha and the weight."""
    ops = [white(t, outer=outer, first=1, drain=1, bank=t & 1) for t in exponents]
    expected, seen, _ = run(PLAIN, ops)
    assert len(seen) == len(ops)
    for op, e, s in zip(ops, expected, seen, strict=True):
        for x in range(2):
            assert (e[2][x][op.bank], e[3][x][op.bank]) == (s[2][x][op.bank], s[3][x][op.bank]), op


@pytest.mark.parametrize("outer", [0, 1])
def test_alpha_at_edges(outer: int) -> None:
    """The cut, segments of the exponential, the upper bound of level 1, zero, wrapping exponents."""
    check_alpha(outer, NEAR_EDGES + FAR)


@pytest.mark.long
@pytest.mark.parametrize("outer", [0, 1])
def test_alpha_of_every_exponent(outer: int) -> None:
    """Every exponent from below the cut to above 0."""
    check_alpha(outer, list(range(CUT_MIN - 3, 40)))


@pytest.mark.parametrize("bank_memories", [False, True])
@pytest.mark.parametrize("levels, depth, fine", [(4, True, False), (4, False, False), (1, True, False), (4, True, True)])
def test_random_tiles(levels: int, depth: bool, fine: bool, bank_memories: bool) -> None:
    """Tiles back to back, banks alternating, bubbles, stops, empty tiles; everything of every drain is compared."""
    config = PLAIN.with_(levels=levels, depth=depth, fine_depth=fine, bank_memories=bank_memories)
    rng = random.Random(7)
    ops = [op for _ in range(TILES) for op in random_tile(rng, config)]
    expected, seen, _ = run(config, ops)
    assert len(expected) == TILES
    assert seen == expected
    assert any(t < t_stop(N) for drain in expected for lane in drain[2] for t in lane)


TILES = 16


def random_tile(rng: random.Random, config: AcceleratorConfig) -> list[Op]:
    """A tile's ops, dense or sparse, with bubbles whose fields must not matter."""
    dense, entries, outer = rng.random() < 0.5, rng.choice((0, 1, 2, 12)), rng.randrange(2)
    order = [(bank, False) for _ in range(entries) for bank in range(config.banks)]
    order += [(bank, True) for bank in range(config.banks)]
    ops: list[Op] = []
    begun: set[int] = set()
    for i, (bank, last) in enumerate(order):
        cut = rng.randint(CUT_MIN, 600)
        near = rng.randint(-700, 5) if dense else rng.choice((cut, 0, -1, -3000))
        ops.append(Op(
            e=tuple(0 if last else level_exponent(near) + rng.randint(-40, 40) for _ in range(config.cores_x)),
            cut=CUT_MIN if dense else cut, bank=bank, outer=1 if last else outer, first=int(bank not in begun), last=int(last),
            drain=int(i == len(order) - 1), colour=tuple(rng.choice((0, 1023, rng.randrange(1024))) for _ in range(3)),
            depth=rng.randrange(1 << N.depth.width), slope=rng.randint(-(1 << 21), (1 << 21) - 1),
            curve=rng.randint(-(1 << 17), (1 << 17) - 1),
        ))
        begun.add(bank)
        if rng.random() < 0.1:
            ops.append(Op(e=(5, 5), cut=-8000, bank=bank, first=1, last=1, drain=1, valid=0, colour=(9, 9, 9)))
    return ops


@pytest.mark.parametrize("bank_memories", [False, True])
def test_stopped_when_every_pixel_is(bank_memories: bool) -> None:
    """`stopped` of a level bank rises with the last core's transmittance and falls with the next tile."""
    opaque = level_exponent(0)
    half = Op(e=(opaque, level_exponent(-9000)), cut=CUT_MIN, first=1)
    ops = [half, Op(e=(opaque, opaque), cut=CUT_MIN), Op(e=(0, 0), cut=0, last=1, drain=1), half]
    _, _, stopped = run(PLAIN.with_(bank_memories=bank_memories), ops)
    assert [s[0] for s in stopped][PIPELINE : PIPELINE + 5] == [0, 1, 1, 0, 0]


@pytest.mark.parametrize("field_name, value, message", [
    ("cut", SQ(3, 16), "fraction bits than exponent"),
    ("weight", UQ(0, 16), "fraction bits than transmittance"),
])
def test_formats_that_do_not_fit_are_rejected(field_name: str, value: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PixelCore(PAPER_SMALL.with_(formats=replace(N, **{field_name: value})))


def test_memories_show_the_blocks_of_their_ops_alone() -> None:
    """`stopped` of banks in memories looks at all blocks: it rises with the last one and falls with the next tile."""
    config, opaque = PLAIN.with_(bank_memories=True), level_exponent(0)
    blocks = [Op(e=(opaque, opaque), cut=CUT_MIN, first=1, bank=config.level_banks * block) for block in range(config.blocks)]
    again = Op(e=(level_exponent(-9000),) * 2, cut=CUT_MIN, first=1)
    kept = run(config.with_(bank_memories=False), [*blocks, *blocks, again, again])[2]
    stopped = run(config, [*blocks, *blocks, again, again])[2]
    begun = len(blocks) + PIPELINE
    assert [s[0] for s in stopped[begun:]] == [s[0] for s in kept[begun:]]
    assert {s[0] for s in stopped[begun:]} == {0, 1}


@pytest.mark.parametrize("make", [PixelCore, VrcRow, MemoryRow])
def test_config_is_required(make: type) -> None:
    with pytest.raises(TypeError, match=r"not 16$"):
        make(16)


@pytest.mark.parametrize("make", [MemoryCore, MemoryRow])
def test_memories_are_of_machines_with_them(make: type) -> None:
    with pytest.raises(ValueError, match=r"^bank_memories must be True, not False$"):
        make(PLAIN)


def test_emission_shares_the_core() -> None:
    """Sixteen instances of one module, the same text every time."""
    text = to_verilog(VrcRow(PAPER_SMALL), "vrc_row")
    assert text.count("module pixel_core(") == 1
    assert len(re.findall(r"^  pixel_core ", text, re.M)) == PAPER_SMALL.cores_x
    assert text == to_verilog(VrcRow(PAPER_SMALL), "vrc_row")


def test_one_name_is_one_module() -> None:
    emission = Emission()
    emission.instance("pixel_core", PixelCore, PAPER_SMALL)
    with pytest.raises(ValueError, match="one module"):
        emission.instance("pixel_core", PixelCore, TINY)
