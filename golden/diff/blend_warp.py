"""Blending in NVIDIA Warp kernels, forward and backward: float32, one thread for each pixel, one block of threads for each
tile.

The sums are those of `golden.diff.blend_cpu`, also without a division by 1 - alpha. The forward pass stores each pixel's
transmittance before every CHUNK-th splat of its tile's list. From it, the backward pass repeats a chunk and then goes through
it back to front. Each intersection's contributions from the tile's pixels are summed within the block in a fixed order, and
then for each splat in the order of intersections. Only integers are added atomically, so results are deterministic.

The kernels also run on Warp's CPU device, one thread after the other; this is how they are tested without a GPU.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import warp as wp
from torch.autograd.function import once_differentiable

from golden.diff.pairs_warp import TileLists, tile_lists
from golden.diff.projection import Projection
from golden.diff.warp_launch import BLOCK, array, launch
from golden.scenes.camera import Camera
from spec.constants import T_STOP, TILE

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

CHUNK = 16
"""Number of splats between two stored transmittances: 64 bytes for each intersection, and half a chunk recomputed for each
pixel."""

SUMS = 10
"""Number of gradients of an intersection: opacity (times the opacity), mean2d 2, factor 3, colour 3, depth."""

COLUMNS = 11
"""Number of columns in a splat's row: mean2d 2, factor 3, opacity, q_max, colour 3, depth."""

_EDGE, _PIXELS, _CHUNK = wp.constant(TILE), wp.constant(TILE * TILE), wp.constant(CHUNK)
_T_STOP = wp.constant(wp.float32(T_STOP))
_Sums = wp.types.vector(SUMS, wp.float32)
_DoubleSums = wp.types.vector(SUMS, wp.float64)
_Chunk = wp.types.vector(CHUNK, wp.float32)
assert BLOCK == TILE * TILE, "a block is a tile"


@wp.struct
class Lists:
    """The splats and tile lists of a frame; chunk[t] is the first of tile t's chunks."""

    start: wp.array(dtype=int)
    splat: wp.array(dtype=int)
    pair: wp.array(dtype=int)
    chunk: wp.array(dtype=int)
    table: wp.array2d(dtype=float)
    alpha_max: float
    width: int
    height: int


@wp.func
def _tiles_x(width: int) -> int:
    return (width + _EDGE - 1) / _EDGE


@wp.func
def _pixel(thread: int, lists: Lists) -> wp.vec2i:
    """Column and row of a thread's pixel, which may lie beyond the frame's right and lower edges."""
    tile, lane = thread / _PIXELS, thread % _PIXELS
    tiles_x = _tiles_x(lists.width)
    return wp.vec2i((tile % tiles_x) * _EDGE + lane % _EDGE, (tile / tiles_x) * _EDGE + lane / _EDGE)


@wp.func
def _reach(table: wp.array2d(dtype=float), i: int, pixel: wp.vec2i) -> wp.vec4:
    """Offset dx, dy of a pixel's centre from the mean of splat i, and u, v there."""
    dx = float(pixel[0]) + 0.5 - table[i, 0]
    dy = float(pixel[1]) + 0.5 - table[i, 1]
    return wp.vec4(dx, dy, table[i, 2] * dx + table[i, 3] * dy, table[i, 4] * dy)


@wp.func
def _alpha(lists: Lists, i: int, pixel: wp.vec2i) -> float:
    """Alpha of splat i at a pixel; 0 where the splat does not reach it."""
    at = _reach(lists.table, i, pixel)
    q = 0.5 * (at[2] * at[2] + at[3] * at[3])
    if q > lists.table[i, 6]:
        return wp.float32(0.0)
    return wp.min(lists.alpha_max, lists.table[i, 5] * wp.exp(-q))


@wp.func
def _colour(table: wp.array2d(dtype=float), i: int) -> wp.vec3:
    return wp.vec3(table[i, 7], table[i, 8], table[i, 9])


