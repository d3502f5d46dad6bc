"""Which splats an image used, and how much of each: pruning asks the CPU renderer for these numbers."""

from __future__ import annotations

import numpy as np

from golden.diff.blend_rows import ZERO, F, kernel, replay_tile, scratch
from golden.diff.pairs import TileLists
from golden.diff.slices import run_slices
from spec.constants import TILE


@kernel
def _usage(
    _slice, begin, end, start, splat, number, table, alpha_max, tiles_x, used, width, height, weight, strongest
):
    """Finds the sum of shares of each intersection, and the splat with the largest share in each pixel (of equals, the
    nearer)."""
    light, pairs, live, records, row_of_record, first_record = scratch(used[begin:end])
    largest = np.empty((TILE, TILE), np.float32)
    for tile in range(begin, end):
        splats, first = splat[start[tile] : start[tile] + used[tile]], start[tile]
        _, _, records, row_of_record = replay_tile(
            tile, tiles_x, width, height, splats, table, alpha_max, light, pairs, live, records, row_of_record, first_record)
        largest[:] = ZERO
        for n in range(used[tile]):
            total = ZERO
            for r in range(first_record[n], first_record[n + 1]):
                y = row_of_record[r]
                for x in range(TILE):
                    share = records[r, TILE + x]
                    total += share
                    if share > largest[y, x]:
                        largest[y, x], strongest[tile, y, x] = share, splats[n]
            weight[number[first + n]] = total
        for n in range(first + used[tile], start[tile + 1]):
            weight[number[n]] = ZERO


@kernel
def _sum_usage(order, room, weight_of_pair, strongest, weight, dominated):
    for k in range(len(order)):
        total = 0.0
        for p in range(room[k], room[k + 1]):
            total += weight_of_pair[p]
        weight[order[k]] = total
    for i in strongest:
        if i >= 0:
            dominated[i] += 1


def usage(
    lists: TileLists, used: np.ndarray, table: np.ndarray, alpha_max: np.float32, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """(M,) int32 number of pixels in which the splat has the largest T alpha, and (M,) float32 sum of its T alpha over pixels.

    Args:
        lists: the splats of each tile, front to back.
        used: (T,) int64 number of intersections that each tile used before it stopped.
        table: (M, 12) float32 as `blend_cpu` packs it.
        alpha_max: upper bound of alpha.
        size: width and height in pixels.
    """
    weight_of_pair, strongest = _measured(lists, used, table, alpha_max, size)
    weight, dominated = np.empty(len(table), F), np.zeros(len(table), np.int32)
    _sum_usage(lists.order, lists.room, weight_of_pair, strongest.ravel(), weight, dominated)
    return dominated, weight


def strongest_of_tiles(
    lists: TileLists, used: np.ndarray, table: np.ndarray, alpha_max: np.float32, size: tuple[int, int]
) -> np.ndarray:
    """(T, TILE, TILE) int32: the row of the splat with the largest T alpha in each pixel of each tile, -1 where there is none.
    The arguments are those of `usage`."""
    return _measured(lists, used, table, alpha_max, size)[1]


def _measured(
    lists: TileLists, used: np.ndarray, table: np.ndarray, alpha_max: np.float32, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """The weight of each intersection, and the strongest splats of each tile's pixels."""
    weight_of_pair = np.empty(len(lists.splat), F)
    strongest = np.full((len(used), TILE, TILE), -1, np.int32)
    run_slices(_usage, len(used), lists.start, lists.splat, lists.pair, table, alpha_max, -(-size[0] // TILE), used, *size,
               weight_of_pair, strongest)
    return weight_of_pair, strongest
