"""Frames for the rendering array: corner cases by hand, and random frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from spec import tables
from spec.config import AcceleratorConfig
from spec.constants import AMP_MAX, EXPONENT_SCALE, LOW_PASS, TILE
from spec.records import array_splat, tile_header


@dataclass(frozen=True)
class Case:
    """The input of one frame, as `golden.msv2_ref.array.render_tiles` and the RTL take it.

        name: the case's name, for messages.
        headers: (tiles,) TileHeader records.
        entries: (sum of counts,) ArraySplat records.
        background: (3,) raw values in the format `colour`.
        background: (3,) raw `colour`.
    """

    name: str
    headers: np.ndarray
    entries: np.ndarray
    background: np.ndarray


@dataclass(frozen=True)
class TileSpec:
    """One tile of a hand-made frame: its entries, and all fields of its header except the count."""

    entries: np.ndarray
    x: int = 3
    y: int = 2
    outer: int = 0
    blend: int = 0
    plane: tuple[int, int, int] = (0, 0, 0)


def frame(config: AcceleratorConfig, name: str, tiles: Sequence[TileSpec], background: Sequence[int] = (77, 300, 511)) -> Case:
    """A case of `tiles`, in order. Blending is turned off on machines of one level."""
    headers = np.zeros(len(tiles), tile_header(config).dtype)
    for row, tile in zip(headers, tiles, strict=True):
        row["tile_x"], row["tile_y"], row["plane"], row["count"] = tile.x, tile.y, tile.plane, len(tile.entries)
        row["outer"], row["blend"] = (tile.outer, tile.blend) if config.levels > 1 else (0, 0)
    entries = np.concatenate([tile.entries for tile in tiles])
    if config.levels == 1:
        entries["use"][:, 1] = 0
    return Case(name, headers, entries, np.array(background, np.int64))


def conic_bits(config: AcceleratorConfig, sigma: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(N, 3) bit patterns of the scaled Cholesky factors of Gaussians with axes `sigma` (N, 2) in pixels, turned by `angle`
    (N,)."""
    c, s = np.cos(angle), np.sin(angle)
    variance = np.asarray(sigma, float) ** 2
    xx = c * c * variance[:, 0] + s * s * variance[:, 1] + LOW_PASS
    yy = s * s * variance[:, 0] + c * c * variance[:, 1] + LOW_PASS
    xy = c * s * (variance[:, 0] - variance[:, 1])
    det = xx * yy - xy * xy
    l1 = np.sqrt(yy / det)
    factors = np.stack([l1, -xy / det / l1, np.sqrt(1 / yy)], 1)
    return config.formats.conic.quantise(EXPONENT_SCALE * factors).astype(np.int64)


def random_entries(
    config: AcceleratorConfig, rng: np.random.Generator, count: int, x: int, y: int, reach: float = 24.0,
) -> np.ndarray:
    """`count` plausible entries around tile (x, y): sizes from needles to giants, opacities from invisible to saturated.

    Most means lie around the tile's centre, at distances of the order of `reach` pixels plus the splat's size; one in sixteen
    lies anywhere.
    """
    n = config.formats
    entries = np.zeros(count, array_splat(config).dtype)
    sigma = np.exp(rng.uniform(np.log(0.05), np.log(200), (count, 2)))
    centre = np.array([x, y]) * TILE + TILE / 2
    mean = centre + rng.normal(size=(count, 2)) * (reach / 2 + sigma.min(axis=1, keepdims=True))
    anywhere = rng.random(count) < 1 / 16
    mean[anywhere] = rng.uniform(-16000, 16000, (anywhere.sum(), 2))
    entries["mean2d"] = n.mean2d.quantise(mean)
    entries["conic"] = conic_bits(config, sigma, rng.uniform(0, np.pi, count))
    entries["use"] = rng.choice([[1, 1], [1, 0], [0, 1], [0, 0]], count, p=[0.6, 0.2, 0.15, 0.05])
    opacity = np.minimum(rng.uniform(-9, 2, (count, 2)), rng.uniform(-4, np.log2(AMP_MAX), (count, 2)))
    entries["log2_opacity"] = n.log2_opacity.quantise(opacity)
    entries["colour"] = rng.integers(0, n.colour.raw_max + 1, (count, 6))
    entries["depth"] = rng.integers(0, n.depth.raw_max + 1, count)
    return entries


