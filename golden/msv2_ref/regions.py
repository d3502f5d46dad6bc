"""Quarters of tiles for machines with several streams: where the splat of an intersection can change a pixel, and the
intersections of each quarter (`spec.supertiles`)."""

from __future__ import annotations

import numpy as np

from golden.host.registers import FrameRegisters
from golden.kernels import compiled
from golden.msv2_ref.projection import Projected, culling_constants, falloff_limit
from golden.msv2_ref.tile_test import Intersections, _span
from golden.threads import for_slices
from spec.config import AcceleratorConfig
from spec.constants import TILE, TILE_EDGE_MARGIN

_REGION = TILE // 2


@compiled(nogil=True, error_model="numpy")
def _find(_slice, begin, end, tile, splat, opacity, level, mean2d, conic, tiles_x, width, height, k, mask):
    """Writes the regions of intersections begin..end to `mask`."""
    one, margin, half = k.mean_one, TILE_EDGE_MARGIN * k.mean_one, 0.5 * k.mean_one
    for e in range(begin, end):
        i, row, column = splat[e], tile[e] // tiles_x, tile[e] % tiles_x
        my, limit = float(mean2d[i, 1]), falloff_limit(opacity[i, level[tile[e]]], k)
        first, last, none, rim = _span(
            float(mean2d[i, 0]), my, conic[i, 0], conic[i, 1], conic[i, 2], limit, float(row), width, height, k)
        reach = min(max(np.floor(rim * one + 0.5), 2 * k.mean_min), 2 * k.mean_max + 1)  # one bit more than `mean2d`
        for y in range(2):
            top = float(row * TILE + y * _REGION)
            low = top * one + half - my - margin
            high = min(top + _REGION, height) * one - half - my + margin
            met = top < height and low <= reach and high >= -reach and not none
            for x in range(2):
                begins = column * TILE + x * _REGION
                if met and first < begins + _REGION and last >= begins:
                    mask[e] |= 1 << (2 * y + x)


def region_masks(
    config: AcceleratorConfig, projected: Projected, opacity: np.ndarray, registers: FrameRegisters, entries: Intersections, *,
    obb: bool = False,
) -> np.ndarray:
    """(E,) uint8: the regions of the tile of each intersection, a bit for each stream.

    Args:
        config: the machine, with four streams.
        projected: the projection's result.
        opacity: (N, 4) raw `log2_opacity`, as `tested_opacity` gives them.
        registers: the frame's registers.
        entries: the frame's intersections.
        obb: take all regions instead of testing them.
    """
    if obb:
        return np.full(len(entries.splat), (1 << config.streams) - 1, np.uint8)
    tile = np.repeat(np.arange(len(registers.header)), np.diff(entries.start))
    return found_regions(
        config, projected.mean2d, projected.conic, opacity, registers.header[:, 0], tile, entries.splat, registers.width,
        registers.height)


def found_regions(
    config: AcceleratorConfig, mean2d: np.ndarray, conic: np.ndarray, opacity: np.ndarray, level: np.ndarray, tile: np.ndarray,
    splat: np.ndarray, width: int, height: int,
) -> np.ndarray:
    """(E,) uint8: the regions of intersections in any order, by the exact test.

    Args:
        config: the machine, with four streams.
        mean2d, conic, opacity: (N, 2) raw, (N, 3) float64 and (N, 4) raw of the splats.
        level: (tiles,) levels.
        tile, splat: (E,) tile and splat of each intersection.
        width, height: size of the frame in pixels.
    """
    mask = np.zeros(len(splat), np.uint8)
    for_slices(
        _find, len(mask), tile, splat, np.ascontiguousarray(opacity), np.ascontiguousarray(level), mean2d, conic,
        -(-width // TILE), float(width), float(height), culling_constants(config), mask)
    return mask


def region_of(config: AcceleratorConfig, stream: int) -> tuple[slice, slice]:
    """The rows and columns of a tile that a stream renders."""
    row, column = divmod(stream, config.split)
    side = config.region
    return slice(row * side, (row + 1) * side), slice(column * side, (column + 1) * side)


def stream_entries(entries: Intersections, regions: np.ndarray, stream: int) -> Intersections:
    """The intersections of a stream: for each tile those with a bit in `regions`."""
    here = (regions >> stream & 1).astype(bool)
    before = np.concatenate(([0], np.cumsum(here)))
    return Intersections(before[entries.start], entries.splat[here], entries.use[here], entries.filtered)
