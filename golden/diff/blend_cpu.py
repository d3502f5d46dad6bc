"""Blending on the CPU, forward and backward: float32, one tile at a time, splat by splat over rows of 16 pixels as vectors.

The backward pass needs no division. It repeats the forward pass of a tile and keeps the alphas and shares T alpha of each row.
Then, back to front, dL/dalpha = T (g . c - G). Here g is the gradient at the pixel, and G is that gradient for everything
behind the splat, composited from transmittance 1: G <- G + alpha (g . c - G), starting with the background. So alphas of 1 and
transmittances of 0 need no special treatment.

Each intersection (a splat and a tile) has its own gradients. They are summed for each splat in a fixed order, so the result
does not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np

from golden.diff.blend_rows import (
    BLOCK,
    COLUMNS,
    HALF,
    LOG2E,
    SCALE,
    ZERO,
    F,
    alpha_of,
    clear,
    inlined,
    kernel,
    last_used,
    live_rows,
    replay_tile,
    row_of,
    scratch,
    set_up,
)
from golden.diff.blend_usage import usage
from golden.diff.pairs import TileLists
from golden.diff.slices import run_slices
from spec.constants import TILE

_T, _RED, _GREEN, _BLUE, _FAR = range(0, 5 * TILE, TILE)
_BEHIND = _T  # the backward pass keeps G where the forward pass keeps T, and gradients in place of the sums

_PER_PIXEL, _PER_FACTOR = F(2 / LOG2E), F(1 / SCALE)  # from exponents of 2 and factors scaled for them back to q

SUMS = 10
"""Number of gradients of an intersection: opacity (times the opacity), mean2d 2, factor 3, colour 3, depth."""


@kernel
def _pack(_slice, begin, end, mean2d, factor, opacity, colour, depth, q_max, table):
    """Writes one row of the table for each splat.

    A row holds the mean (columns 0, 1), the conic factor scaled for exponents of 2 (2-4), the exponent's limit (5), log2
    opacity (6), colour (7-9), depth (10), and the half extent in y (11).
    """
    for i in range(begin, end):
        table[i, 0], table[i, 1] = mean2d[i, 0], mean2d[i, 1]
        for c in range(3):
            table[i, 2 + c], table[i, 7 + c] = factor[i, c] * SCALE, colour[i, c]
        table[i, 5], table[i, 6] = q_max[i] * LOG2E, np.log2(opacity[i])
        table[i, 10] = depth[i]
        table[i, 11] = np.sqrt(table[i, 5]) / table[i, 4]


@inlined
def _composite(rows, y, u, l1, room, top, alpha_max, red, green, blue, depth):
    """Composites one splat over row `y`.

    `u` is its value at the first pixel and `l1` its step from pixel to pixel; `room` is what the row leaves of the exponent's
    limit.
    """
    for x in range(TILE):
        before = rows[y, _T + x]
        share = before * alpha_of(before, u + F(x) * l1, room, top, alpha_max)
        rows[y, _T + x] = before - share
        rows[y, _RED + x] += share * red
        rows[y, _GREEN + x] += share * green
        rows[y, _BLUE + x] += share * blue
        rows[y, _FAR + x] += share * depth


@kernel
def _draw(splats, left, top, table, alpha_max, rows, before, pairs, live):
    """Blends one tile into `rows`, which must be cleared; returns how many intersections were used before all its pixels
    stopped."""
    used, light = len(splats), rows[:, _T : _T + TILE]
    for begin in range(0, len(splats), BLOCK):
        if not live_rows(light, live):
            block = splats[begin - BLOCK : begin]
            used = begin - BLOCK + last_used(block, left, top, table, alpha_max, before, pairs, live)
            break
        before[:] = light
        block = splats[begin : begin + BLOCK]
        set_up(block, left, top, table, pairs)
        for j in range(len(block)):
            for y in range(int(pairs[j, 12]), int(pairs[j, 13]) + 1):
                u, room, top_alpha = row_of(pairs, j, y)
                if (room >= 0) & live[y]:
                    _composite(rows, y, u, pairs[j, 2], room, top_alpha, alpha_max, pairs[j, 7], pairs[j, 8], pairs[j, 9],
                               pairs[j, 10])
    else:
        if len(splats) and not live_rows(light, live):
            begin = (len(splats) - 1) // BLOCK * BLOCK
            used = begin + last_used(splats[begin:], left, top, table, alpha_max, before, pairs, live)
    return used


@kernel
def _forward(_slice, begin, end, start, splat, table, alpha_max, background, tiles_x, image, far, light, used):
    rows, before = np.empty((TILE, 5 * TILE), np.float32), np.empty((TILE, TILE), np.float32)
    pairs, live = np.empty((BLOCK, COLUMNS), np.float32), np.empty(TILE, np.bool_)
    height, width = far.shape
    for tile in range(begin, end):
        tile_y, tile_x = tile // tiles_x, tile % tiles_x
        rows[:] = ZERO
        clear(rows[:, _T : _T + TILE], tile_x, tile_y, width, height)
        left, top = F(tile_x * TILE) + HALF, F(tile_y * TILE) + HALF
        used[tile] = _draw(splat[start[tile] : start[tile + 1]], left, top, table, alpha_max, rows, before, pairs, live)
        for y in range(min(TILE, height - tile_y * TILE)):
            row = tile_y * TILE + y
            for x in range(min(TILE, width - tile_x * TILE)):
                column, rest = tile_x * TILE + x, rows[y, _T + x]
                far[row, column], light[row, column] = rows[y, _FAR + x], rest
                image[row, column, 0] = rows[y, _RED + x] + rest * background[0]
                image[row, column, 1] = rows[y, _GREEN + x] + rest * background[1]
                image[row, column, 2] = rows[y, _BLUE + x] + rest * background[2]


@inlined
def _accumulate(rows, y, records, r, u, l1, dx, dy, v, alpha_max, red, green, blue, depth, sums):
    """One splat over a row in the backward pass: updates G and adds to the vectors of sums."""
    for x in range(TILE):
        alpha, share, behind = records[r, x], records[r, TILE + x], rows[y, _BEHIND + x]
        g_red, g_green, g_blue, g_far = rows[y, _RED + x], rows[y, _GREEN + x], rows[y, _BLUE + x], rows[y, _FAR + x]
        beyond = g_red * red + g_green * green + g_blue * blue + g_far * depth - behind
        rows[y, _BEHIND + x] = behind + alpha * beyond
        w = share * beyond if alpha < alpha_max else ZERO
        wu = w * (u + F(x) * l1)
        sums[x] += w
        sums[TILE + x] += wu
        sums[2 * TILE + x] += w * v
        sums[3 * TILE + x] += wu * (dx + F(x))
        sums[4 * TILE + x] += wu * dy
        sums[5 * TILE + x] += w * (v * dy)
        sums[6 * TILE + x] += share * g_red
        sums[7 * TILE + x] += share * g_green
        sums[8 * TILE + x] += share * g_blue
        sums[9 * TILE + x] += share * g_far


@inlined
def _accumulate_appearance(rows, y, records, r, alpha_max, red, green, blue, depth, sums):
    """As `_accumulate`, for training in which only opacities and colours change."""
    for x in range(TILE):
        alpha, share, behind = records[r, x], records[r, TILE + x], rows[y, _BEHIND + x]
        g_red, g_green, g_blue, g_far = rows[y, _RED + x], rows[y, _GREEN + x], rows[y, _BLUE + x], rows[y, _FAR + x]
        beyond = g_red * red + g_green * green + g_blue * blue + g_far * depth - behind
        rows[y, _BEHIND + x] = behind + alpha * beyond
        sums[x] += share * beyond if alpha < alpha_max else ZERO
        sums[6 * TILE + x] += share * g_red
        sums[7 * TILE + x] += share * g_green
        sums[8 * TILE + x] += share * g_blue


@kernel
def _finish(pairs, j, sums, gradient, p):
    """The gradients of an intersection from its vectors of sums. The sum w is dL/dalpha times alpha, which is minus dL/dq."""
    for k in range(SUMS):
        total = ZERO
        for x in range(TILE):
            total += sums[k * TILE + x]
        gradient[p, k] = total
    w_u, w_v = gradient[p, 1], gradient[p, 2]
    gradient[p, 1] = w_u * pairs[j, 2] * _PER_PIXEL
    gradient[p, 2] = (w_u * pairs[j, 3] + w_v * pairs[j, 4]) * _PER_PIXEL
    for k in range(3, 6):
        gradient[p, k] *= -_PER_FACTOR


@kernel
def _back(
    splats, numbers, left, top, table, alpha_max, rows, pairs, records, row_of_record, first_record, geometry, sums, gradient
):
    """Goes through the records of one tile back to front."""
    for begin in range((len(splats) - 1) // BLOCK * BLOCK, -1, -BLOCK):
        block = splats[begin : begin + BLOCK]
        set_up(block, left, top, table, pairs)
        for j in range(len(block) - 1, -1, -1):
            n = begin + j
            for k in range(SUMS * TILE):
                sums[k] = ZERO
            for r in range(first_record[n], first_record[n + 1]):
                y = row_of_record[r]
                if not geometry:
                    _accumulate_appearance(rows, y, records, r, alpha_max, pairs[j, 7], pairs[j, 8], pairs[j, 9], pairs[j, 10],
                                           sums)
                    continue
                dy = pairs[j, 1] + F(y)
                _accumulate(rows, y, records, r, pairs[j, 11] + pairs[j, 3] * F(y), pairs[j, 2], pairs[j, 0], dy,
                            pairs[j, 4] * dy, alpha_max, pairs[j, 7], pairs[j, 8], pairs[j, 9], pairs[j, 10], sums)
            _finish(pairs, j, sums, gradient, numbers[n])


@kernel
def _load_gradients(rows, tile_x, tile_y, background, g_image, g_far, g_light):
    """Loads a tile's gradients of image and depth sum into `rows`, and G of the background."""
    height, width = g_far.shape
    rows[:] = ZERO
    for y in range(min(TILE, height - tile_y * TILE)):
        row = tile_y * TILE + y
        for x in range(min(TILE, width - tile_x * TILE)):
            column = tile_x * TILE + x
            red, green, blue = g_image[row, column, 0], g_image[row, column, 1], g_image[row, column, 2]
            rows[y, _RED + x], rows[y, _GREEN + x], rows[y, _BLUE + x] = red, green, blue
            rows[y, _FAR + x] = g_far[row, column]
            rows[y, _BEHIND + x] = (
                g_light[row, column] + red * background[0] + green * background[1] + blue * background[2])


