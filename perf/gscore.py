"""A cycle estimate of a machine like GSCore (Lee et al., ASPLOS 2024), made from its published description, on our frames.

It differs from our machine in these points. A tile's list holds the splats whose oriented bounding box of three standard
deviations meets the tile. There are four culling and conversion units, two sorting units that work on different tiles, and 64
cores. The cores take an 8x8 subtile of a tile at a time, and skip subtiles that the box does not meet (a bitmap comes with each
intersection) or whose pixels have all stopped. There are double buffers between tiles but no cache: a tile's splats are fetched
when it is sorted.

Where the description is silent, the model uses our machine's values: cycles of a culling unit, bytes of every record, the
memory's bandwidth, one intersection per cycle and sorting unit, and levels. GSCore does not know blending tiles, so they are
rendered once for each of their levels.

Where there is doubt, the model favours GSCore: it has no latency of a unit or of memory, no bank conflict and no refresh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from golden.kernels import compiled
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.projection import VISIBLE
from spec.constants import ALPHA_MAX_L1, ALPHA_MIN, ENTRY_BYTES, EXPONENT_SCALE, SUPPORT_SIGMA, T_STOP, TILE
from spec.memory import BEAT_BYTES, DISPLAY_PIXEL_BYTES, DRAM_BYTES_PER_CYCLE, colour_beats

SUBTILE = 8
"""Edge length, in pixels, of the subtile that the cores take at a time."""

POINT_CYCLES = 8
"""Cycles that a culling and conversion unit takes for a point (as `AcceleratorConfig.point_interval` of one unit of ours)."""


@dataclass(frozen=True)
class GscoreConfig:
    """The resources of the machine; the defaults are the published ones.

    Attributes:
        culling_units, sorting_units, cores: the numbers of units.
        bytes_per_cycle: the memory's bandwidth.
    """

    culling_units: float = 4
    sorting_units: float = 2
    cores: float = 64
    bytes_per_cycle: float = DRAM_BYTES_PER_CYCLE

    def scaled(self, factor: float) -> GscoreConfig:
        """The machine with `factor` times the units, for curves over area. Fractions of a unit stand for another speed."""
        if not factor > 0:
            raise ValueError(f"factor must be positive, not {factor!r}")
        return GscoreConfig(self.culling_units * factor, self.sorting_units * factor, self.cores * factor, self.bytes_per_cycle)


class GscoreTrace(NamedTuple):
    """The properties of a frame on which the machine's timing depends.

    Attributes:
        points, survivors, pixels: the frame's numbers of points, of splats with an intersection, and of pixels.
        colour_beats: the beats of a survivor's colour record.
        entries: (passes,) int64: the intersections of each tile; a tile with two levels is two passes.
        subtiles: (passes,) int64: the subtiles that the intersections bring to the cores.
    """

    points: int
    survivors: int
    pixels: int
    colour_beats: int
    entries: np.ndarray
    subtiles: np.ndarray


class GscoreCycles(NamedTuple):
    """The cycles of a frame, and the bytes that it moves."""

    total: int
    geometry: int
    render: int
    dram_bytes: int


@compiled
def _meets(cx, cy, ax, ay, ra, rb, left, right, top, bottom):
    """Whether a box meets a rectangle, by separating axes. The box has the centre (cx, cy) and the half axes ra along (ax, ay)
    and rb across."""
    mx, my, hx, hy = (left + right) / 2 - cx, (top + bottom) / 2 - cy, (right - left) / 2, (bottom - top) / 2
    if abs(mx) > hx + ra * abs(ax) + rb * abs(ay) or abs(my) > hy + ra * abs(ay) + rb * abs(ax):
        return False
    return (abs(mx * ax + my * ay) <= ra + hx * abs(ax) + hy * abs(ay)
            and abs(mx * ay - my * ax) <= rb + hx * abs(ay) + hy * abs(ax))


@compiled
def _list_entries(order, box, shape, width, height, tiles_x, tile_of, splat_of):
    """Writes the (tile, splat) pairs, splat by splat in order, as far as the arrays have free space. Returns how many there
    are."""
    count = 0
    for i in order:
        cx, cy, ax, ay, ra, rb = shape[i]
        for ty in range(box[i, 2], box[i, 3] + 1):
            for tx in range(box[i, 0], box[i, 1] + 1):
                right, bottom = min(TILE * tx + TILE, width), min(TILE * ty + TILE, height)
                if _meets(cx, cy, ax, ay, ra, rb, TILE * tx, right, TILE * ty, bottom):
                    if count < len(tile_of):
                        tile_of[count], splat_of[count] = ty * tiles_x + tx, i
                    count += 1
    return count


@compiled
def _subtiles(splats, tile_x, tile_y, width, height, mean, conic, opacity, alpha_max, shape, light):
    """Number of subtiles that the intersections of a tile bring to the cores, front to back. `light` becomes the
    transmittance."""
    side, work = TILE // SUBTILE, 0
    light[:] = 1.0
    stopped = np.zeros((side, side), np.bool_)
    for sy in range(side):
        for sx in range(side):
            stopped[sy, sx] = TILE * tile_x + SUBTILE * sx >= width or TILE * tile_y + SUBTILE * sy >= height
    for i in splats:
        cx, cy, ax, ay, ra, rb = shape[i]
        for sy in range(side):
            top = TILE * tile_y + SUBTILE * sy
            for sx in range(side):
                left = TILE * tile_x + SUBTILE * sx
                if stopped[sy, sx] or not _meets(cx, cy, ax, ay, ra, rb, left, min(left + SUBTILE, width), top,
                                                 min(top + SUBTILE, height)):
                    continue
                work += 1
                brightest = 0.0
                for y in range(SUBTILE):
                    dy = top + y + 0.5 - mean[i, 1]
                    v = conic[i, 2] * dy
                    for x in range(SUBTILE):
                        dx = left + x + 0.5 - mean[i, 0]
                        u = conic[i, 0] * dx + conic[i, 1] * dy
                        alpha = min(alpha_max, opacity[i] * 2.0 ** -(u * u + v * v))
                        t = light[SUBTILE * sy + y, SUBTILE * sx + x]
                        if alpha >= ALPHA_MIN and t >= T_STOP:
                            t *= 1 - alpha
                            light[SUBTILE * sy + y, SUBTILE * sx + x] = t
                        if left + x < width and top + y < height:
                            brightest = max(brightest, t)
                stopped[sy, sx] = brightest < T_STOP
    return work


@compiled
def _passes(start, splat, header, bound, tiles_x, width, height, mean, conic, opacity, shape, entries, subtiles):
    """Fills `entries` and `subtiles` for the pass of every tile at its own level, and at the next level where the tile blends;
    the second is 0 elsewhere."""
    light = np.empty((TILE, TILE))
    for tile in range(len(header)):
        for bank in range(1 + header[tile, 1]):
            level = header[tile, 0] + bank
            mine = splat[start[tile] : start[tile + 1]]
            mine = mine[bound[mine] >= level]
            entries[tile, bank] = len(mine)
            subtiles[tile, bank] = _subtiles(
                mine, tile % tiles_x, tile // tiles_x, width, height, mean, conic, opacity[:, level],
                ALPHA_MAX_L1 if level == 0 else 1.0, shape, light)


def _boxes(frame: Frame, mean: np.ndarray, conic: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 6) centre, first axis and half axes of the oriented boxes in pixels, and (N, 4) the ranges of tiles that they
    cover."""
    r = frame.registers
    precision = np.zeros((len(conic), 2, 2))
    precision[:, 0, 0], precision[:, 0, 1] = conic[:, 0] ** 2, conic[:, 0] * conic[:, 1]
    precision[:, 1, 0], precision[:, 1, 1] = precision[:, 0, 1], conic[:, 1] ** 2 + conic[:, 2] ** 2
    seen = frame.projected.reason == VISIBLE
    precision[~seen] = np.eye(2)
    value, vector = np.linalg.eigh(precision / EXPONENT_SCALE**2)
    half = SUPPORT_SIGMA / np.sqrt(np.maximum(value, 1e-12))
    axis = vector[:, :, 0]
    shape = np.column_stack([mean, axis, half])
    reach = np.abs(axis) * half[:, :1] + np.abs(axis[:, ::-1]) * half[:, 1:]
    last = np.array([r.tiles_x, r.tiles_y]) - 1
    low = np.clip(np.floor((mean - reach) / TILE), 0, last + 1)
    high = np.clip(np.floor((mean + reach) / TILE), -1, last)
    return shape, np.column_stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]]).astype(np.int64)


