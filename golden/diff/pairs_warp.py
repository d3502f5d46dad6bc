"""Which splats each tile blends, front to back, computed on the tensors' device with Warp kernels and torch's stable sorts.

The lists are the same as those of `golden.diff.pairs`: the test is in float64 in both.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import warp as wp

from golden.diff.pairs import SLACK
from golden.diff.warp_launch import array, launch
from spec.constants import TILE

wp.set_module_options({"enable_backward": False})

_EDGE, _SIZE = wp.constant(wp.float64(TILE)), wp.constant(TILE)
_FIRST_CENTRE, _LAST_CENTRE = wp.constant(wp.float64(0.5)), wp.constant(wp.float64(TILE - 0.5))
_SLACK = wp.constant(wp.float64(SLACK))
_NONE = wp.constant(wp.vec2i(1, 0))


@dataclass(frozen=True)
class TileLists:
    """M splats in T tiles with E intersections: the fields of `golden.diff.pairs.TileLists` as int32 tensors."""

    start: torch.Tensor
    splat: torch.Tensor
    pair: torch.Tensor
    order: torch.Tensor
    room: torch.Tensor


@wp.func
def _met(low: wp.float64, high: wp.float64, tiles: int, size: int) -> wp.vec2i:
    """First and last tile whose pixel centres span a range that meets [low, high], clipped to the frame; 1, 0 if none."""
    if low > wp.float64(size) - _FIRST_CENTRE or high < _FIRST_CENTRE:
        return _NONE
    first = wp.ceil(wp.max((low - _LAST_CENTRE) / _EDGE, wp.float64(0.0)))
    last = wp.floor(wp.min((high - _FIRST_CENTRE) / _EDGE, wp.float64(tiles - 1)))
    return wp.vec2i(int(first), int(last))


@wp.func
def _columns(
    mean: wp.vec2d, f: wp.vec3d, limit: wp.float64, rim: wp.float64, steep: wp.float64, row: int, tiles_x: int, width: int,
    height: int,
) -> wp.vec2i:
    """First and last tile that the ellipse u^2 + v^2 <= limit meets in a tile row."""
    top = wp.float64(row * _SIZE) + _FIRST_CENTRE - mean[1]
    bottom = wp.float64(wp.min((row + 1) * _SIZE, height)) - _FIRST_CENTRE - mean[1]
    low, high = wp.max(top, -rim), wp.min(bottom, rim)
    if low > high:
        return _NONE
    left_v = f[2] * wp.clamp(steep, low, high)
    right_v = f[2] * wp.clamp(-steep, low, high)
    shear = f[1] / f[2]
    left = -wp.sqrt(wp.max(limit - left_v * left_v, wp.float64(0.0))) - shear * left_v
    right = wp.sqrt(wp.max(limit - right_v * right_v, wp.float64(0.0))) - shear * right_v
    return _met(mean[0] + left / f[0], mean[0] + right / f[0], tiles_x, width)


@wp.kernel
def _visit(
    order: wp.array(dtype=int), mean2d: wp.array(dtype=wp.vec2), factor: wp.array(dtype=wp.vec3), q_max: wp.array(dtype=float),
    width: int, height: int, mask: wp.array2d(dtype=wp.uint8), room: wp.array(dtype=int), numbering: int,
    tile_of: wp.array(dtype=int), splat_of: wp.array(dtype=int),
):
    """Counts the intersections of one splat into `room` or, with `numbering`, numbers them from room[k] on."""
    k = wp.tid()
    i = order[k]
    mean, f = wp.vec2d(mean2d[i]), wp.vec3d(factor[i])
    limit = wp.float64(2.0) * (wp.float64(q_max[i]) + _SLACK)
    root = wp.sqrt(limit)
    rim = root / f[2]
    steep = f[1] * root / (f[2] * wp.sqrt(f[1] * f[1] + f[2] * f[2]))
    rows = _met(mean[1] - rim, mean[1] + rim, mask.shape[0], height)
    at = room[k] * numbering
    for row in range(rows[0], rows[1] + 1):
        columns = _columns(mean, f, limit, rim, steep, row, mask.shape[1], width, height)
        for column in range(columns[0], columns[1] + 1):
            if mask[row, column] != wp.uint8(0):
                if numbering != 0:
                    tile_of[at] = row * mask.shape[1] + column
                    splat_of[at] = i
                at += 1
    if numbering == 0:
        room[k] = at


def tile_lists(
    mean2d: torch.Tensor, factor: torch.Tensor, q_max: torch.Tensor, depth: torch.Tensor, width: int, height: int,
    mask: torch.Tensor,
) -> TileLists:
    """Lists every intersection: every (splat, tile) pair whose footprint meets the rectangle of those of the tile's pixel
    centres that lie in the frame.

    Args:
        mean2d, factor, q_max, depth: (M, 2), (M, 3), (M,), (M,) float32 of `projection.Projection`, contiguous.
        width, height: size of the frame in pixels.
        mask: (tiles_y, tiles_x) bool, the tiles to list.
    """
    count, device = len(depth), depth.device
    order = torch.sort(depth, stable=True).indices.to(torch.int32)
    splats = (array(order, int), array(mean2d, wp.vec2), array(factor, wp.vec3), array(q_max, float))
    scene = (*splats, width, height, array(mask.to(torch.uint8).contiguous(), wp.uint8))
    counts = torch.zeros(count, dtype=torch.int32, device=device)
    nothing = array(torch.empty(1, dtype=torch.int32, device=device), int)
    launch(_visit, count, device, *scene, array(counts, int), 0, nothing, nothing)
    room = torch.zeros(count + 1, dtype=torch.int32, device=device)
    torch.cumsum(counts, 0, dtype=torch.int32, out=room[1:])
    total = int(room[-1])
    tile_of, splat_of = torch.empty(2, total, dtype=torch.int32, device=device)
    if total:
        launch(_visit, count, device, *scene, array(room, int), 1, array(tile_of, int), array(splat_of, int))
    sorted_tiles, pair = torch.sort(tile_of, stable=True)  # by tile; within a tile the order of depth and row is kept
    tiles = torch.arange(mask.numel() + 1, dtype=torch.int32, device=device)
    start = torch.searchsorted(sorted_tiles, tiles, out_int32=True)
    return TileLists(start, splat_of[pair], pair.to(torch.int32), order, room)