@wp.kernel
def _forward(
    lists: Lists, background: wp.vec3, image: wp.array2d(dtype=wp.vec3), far: wp.array2d(dtype=float),
    light: wp.array2d(dtype=float), stop: wp.array2d(dtype=int), used: wp.array(dtype=int), keep: int,
    before: wp.array2d(dtype=float),
):
    """Renders one pixel.

    It writes to `stop` how many splats of the list the pixel went through, to `used` the largest of these in the tile, and to
    `before` the transmittance by chunk and pixel.
    """
    thread = wp.tid()
    tile, lane = thread / _PIXELS, thread % _PIXELS
    pixel = _pixel(thread, lists)
    if pixel[0] < lists.width and pixel[1] < lists.height:
        first, count = lists.start[tile], lists.start[tile + 1] - lists.start[tile]
        colour, depth, t, n = wp.vec3(), wp.float32(0.0), wp.float32(1.0), wp.int32(0)
        while n < count and t >= _T_STOP:
            if keep != 0 and n % _CHUNK == 0:
                before[lists.chunk[tile] + n / _CHUNK, lane] = t
            i = lists.splat[first + n]
            share = t * _alpha(lists, i, pixel)
            colour += share * _colour(lists.table, i)
            depth += share * lists.table[i, 10]
            t -= share
            n += 1
        image[pixel[1], pixel[0]] = colour + t * background
        far[pixel[1], pixel[0]] = depth
        light[pixel[1], pixel[0]] = t
        stop[pixel[1], pixel[0]] = n
        wp.atomic_max(used, tile, n)


@wp.func
def _gradient(lists: Lists, i: int, pixel: wp.vec2i, alpha: float, share: float, beyond: float, g: wp.vec4) -> _Sums:
    """One pixel's part of an intersection's gradients; `beyond` is dL/dalpha divided by T."""
    at = _reach(lists.table, i, pixel)
    w = wp.float32(0.0)
    if alpha < lists.alpha_max:  # where alpha is clipped it does not change
        w = share * beyond
    u, v = w * at[2], w * at[3]
    sums = _Sums()
    sums[0] = w
    sums[1] = u * lists.table[i, 2]
    sums[2] = u * lists.table[i, 3] + v * lists.table[i, 4]
    sums[3] = -u * at[0]
    sums[4] = -u * at[1]
    sums[5] = -v * at[1]
    for c in range(4):
        sums[6 + c] = share * g[c]
    return sums


@wp.kernel
def _backward(
    lists: Lists, background: wp.vec3, stop: wp.array2d(dtype=int), used: wp.array(dtype=int), before: wp.array2d(dtype=float),
    g_image: wp.array2d(dtype=wp.vec3), g_far: wp.array2d(dtype=float), g_light: wp.array2d(dtype=float),
    gradient: wp.array(dtype=_Sums),
):
    """One pixel, back to front. All threads of a tile process each splat together, whether or not their pixels show it."""
    thread = wp.tid()
    tile, lane = thread / _PIXELS, thread % _PIXELS
    pixel = _pixel(thread, lists)
    g, behind, mine = wp.vec4(), wp.float32(0.0), wp.int32(0)
    if pixel[0] < lists.width and pixel[1] < lists.height:
        colour = g_image[pixel[1], pixel[0]]
        g = wp.vec4(colour[0], colour[1], colour[2], g_far[pixel[1], pixel[0]])
        behind = g_light[pixel[1], pixel[0]] + wp.dot(colour, background)
        mine = stop[pixel[1], pixel[0]]
    alphas, shares = _Chunk(), _Chunk()
    end = used[tile]
    while end > 0:
        chunk = (end - 1) / _CHUNK
        begin = chunk * _CHUNK
        t = wp.float32(0.0)
        if begin < mine:
            t = before[lists.chunk[tile] + chunk, lane]
        for n in range(begin, end):
            alpha = wp.float32(0.0)
            if n < mine:
                alpha = _alpha(lists, lists.splat[lists.start[tile] + n], pixel)
            alphas[n - begin] = alpha
            shares[n - begin] = t * alpha
            t -= t * alpha
        while end > begin:
            end -= 1
            e = lists.start[tile] + end
            i = lists.splat[e]
            alpha = alphas[end - begin]
            beyond = wp.dot(wp.vec3(g[0], g[1], g[2]), _colour(lists.table, i)) + g[3] * lists.table[i, 10] - behind
            behind += alpha * beyond
            part = _gradient(lists, i, pixel, alpha, shares[end - begin], beyond, g)
            total = wp.tile_extract(wp.tile_sum(wp.tile(part, preserve_type=True)), 0)
            if thread % wp.block_dim() == 0:
                p = lists.pair[e]
                gradient[p] = gradient[p] + total  # one thread writes an intersection; += would be an atomic addition


