"""The decoders of compact geometry against their text, value by value in Amaranth's simulator."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Sequence

import pytest
from amaranth.hdl import Module, Shape, Signal, Value, signed, unsigned
from amaranth.sim import Simulator

from rtl.chunks import decode
from rtl.float.number import Let
from spec import compact
from spec.config import PAPER, SHORT_FORMATS, V3_RECORDS, NumberFormats
from spec.formats import SQ
from tests.helpers import compact_by_the_text as text

COARSE = pytest.mark.parametrize("coarse", [False, True], ids=["fine", "coarse"])


def results(shapes: Sequence[Shape], logic: Callable[..., Sequence[Value]], rows: Iterable[Sequence[int]]) -> list[list[int]]:
    """What combinational `logic` of inputs of these shapes gives for each row of inputs."""
    m, inputs, found = Module(), [Signal(of, name=f"in_{i}") for i, of in enumerate(shapes)], []

    def let(name: str, value: Value) -> Signal:
        wire = Signal(value.shape(), name=name)
        m.d.comb += wire.eq(value)
        return wire

    values = [Value.cast(value) for value in logic(let, *inputs)]
    outputs = [Signal(value.shape(), name=f"out_{i}") for i, value in enumerate(values)]
    m.d.comb += [output.eq(value) for output, value in zip(outputs, values, strict=True)]

    async def bench(ctx):
        for row in rows:
            for port, number in zip(inputs, row, strict=True):
                ctx.set(port, number)
            found.append([ctx.get(output) for output in outputs])

    simulator = Simulator(m)
    simulator.add_testbench(bench)
    simulator.run()
    return found


@COARSE
def test_scales_of_some_chunks(coarse: bool):
    bits = compact.scale_bits(coarse)
    codes = [*range(0, 1 << bits, 37), *range((1 << bits) - 4, 1 << bits)]
    rows = [(code, top) for top in (0, 15, 16, 17, 200, 1023) for code in codes]

    def word(let: Let, code: Value, top: Value) -> list[Value]:
        wide = code << (decode.SCALE_SHIFT if coarse else 0)
        return [decode.scale_word(let("c", decode.scale_logarithm(wide, top)), code.all())]

    got = results([unsigned(bits), unsigned(10)], word, rows)
    assert [row[0] for row in got] == [text.scale(code, top, coarse) for code, top in rows]
    assert {0, 63} <= {row[0] >> 11 for row in got}


def test_operands_of_positions_are_exact():
    rng = random.Random(3)
    codes = [0, 3, 0x7FFF, 0xFFFF, *(1 << n for n in range(16)), *(rng.getrandbits(16) >> rng.randrange(16) for _ in range(60))]
    rows = [(code, step) for code in codes for step in (0, 1, 40, 63)]
    got = results([unsigned(16), unsigned(6)], lambda let, code, step: [decode.operand(let, code, step)], rows)
    assert [float(decode.OPERAND.to_float(bits)) for [bits] in got] == [
        code * 2.0 ** (step - compact.STEP_BIAS) for code, step in rows]


@COARSE
def test_quaternions_at_corners_and_at_random(coarse: bool):
    """Components that are zero, equal, as large as codes allow, and so large that no real number is left for the last one."""
    rng, bits = random.Random(5), compact.quaternion_bits(coarse)
    low, high = -(1 << bits - 1), (1 << bits - 1) - 1
    ends = (low, -1, 0, 1, high)
    rows = [(a, b, c) for a in ends for b in ends for c in ends]
    rows += [(rng.randint(low, high), rng.randint(low // 2, high // 2), rng.randint(low // 4, high // 4)) for _ in range(200)]

    def words(let: Let, *codes: Value) -> list[Value]:
        others = [let("q", decode.component(code << (decode.QUATERNION_SHIFT if coarse else 0))) for code in codes]
        x = let("x", decode.remainder(let, [let("square", decode.component_square(let, q)) for q in others]))
        return [decode.root(let, x, *decode.root_line(x)), *others]

    got = results([signed(bits)] * 3, words, rows)
    assert got == [text.quaternion(0, row, coarse) for row in rows]
    assert min(row[0] for row in got) < 4100 and max(row[0] for row in got) == 8191


def test_the_codes_of_geometry_are_where_the_record_has_them():
    rng, rows, wanted = random.Random(7), [], []
    for coarse in (0, 1) * 30:
        record, most = compact.compact_geometry(V3_RECORDS, bool(coarse)), (1 << compact.scale_bits(bool(coarse))) - 1
        row = record.unpack(rng.getrandbits(record.width))
        row["scale"][rng.randrange(3)] = most
        rows.append((record.pack(row) | rng.getrandbits(128 - record.width) << record.width, coarse))
        wanted.append([*row["position"], *(s << coarse for s in row["scale"]), *(s == most for s in row["scale"]),
                       row["largest"], *(q << coarse for q in row["quaternion"]), row["opacity"]])

    def codes(let: Let, bits: Value, coarse: Value) -> list[Value]:
        got = decode.geometry_codes(V3_RECORDS, bits, coarse)
        return [*got.position, *got.scale, *got.degenerate, got.largest, *got.quaternion, got.opacity]

    assert results([unsigned(128), unsigned(1)], codes, rows) == wanted


def test_formats_that_the_encodings_do_not_assume_are_refused():
    compact.check_formats(PAPER)
    compact.check_formats(V3_RECORDS.with_(formats=SHORT_FORMATS))
    with pytest.raises(ValueError, match=r"sh_dc must be SQ2\.11 with compact records, not SQ2\.10"):
        compact.check_formats(V3_RECORDS.with_(formats=NumberFormats(sh_dc=SQ(2, 10))))
