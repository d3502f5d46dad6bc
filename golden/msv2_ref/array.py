"""The volume rendering array: intersections in rendering order to pixels, as docs/array.md defines it.

The code is organised for a CPU: one pass over a tile's intersections for each of its levels, rows of 16 pixels as vectors of
int32, and rows that the splat cannot reach skipped by a conservative test (`array_kernel`). None of this changes a bit of the
result.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from golden.msv2_ref import array_kernel
from golden.msv2_ref.vectors import LANES
from golden.threads import for_slices
from spec import tables
from spec.config import AcceleratorConfig
from spec.constants import TILE


class ArraySplats(NamedTuple):
    """Splats as the array reads them, one row for each splat.

    Attributes:
        mean2d: (N, 2) int32, raw `mean2d`.
        conic: (N, 3) int32, signed significands of the Cholesky factors.
        conic_exp: (N, 3) int32, their exponents, <= 0.
        log2_opacity: (N, levels) int32, raw `log2_opacity`.
        colour: (N, levels, 3) int32, raw `colour`.
        depth: (N,) int32, raw `depth`.
    """

    mean2d: np.ndarray
    conic: np.ndarray
    conic_exp: np.ndarray
    log2_opacity: np.ndarray
    colour: np.ndarray
    depth: np.ndarray


class Pixels(NamedTuple):
    """Finished pixels by tile: `colour` (tiles, 16, 16, 3), `depth` and `transmittance` (tiles, 16, 16), raw int32."""

    colour: np.ndarray
    depth: np.ndarray
    transmittance: np.ndarray


class TileWork(NamedTuple):
    """The array's work for a frame: tiles, and their intersections in rendering order.

    Attributes:
        header: (tiles, 5) int64: tile_x, tile_y, index of the tile's level in the splats' arrays, outer, blend.
        plane: (tiles, 3) int64, raw `plane`.
        start: (tiles + 1,) int64, first intersection of each tile.
        order: (E,) int32, row of each intersection's splat.
        use: (E,) uint8, bit 0: the tile's level uses the splat; bit 1: the next level does.
    """

    header: np.ndarray
    plane: np.ndarray
    start: np.ndarray
    order: np.ndarray
    use: np.ndarray


@cache
def _mantissas(config: AcceleratorConfig) -> np.ndarray:
    """(2 * LANES,) int32: the exponential's segments as `array_kernel` needs them, negated bases and then slopes.

    Raises:
        ValueError: the number of segments is no power of two or more than a vector's lanes.
    """
    count, (base, slope) = config.formats.exp2_segments, tables.exp2_segments(config.formats)
    if count not in (1, 2, 4, 8, LANES):
        raise ValueError(f"exp2_segments must be a power of two up to {LANES}, not {count!r}")
    return np.concatenate([np.resize(-base, LANES), np.resize(slope, LANES)]).astype(np.int32)  # repeated to fill all lanes


def render(
    config: AcceleratorConfig, splats: ArraySplats, work: TileWork, background: np.ndarray, rendered: np.ndarray | None = None,
) -> Pixels:
    """Renders all tiles.

    Args:
        config: the machine.
        splats: the splats.
        work: the tiles and their intersections.
        background: (3,) raw `colour`.
        rendered: (tiles,) bool: tiles to render. The others have no intersections, and their pixels are 0. None: all tiles.
    """
    if rendered is not None:
        start = np.append(work.start[:-1][rendered], work.start[-1])
        some = render(config, splats, work._replace(header=work.header[rendered], plane=work.plane[rendered], start=start),
                      background)
        every = Pixels(*(np.zeros((len(rendered), *part.shape[1:]), part.dtype) for part in some))
        for whole, part in zip(every, some, strict=True):
            whole[rendered] = part
        return every
    tiles = len(work.header)
    pixels = _no_pixels(tiles)
    kernel = array_kernel.render_tiles if config.depth else array_kernel.render_tiles_flat
    for_slices(
        kernel, tiles, splats, work, np.asarray(background, np.int32), _mantissas(config),
        tables.smoothstep_table(config.formats), array_kernel.array_constants(config), *pixels)
    return pixels


def split_conic(config: AcceleratorConfig, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(significand, exponent) int32 of `conic` values held in float64, any shape."""
    conic = config.formats.conic
    mantissa, exponent = np.frexp(value)
    significand = np.ldexp(mantissa, conic.sig_bits).astype(np.int32)
    return significand, np.where(value == 0, conic.exp_min, exponent - 1).astype(np.int32)


