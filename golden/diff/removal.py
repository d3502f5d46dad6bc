"""What an image loses if one splat is left out: squared changes, summed over its pixels and colour channels, on the CPU.

Leaving out a splat with alpha and share s = T alpha changes a pixel by -s (c - B), where c is its colour and B what is behind
it, composited from transmittance 1. This is exact for one splat: what is before it stays, and what is behind it is seen
through 1 instead of 1 - alpha.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from golden.diff.blend_rows import BLOCK, F, kernel, replay_tile, scratch, set_up
from golden.diff.blend_squares import sum_pairs
from golden.diff.gaussians import Gaussians
from golden.diff.projection import project
from golden.diff.sensitivity import blended
from golden.diff.slices import run_slices
from golden.scenes.camera import Camera
from spec.constants import ALPHA_MAX_L1, SUPPORT_SIGMA, TILE


@kernel
def _tile(splats, numbers, left, top, table, behind, pairs, records, row_of_record, first_record, sums, changes):
    """Goes through the records of one tile back to front."""
    for begin in range((len(splats) - 1) // BLOCK * BLOCK, -1, -BLOCK):
        block = splats[begin : begin + BLOCK]
        set_up(block, left, top, table, pairs)
        for j in range(len(block) - 1, -1, -1):
            n = begin + j
            sums[:] = F(0)
            red, green, blue = pairs[j, 7], pairs[j, 8], pairs[j, 9]
            for r in range(first_record[n], first_record[n + 1]):
                y = row_of_record[r]
                for x in range(TILE):
                    alpha, share = records[r, x], records[r, TILE + x]
                    b_red, b_green, b_blue = red - behind[0, y, x], green - behind[1, y, x], blue - behind[2, y, x]
                    behind[0, y, x] += alpha * b_red
                    behind[1, y, x] += alpha * b_green
                    behind[2, y, x] += alpha * b_blue
                    sums[x] += share * share * (b_red * b_red + b_green * b_green + b_blue * b_blue)
            changes[numbers[n]] = sums.sum()


@kernel
def _changes(_slice, begin, end, start, splat, number, table, alpha_max, background, tiles_x, used, width, height, changes):
    light, pairs, live, records, row_of_record, first_record = scratch(used[begin:end])
    sums, behind = np.empty(TILE, np.float32), np.empty((3, TILE, TILE), np.float32)
    for tile in range(begin, end):
        splats = splat[start[tile] : start[tile] + used[tile]]
        numbers = number[start[tile] : start[tile + 1]]
        left, top, records, row_of_record = replay_tile(
            tile, tiles_x, width, height, splats, table, alpha_max, light, pairs, live, records, row_of_record, first_record)
        for c in range(3):
            behind[c] = background[c]
        _tile(splats, numbers, left, top, table, behind, pairs, records, row_of_record, first_record, sums, changes)
        for n in range(used[tile], len(numbers)):
            changes[numbers[n]] = F(0)


@dataclass(frozen=True)
class Removal:
    """What leaving out one Gaussian changes in one image, for M projected Gaussians.

    Attributes:
        index: (M,) int64 rows of the projected Gaussians, ascending.
        change: (M,) float64 squared change of the image, summed over pixels and colour channels.
        tiles: (M,) int32 number of tiles that used it before all their pixels had stopped.
    """

    index: torch.Tensor
    change: torch.Tensor
    tiles: torch.Tensor


@torch.no_grad()
def removal(
    gaussians: Gaussians, camera: Camera, *, alpha_max: float = ALPHA_MAX_L1, background: Sequence[float] = (0.0, 0.0, 0.0)
) -> Removal:
    """What each Gaussian means to one image. It is computed on the CPU, also for Gaussians elsewhere; results are on their
    device.

    Args:
        gaussians, camera, alpha_max, background: as for `golden.diff.render.render`.
    """
    device = gaussians.device
    splats = project(gaussians.detached().to("cpu"), camera, SUPPORT_SIGMA)
    blending = blended(splats, camera, alpha_max, background)
    lists, count = blending.lists, len(blending.table)
    of_pair, change = np.empty(len(lists.splat), np.float32), np.empty(count)
    run_slices(_changes, len(blending.used), lists.start, lists.splat, lists.pair, blending.table, blending.alpha_max,
               blending.background, blending.tiles_x, blending.used, *blending.size, of_pair)
    run_slices(sum_pairs, count, lists.order, lists.room, of_pair, change)
    return Removal(*(found.to(device) for found in (
        splats.index, torch.from_numpy(change), torch.from_numpy(blending.tiles))))
