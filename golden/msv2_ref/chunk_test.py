"""The chunk test: which chunks of the model the machine reads. `spec.chunks` defines it.

Numbers are float64 that hold small floats exactly, so that one operation and one rounding give the unit's result.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from golden.host.registers import FrameRegisters
from spec.chunks import (
    BOX_SHIFT,
    CENTRE_MARGIN,
    CHUNK,
    SCALE_TOP_STEPS,
    WIDE_SPREAD,
    pad,
    pixel_format,
    sigma_significands,
)
from spec.compact import STEP_BIAS
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, TILE
from spec.formats import Rounding, SmallFloat


class LevelBounds(NamedTuple):
    """For each quality bound, an octagon around the tiles that splats of this bound can touch.

    Attributes:
        present: (MAX_LEVELS,) bool: whether there is such a tile; where there is none, the other fields are 0.
        least, most: (MAX_LEVELS, 4) int64: smallest and largest x, y, x + y, x - y of these tiles.
    """

    present: np.ndarray
    least: np.ndarray
    most: np.ndarray


def level_bounds(level: np.ndarray, tiles_x: int, rendered: np.ndarray | None = None) -> LevelBounds:
    """The level bounds of a frame.

    Args:
        level: (tiles,) level of each tile, 0-based, row-major.
        tiles_x: number of tile columns.
        rendered: (tiles,) bool: tiles that are rendered; None: all.
    """
    y, x = np.divmod(np.arange(len(level)), tiles_x)
    sides = np.stack([x, y, x + y, x - y], 1)
    present = np.zeros(MAX_LEVELS, bool)
    least, most = np.zeros((MAX_LEVELS, 4), np.int64), np.zeros((MAX_LEVELS, 4), np.int64)
    for bound in range(MAX_LEVELS):
        found = sides[(level <= bound) & (True if rendered is None else rendered)]
        present[bound] = len(found) > 0
        if len(found):
            least[bound], most[bound] = found.min(axis=0), found.max(axis=0)
    return LevelBounds(present, least, most)


class ChunkTest(NamedTuple):
    """What the chunk test finds of each chunk; a chunk can have several reasons to be skipped.

    Attributes:
        behind, faint, outside, filtered, empty, astray: (C,) bool, why it is skipped.
        first, last: (C, 2) int64, the columns and rows of tiles that it can touch, clamped to the frame; undefined where the
            chunk is behind or outside.
    """

    behind: np.ndarray
    faint: np.ndarray
    outside: np.ndarray
    filtered: np.ndarray
    empty: np.ndarray
    astray: np.ndarray
    first: np.ndarray
    last: np.ndarray

    @property
    def read(self) -> np.ndarray:
        """(C,) bool: the chunks that are read."""
        return ~(self.behind | self.faint | self.outside | self.filtered | self.empty | self.astray)


def _cut(x: np.ndarray | float, to: SmallFloat) -> np.ndarray:
    """Numbers of the format `view` rounded towards zero to a format with fewer significand bits."""
    mantissa, exponent = np.frexp(x)
    return np.ldexp(np.trunc(np.ldexp(mantissa, to.sig_bits)), exponent - to.sig_bits)


def judged_chunks(
    config: AcceleratorConfig, chunks: np.ndarray, gaussians: int, registers: FrameRegisters,
    rendered: np.ndarray | None = None,
) -> ChunkTest:
    """Tests every chunk.

    Args:
        config: the machine.
        chunks: (C,) ChunkHeader records.
        gaussians: number of Gaussians of the model.
        registers: the frame's registers.
        rendered: (tiles,) bool: tiles that are rendered; None: all.
    """
    n, r = config.formats, registers
    size = (r.tiles_x, r.tiles_y)
    lo, hi = _intervals(config, chunks, r)
    near = float(_cut(r.near, n.chunk))
    behind = hi[:, 2] <= near
    q0 = n.chunk.round(1 / np.maximum(lo[:, 2], near))
    q1 = n.chunk.round(1 / np.where(behind, 1.0, hi[:, 2]))
    top, one = chunks["scale_top"], 1 << n.chunk.sig_bits - 1
    significand = np.array(sigma_significands(config), np.float64)[top % SCALE_TOP_STEPS] / one
    sigma = np.ldexp(significand, top // SCALE_TOP_STEPS - n.scale.bias)
    reach = _cut(r.reach, n.chunk)
    near_sigma = n.chunk.round(sigma * q0)

    first, last = np.zeros((len(chunks), 2), np.int64), np.zeros((len(chunks), 2), np.int64)
    outside = np.zeros(len(chunks), bool)
    for k in range(2):
        spread = n.chunk.round(reach[k] * near_sigma)
        low = n.chunk.round(n.chunk.round(lo[:, k] * np.where(lo[:, k] >= 0, q1, q0)) - spread)
        high = n.chunk.round(n.chunk.round(hi[:, k] * np.where(hi[:, k] >= 0, q0, q1)) + spread)
        centre, wide = int(r.centre[k]) >> n.mean2d.frac_bits, spread >= WIDE_SPREAD
        begin = pixel_format().quantise(low, Rounding.FLOOR) + centre - pad(config) >> TILE.bit_length() - 1
        end = pixel_format().quantise(high, Rounding.FLOOR) + centre + pad(config) + 2 >> TILE.bit_length() - 1
        outside |= ~wide & ((end < 0) | (begin > size[k] - 1))
        first[:, k] = np.where(wide, 0, np.maximum(begin, 0))
        last[:, k] = np.where(wide, size[k] - 1, np.minimum(end, size[k] - 1))
    bounds = level_bounds(r.header[:, 0], r.tiles_x, rendered)
    outside &= ~behind
    filtered = _filtered(chunks["bound"], bounds, first, last) & ~(behind | outside)
    return ChunkTest(behind, chunks["opacity"] == 0, outside, filtered, chunks["count"] == 0, astray(chunks, gaussians),
                     first, last)


def astray(chunks: np.ndarray, gaussians: int) -> np.ndarray:
    """(C,) bool: chunks with more Gaussians than a chunk has, or with some that the model does not have. Arguments as above."""
    count = chunks["count"].astype(np.int64)
    return (count > CHUNK) | (chunks["first"] + count > gaussians)


def _intervals(config: AcceleratorConfig, chunks: np.ndarray, r: FrameRegisters) -> tuple[np.ndarray, np.ndarray]:
    """lo and hi, (C, 3), of the chunks' boxes along x, y (times the focal lengths) and z of the camera."""
    n = config.formats
    chunk = n.chunk.round
    step = chunks["step"].astype(np.int64) + BOX_SHIFT - STEP_BIAS - 1
    half, wide = np.ldexp(chunks["extent"] + 1.0, step), np.ldexp(chunks["extent"] + 2.0, step)
    centre = chunk(_cut(n.view.round(n.position.to_float(chunks["low"]) - r.position), n.chunk) + half)
    share = np.ldexp(np.abs(centre), -CENTRE_MARGIN)
    margin = chunk(wide + np.where(share < n.chunk.min, 0.0, share))
    rotation = _cut(r.rotation, n.chunk)

    def dot(row: np.ndarray, x: np.ndarray) -> np.ndarray:
        return chunk(chunk(chunk(row[0] * x[:, 0]) + chunk(row[1] * x[:, 1])) + chunk(row[2] * x[:, 2]))

    v = np.stack([dot(row, centre) for row in rotation], 1)
    s = np.stack([dot(np.abs(row), margin) for row in rotation], 1)
    return chunk(v - s), chunk(v + s)


