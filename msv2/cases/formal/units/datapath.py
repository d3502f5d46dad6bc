"""Proofs of operators, delays and memories, which have no streams."""

from __future__ import annotations

from collections.abc import Callable

from amaranth.hdl import Const, Value
from amaranth.lib import wiring

from msv2.cases.formal.bench import Bench
from msv2.cases.formal.proof import SMALL_SUPER, Proof
from rtl.culling.fixed_multiply import FixedMul
from rtl.float.add import FloatAdd
from rtl.float.convert import FixedToFloat, FloatToFixed
from rtl.float.divide import FloatDivide, FloatReciprocal
from rtl.float.multiply import FloatMul
from rtl.float.roots import FloatRsqrt, FloatSqrt
from rtl.vrc_array.pixel_state import PixelState, StateMemory
from rtl.warp_unit.delay import Delay
from spec.formats import SQ, SmallFloat

FLOAT = SmallFloat(sig_bits=4, exp_bits=4, bias=7)
FIXED = SQ(3, 4)


def pipelined(bench: Bench) -> None:
    """A result for each operation, its latency later, and none besides."""
    unit, late = bench.unit, bench.unit.valid
    for _ in range(unit.latency):
        late = bench.before(late)
    bench.never(f"a result {unit.latency} cycles after its operands", ~unit.result_valid, when=late)
    bench.never("no result without operands", ~late, when=unit.result_valid)


def delayed(bench: Bench) -> None:
    """What is loaded comes out so many cycles later."""
    unit, value, loaded = bench.unit, bench.unit.early, bench.unit.load
    for _ in range(unit._cycles):
        value, loaded = bench.before(value), bench.before(loaded)
    bench.never("what was loaded comes out in its cycle", unit.late != value, when=loaded)


def state_memory(bench: Bench) -> None:
    """A row, any one, is as it was written last."""
    unit = bench.unit
    row, written, known = bench.some(len(unit.row), "row"), bench.register("written", len(unit.data)), bench.register("known")
    mine = unit.write & (unit.row == row)
    with bench.m.If(mine):
        bench.m.d.sync += [written.eq(unit.data), known.eq(1)]
    bench.assume(~(unit.read & unit.write & (unit.row == unit.address)))
    reads = unit.read & (unit.address == row) & ~unit.fresh & known
    shows, expected = bench.before(bench.before(reads)), bench.before(bench.before(written))
    bench.never("a row is read as it was written", unit.state != expected, when=shows)
    fresh = bench.before(bench.before(unit.read & unit.fresh))
    bench.never("a fresh row is the start", unit.state != unit._start, when=fresh)
    still = ~bench.before(bench.before(unit.read)) & bench.seen(bench.before(bench.before(unit.read)))
    bench.never("a row stays until the next one is read", unit.state != bench.before(unit.state), when=still)


def pixel_state(bench: Bench) -> None:
    """A tile, any one, is not loaded while its store is under way; and it has stopped only while its super-tile is current."""
    unit, config = bench.unit, bench.unit.config
    tile = bench.some(len(unit.place), "tile")
    bench.assume(~unit.loading | unit.may_load)
    stored, under_way = unit.stored, bench.register("under_way")
    ends = (stored.row == config.region - 1) & (stored.column == config.region - config.array_x)
    begins = unit.storing & (unit.place == tile)
    lands = stored.valid & ends & (stored.place == tile)
    with bench.m.If(lands):
        bench.m.d.sync += under_way.eq(0)
    with bench.m.Elif(begins):
        bench.m.d.sync += under_way.eq(1)
    mine: Value = unit.pending.bit_select(tile, 1)
    bench.never("a store that is under way is pending", ~mine, when=under_way)
    bench.never("no store is pending that is not under way", ~under_way, when=mine)
    bench.never("a tile is not loaded while its store is under way", unit.may_load, when=under_way & (unit.place == tile))
    waits = bench.cycles(~unit.loading & ~mine & (unit.place == tile) & ~unit.may_load, config.array_y + 2)
    bench.never("a load waits for the one before it only", waits > config.array_y + 1, when=unit.loading)
    done = unit.done.bit_select(tile, 1)
    changed = unit.current != bench.before(unit.current)
    bench.never("no tile has stopped when another super-tile begins", unit.done.any(), when=changed & bench.seen(Const(1, 1)))
    falls = bench.before(done) & ~done
    bench.never("a tile that has stopped stays so until its last row, or another super-tile",
                ~changed & ~bench.before(bench.before(stored.final & ends & (stored.place == tile)), 0), when=falls)


def _operator(unit: type[wiring.Component], make: Callable[[], wiring.Component]) -> Proof:
    return Proof(unit, make, (pipelined,), "numbers of 4 bits of significand", {"free": OPERANDS[unit]}, quick=True)


OPERANDS: dict[type[wiring.Component], tuple[str, ...]] = {
    FloatAdd: ("valid", "a", "b", "subtract"), FloatMul: ("valid", "a", "b"), FloatDivide: ("valid", "a", "b"),
    FloatReciprocal: ("valid", "a"), FloatRsqrt: ("valid", "a"), FloatSqrt: ("valid", "a"), FloatToFixed: ("valid", "a"),
    FixedToFloat: ("valid", "a"), FixedMul: ("valid", "a", "b"),
}

PROOFS = (
    _operator(FloatAdd, lambda: FloatAdd(a=FLOAT, b=FLOAT, result=FLOAT)),
    _operator(FloatMul, lambda: FloatMul(a=FLOAT, b=FLOAT, result=FLOAT)),
    _operator(FloatDivide, lambda: FloatDivide(a=FLOAT, b=FLOAT, result=FLOAT)),
    _operator(FloatReciprocal, lambda: FloatReciprocal(a=FLOAT, result=FLOAT)),
    _operator(FloatRsqrt, lambda: FloatRsqrt(a=FLOAT, result=FLOAT)),
    _operator(FloatSqrt, lambda: FloatSqrt(a=FLOAT, result=FLOAT)),
    _operator(FloatToFixed, lambda: FloatToFixed(a=FLOAT, result=FIXED)),
    _operator(FixedToFloat, lambda: FixedToFloat(a=FIXED, result=FLOAT)),
    _operator(FixedMul, lambda: FixedMul(a=FIXED, b=FIXED, result=FIXED)),
    Proof(Delay, lambda: Delay(2, 5), (delayed,), "5 cycles", {"free": ("load", "early")}, quick=True),
    Proof(StateMemory, lambda: StateMemory(2, 4, 3), (state_memory,), "4 rows of 2 bits",
          {"free": ("write", "row", "data", "read", "fresh", "address")}, quick=True),
    Proof(PixelState, lambda: PixelState(SMALL_SUPER), (pixel_state,), "",
          {"free": ("place", "fresh", "block", "loading", "storing", "stored", "visit", "sequence")}),
)