@wp.kernel
def _reduce(
    order: wp.array(dtype=int), room: wp.array(dtype=int), of_pair: wp.array(dtype=_Sums), of_splat: wp.array(dtype=_Sums),
):
    """Sums the intersections' gradients; one thread for each splat."""
    k = wp.tid()
    total = _DoubleSums()
    for p in range(room[k], room[k + 1]):
        total += _DoubleSums(of_pair[p])
    of_splat[order[k]] = _Sums(total)


@wp.kernel
def _usage(
    lists: Lists, stop: wp.array2d(dtype=int), used: wp.array(dtype=int), weight: wp.array(dtype=float),
    dominated: wp.array(dtype=int),
):
    """Sums each intersection's shares, and counts for each splat the pixels in which its share is the largest.

    Of equal shares, that of the nearer splat counts.
    """
    thread = wp.tid()
    tile = thread / _PIXELS
    pixel = _pixel(thread, lists)
    mine = wp.int32(0)
    if pixel[0] < lists.width and pixel[1] < lists.height:
        mine = stop[pixel[1], pixel[0]]
    t, largest, strongest = wp.float32(1.0), wp.float32(0.0), wp.int32(-1)
    for n in range(used[tile]):
        e = lists.start[tile] + n
        i = lists.splat[e]
        share = wp.float32(0.0)
        if n < mine:
            share = t * _alpha(lists, i, pixel)
            t -= share
        if share > largest:
            largest = share
            strongest = i
        total = wp.tile_extract(wp.tile_sum(wp.tile(share)), 0)
        if thread % wp.block_dim() == 0:
            p = lists.pair[e]
            weight[p] = weight[p] + total
    if strongest >= 0:
        wp.atomic_add(dominated, strongest, 1)


@wp.kernel
def _sum_weights(
    order: wp.array(dtype=int), room: wp.array(dtype=int), of_pair: wp.array(dtype=float), of_splat: wp.array(dtype=float),
):
    """Sums the intersections' weights; one thread for each splat."""
    k = wp.tid()
    total = wp.float64(0.0)
    for p in range(room[k], room[k + 1]):
        total += wp.float64(of_pair[p])
    of_splat[order[k]] = wp.float32(total)


