"""The page docs/tile_size.md."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from msv2.studies.memory import IDEAL, LPDDR3, MEMORY_NAMES
from msv2.studies.page import table
from msv2.studies.tile_size.measure import ARRAYS, SIZES
from spec.constants import TILE

Row = Mapping[str, Any]

_HEAD = """# Why a tile has 16 pixels, and an array at most 16x16 cores

Written by `msv2 study run tile_size --keep`. All frames are 640x360 with the gaze in the centre and four levels, on the
resources of `paper`: a Gaussian a cycle, an intersection a cycle through the sorter, 25.6 bytes of memory a cycle, a splat
cache of 2,048 lines.

{verdict}

## What is measured and what is modelled

- *Intersections* are counted with the float64 renderer's exact tile test, which takes tiles of any size. At 16 pixels the
  integer renderer, whose pixels equal the hardware's, counts {golden}.
- *Cycles* are bounds: the busiest unit of the geometry phase and that of the rendering phase, without waiting and without early
  termination, with an ideal memory. At 16 pixels the cycle model, which is within 0.05 % of the RTL, gives {model} of the bound
  with that memory. With LPDDR3, whose rows must be opened, it gives {lpddr3}.
- *Area* at 16 nm: the array of 16x16 cores is synthesised, that of 8x8 cores is an estimate from its cells, and the others are
  modelled: they have as many cores as they are named for, and each core holds the sums of the pixels that it renders.
"""

_LISTS = """A list that is longer than the sorter's chunk of 4,096 intersections is written to memory and merged. Comparisons
are those of sorting each tile's list by itself. The last column counts splat records that the splat cache did not hold."""

_ARRAYS = """*Utilisation* is the share of core cycles in which the core's pixel lies in the splat's footprint. An array that is
smaller than the tile takes an operation for each of its blocks, whether the splat touches the block or not. *Bound* names the
busiest unit of the rendering phase."""

_AREAS = """The machine holds three words for each tile of the largest frame, which is 1,920 pixels wide and high: the count of
its intersections, and two words that say where its list goes on. With tiles of 8 pixels these memories alone are larger than
the array."""

_WHY = """A tile's size is no parameter (`spec.constants.TILE`), because number formats rest on it. The array adds up first and
second differences of the falloff over a tile. The ranges and fraction bits of `offset`, `exponent`, `slope` and `curvature`
were derived for 16 steps ([array.md](array.md)); over 32 steps an error of the second difference grows four times as large, so
these formats would need more bits in every core. An array that is larger than a tile would have cores without pixels. Therefore
`cores_x` and `cores_y` are at most 16 and divide 16."""


def page(content: Row) -> str:
    """The page as Markdown."""
    rows, areas = content["frames"], content["areas"]
    return "\n\n".join(part.strip() for part in (
        _HEAD.format(verdict=_verdict(rows, areas), golden=_golden(rows), model=_model(rows, IDEAL),
                     lpddr3=_model(rows, LPDDR3)),
        "## Intersections and sorting", _lists(rows), _LISTS, "## The array", _arrays(rows), _ARRAYS, "## Area", _areas(areas),
        _AREAS, "## Why the configuration cannot change it", _WHY)) + "\n"


def _mean(values: Sequence[float]) -> float:
    """Geometric mean."""
    return float(np.exp(np.mean(np.log(values))))


def _of(row: Row, tile: int, cores: int) -> Row:
    return next(array for array in row["arrays"] if (array["tile"], array["cores"]) == (tile, cores))


def _size(row: Row, tile: int) -> Row:
    return next(size for size in row["sizes"] if size["tile"] == tile)


def _cycles(rows: Sequence[Row], tile: int, cores: int) -> float:
    """Cycles of a frame relative to those with 16x16 cores; the geometric mean over the frames."""
    return _mean([_of(row, tile, cores)["cycles"] / _of(row, TILE, TILE)["cycles"] for row in rows])


