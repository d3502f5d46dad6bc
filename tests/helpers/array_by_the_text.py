"""docs/array.md in plain Python integers, step by step and pixel by pixel: slow, with nothing of golden's or rtl's in it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from spec import tables
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.records import array_splat, tile_header


class Op(NamedTuple):
    """A splat (or the background) at one level of one tile."""

    exponent: int
    slope_x: int
    slope_y: int
    curve_xx: int
    curve_xy: int
    curve_yy: int
    cut: int
    colour: tuple[int, int, int]
    depth: int
    outer: bool
    last: bool


def rs(x: int, n: int) -> int:
    """x / 2^n, HALF_UP."""
    return (x + (1 << n - 1)) >> n if n >= 1 else x


class ArrayByTheText:
    """The array of one configuration.

    `tile` gives a tile's pixels from its header and entries, both as `Record.unpack` returns them.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        self.config, self.n = config, config.formats
        self.base, self.slope = (t.tolist() for t in tables.exp2_segments(self.n))
        self.smoothstep = tables.smoothstep_table(self.n).tolist()

    def polynomial(self, entry: dict, tile_x: int, tile_y: int) -> tuple[int, ...] | None:
        """Setup steps 1-6: corner, slopes and curvatures; None for a dropped pair."""
        n = self.n
        G, A, B, M, p = (n.exponent.frac_bits, n.offset.frac_bits, n.factor.frac_bits, n.mean2d.frac_bits, n.conic.sig_bits)
        dx = ((16 * tile_x + 8) << M) + (1 << M - 1) - entry["mean2d"][0]
        dy = ((16 * tile_y + 8) << M) + (1 << M - 1) - entry["mean2d"][1]
        factors = [tuple(int(f) for f in n.conic.fields(bits)) for bits in entry["conic"]]

        def offset(factor: tuple[int, int], d: int) -> int:
            m, e = factor
            shift = p - 1 - e + M - A
            return rs(m * d, shift) if shift < 48 else 0

        u = offset(factors[0], dx) + offset(factors[1], dy)
        v = offset(factors[2], dy)
        if not all(n.offset.raw_min <= x <= n.offset.raw_max for x in (u, v)):
            return None
        if u**2 + v**2 >= tables.CENTRE_EXPONENT_MAX << 2 * A:
            return None
        k1, k2, k3 = (rs(m, -e) if -e <= p else 0 for m, e in factors)
        q = rs(u**2 + v**2, 2 * A - G)
        curve_xx, curve_xy = -rs(2 * k1**2, 2 * B - G), -rs(2 * k1 * k2, 2 * B - G)
        curve_yy = -rs(2 * (k2**2 + k3**2), 2 * B - G)
        gx = -rs(2 * u * k1, A + B - G) + (curve_xx >> 1)
        gy = -rs(2 * (u * k2 + v * k3), A + B - G) + (curve_yy >> 1)
        slope_x, slope_y = gx - 8 * curve_xx - 8 * curve_xy, gy - 8 * curve_yy - 8 * curve_xy
        corner = -q - 8 * gx - 8 * gy + 36 * curve_xx + 36 * curve_yy + 64 * curve_xy
        return corner, slope_x, slope_y, curve_xx, curve_xy, curve_yy

    def ops(self, header: dict, entries: list[dict], bank: int, background: list[int]) -> list[Op]:
        """Setup step 7 for one level bank, its background at the end."""
        n, ops = self.n, []
        G, support = n.exponent.frac_bits, tables.support_exponent(self.config)
        for entry in entries:
            polynomial = self.polynomial(entry, header["tile_x"], header["tile_y"])
            if polynomial is None or not entry["use"][bank]:
                continue
            opacity = entry["log2_opacity"][bank]
            exponent = polynomial[0] + (opacity << G - n.log2_opacity.frac_bits) + (1 << G - n.cut.frac_bits - 1)
            cut = tables.log2_alpha_min(n)
            if support is not None:
                cut = max(opacity - support, cut)
            op = Op(exponent, *polynomial[1:], cut, tuple(entry["colour"][3 * bank : 3 * bank + 3]), entry["depth"],
                    bool(header["outer"]) or bank == 1, False)
            formats = (n.exponent, n.slope, n.slope, n.curvature, n.curvature, n.curvature, n.cut)
            assert all(f.raw_min <= value <= f.raw_max for f, value in zip(formats, op, strict=False)), f"{op} overflows"
            ops.append(op)
        return [*ops, Op(0, 0, 0, 0, 0, 0, 0, tuple(background), 0, True, True)]

    def alpha(self, t: int, op: Op) -> int:
        """Step 2 of a pixel."""
        n = self.n
        one, F = 1 << n.alpha.frac_bits, n.cut.frac_bits
        if op.last or t >= 0:
            alpha = one
        else:
            i, f = t >> F, t & (1 << F) - 1
            segment, r = divmod(f, (1 << F) // n.exp2_segments)
            k = tables.EXP2_SLOPE_FRAC + F - n.alpha.frac_bits
            m = self.base[segment] + (self.slope[segment] * r >> k)
            alpha = -(-m >> -i)
        return alpha if op.outer else min(alpha, tables.alpha_max_l1(n))

    def composite(self, state: list[int], op: Op, e: int) -> None:
        """Steps 1-5 on one pixel: `state` is T, red, green, blue, depth."""
        n, T = self.n, state[0]
        t = e >> n.exponent.frac_bits - n.cut.frac_bits
        if not (op.last or (t >= op.cut and T >= tables.t_stop(n))):
            return
        after = rs(T * ((1 << n.alpha.frac_bits) - self.alpha(t, op)), n.alpha.frac_bits)
        d = n.transmittance.frac_bits - n.weight.frac_bits
        w = (T >> d) - (after >> d)
        for c in range(3):
            state[1 + c] += rs(w * op.colour[c], n.weight.frac_bits + n.colour.frac_bits - n.accumulator.frac_bits)
        if self.config.depth:
            fine = self.config.depth_weight.frac_bits
            d = n.transmittance.frac_bits - fine
            state[4] += rs(((T >> d) - (after >> d)) * op.depth, fine + n.depth.frac_bits - n.depth_accumulator.frac_bits)
        if not op.last:
            state[0] = after

    def bank(self, ops: list[Op]) -> list[list[list[int]]]:
        """One level bank of a tile by forward differences: state[y][x]."""
        pixels = [[[self.n.transmittance.raw_max, 0, 0, 0, 0] for _ in range(TILE)] for _ in range(TILE)]
        for op in ops:
            row, along, down = op.exponent, op.slope_x, op.slope_y
            for y in range(TILE):
                e, step = row, along
                for x in range(TILE):
                    self.composite(pixels[y][x], op, e)
                    e, step = e + step, step + op.curve_xx
                row, along, down = row + down, along + op.curve_xy, down + op.curve_yy
        return pixels

    def blend_weight(self, plane: list[int], x: int, y: int) -> int:
        """Share of bank 1, raw `blend_weight`."""
        F = self.n.plane.frac_bits
        t = plane[0] + x * plane[1] + y * plane[2]
        if t < 0:
            return 0
        if t >= 1 << F:
            return 1 << self.n.blend_weight.frac_bits
        return self.smoothstep[t >> F - tables.BLEND_INDEX_BITS]

    def tile(self, header: dict, entries: list[dict], background: list[int]) -> list[list[list[int]]]:
        """state[y][x] = T, red, green, blue, depth of a whole tile."""
        first = self.bank(self.ops(header, entries, 0, background))
        if not header["blend"]:
            return first
        second = self.bank(self.ops(header, entries, 1, background))
        for y in range(TILE):
            for x in range(TILE):
                W = self.blend_weight(header["plane"], x, y)
                pair = zip(first[y][x], second[y][x], strict=True)
                first[y][x] = [a + rs((b - a) * W, self.n.blend_weight.frac_bits) for a, b in pair]
        return first

    def render(self, headers: np.ndarray, entries: np.ndarray, background: list[int]) -> np.ndarray:
        """(tiles, 16, 16, 5) int64 of record arrays."""
        as_header, as_entry = tile_header(self.config), array_splat(self.config)
        rows, at, out = [as_entry.unpack(as_entry.pack(entry)) for entry in entries], 0, []
        for packed in headers:
            header = as_header.unpack(as_header.pack(packed))
            out.append(self.tile(header, rows[at : at + header["count"]], background))
            at += header["count"]
        return np.array(out, np.int64)
