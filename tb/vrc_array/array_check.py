"""Compares the array's pixels with the golden renderer's, bit by bit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.msv2_ref.array import Pixels, render_tiles
from golden.msv2_ref.regions import region_of
from spec.config import AcceleratorConfig
from tb.common.player import Recording, Run
from tb.vrc_array.array_device import background_bits, rows_per_tile, tiles_from_rows
from tb.vrc_array.array_stimuli import Case

_SHOWN = 5


@dataclass(frozen=True)
class Mismatch:
    """A pixel value in which RTL and golden renderer differ. `tile` counts headers; x and y are inside the tile."""

    field: str
    tile: int
    x: int
    y: int
    rtl: tuple[int, ...]
    golden: tuple[int, ...]

    def __str__(self) -> str:
        return f"tile {self.tile} pixel ({self.x}, {self.y}): {self.field} is {self.rtl}, golden {self.golden}"


def run_of(config: AcceleratorConfig, case: Case, name: str | None = None, **options: object) -> Run:
    """The run that plays a case; `options` are those of `Run`."""
    return Run(
        name or case.name, {"tiles": case.headers, "entries": case.entries},
        {"pixels": len(case.headers) * rows_per_tile(config)},
        {"background": background_bits(config, case.background)}, **options)


def golden_pixels(config: AcceleratorConfig, case: Case) -> Pixels:
    """The golden renderer's pixels of a case."""
    return render_tiles(config, case.headers, case.entries, case.background)


def mismatches(rtl: Pixels, golden: Pixels) -> list[Mismatch]:
    """Every value in which the pixels differ, in the order of tiles."""
    found = []
    for name, got, expected in zip(Pixels._fields, rtl, golden, strict=True):
        got, expected = (np.asarray(a).reshape(*np.shape(a)[:3], -1) for a in (got, expected))
        for tile, y, x in np.argwhere((got != expected).any(axis=-1)).tolist():
            values = (tuple(int(v) for v in a[tile, y, x]) for a in (got, expected))
            found.append(Mismatch(name, tile, x, y, *values))
    return sorted(found, key=lambda m: (m.tile, m.y, m.x))


def problems(
    config: AcceleratorConfig, case: Case, recording: Recording, golden: Pixels, quarter: int = 0,
) -> list[str]:
    """Descriptions of everything that is wrong with a recording of a case; empty when every bit and every rule is right. The
    array of a stream renders this quarter of the tiles."""
    found = list(recording.errors)
    try:
        pixels = tiles_from_rows(config, case.headers, recording.outputs["pixels"], quarter)
    except ValueError as error:
        return [*found, str(error)]
    part = region_of(config, quarter)
    wrong = mismatches(pixels, Pixels(*(values[:, *part] for values in golden)))
    found += [str(m) for m in wrong[:_SHOWN]]
    if len(wrong) > _SHOWN:
        found.append(f"and {len(wrong) - _SHOWN} more values")
    return found