def decode_conic(config: AcceleratorConfig, bits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(significand, exponent) int32 of raw `conic` bit patterns, any shape."""
    significand, exponent = config.formats.conic.fields(bits)
    return significand.astype(np.int32), exponent.astype(np.int32)


def render_tiles(config: AcceleratorConfig, headers: np.ndarray, entries: np.ndarray, background: np.ndarray) -> Pixels:
    """Runs the array on its own input records.

    Args:
        config: the machine.
        headers: (tiles,) records of `spec.records.tile_header`'s dtype; `count` is the number of a tile's intersections.
        entries: (sum of counts,) records of `spec.records.array_splat`'s dtype, in order.
        background: (3,) raw `colour`.

    Raises:
        ValueError: the headers' counts do not sum to the number of entries.
    """
    total = int(headers["count"].sum(dtype=np.int64))
    if total != len(entries):
        raise ValueError(f"the headers' counts must sum to the number of entries, {len(entries)}, not {total!r}")
    return render(config, *_work_of(config, headers, headers["count"], entries), background)


def render_visits(config: AcceleratorConfig, visits: np.ndarray, entries: np.ndarray, background: np.ndarray) -> Pixels:
    """Runs the array of a machine with super-tiles on its own input records: tiles in pieces, with a state for each place of a
    super-tile that is kept between them.

    Args:
        config: the machine.
        visits: (visits,) TileVisit records. The first visit of a tile is `fresh`, the last one `final`.
        entries: VisitEntry records in order; an item with `end` follows the last one of every visit.
        background: (3,) raw `colour`.

    Returns:
        The pixels of the visits that are `final`, in their order.

    Raises:
        ValueError: there are not as many items with `end` as visits.
    """
    ends = np.flatnonzero(entries["end"])
    if len(ends) != len(visits) or (len(ends) and ends[-1] + 1 != len(entries)):
        raise ValueError(f"entries must have {len(visits)} items with `end`, one behind every visit, not {len(ends)!r}")
    splats, work = _work_of(config, visits, np.diff(ends, prepend=-1) - 1, entries[entries["end"] == 0])
    places = np.stack([visits[name] for name in ("place", "fresh", "final")], 1).astype(np.int64)
    out = _no_pixels(int(visits["final"].sum()))
    kernel = array_kernel.visit_tiles if config.depth else array_kernel.visit_tiles_flat
    kernel(splats, work, places, np.asarray(background, np.int32), _mantissas(config), tables.smoothstep_table(config.formats),
           array_kernel.array_constants(config), *out)
    return out


def _no_pixels(tiles: int) -> Pixels:
    """Space for the pixels of so many tiles."""
    shape = (tiles, TILE, TILE)
    return Pixels(np.empty((*shape, 3), np.int32), np.empty(shape, np.int32), np.empty(shape, np.int32))


def _work_of(
    config: AcceleratorConfig, headers: np.ndarray, counts: np.ndarray, entries: np.ndarray,
) -> tuple[ArraySplats, TileWork]:
    """The array's work, from records with the fields of TileHeader and of ArraySplat, and the number of entries of each
    header."""
    start = np.concatenate(([0], np.cumsum(counts, dtype=np.int64)))
    significand, exponent = decode_conic(config, entries["conic"])
    splats = ArraySplats(
        entries["mean2d"].astype(np.int32), significand, exponent, entries["log2_opacity"].astype(np.int32),
        entries["colour"].reshape(-1, 2, 3).astype(np.int32), entries["depth"].astype(np.int32))
    level = np.zeros(len(headers), np.int64)  # in these records, the tile's own level always comes first
    header = np.stack([headers["tile_x"], headers["tile_y"], level, headers["outer"], headers["blend"]], 1)
    use = (entries["use"] @ np.array([1, 2])).astype(np.uint8)
    order = np.arange(len(entries), dtype=np.int32)
    return splats, TileWork(header.astype(np.int64), headers["plane"].astype(np.int64), start, order, use)