def _verdict(rows: Sequence[Row], areas: Sequence[Row]) -> str:
    counts = {tile: _mean([_size(row, tile)["intersections"] / _size(row, TILE)["intersections"] for row in rows])
              for tile in SIZES}
    mm2 = {(a["tile"], a["cores"]): a["array_mm2"] + a["tile_memory_mm2"] + a["output_mm2"] for a in areas}
    here, faster = mm2[TILE, TILE], 100 * (1 - _cycles(rows, 32, 32))
    return "\n".join((
        f"**Tiles of 8 pixels** make {counts[8]:.1f} times as many intersections to write, to read and to sort. A frame takes",
        f"{_cycles(rows, 8, 8):.2f} times the cycles. The array has a quarter of the cores, but with the memories that hold",
        f"words for each tile it is {mm2[8, 8] / here:.1f} times as large.",
        "",
        f"**Tiles of 32 pixels** make {1 / counts[32]:.1f} times fewer intersections, but most cores idle in each of them.",
        f"With 16x16 cores a frame takes {_cycles(rows, 32, 16):.2f} times the cycles. With 32x32 cores it takes",
        f"{faster:.0f} % fewer cycles, for {mm2[32, 32] / here:.1f} times the area of array and memories. (All ratios are",
        f"geometric means over {len(rows)} scene{'s' if len(rows) > 1 else ''}.)"))


def _range(values: Sequence[float], digits: int) -> str:
    low, high = f"{min(values):.{digits}f}", f"{max(values):.{digits}f}"
    return low if low == high else f"{low} to {high}"


def _golden(rows: Sequence[Row]) -> str:
    return _range([row["golden_intersections"] / _size(row, TILE)["intersections"] for row in rows], 3) + " times as many"


def _model(rows: Sequence[Row], memory: str) -> str:
    shares = [row["model_cycles"][memory][f"{cores}x{cores}"] / _of(row, TILE, cores)["cycles"]
              for row in rows for cores in (8, 16)]
    return _range(shares, 2) + " times the cycles"


def _lists(rows: Sequence[Row]) -> str:
    head = ("frame", "tile", "intersections", "mean of a tile", "largest", "comparisons", "in lists longer than the sorter",
            "records from memory")
    cells = []
    for row in rows:
        for tile in SIZES:
            s = _size(row, tile)
            cells.append((row["scene"], tile, f"{s['intersections']:,}", f"{s['mean']:.0f}", f"{s['largest']:,}",
                          f"{s['comparisons'] / 1e6:.2f} M", f"{s['longer_than_the_sorter']:,}", f"{s['misses']:,}"))
    return table(head, cells, left=1)


def _arrays(rows: Sequence[Row]) -> str:
    head = ("frame", "tile", "cores", "operations", "utilisation", "MB moved", "geometry, cycles", "rendering, cycles", "bound",
            "frame, cycles", *(f"cycle model, {name}" for name in MEMORY_NAMES.values()))
    cells = []
    for row in rows:
        for array in ARRAYS:
            a = _of(row, array.tile, array.cores)
            modelled = [f"{row['model_cycles'][memory][array.name]:,}" if array.expressible else "-" for memory in MEMORY_NAMES]
            cells.append((
                row["scene"], array.tile, array.name, f"{a['operations']:,}", f"{100 * a['utilisation']:.0f} %",
                f"{a['bytes'] / 1e6:.2f}", f"{max(a['geometry'].values()):,}", f"{max(a['drawing'].values()):,}",
                max(a["drawing"], key=a["drawing"].get), f"{a['cycles']:,}", *modelled))
    return table(head, cells, left=1, words=("bound",))


def _areas(areas: Sequence[Row]) -> str:
    head = ("tile", "cores", "array, mm²", "memories with words for each tile, mm²", "output buffer, mm²", "sum, mm²",
            "the array's area is")
    cells = [(a["tile"], f"{a['cores']}x{a['cores']}", f"{a['array_mm2']:.3f}", f"{a['tile_memory_mm2']:.3f}",
              f"{a['output_mm2']:.3f}", f"{a['array_mm2'] + a['tile_memory_mm2'] + a['output_mm2']:.3f}", a["basis"])
             for a in areas]
    return table(head, cells, left=0, words=("the array's area is",))
