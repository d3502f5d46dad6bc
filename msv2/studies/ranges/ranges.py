"""The ranges of values in the records of real frames: the least and the largest value, how often a value lies at the limit of
its format, and how many bits are to spare.

The word lengths of the formats are based on these ranges. Values at the limit include those that saturated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from golden.msv2_ref import array_kernel
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.projection import projected_splats
from golden.msv2_ref.tile_merge import tile_groups
from msv2.studies import page
from msv2.studies.picture import find_pyplot, save_figure
from spec.constants import TILE
from spec.formats import Fixed, Format
from spec.records import (
    Record,
    array_splat,
    gaussian_colour,
    gaussian_geometry,
    pixel_op,
    pixel_row,
    projected_splat,
    tile_group,
    tile_header,
)

LEFT_OUT = {"end", "last", "empty", "use", "bank", "outer", "first", "drain", "blend", "bound", "row", "column"}
"""Flags, of which every value is used."""


@dataclass
class Profile:
    """The values of a field over all frames.

    Attributes:
        record, field: the names of the record and of the field.
        format: its number format.
        count: the number of values.
        low, high: the least and the largest value.
        smallest: the least magnitude other than 0.
        at_low, at_high: how many values lie at the format's least and largest value; for floats `at_high` counts both signs.
        zeros: how many values are 0.
    """

    record: str
    field: str
    format: Format
    count: int = 0
    low: float = np.inf
    high: float = -np.inf
    smallest: float = np.inf
    at_low: int = 0
    at_high: int = 0
    zeros: int = 0

    def add(self, values: np.ndarray) -> None:
        """Adds values, given as real numbers."""
        values = np.asarray(values, np.float64).ravel()
        if not len(values):
            return
        fixed = isinstance(self.format, Fixed)
        least, most = (float(self.format.to_float(raw)) for raw in (self.format.raw_min, self.format.raw_max)) if fixed else (
            -self.format.max, self.format.max)
        self.count += len(values)
        self.low, self.high = min(self.low, float(values.min())), max(self.high, float(values.max()))
        magnitude = np.abs(values[values != 0])
        self.smallest = min(self.smallest, float(magnitude.min())) if len(magnitude) else self.smallest
        self.at_low += int((values <= least).sum()) if fixed and self.format.signed else 0
        self.at_high += int((values >= most).sum()) + (0 if fixed else int((values <= least).sum()))
        self.zeros += int((values == 0).sum())

    @property
    def margin(self) -> float:
        """Bits to spare at the top: log2 of the ratio of the format's largest magnitude to the largest value; infinite if all
        are 0."""
        largest = max(abs(self.low), abs(self.high))
        most = float(self.format.to_float(self.format.raw_max)) if isinstance(self.format, Fixed) else self.format.max
        return max(float(np.log2(most / largest)), 0.0) if largest else np.inf  # -1 is beyond 1 less an ulp

    @property
    def margin_below(self) -> float | None:
        """For floats, the octaves between the format's smallest number and the smallest magnitude; None otherwise."""
        if isinstance(self.format, Fixed) or not np.isfinite(self.smallest):
            return None
        return float(np.log2(self.smallest / self.format.min))

    @property
    def row(self) -> dict[str, object]:
        """The profile as a JSON-ready row."""
        return {"record": self.record, "field": self.field, "format": str(self.format), "bits": self.format.width,
                "count": self.count, "min": self.low, "max": self.high, "at_min": self.at_low, "at_max": self.at_high,
                "zeros": self.zeros, "margin_bits": self.margin, "margin_below_octaves": self.margin_below}


Profiles = dict[tuple[str, str], Profile]


def _add_rows(profiles: Profiles, record: Record, rows: np.ndarray) -> None:
    """Adds the fields of records that are given in the record's dtype."""
    for f in record.fields:
        if f.name not in LEFT_OUT:
            raw = rows[f.name]
            values = f.format.to_float(raw if isinstance(f.format, Fixed) else raw.astype(np.uint64))
            profiles.setdefault((record.name, f.name), Profile(record.name, f.name, f.format)).add(values)


