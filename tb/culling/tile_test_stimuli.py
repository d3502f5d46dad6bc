"""Stimuli of the tile test: frames of projected splats, and the levels of tiles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.projection import VISIBLE
from golden.msv2_ref.tile_test import TileTest, tile_test
from spec.config import AcceleratorConfig
from spec.constants import EXPONENT_SCALE, LOW_PASS, MAX_LEVELS, TILE
from spec.queues import LEVEL_GROUP
from spec.records import INDEX_BITS, opacities_carried, projected_splat, tile_level
from spec.tables import log2_alpha_min

SHAPES = ("dots", "discs", "needles", "giants", "extremes")
"""The kinds of footprints."""

LEVELS = ("one", "rings", "alternating", "random", "stretches")
"""The kinds of level tables."""


class Cost(NamedTuple):
    """The work of a frame.

    Attributes:
        runs: the runs of tiles that the unit tests.
        emitting: the runs that give intersections.
        entries: the intersections, without the `end` item.
    """

    runs: int
    emitting: int
    entries: int

    @property
    def steps(self) -> int:
        """Cycles of the last stage: one per intersection, and one per run that gives none."""
        return self.entries + self.runs - self.emitting


@dataclass(frozen=True)
class Case:
    """Consecutive frames of one size.

    Attributes:
        name: the case's name, for messages.
        config: the machine's configuration.
        width, height: the frame's size in pixels.
        frames: for each frame its ProjectedSplat records without `end`, and (tiles, 2) the level and blend of its tiles.
        obb: whether the unit tests boxes instead of making the exact test.
        rendered: for each frame (tiles,) bool, which tiles are rendered, on machines with stereo; empty where all are.
    """

    name: str
    config: AcceleratorConfig
    width: int
    height: int
    frames: tuple[tuple[np.ndarray, np.ndarray], ...]
    obb: bool = False
    rendered: tuple[np.ndarray, ...] = ()

    @property
    def masks(self) -> list[np.ndarray]:
        """For each frame (tiles,) bool, which tiles are rendered."""
        return list(self.rendered) or [np.ones(len(levels), bool) for _, levels in self.frames]

    @property
    def settings(self) -> dict[str, int]:
        """Values of the unit's plain inputs."""
        return {"width": self.width, "height": self.height, "obb": int(self.obb)}

    @cached_property
    def golden(self) -> list[TileTest]:
        """The golden renderer's results for each frame."""
        return [tile_test(self.config, *frame, self.width, self.height, obb=self.obb, rendered=mask)
                for frame, mask in zip(self.frames, self.masks, strict=True)]

    @property
    def inputs(self) -> dict[str, np.ndarray]:
        """Items of the unit's input streams."""
        end = np.zeros(1, projected_splat(self.config).dtype)
        end["end"] = 1
        tables = np.zeros(sum(len(levels) for _, levels in self.frames), tile_level(self.config).dtype)
        tables["tile"] = np.concatenate([np.arange(len(levels)) for _, levels in self.frames])
        tables["level"], tables["blend"] = np.concatenate([levels for _, levels in self.frames]).T
        if self.config.stereo:
            tables["rendered"] = np.concatenate(self.masks)
        return {"splats": np.concatenate([part for splats, _ in self.frames for part in (splats, end)]), "table": tables}

    @property
    def expected(self) -> dict[str, np.ndarray]:
        """Items of the output streams."""
        return {name: np.concatenate([getattr(frame, name) for frame in self.golden]) for name in ("entries", "survivors")}

    @property
    def observed(self) -> dict[str, int]:
        """Plain outputs after the last frame."""
        return {"touched": self.golden[-1].touched, "filtered": self.golden[-1].filtered, "busy": 0}

    def costs(self) -> list[Cost]:
        """The work of each frame."""
        return [self._cost(*frame, mask, golden)
                for frame, mask, golden in zip(self.frames, self.masks, self.golden, strict=True)]

    def _cost(self, splats: np.ndarray, levels: np.ndarray, rendered: np.ndarray, golden: TileTest) -> Cost:
        """The work of one frame. A run of tiles ends at the last tile of a group, and where the next tile has another level,
        another blend, or is rendered where this one is not."""
        tiles_x = -(-self.width // TILE)
        grid = np.column_stack([levels, rendered]).reshape(-1, tiles_x, 3)
        stops = np.ones(grid.shape[:2], np.int64)
        stops[:, :-1] = (grid[:, 1:] != grid[:, :-1]).any(2) | (np.arange(1, tiles_x) % LEVEL_GROUP == 0)
        before = np.zeros((len(grid) + 1, tiles_x + 1), np.int64)
        before[1:, 1:] = stops.cumsum(0).cumsum(1)
        first_x, last_x, first_y, last_y = (splats[f"{end}_{axis}"] for axis in "xy" for end in ("first", "last"))
        inside = before[last_y + 1, last_x] - before[first_y, last_x] - before[last_y + 1, first_x] + before[first_y, first_x]
        runs = int((inside + last_y - first_y + 1).sum())
        tile, index = golden.entries["tile"][:-1], golden.entries["index"][:-1]
        goes_on = (index[1:] == index[:-1]) & (tile[1:] == tile[:-1] + 1) & (stops.ravel()[tile[:-1]] == 0)
        return Cost(runs, len(tile) - int(goes_on.sum()), len(tile))


def _factors(rng: np.random.Generator, count: int, shape: str) -> np.ndarray:
    """(count, 3) Cholesky factors. The narrowest footprint that projection produces has EXPONENT_SCALE / sqrt(LOW_PASS)."""
    most = EXPONENT_SCALE / np.sqrt(LOW_PASS)
    if shape == "slanted":  # so far that the leftmost point lies just beside the upper or the lower end
        l1, l2, l3 = most * 2.0 ** -rng.uniform([[0], [0], [5]], [[2], [0.5], [6.5]], (3, count))
        return np.stack([l1, l2 * rng.choice([-1, 1], count), l3], 1)
    size = {"dots": (0, 1), "discs": (2, 6), "needles": (0, 9), "giants": (7, 14), "extremes": (0, 62)}[shape]
    l1, l3 = most * 2.0 ** -rng.uniform(*size, (2, count))
    slope = rng.choice([0, 1e-6, 0.3, 1, 3, 30], count) * rng.normal(0, 1, count) * (shape != "dots")
    l2 = np.clip(slope * l1, -most, most)
    return np.stack([l1, l2, np.where(shape == "needles", l3 * 2.0 ** -rng.uniform(0, 6, count), l3)], 1)


def _means(config: AcceleratorConfig, rng: np.random.Generator, count: int, width: int, height: int) -> np.ndarray:
    """(count, 2) raw means: in and around the frame, on pixel centres and tile edges, and as far away as the format allows."""
    n, size = config.formats.mean2d, np.array([width, height])
    pixels = rng.uniform(-0.3, 1.3, (count, 2)) * size
    kind = rng.integers(0, 6, (count, 1))
    pixels = np.where(kind == 0, np.floor(pixels) + 0.5, pixels)
    pixels = np.where(kind == 1, np.round(pixels / TILE) * TILE + rng.choice([-0.5, 0, 0.5], (count, 2)), pixels)
    far = rng.choice([-1.0, 1.0], (count, 2)) * 2.0**n.int_bits
    return n.quantise(np.where((kind == 2) & (rng.random((count, 2)) < 0.3), far, pixels))


def _opacities(config: AcceleratorConfig, rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 4) raw opacities. They are equal in all levels or grow with the level; some are at the cut, just above or just
    below it, and some are the extremes of the format."""
    n, cut = config.formats.log2_opacity, log2_alpha_min(config.formats)
    gain = np.cumsum(rng.uniform(0, 2.5, (count, MAX_LEVELS)), 1) * rng.integers(0, 2, (count, 1))
    raw, kind = n.quantise(rng.uniform(-8, 0.5, (count, 1)) + gain), rng.integers(0, 12, (count, MAX_LEVELS))
    near = cut + rng.integers(-1, 3, (count, MAX_LEVELS))
    return np.select([kind == 0, kind == 1], [near, rng.choice([n.raw_min, n.raw_max], (count, MAX_LEVELS))], raw)


def random_splats(
    config: AcceleratorConfig, rng: np.random.Generator, count: int, width: int, height: int, shape: str,
) -> np.ndarray:
    """(count,) ProjectedSplat records of one of SHAPES. Their boxes are of every kind, and most are small ones near the
    mean."""
    n = config.formats
    splats = np.zeros(count, projected_splat(config).dtype)
    for field in projected_splat(config).fields:  # random values also in the fields that the unit only passes on
        low, high = field.raw_range
        size = (count, field.count) if field.count > 1 else count
        splats[field.name] = rng.integers(low, high + 1, size)
    splats["index"] = np.sort(rng.choice(1 << INDEX_BITS, count, replace=False))
    splats["bound"], splats["end"] = rng.integers(0, MAX_LEVELS, count), 0
    splats["mean2d"] = _means(config, rng, count, width, height)
    splats["conic"] = n.conic.quantise(_factors(rng, count, shape))
    opacity = _opacities(config, rng, count)
    splats["log2_opacity"] = opacity[:, 0] if opacities_carried(config) == 1 else opacity
    for axis, size in (("x", width), ("y", height)):
        tiles, mean = -(-size // TILE), splats["mean2d"][:, "xy".index(axis)] / 2.0**n.mean2d.frac_bits
        reach = rng.choice([0, 1, 1, 2, 4, tiles], count) * rng.uniform(0, TILE, count)
        splats[f"first_{axis}"] = np.clip((mean - reach) // TILE, 0, tiles - 1)
        splats[f"last_{axis}"] = np.clip((mean + reach) // TILE, splats[f"first_{axis}"], tiles - 1)
    return splats


def random_levels(rng: np.random.Generator, tiles_x: int, tiles_y: int, kind: str) -> np.ndarray:
    """(tiles, 2) the level and blend of tiles, of one of LEVELS."""
    y, x = np.divmod(np.arange(tiles_x * tiles_y), tiles_x)
    if kind == "one":
        return np.zeros((len(x), 2), np.int64)
    if kind == "rings":
        distance = np.hypot(x - rng.uniform(0, tiles_x), y - rng.uniform(0, tiles_y)) / max(tiles_x, tiles_y) * 2 * MAX_LEVELS
        step = np.minimum(distance.astype(np.int64), 2 * MAX_LEVELS - 2)
        return np.stack([step // 2, step % 2], 1)
    if kind == "alternating":
        return np.stack([(x + y) % 2 * rng.integers(1, MAX_LEVELS), x % 3 % 2], 1)
    drawn = rng.integers(0, 2 * MAX_LEVELS, len(x))
    if kind == "stretches":
        drawn = np.repeat(drawn, rng.integers(1, 40, len(x)))[: len(x)]
    return np.stack(np.divmod(drawn, 2), 1)


def random_case(
    config: AcceleratorConfig, rng: np.random.Generator, name: str, width: int, height: int, count: int, *, frames: int = 2,
    shape: str | None = None, kind: str | None = None, obb: bool = False,
) -> Case:
    """Frames of `count` splats each. The shape and the kind of level table are drawn for each frame where they are not given;
    on machines with stereo it is also drawn which tiles are rendered."""
    tiles = -(-width // TILE), -(-height // TILE)
    drawn = tuple((random_splats(config, rng, count, width, height, shape or str(rng.choice(SHAPES))),
                   random_levels(rng, *tiles, kind or str(rng.choice(LEVELS)))) for _ in range(frames))
    share = rng.choice([0.0, 0.1, 0.5, 0.9, 1.0], frames) if config.stereo else ()
    return Case(name, config, width, height, drawn, obb, tuple(rng.random(tiles[0] * tiles[1]) < part for part in share))


def _ends(
    config: AcceleratorConfig, splats: np.ndarray, width: int, height: int, side: str, *, rows: bool = False,
) -> np.ndarray:
    """(count,) first or last tile column, or row, of each splat's intersections, -1 where it has none; all tiles are at one
    level."""
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    entries = tile_test(config, splats, np.zeros((tiles_x * tiles_y, 2), np.int64), width, height).entries[:-1]
    splat, place = np.searchsorted(splats["index"], entries["index"]), np.divmod(entries["tile"], tiles_x)[not rows]
    found = np.full(len(splats), tiles_x + tiles_y if side == "first" else -1)
    (np.minimum if side == "first" else np.maximum).at(found, splat, place)
    return np.where(found == tiles_x + tiles_y, -1, found)


def sharp_splats(
    config: AcceleratorConfig, rng: np.random.Generator, count: int, width: int, height: int, shape: str,
) -> np.ndarray:
    """ProjectedSplat records at positions where one ulp of `mean2d` along x moves an end of the splat by one tile column.

    Each splat's box is one row high; if the shape is "slanted", it is the splat's uppermost or lowermost row. Its first or
    last tile column depends on the last bit of the ellipse's reach. There are two records of each, one on either side of the
    step.
    """
    splats = whole_frame(random_splats(config, rng, count, width, height, shape), width, height)
    frac = config.formats.mean2d.frac_bits
    if opacities_carried(config) > 1:
        splats["log2_opacity"] = splats["log2_opacity"][:, :1]
    splats["mean2d"] = rng.integers(0, np.array([width, height]) << frac, (count, 2))
    row = np.clip((splats["mean2d"][:, 1] >> frac) // TILE + rng.integers(-1, 2, count), 0, (height - 1) // TILE)
    if shape == "slanted":
        upper, lower = (_ends(config, splats, width, height, side, rows=True) for side in ("first", "last"))
        row = np.maximum(np.where(rng.random(count) < 0.5, upper, lower), 0)
    splats["first_y"] = splats["last_y"] = row
    sharp = []
    for side, part in (("first", splats[::2]), ("last", splats[1::2])):
        low, high = part.copy(), part.copy()
        high["mean2d"][:, 0] += TILE << frac
        start, end = (_ends(config, moved, width, height, side) for moved in (low, high))
        low, high, start = (moved[(start >= 0) & (end == start + 1)] for moved in (low, high, start))
        while len(low) and (high["mean2d"][:, 0] - low["mean2d"][:, 0] > 1).any():
            middle = low.copy()
            middle["mean2d"][:, 0] = (low["mean2d"][:, 0] + high["mean2d"][:, 0]) // 2
            below = _ends(config, middle, width, height, side) == start
            low["mean2d"][below], high["mean2d"][~below] = middle["mean2d"][below], middle["mean2d"][~below]
        sharp += [low, high]
    return np.concatenate(sharp)


def sharp_case(
    config: AcceleratorConfig, rng: np.random.Generator, count: int, shapes: Sequence[str] = ("dots", "discs", "needles"),
) -> Case:
    """`sharp_splats` of shapes, one frame each."""
    width, height = min(config.row_width, 333), min(config.row_width, 121)
    tiles = -(-width // TILE) * -(-height // TILE)
    return Case(f"where an ulp decides, {', '.join(shapes)}", config, width, height, tuple(
        (sharp_splats(config, rng, count, width, height, shape), np.zeros((tiles, 2), np.int64))
        for shape in shapes))


def whole_frame(splats: np.ndarray, width: int, height: int) -> np.ndarray:
    """The splats with a box that is the whole frame."""
    splats = splats.copy()
    for axis, size in (("x", width), ("y", height)):
        splats[f"first_{axis}"], splats[f"last_{axis}"] = 0, (size - 1) // TILE
    return splats


def many_cases(config: AcceleratorConfig, rng: np.random.Generator) -> list[Case]:
    """Thousands of splats of every shape in boxes that are the whole frame, so that their ellipses alone decide. They are
    enough for the low bits of sums and comparisons; large ones meet so many tiles that there are fewer of them."""
    cases = []
    for shape, count in (("dots", 4000), ("discs", 4000), ("needles", 4000), ("giants", 400), ("extremes", 400)):
        case = random_case(config, rng, f"many {shape}", config.row_width, 40, count, frames=1, shape=shape)
        ((splats, levels),) = case.frames
        cases.append(replace(case, frames=((whole_frame(splats, case.width, case.height), levels),)))
    return cases


def corner_cases(config: AcceleratorConfig, rng: np.random.Generator) -> list[Case]:
    """Every shape in every kind of table; frames of one pixel, tile, row or column and of odd sizes; no splats; boxes; splats
    over the whole frame."""
    widest = config.row_width
    wide, tall = min(widest, 333), min(widest, 121)
    cases = [random_case(config, rng, f"{shape} in {kind}", wide, tall, 60, frames=1, shape=shape, kind=kind)
             for shape, kind in product(SHAPES, LEVELS)]
    for width, height in ((1, 1), (16, 16), (17, 16), (widest, 1), (5, min(widest, 300)), (256, 33), (257, 48),
                          (widest - 1, 65)):
        if max(width, height) <= widest:
            cases.append(random_case(config, rng, f"{width}x{height}", width, height, 60))
    for shape in SHAPES:
        case = random_case(config, rng, f"{shape} over the whole frame", wide, tall, 12, frames=1, shape=shape)
        cases.append(replace(case, frames=tuple((whole_frame(s, wide, tall), levels) for s, levels in case.frames)))
        cases.append(random_case(config, rng, f"{shape}, boxes", wide, tall, 60, frames=1, shape=shape, obb=True))
    none = np.zeros(0, projected_splat(config).dtype)
    some, levels = random_splats(config, rng, 20, 100, 50, "discs"), random_levels(rng, 7, 4, "random")
    unused, outer = some.copy(), np.stack([np.full(28, 3), np.zeros(28, np.int64)], 1)
    unused["bound"] = 0
    return [
        *cases,
        Case("no splats", config, 100, 50, ((none, levels), (none, levels))),
        Case("no splats, then some, then none", config, 100, 50, ((none, levels), (some, levels), (none, levels))),
        Case("splats that no tile uses", config, 100, 50, ((unused, outer), (some, levels))),
    ]


def splats_of(frame: Frame) -> np.ndarray:
    """The ProjectedSplat records of a rendered frame, in the order of their index."""
    p, n, geometry = frame.projected, frame.config.formats, frame.words.geometry
    rows = np.flatnonzero(p.reason == VISIBLE)
    splats = np.zeros(len(rows), projected_splat(frame.config).dtype)
    splats["index"], splats["conic"] = rows, n.conic.quantise(p.conic[rows])
    splats["offset"] = n.view.quantise(frame.words.decoded.mean[rows] - frame.registers.position)
    for name in ("mean2d", "depth", "depth_key"):
        splats[name] = getattr(p, name)[rows]
    opacity = frame.words.decoded.opacity if opacities_carried(frame.config) == 1 else geometry["log2_opacity"]
    splats["bound"], splats["log2_opacity"] = geometry["bound"][rows], opacity[rows]
    for k, name in enumerate(("first_x", "last_x", "first_y", "last_y")):
        splats[name] = p.box[rows, k]
    return splats


def case_of(frame: Frame, name: str, *, obb: bool = False) -> Case:
    """The splats and levels of a rendered frame."""
    r = frame.registers
    return Case(name, frame.config, r.width, r.height, ((splats_of(frame), r.header[:, :2]),), obb)
