"""Which splat contributes most to a pixel, from the golden lists of the pixel's tile, and where else that splat is drawn.

The weights follow docs/array.md with the golden frame's own values, but in float64: they rank splats and are no pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.msv2_ref.pipeline import Frame
from spec import tables
from spec.constants import TILE


@dataclass(frozen=True)
class Found:
    """The splat that contributes most to a pixel.

    Attributes:
        pixel: column and row.
        index: row of the splat in the model.
        weight: its share of the pixel, 0..1.
        contributors: the number of splats that contribute to the pixel.
        place: its place in the tile's list, from 0; count: the list's length.
        level: level of the pixel's tile, from 0; blend: whether the tile blends two levels.
        bound: the highest level that uses the splat, from 0.
        mean: (2,) its centre in pixels; depth: z in world units.
        position: (3,) world position; scale: (3,) standard deviations in world units.
        opacity: (levels,) amplified opacity of each level; colour: (levels, 3) colour of each level.
        record: the raw numbers of its record as the array reads it in this tile.
        tiles: (n, 2) column and row of every tile on whose list it stands.
        tiles_x: number of tiles in a row of the frame.
    """

    pixel: tuple[int, int]
    index: int
    weight: float
    contributors: int
    place: int
    count: int
    level: int
    blend: bool
    bound: int
    mean: np.ndarray
    depth: float
    position: np.ndarray
    scale: np.ndarray
    opacity: np.ndarray
    colour: np.ndarray
    record: dict[str, object]
    tiles: np.ndarray
    tiles_x: int

    def markdown(self) -> str:
        """The record as the viewer shows it."""
        def numbers(values: np.ndarray, digits: int = 4) -> str:
            return ", ".join(f"{value:.{digits}g}" for value in np.atleast_1d(values))

        shown = ", ".join(f"{x},{y}" for x, y in self.tiles[:12]) + (" …" if len(self.tiles) > 12 else "")
        fields = "\n".join(f"| {name} | {np.asarray(value).tolist()} |" for name, value in self.record.items())
        return (
            f"**Splat {self.index:,}** has {self.weight:.1%} of pixel {self.pixel[0]}, {self.pixel[1]}, "
            f"the most of {self.contributors:,} splats. It is number {self.place + 1:,} of {self.count:,} on the tile's list; "
            f"the tile has level {self.level + 1}{' and blends it with the next' if self.blend else ''}.\n\n"
            f"On the lists of **{len(self.tiles):,} tiles**: {shown}\n\n"
            f"| property | value |\n|---|---|\n| position | {numbers(self.position)} |\n| standard deviations | "
            f"{numbers(self.scale)} |\n| depth | {self.depth:.4g} |\n| centre, pixels | {numbers(self.mean, 6)} |\n"
            f"| highest level | {self.bound + 1} |\n| opacity by level | {numbers(self.opacity)} |\n"
            f"| colour of the tile's level | {numbers(self.colour[min(self.level, len(self.colour) - 1)], 3)} |\n\n"
            f"| record, raw | value |\n|---|---|\n{fields}\n")


def weights(frame: Frame, x: int, y: int) -> tuple[np.ndarray, np.ndarray]:
    """(splats, shares) of a pixel: rows in the model of the tile's list, in order, and the share of each in the pixel.

    Args:
        frame: a golden frame.
        x, y: the pixel.
    """
    n, r = frame.config.formats, frame.registers
    tile = y // TILE * r.tiles_x + x // TILE
    begin, end = frame.entries.start[tile : tile + 2]
    rows, use, s = frame.entries.splat[begin:end], frame.entries.use[begin:end], frame.splats
    level, blend, outer = r.header[tile]
    factor = np.ldexp(s.conic[rows].astype(np.float64), s.conic_exp[rows] - n.conic.sig_bits + 1)
    dx, dy = (np.array([[x, y]]) + 0.5 - n.mean2d.to_float(s.mean2d[rows])).T
    falloff = (factor[:, 0] * dx + factor[:, 1] * dy) ** 2 + (factor[:, 2] * dy) ** 2
    share = _bank(frame, rows, use & 1 != 0, falloff, int(level), bool(outer))
    if blend:
        plane = n.plane.to_float(r.plane[tile])
        t = np.clip(plane[0] + x % TILE * plane[1] + y % TILE * plane[2], 0, 1)
        second = t * t * (3 - 2 * t)
        share = (1 - second) * share + second * _bank(frame, rows, use & 2 != 0, falloff, int(level) + 1, True)
    return rows, share


def _bank(frame: Frame, rows: np.ndarray, used: np.ndarray, falloff: np.ndarray, level: int, outer: bool) -> np.ndarray:
    """The share of every splat in a pixel of one level."""
    n, opacity = frame.config.formats, frame.splats.log2_opacity[rows, level]
    support = tables.support_exponent(frame.config)
    lowest = np.full(len(rows), tables.log2_alpha_min(n)) if support is None else np.maximum(
        opacity - support, tables.log2_alpha_min(n))
    exponent = n.log2_opacity.to_float(opacity) - falloff
    alpha = np.exp2(np.minimum(exponent, 0.0))
    alpha = alpha if outer else np.minimum(alpha, n.alpha.to_float(tables.alpha_max_l1(n)))
    alpha = np.where(used & (exponent >= n.cut.to_float(lowest)), alpha, 0.0)
    before = np.concatenate(([1.0], np.cumprod(1 - alpha)[:-1])) if len(rows) else np.empty(0)
    return np.where(before >= n.transmittance.to_float(tables.t_stop(n)), before * alpha, 0.0)


def find(frame: Frame, x: int, y: int) -> Found | None:
    """The splat with the largest share of a pixel; None where no splat reaches it.

    Args:
        frame: a golden frame.
        x, y: the pixel; places beyond the frame's edges are moved to them.
    """
    r, n = frame.registers, frame.config.formats
    x, y = min(max(x, 0), r.width - 1), min(max(y, 0), r.height - 1)
    rows, share = weights(frame, x, y)
    if not len(rows) or share.max() <= 0:
        return None
    place, tile = int(np.argmax(share)), y // TILE * r.tiles_x + x // TILE
    index, entry = int(rows[place]), int(frame.entries.start[tile]) + place
    level, blend, _ = (int(value) for value in r.header[tile])
    on = np.searchsorted(frame.entries.start, np.flatnonzero(frame.entries.splat == index), side="right") - 1
    geometry, s = frame.words.geometry[index], frame.splats
    both = np.minimum([level, level + 1], s.log2_opacity.shape[1] - 1)
    record = {
        "mean2d": s.mean2d[index], "conic": n.conic.quantise(frame.projected.conic[index]),
        "use": frame.entries.use[entry] >> np.arange(2) & 1, "log2_opacity": s.log2_opacity[index, both],
        "colour": s.colour[index, both].reshape(-1), "depth": s.depth[index]}
    return Found(
        (x, y), int(frame.words.in_model(index)), float(share[place]), int((share > 0).sum()), place, len(rows), level,
        bool(blend),
        int(geometry["bound"]), n.mean2d.to_float(s.mean2d[index]), float(n.depth.to_float(s.depth[index]) * r.depth_far),
        n.position.to_float(geometry["mean"]) + frame.words.origin, n.scale.to_float(geometry["scale"]),
        np.exp2(n.log2_opacity.to_float(s.log2_opacity[index])), n.colour.to_float(s.colour[index]), record,
        np.stack([on % r.tiles_x, on // r.tiles_x], axis=1), r.tiles_x)