@kernel
def _backward(
    _slice, begin, end, start, splat, number, table, alpha_max, background, tiles_x, used, g_image, g_far, g_light, geometry,
    gradient
):
    light, pairs, live, records, row_of_record, first_record = scratch(used[begin:end])
    rows, sums = np.empty((TILE, 5 * TILE), np.float32), np.empty(SUMS * TILE, np.float32)
    height, width = g_far.shape
    for tile in range(begin, end):
        tile_y, tile_x = tile // tiles_x, tile % tiles_x
        splats = splat[start[tile] : start[tile] + used[tile]]
        left, top, records, row_of_record = replay_tile(
            tile, tiles_x, width, height, splats, table, alpha_max, light, pairs, live, records, row_of_record, first_record)
        _load_gradients(rows, tile_x, tile_y, background, g_image, g_far, g_light)
        numbers = number[start[tile] : start[tile + 1]]
        _back(splats, numbers, left, top, table, alpha_max, rows, pairs, records, row_of_record, first_record, geometry, sums,
              gradient)
        for n in range(used[tile], len(numbers)):
            gradient[numbers[n]] = ZERO


@kernel
def _reduce(_slice, begin, end, order, room, opacity, gradient, g_mean2d, g_factor, g_opacity, g_colour, g_depth):
    """Sums the intersections' gradients for each splat."""
    total = np.empty(SUMS, np.float64)
    for k in range(begin, end):
        total[:] = 0
        for p in range(room[k], room[k + 1]):
            for c in range(SUMS):
                total[c] += gradient[p, c]
        i = order[k]
        g_opacity[i], g_depth[i] = total[0] / opacity[i], total[9]
        g_mean2d[i, 0], g_mean2d[i, 1] = total[1], total[2]
        for c in range(3):
            g_factor[i, c], g_colour[i, c] = total[3 + c], total[6 + c]