def gscore_trace(frame: Frame) -> GscoreTrace:
    """The machine's work for the scene and camera of a golden frame, computed independently in floating point."""
    n, r, words = frame.config.formats, frame.registers, frame.words
    mean = n.mean2d.to_float(frame.projected.mean2d)
    conic = np.ascontiguousarray(frame.projected.conic)
    shape, box = _boxes(frame, mean, conic)
    rows = np.flatnonzero(frame.projected.reason == VISIBLE)
    order = rows[np.argsort(frame.projected.depth_key[rows], kind="stable")]
    tile_of = splat_of = np.empty(0, np.int64)
    room = _list_entries(order, box, shape, r.width, r.height, r.tiles_x, tile_of, splat_of)
    tile_of, splat_of = np.empty(room, np.int64), np.empty(room, np.int64)
    _list_entries(order, box, shape, r.width, r.height, r.tiles_x, tile_of, splat_of)
    by_tile = np.argsort(tile_of, kind="stable")
    start = np.searchsorted(tile_of[by_tile], np.arange(len(r.header) + 1))
    opacity = 2.0 ** n.log2_opacity.to_float(words.geometry["log2_opacity"])
    entries, subtiles = np.zeros((len(r.header), 2), np.int64), np.zeros((len(r.header), 2), np.int64)
    _passes(start, splat_of[by_tile], r.header, words.geometry["bound"].astype(np.int64), r.tiles_x, r.width, r.height, mean,
            conic, opacity, shape, entries, subtiles)
    there = (np.arange(2) <= r.header[:, 1:2]).reshape(-1)
    return GscoreTrace(
        len(words.geometry), len(np.unique(splat_of)), r.width * r.height, colour_beats(frame.config, words.sh_degree),
        entries.reshape(-1)[there], subtiles.reshape(-1)[there])


