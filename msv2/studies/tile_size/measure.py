"""What tiles of 8, 16 and 32 pixels cost on a frame: intersections, work of the units, memory traffic, bounds of cycles."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from golden.msv2_ref.fetch import find_misses
from golden.oracle.project import Splats, project
from golden.oracle.tiles import TileLists, tile_lists
from golden.scenes.gaze import Display, FoveationMap, foveation_map, no_foveation
from golden.scenes.request import Request
from spec.config import PAPER, AcceleratorConfig
from spec.constants import ENTRY_BYTES, TILE
from spec.memory import BEAT_BYTES, DISPLAY_PIXEL_BYTES, DRAM_BYTES_PER_CYCLE, TILE_SETTING_BYTES, colour_beats
from spec.queues import CACHE_WAYS

SIZES = (8, 16, 32)
"""Edges of a tile in pixels."""


@dataclass(frozen=True)
class Array:
    """A way to render tiles of one size.

    Attributes:
        tile: the tile's edge.
        cores: the array's edge. Where it is smaller than the tile, an intersection takes an operation for each block.
    """

    tile: int
    cores: int

    @property
    def blocks(self) -> int:
        return (self.tile // self.cores) ** 2

    @property
    def expressible(self) -> bool:
        """Whether a configuration can have it."""
        return self.tile == TILE and self.cores <= TILE

    @property
    def name(self) -> str:
        return f"{self.cores}x{self.cores}"


ARRAYS = (Array(8, 8), Array(16, 8), Array(16, 16), Array(32, 16), Array(32, 32))
"""The arrays that are compared. The second and the third can be configured and are synthesised; the others are modelled."""


def foveation_of(request: Request, tile: int) -> FoveationMap:
    """Levels and blend flags of the request's gaze for tiles of another size."""
    of = request.foveation
    display = Display(of.display.width_px, of.display.height_px, of.display.fov_deg)
    return no_foveation(display, tile) if of.gaze_xy is None else foveation_map(display, of.gaze_xy, of.levels, tile)


def footprint_pixels(splats: Splats, of: FoveationMap) -> int:
    """The (splat, pixel) pairs whose pixel lies in the splat's footprint, at the levels that the tiles of `of` render."""
    whole = of.display.height_px, of.display.width_px

    def by_pixel(field: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(field.repeat(of.tile, 0).repeat(of.tile, 1)[: whole[0], : whole[1]])

    each = replace(of, tile=1, tile_level=by_pixel(of.tile_level), blend=by_pixel(of.blend), plane=np.zeros((*whole, 3)))
    return int(tile_lists(splats, each).start[-1])


def measured(request: Request, config: AcceleratorConfig = PAPER) -> dict[str, object]:
    """The numbers of a frame, by tile size and by array.

    The lists are those of the float64 renderer's tile test, whose tiles may have any size. Early termination is left out.
    """
    splats, _ = project(request.model, request.camera, config.support_sigma)
    sizes = {}
    for tile in SIZES:
        of = foveation_of(request, tile)
        sizes[tile] = _of_size(tile_lists(splats, of), of, splats, config)
        sizes[tile]["footprint_pixels"] = footprint_pixels(splats, of)
    points = len(request.model)
    survivors = max(size["survivors"] for size in sizes.values())
    arrays = [_of_array(array, sizes[array.tile], points, survivors, request, config) for array in ARRAYS]
    return {"points": points, "sizes": [{"tile": tile, **_numbers(size)} for tile, size in sizes.items()], "arrays": arrays}


def _numbers(size: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in size.items() if not isinstance(value, np.ndarray)}


def _of_size(lists: TileLists, of: FoveationMap, splats: Splats, config: AcceleratorConfig) -> dict[str, object]:
    """Counts of the tiles' lists."""
    counts = np.diff(lists.start)
    index = splats.index[lists.entries].astype(np.int64)
    level = np.repeat(of.tile_level.reshape(-1), counts).astype(np.int64)
    misses = int(find_misses(index, level, config.splat_cache_lines, CACHE_WAYS, False, False).sum())
    filled = counts[counts > 0]
    both = counts * of.blend.reshape(-1)
    return {
        "tiles": len(counts), "filled_tiles": len(filled), "intersections": int(counts.sum()),
        "largest": int(counts.max(initial=0)), "mean": float(filled.mean()) if len(filled) else 0.0,
        "comparisons": float((filled * np.log2(np.maximum(filled, 2))).sum()),
        "longer_than_the_sorter": int(counts[counts > config.sort_chunk].sum()), "misses": misses,
        "survivors": len(np.unique(index)), "operations": counts + both, "blend_intersections": int(both.sum())}


def _of_array(
    array: Array, size: dict[str, object], points: int, survivors: int, request: Request, config: AcceleratorConfig,
) -> dict[str, object]:
    """Bounds of a frame's cycles with an array: the busiest unit of each phase, without waiting."""
    operations = size["operations"] * array.blocks
    rows = array.tile * (array.tile // array.cores)  # a tile's rows leave one a cycle and block column, however few its work is
    drawn = int(np.maximum(operations, rows).sum())
    count, pixels = size["intersections"], request.camera.width * request.camera.height
    spilled = 2 * size["longer_than_the_sorter"] * ENTRY_BYTES
    drawing_bytes = (count * ENTRY_BYTES + spilled + size["misses"] * BEAT_BYTES + pixels * DISPLAY_PIXEL_BYTES
                     + size["tiles"] * TILE_SETTING_BYTES)
    degree = min(request.model.sh_degree, config.sh_degree)
    geometry_bytes = (points + survivors * (colour_beats(config, degree) + 1) + count) * BEAT_BYTES
    geometry = {"points": points * config.point_interval, "colours": survivors * config.colour_interval, "intersections": count,
                "memory": round(geometry_bytes / DRAM_BYTES_PER_CYCLE)}
    drawing = {"sort": count + size["longer_than_the_sorter"], "array": drawn,
               "memory": round(drawing_bytes / DRAM_BYTES_PER_CYCLE)}
    slots = int(operations.sum()) * array.cores**2
    return {
        "tile": array.tile, "cores": array.cores, "operations": int(operations.sum()),
        "utilisation": size["footprint_pixels"] * (1 + size["blend_intersections"] / max(1, count)) / max(1, slots),
        "bytes": geometry_bytes + drawing_bytes, "geometry": geometry, "drawing": drawing,
        "cycles": max(geometry.values()) + max(drawing.values())}