def _pairs(frame: Frame) -> Iterator[tuple[np.ndarray, int]]:
    """Blocks of intersections as the array sets them up, (rows, columns), each with the number of those that it drops."""
    k, e, s = array_kernel.array_constants(frame.config), frame.entries, frame.splats
    rows, block = array_kernel._PAIR_ROWS, array_kernel._BLOCK
    pairs = np.ones(rows * block)
    for tile in np.flatnonzero(np.diff(e.start)).tolist():
        tile_y, tile_x = divmod(tile, frame.registers.tiles_x)
        level = int(frame.registers.header[tile, 0])
        centre = (TILE // 2 << k.mean_frac) + (1 << (k.mean_frac - 1))
        order, use = (part[e.start[tile] : e.start[tile + 1]] for part in (e.splat, e.use))
        taken = 0
        while taken < len(order):
            count, taken = array_kernel._gather(pairs, s, order, use, 0, taken, level, (TILE * tile_x << k.mean_frac) + centre,
                                                (TILE * tile_y << k.mean_frac) + centre, k)
            array_kernel._set_up(pairs, k)
            table = pairs.reshape(rows, block)[:, :count]
            yield table, int((table[array_kernel._FIRST // block] == TILE).sum())


def _add_ops(profiles: Profiles, frame: Frame) -> int:
    """Adds the setup unit's operations for a frame, at the tiles' own levels. Returns the number of intersections that it
    drops."""
    k, record, block = array_kernel.array_constants(frame.config), pixel_op(frame.config), array_kernel._BLOCK
    places = {"slope_x": array_kernel._SLOPE_X, "slope_y": array_kernel._SLOPE_Y, "curve_xx": array_kernel._XX,
              "curve_xy": array_kernel._XY, "curve_yy": array_kernel._YY, "cut": array_kernel._CUT}
    dropped, gathered = 0, {name: [] for name in (*places, "exponent")}
    for table, gone in _pairs(frame):
        dropped += gone
        kept = table[:, table[array_kernel._FIRST // block] < TILE]
        for name, place in places.items():
            gathered[name].append(kept[place // block].copy())
        exponent = kept[array_kernel._CORNER // block] + np.ldexp(kept[array_kernel._OPACITY // block], k.grid - k.opacity_frac)
        gathered["exponent"].append(exponent + (1 << (k.grid - k.cut_frac) >> 1))
    for f in record.fields:
        if gathered.get(f.name):
            values = f.format.to_float(np.concatenate(gathered[f.name]).astype(np.int64))
            profiles.setdefault((record.name, f.name), Profile(record.name, f.name, f.format)).add(values)
    return dropped


def profile(frame: Frame, profiles: Profiles) -> dict[str, int]:
    """Adds the values of a frame. Returns how many values were clipped when the model was quantised, and how many intersections
    the setup unit drops."""
    config, words = frame.config, frame.words
    counts = np.diff(frame.entries.start)
    _add_rows(profiles, gaussian_geometry(config), words.geometry)
    _add_rows(profiles, gaussian_colour(config, words.sh_degree), words.colour)
    _add_rows(profiles, projected_splat(config), projected_splats(config, words, frame.registers)[:-1])
    _add_rows(profiles, tile_group(config), tile_groups(config, counts, frame.registers.tiles_x, None))
    _add_rows(profiles, tile_header(config), frame.headers)
    _add_rows(profiles, array_splat(config), frame.array_entries)
    dropped = _add_ops(profiles, frame)
    row = pixel_row(config)
    for f in row.fields:
        if hasattr(frame.pixels, f.name):
            values = f.format.to_float(frame.untiled(getattr(frame.pixels, f.name)))
            profiles.setdefault((row.name, f.name), Profile(row.name, f.name, f.format)).add(values)
    return {**{f"model {name}": count for name, count in words.saturated.items()}, "pairs dropped in setup": dropped}


def markdown(profiles: Profiles, scenes: dict[str, dict[str, int]]) -> str:
    """The content of ranges.md."""
    rows = []
    for p in profiles.values():
        below = "" if p.margin_below is None else f"{p.margin_below:.1f}"
        margin = "all 0" if np.isinf(p.margin) else f"{p.margin:.1f}"
        rows.append([p.record, f"`{p.field}`", p.format, f"{p.low:.6g}", f"{p.high:.6g}", _share(p.at_low, p.count),
                     _share(p.at_high, p.count), margin, below])
    names = list(dict.fromkeys(name for counts in scenes.values() for name in counts))
    clipped = [[scene, *(counts.get(name, 0) for name in names)] for scene, counts in scenes.items()]
    head = ("record", "field", "format", "least", "largest", "at the least", "at the largest", "bits to spare", "octaves below")
    return "\n\n".join([
        "# Ranges", "Written by `msv2 study run ranges --keep`, explained in [docs/stability.md](../docs/stability.md). "
        "All scenes together.", page.table(head, rows), "Clipped on the way in, and pairs dropped:",
        page.table(["scene", *names], clipped)])


def _share(part: int, count: int) -> str:
    return "0" if not part else f"{part} ({100 * part / count:.2g} %)"


SHOWN_BITS = 16
"""Largest number of bits to spare that a bar of the picture shows."""


def picture(fields: Sequence[Mapping[str, object]], path: Path) -> bool:
    """Draws the bits to spare of each field, with dots where values lie at the format's limit. Returns False without
    matplotlib."""
    pyplot = find_pyplot()
    if pyplot is None:
        return False
    shown = [f for f in fields if f["margin_bits"] is not None]
    places = range(len(shown))
    figure, axes = pyplot.subplots(figsize=(8, 0.17 * len(shown) + 1))
    axes.barh(places, [min(f["margin_bits"], SHOWN_BITS) for f in shown], color="#49708a", height=0.7)
    for place, f in zip(places, shown, strict=True):
        if f["margin_bits"] > SHOWN_BITS:
            axes.text(SHOWN_BITS, place, f" {f['margin_bits']:.0f}", fontsize=6, va="center")
        if f["at_min"] + f["at_max"]:
            axes.plot(0, place, "o", color="#c8402f", markersize=5, clip_on=False)
            share = 100 * (f["at_min"] + f["at_max"]) / f["count"]
            axes.text(0.3, place, f"{share:.2g} % at the limit", fontsize=6, va="center", color="#c8402f")
    axes.set_yticks(places, [f"{f['record']}.{f['field']}  {f['format']}" for f in shown], fontsize=6)
    axes.invert_yaxis()
    axes.set_xlabel("bits to spare above the largest value seen", fontsize=8)
    axes.tick_params(axis="x", labelsize=7)
    axes.margins(y=0.01)
    axes.grid(axis="x", linewidth=0.4)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    save_figure(figure, path, bbox_inches="tight")
    return True