class Blending:
    """The blending of one image on a device: the counterpart of `golden.diff.blend_cpu.Blending` with torch's tensors.

    Attributes:
        image, depth_sum, transmittance: (H, W, 3), (H, W), (H, W) float32.
        tiles: (M,) int32, number of tiles that used each splat before all their pixels had stopped.
        lists: the splats of each tile, front to back.
    """

    def __init__(
        self, splats: tuple[torch.Tensor, ...], q_max: torch.Tensor, lists: TileLists, size: tuple[int, int], alpha_max: float,
        background: Sequence[float], keep: bool,
    ) -> None:
        """Runs the forward pass.

        Args:
            splats: float32 mean2d (M, 2), factor (M, 3), opacity (M,), colour (M, 3), depth (M,).
            q_max: (M,) float32, largest falloff exponent that each splat covers.
            lists: the splats of each tile, front to back.
            size: width and height in pixels.
            alpha_max: upper bound of alpha.
            background: red, green, blue.
            keep: whether `backward` may follow.
        """
        mean2d, factor, opacity, colour, depth = splats
        width, height = size
        self.lists, self.opacity, self.device = lists, opacity, q_max.device
        self._table = torch.cat([mean2d, factor, opacity[:, None], q_max[:, None], colour, depth[:, None]], 1)
        counts = lists.start.diff()
        chunks = torch.zeros_like(lists.start)
        torch.cumsum((counts + CHUNK - 1) // CHUNK, 0, dtype=torch.int32, out=chunks[1:])
        self._chunks = chunks
        self._threads = TILE * TILE * len(counts)
        self._scene = self._lists(alpha_max, width, height)
        self._background = wp.vec3(*map(float, background))
        self.image = torch.empty(height, width, 3, device=self.device)
        self.depth_sum, self.transmittance = torch.empty(2, height, width, device=self.device)
        self._stop = torch.empty(height, width, dtype=torch.int32, device=self.device)
        self._used = torch.zeros(len(counts), dtype=torch.int32, device=self.device)
        self._before = torch.empty(int(chunks[-1]) if keep else 0, TILE * TILE, device=self.device)
        launch(_forward, self._threads, self.device, self._scene, self._background, array(self.image, wp.vec3),
               array(self.depth_sum, float), array(self.transmittance, float), array(self._stop, int), array(self._used, int),
               int(keep), array(self._before, float))
        place = torch.arange(len(lists.splat), dtype=torch.int32, device=self.device)
        used_up_to = torch.repeat_interleave(lists.start[:-1] + self._used, counts, output_size=len(place))
        self.tiles = torch.bincount(lists.splat[place < used_up_to], minlength=len(q_max)).to(torch.int32)

    def backward(self, *gradients: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Gradients of mean2d, factor, opacity, colour and depth, given those of the three results."""
        g_image, g_depth_sum, g_transmittance = (gradient.contiguous() for gradient in gradients)
        of_pair = torch.zeros(len(self.lists.splat), SUMS, device=self.device)
        of_splat = torch.empty(len(self._table), SUMS, device=self.device)
        launch(_backward, self._threads, self.device, self._scene, self._background, array(self._stop, int),
               array(self._used, int), array(self._before, float), array(g_image, wp.vec3), array(g_depth_sum, float),
               array(g_transmittance, float), array(of_pair, _Sums))
        launch(_reduce, len(of_splat), self.device, array(self.lists.order, int), array(self.lists.room, int),
               array(of_pair, _Sums), array(of_splat, _Sums))
        return of_splat[:, 1:3], of_splat[:, 3:6], of_splat[:, 0] / self.opacity, of_splat[:, 6:9], of_splat[:, 9]

    def usage(self) -> tuple[torch.Tensor, torch.Tensor]:
        """(M,) int32 number of pixels that each splat dominates, and (M,) float32 sums of T alpha."""
        of_pair = torch.zeros(len(self.lists.splat), device=self.device)
        weight = torch.empty(len(self._table), device=self.device)
        dominated = torch.zeros(len(self._table), dtype=torch.int32, device=self.device)
        launch(_usage, self._threads, self.device, self._scene, array(self._stop, int), array(self._used, int),
               array(of_pair, float), array(dominated, int))
        launch(_sum_weights, len(weight), self.device, array(self.lists.order, int), array(self.lists.room, int),
               array(of_pair, float), array(weight, float))
        return dominated, weight

    def _lists(self, alpha_max: float, width: int, height: int) -> Lists:
        scene = Lists()
        scene.start, scene.splat = array(self.lists.start, int), array(self.lists.splat, int)
        scene.pair, scene.chunk = array(self.lists.pair, int), array(self._chunks, int)
        scene.table = array(self._table, float)
        scene.alpha_max, scene.width, scene.height = float(alpha_max), width, height
        return scene


class _Blend(torch.autograd.Function):
    """Blending of splats. The forward pass appends the `Blending` that it makes to the list `made`."""

    @staticmethod
    def forward(ctx, mean2d, factor, opacity, colour, depth, make, made):
        splats = tuple(tensor.detach().contiguous() for tensor in (mean2d, factor, opacity, colour, depth))
        ctx.blending = make(splats, any(ctx.needs_input_grad))
        made.append(ctx.blending)
        results = (ctx.blending.image, ctx.blending.depth_sum, ctx.blending.transmittance)
        return tuple(result.detach() for result in results)  # the results themselves would form a cycle with the graph

    @staticmethod
    @once_differentiable
    def backward(ctx, *gradients):
        return (*ctx.blending.backward(*gradients), None, None)


def blend(
    splats: Projection, camera: Camera, alpha_max: float, background: Sequence[float], mask: torch.Tensor | np.ndarray
) -> tuple[tuple[torch.Tensor, ...], Blending]:
    """Image, depth sum and transmittance, differentiable, and the `Blending` that made them.

    Args:
        splats: the projected splats.
        camera: the camera.
        alpha_max: upper bound of alpha.
        background: red, green, blue.
        mask: (tiles_y, tiles_x) bool, the tiles to render.
    """
    mask = torch.as_tensor(mask, device=splats.q_max.device)
    q_max, size = splats.q_max.contiguous(), (camera.width, camera.height)

    def make(tensors: tuple[torch.Tensor, ...], keep: bool) -> Blending:
        lists = tile_lists(tensors[0], tensors[1], q_max, tensors[4], *size, mask)
        return Blending(tensors, q_max, lists, size, alpha_max, background, keep)

    made: list[Blending] = []
    images = _Blend.apply(splats.mean2d, splats.factor, splats.opacity, splats.colour, splats.depth, make, made)
    return images, made[0]