@kernel
def _count_tiles(start, used, splat, tiles):
    for tile in range(len(used)):
        for e in range(start[tile], start[tile] + used[tile]):
            tiles[splat[e]] += 1


class Blending:
    """The blending of one image: made by the forward pass, kept for the backward pass and for `usage`.

    Attributes:
        image: (H, W, 3) float32, background included.
        depth_sum: (H, W) float32 sum of T alpha z.
        transmittance: (H, W) float32.
        tiles: (M,) int32, number of tiles that used each splat before all their pixels had stopped.
    """

    def __init__(
        self, splats: tuple[np.ndarray, ...], q_max: np.ndarray, lists: TileLists, size: tuple[int, int], alpha_max: float,
        background: tuple[float, float, float]
    ) -> None:
        """Runs the forward pass.

        Args:
            splats: float32 mean2d (M, 2), factor (M, 3), opacity (M,), colour (M, 3), depth (M,).
            q_max: (M,) float32, largest falloff exponent that each splat covers.
            lists: the splats of each tile, front to back.
            size: width and height in pixels.
            alpha_max: upper bound of alpha.
            background: red, green, blue.
        """
        width, height = size
        self.lists, self.opacity, self.size = lists, splats[2], size
        self.alpha_max, self.background = F(alpha_max), np.asarray(background, F)
        self.tiles_x = -(-width // TILE)
        self.table = np.empty((len(q_max), 12), F)
        run_slices(_pack, len(q_max), *splats, q_max, self.table)
        self.image, self.depth_sum, self.transmittance = (np.empty((height, width, *c), F) for c in ((3,), (), ()))
        self.used = np.empty(len(lists.start) - 1, np.int64)
        run_slices(_forward, len(self.used), lists.start, lists.splat, self.table, self.alpha_max, self.background,
                   self.tiles_x, self.image, self.depth_sum, self.transmittance, self.used)
        self.tiles = np.zeros(len(q_max), np.int32)
        _count_tiles(lists.start, self.used, lists.splat, self.tiles)

    def backward(
        self, g_image: np.ndarray, g_depth_sum: np.ndarray, g_transmittance: np.ndarray, geometry: bool = True
    ) -> tuple[np.ndarray, ...]:
        """Gradients of mean2d, factor, opacity, colour and depth, given those of image, depth sum and transmittance.

        Args:
            g_image, g_depth_sum, g_transmittance: gradients of the three results, in their shapes.
            geometry: whether gradients of mean2d, factor and depth are wanted; otherwise these are 0.
        """
        lists, count = self.lists, len(self.table)
        gradient = np.empty((len(lists.splat), SUMS), F)
        run_slices(_backward, len(self.used), lists.start, lists.splat, lists.pair, self.table, self.alpha_max, self.background,
                   self.tiles_x, self.used, g_image, g_depth_sum, g_transmittance, geometry, gradient)
        results = tuple(np.empty((count, *c), F) for c in ((2,), (3,), (), (3,), ()))
        run_slices(_reduce, count, lists.order, lists.room, self.opacity, gradient, *results)
        return results

    def usage(self) -> tuple[np.ndarray, np.ndarray]:
        """(M,) int32 number of pixels in which the splat has the largest T alpha, and (M,) float32 sum of its T alpha over
        pixels."""
        return usage(self.lists, self.used, self.table, self.alpha_max, self.size)