def flat_entries(config: AcceleratorConfig, opacity: np.ndarray | Sequence[int], depth: int = 5000) -> np.ndarray:
    """Entries without falloff: in both levels, the exponent of every pixel is the given raw `log2_opacity` (N,)."""
    entries = np.zeros(len(opacity), array_splat(config).dtype)
    entries["use"] = 1
    entries["log2_opacity"] = np.asarray(opacity)[:, None]
    colour = 300 + np.arange(len(opacity))[:, None] * np.array([37, 101, 211, 59, 157, 251])
    entries["colour"] = colour % (config.formats.colour.raw_max + 1)
    entries["depth"] = depth
    return entries


def random_plane(config: AcceleratorConfig, rng: np.random.Generator) -> tuple[int, int, int]:
    """A blend plane whose band is between a few pixels and a few tiles wide and lies near the tile."""
    slope = rng.normal(0, 0.15, 2)
    corner = 0.5 - (slope * rng.uniform(0, TILE, 2)).sum()
    return tuple(config.formats.plane.quantise([corner, *slope]).tolist())


def random_case(config: AcceleratorConfig, name: str, seed: int, tiles: int = 24, mean_count: float = 24) -> Case:
    """A random frame with empty, short and long tiles, with and without blending, at level 1 and beyond."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(tiles):
        x, y = rng.integers(0, 80, 2).tolist()
        count = int(rng.choice([0, 1, 2, rng.geometric(1 / mean_count)], p=[0.1, 0.1, 0.1, 0.7]))
        entries = random_entries(config, rng, count, x, y)
        made.append(TileSpec(entries, x, y, int(rng.integers(2)), int(rng.random() < 0.4), random_plane(config, rng)))
    return frame(config, name, made, rng.integers(0, config.formats.colour.raw_max + 1, 3))


def _empty(config: AcceleratorConfig) -> Case:
    none = flat_entries(config, [])
    kinds = [(0, 0), (1, 0), (0, 1), (1, 1), (0, 0), (0, 0)]
    return frame(config, "empty tiles", [
        TileSpec(none, k, 0, outer, blend, (2048, 100, -100)) for k, (outer, blend) in enumerate(kinds)])


def _single(config: AcceleratorConfig) -> Case:
    return frame(config, "one entry", [TileSpec(flat_entries(config, [-1024]))])


def _singles(config: AcceleratorConfig) -> Case:
    rng = np.random.default_rng(1)
    return frame(config, "one-entry tiles back to back", [
        TileSpec(random_entries(config, rng, 1, k % 9, k // 9), k % 9, k // 9, blend=k % 7 == 3, plane=(1000, 90, 40))
        for k in range(72)])


def _dropped(config: AcceleratorConfig) -> Case:
    """Splats around the limit of the drop test, far beyond it, and at the ends of the coordinate range."""
    n, rng = config.formats, np.random.default_rng(2)
    ring = random_entries(config, rng, 160, 3, 2)
    ring["conic"] = conic_bits(config, np.full((160, 2), 0.01), np.zeros(160))
    angle, radius = rng.uniform(0, 2 * np.pi, 160), np.linspace(14.4, 14.8, 160)  # sqrt(512) / 1.551 = 14.59 px
    ring["mean2d"] = n.mean2d.quantise(np.stack([56 + radius * np.cos(angle), 40 + radius * np.sin(angle)], 1))
    ring["log2_opacity"] = n.log2_opacity.quantise(7)
    far = random_entries(config, rng, 8, 3, 2)
    far["mean2d"] = np.array([[n.mean2d.raw_min, n.mean2d.raw_max], [n.mean2d.raw_max, n.mean2d.raw_min]] * 4)
    nothing_left = [TileSpec(far), TileSpec(far, 1023, 1023), TileSpec(far, 0, 0, blend=1, plane=(4096, 0, 0))]
    return frame(config, "dropped pairs", [TileSpec(ring), *nothing_left, TileSpec(np.concatenate([far, ring[:40], far]))])


def _saturated(config: AcceleratorConfig) -> Case:
    """Amplification of 128 over the whole footprint, in level 1, where alpha stays below 1, and in outer levels."""
    top = config.formats.log2_opacity.quantise(np.log2(AMP_MAX))
    amplified = random_entries(config, np.random.default_rng(3), 60, 3, 2, reach=8)
    amplified["log2_opacity"] = top
    return frame(config, "alpha saturated", [
        TileSpec(amplified, outer=0), TileSpec(amplified, outer=1), TileSpec(flat_entries(config, [top, top]), outer=1),
        TileSpec(flat_entries(config, [top, top, top, top]), outer=0), TileSpec(amplified, blend=1, plane=(2000, 60, -60))])


def _at_the_cut(config: AcceleratorConfig) -> Case:
    """Exponents one ulp around the smallest visible one, and footprints that end inside the tile, at that exponent or at the
    support."""
    low, rng = tables.log2_alpha_min(config.formats), np.random.default_rng(4)
    footprints = random_entries(config, rng, 64, 3, 2, reach=8)
    footprints["conic"] = conic_bits(config, np.repeat(np.linspace(0.3, 3, 64)[:, None], 2, 1), np.zeros(64))
    faint, strong = rng.integers(low, low + 3000, (64, 1)), rng.integers(-1400, 0, (64, 1))
    footprints["log2_opacity"] = np.where(np.arange(64)[:, None] % 2, strong, faint)
    return frame(config, "alpha at the cut", [
        *(TileSpec(flat_entries(config, [low + d])) for d in (-1, 0, 1)),
        TileSpec(flat_entries(config, [low - 1, low, low + 1] * 9)),
        *(TileSpec(footprints[k::8], outer=k % 2) for k in range(8))])


def _exponentials(config: AcceleratorConfig) -> Case:
    """Every exponent from below the cut to above 0, which covers the whole table and every shift. Small arrays take every
    seventh."""
    exponents = np.arange(tables.log2_alpha_min(config.formats) - 2, 3, 1 if config.blocks == 1 else 7)
    tiles = len(exponents) // 8  # a tile has one of each octave, the largest last: its transmittance never gets too small
    return frame(config, "every exponent", [
        TileSpec(flat_entries(config, exponents[k::tiles]), outer=k % 2) for k in range(tiles)])


def _opaque(config: AcceleratorConfig) -> Case:
    """Early stop caused by one opaque splat, by several, and by a transmittance one ulp around the limit; more splats
    follow."""
    n = config.formats
    tail = random_entries(config, np.random.default_rng(5), 40, 3, 2)
    tail["log2_opacity"] = n.log2_opacity.quantise(-0.5)
    capped = flat_entries(config, [n.log2_opacity.raw_max] * 3)  # 0.01^2 is above the limit and 0.01^3 below it
    thin = flat_entries(config, [-8] * 60)
    tiles = [TileSpec(np.concatenate([flat_entries(config, [0] * k), tail]), outer=1) for k in (1, 2)]
    tiles += [TileSpec(np.concatenate([capped[:k], tail])) for k in (1, 2, 3)]
    tiles += [TileSpec(np.concatenate([capped[:2], thin[:k], tail])) for k in (1, 20, 60)]
    fading = np.random.default_rng(10).integers(-3000, -300, (12, 60))  # small steps through the smallest transmittances
    tiles += [TileSpec(flat_entries(config, steps)) for steps in fading]
    tiles += [TileSpec(np.concatenate([flat_entries(config, [0]), tail]), blend=1, plane=(1000, 100, 50))]
    return frame(config, "early stop", tiles)


def _blended(config: AcceleratorConfig) -> Case:
    """Every combination of `use`, with planes below, inside, above and across the band, and at the limits of their format."""
    n, rng = config.formats, np.random.default_rng(6)
    one, ends = 1 << n.plane.frac_bits, (n.plane.raw_min, n.plane.raw_max)
    planes = [(0, 0, 0), (-1, 0, 0), (one - 1, 0, 0), (one, 0, 0), (one + 1, 0, 0), (one // 2, 0, 0), (0, one // 15, 0)]
    planes += [(0, 0, one // 15), (one // 2, -300, 280), (ends[0], ends[1], ends[1]), (ends[1], ends[0], ends[1])]
    planes += [(ends[1],) * 3, (ends[0],) * 3, (ends[0], ends[1], 0), (ends[0], 0, ends[1])]
    tiles = []
    for k, plane in enumerate(planes):
        entries = random_entries(config, rng, 12, 3, 2)
        entries["use"] = [(k & 1, k >> 1 & 1), (1, 1), (k >> 1 & 1, k & 1)] * 4
        tiles.append(TileSpec(entries, outer=k % 2, blend=1, plane=plane))
    tiles += [TileSpec(random_entries(config, rng, 5, 3, 2), outer=1, blend=k % 2, plane=(2222, 33, 44)) for k in range(6)]
    return frame(config, "level blending", tiles)


def _unused(config: AcceleratorConfig) -> Case:
    """Tiles in which no entry is used by any level, or every entry only by the other level."""
    entries = random_entries(config, np.random.default_rng(7), 20, 3, 2)
    tiles = []
    for use in ((0, 0), (0, 1), (1, 0)):
        for blend in (0, 1):
            entries = entries.copy()
            entries["use"] = use
            tiles.append(TileSpec(entries, blend=blend, plane=(1500, 80, 80)))
    return frame(config, "unused entries", tiles)


def _long(config: AcceleratorConfig) -> Case:
    entries = random_entries(config, np.random.default_rng(8), 3000, 3, 2)
    entries["log2_opacity"] = np.minimum(entries["log2_opacity"], config.formats.log2_opacity.quantise(-7))
    short = entries[:3]
    return frame(config, "3000 entries in a tile", [TileSpec(short), TileSpec(entries), TileSpec(short)])


def _extremes(config: AcceleratorConfig) -> Case:
    """The steepest and the flattest polynomials at the largest distances, and the largest colours and depths."""
    n, rng = config.formats, np.random.default_rng(9)
    count = 192
    entries = random_entries(config, rng, count, 3, 2)
    sigma = np.stack([np.full(count, 0.001), np.geomspace(0.001, 1e6, count)], 1)
    angle = rng.choice(np.arange(8) * np.pi / 8, count) + rng.normal(0, 1e-3, count)
    entries["conic"] = conic_bits(config, sigma, angle)
    direction = np.stack([-np.sin(angle), np.cos(angle)], 1)
    entries["mean2d"] = n.mean2d.quantise([56, 40] + rng.uniform(-14, 14, (count, 1)) * direction)
    entries["log2_opacity"] = rng.choice([n.log2_opacity.quantise(7), n.log2_opacity.raw_min, -600, -2000], (count, 1))
    white = flat_entries(config, [-3000] * 40 + [0], depth=n.depth.raw_max)
    white["colour"] = n.colour.raw_max
    tiles = [TileSpec(entries[k::16], outer=k % 2) for k in range(16)]
    tiles += [TileSpec(white, outer=1), TileSpec(white)]
    return frame(config, "extremes", tiles, (n.colour.raw_max,) * 3)


CORNERS: tuple[Callable[[AcceleratorConfig], Case], ...] = (
    _empty, _single, _singles, _dropped, _saturated, _at_the_cut, _exponentials, _opaque, _blended, _unused, _long, _extremes)
"""Functions that make the hand-made cases."""