def _filtered(bound: np.ndarray, bounds: LevelBounds, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """(C,) bool: no tile of the octagon of the chunk's bound lies in first..last."""
    least, most = bounds.least[bound], bounds.most[bound]
    smallest = np.stack([first[:, 0], first[:, 1], first[:, 0] + first[:, 1], first[:, 0] - last[:, 1]], 1)
    largest = np.stack([last[:, 0], last[:, 1], last[:, 0] + last[:, 1], last[:, 0] - first[:, 1]], 1)
    return ~bounds.present[bound] | (smallest > most).any(axis=1) | (largest < least).any(axis=1)


def read_chunks(
    config: AcceleratorConfig, chunks: np.ndarray, gaussians: int, registers: FrameRegisters,
    rendered: np.ndarray | None = None,
) -> np.ndarray:
    """(C,) bool: which chunks the machine reads in a frame; the arguments are those of `judged_chunks`."""
    return judged_chunks(config, chunks, gaussians, registers, rendered).read


def read_points(chunks: np.ndarray, read: np.ndarray, count: int) -> np.ndarray:
    """(count,) bool: whether each Gaussian is read.

    Args:
        chunks: (C,) ChunkHeader records.
        read: (C,) bool: the chunks that are read.
        count: number of Gaussians of the model.
    """
    edges = np.zeros(count + 1, np.int64)
    np.add.at(edges, chunks["first"][read], 1)
    np.add.at(edges, chunks["first"][read] + chunks["count"][read], -1)
    return np.cumsum(edges[:-1]) > 0
