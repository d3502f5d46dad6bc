"""Decoders of opacities and base colours: every code, against the golden renderer's."""

from __future__ import annotations

import itertools

import numpy as np
from amaranth.hdl import Module, Signal
from amaranth.sim import Simulator

from golden.host.compact import CompactWords, decode, decoded_opacity
from rtl.chunks.decode_colour import base_colour, opacity
from rtl.shapes import shape
from spec.chunks import chunk_header
from spec.compact import COARSE_BOUND, OPACITY_BITS, OPACITY_LOG2, OPACITY_ONE, compact_colour, compact_geometry, dc_bits
from spec.config import V3_RECORDS


def outputs(m: Module, inputs: tuple[Signal, ...], rows: list[tuple[int, ...]], output: Signal) -> list[int]:
    """The output for each row of inputs."""
    found = []

    async def bench(ctx):
        for row in rows:
            for signal, value in zip(inputs, row, strict=True):
                ctx.set(signal, value)
            await ctx.delay(1e-9)
            found.append(ctx.get(output))

    simulator = Simulator(m)
    simulator.add_testbench(bench)
    simulator.run()
    return found


def test_every_opacity():
    m, code, result = Module(), Signal(OPACITY_BITS), Signal(shape(V3_RECORDS.formats.log2_opacity))
    m.d.comb += result.eq(opacity(V3_RECORDS, code))
    codes = list(range(1 << OPACITY_BITS))
    found = outputs(m, (code,), [(c,) for c in codes], result)
    assert found == decoded_opacity(np.array(codes)).tolist()
    assert found[0] == OPACITY_LOG2[0] == V3_RECORDS.formats.log2_opacity.raw_min
    assert found[OPACITY_ONE] == 0 and found == sorted(found)


def test_every_base_colour():
    """All codes of fine and coarse records at every range, the largest of which reaches beyond the format."""
    m, code, coarse, dc_range = Module(), Signal(dc_bits(False)), Signal(), Signal(2)
    result = Signal(shape(V3_RECORDS.formats.sh_dc))
    m.d.comb += result.eq(base_colour(V3_RECORDS, code, coarse, dc_range))
    kinds = itertools.product((0, 1), range(4))
    rows = [(c, kind, r) for kind, r in kinds for c in range(1 << dc_bits(bool(kind)))]
    found = outputs(m, (code, coarse, dc_range), rows, result)
    codes, kinds, ranges = np.array(rows).T
    colour = np.zeros(len(rows), compact_colour(V3_RECORDS, True).dtype)
    colour["dc"][:, 0], colour["dc_range"] = codes, ranges
    headers = np.zeros(len(rows), chunk_header(V3_RECORDS).dtype)
    headers["bound"], headers["count"] = COARSE_BOUND * kinds, 1
    words = CompactWords(V3_RECORDS, kinds == 1, np.zeros(len(rows), compact_geometry(V3_RECORDS, True).dtype), colour, None)
    assert found == decode(V3_RECORDS, headers, words, 0)[1]["dc"][:, 0].tolist()
    assert max(found) == V3_RECORDS.formats.sh_dc.raw_max and min(found) == V3_RECORDS.formats.sh_dc.raw_min