@compiled
def _pipeline(fetch, sort, render, units):
    """The end of the last pass. Fetching, `units` sorting units and the cores work in a pipeline with two buffers between
    each."""
    n = len(fetch)
    fetched, sorted_, done = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        free = sorted_[i - 1 - units] if i > units else 0.0  # there is a buffer for each unit, and one to fill besides
        fetched[i] = max(fetched[i - 1] if i else 0.0, free) + fetch[i]
        unit = sorted_[i - units] if i >= units else 0.0
        out = done[i - 2] if i > 1 else 0.0
        sorted_[i] = max(fetched[i], unit, out) + sort[i]
        done[i] = max(sorted_[i], done[i - 1] if i else 0.0) + render[i]
    return done[n - 1] if n else 0.0


def gscore_cycles(trace: GscoreTrace, config: GscoreConfig | None = None) -> GscoreCycles:
    """Cycles of a frame. The geometry phase takes as long as the busier of units and memory; then the tiles pass the
    pipeline."""
    c = config or GscoreConfig()
    entries = int(trace.entries.sum())
    per_survivor = (trace.colour_beats + 1) * BEAT_BYTES  # its colour record is read and its splat record written
    geometry_bytes = trace.points * BEAT_BYTES + trace.survivors * per_survivor + entries * ENTRY_BYTES
    geometry = max(trace.points * POINT_CYCLES / c.culling_units, geometry_bytes / c.bytes_per_cycle)
    units = max(1, round(c.sorting_units))
    fetched = trace.entries * float(ENTRY_BYTES + BEAT_BYTES)
    written = trace.pixels * DISPLAY_PIXEL_BYTES / max(1, len(trace.entries))  # the share of a pass
    render = _pipeline((fetched + written) / c.bytes_per_cycle, trace.entries * (units / c.sorting_units),
                       trace.subtiles * (SUBTILE**2 / c.cores), units)
    moved = geometry_bytes + int(fetched.sum()) + trace.pixels * DISPLAY_PIXEL_BYTES
    return GscoreCycles(round(geometry + render), round(geometry), round(render), moved)
