"""Stimuli of the tile test by super-tiles: frames of splats, and their pairs, as they come back in the second phase.

What is expected follows from the intersections of whole frames, which `golden.msv2_ref.tile_test` finds without knowing of
super-tiles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from golden.msv2_ref.regions import found_regions
from golden.msv2_ref.tile_test import TileTest, tile_test
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, SUPER_TILES, SUPER_X, SUPER_Y, TILE
from spec.queues import LEVEL_GROUP, LINES_AHEAD
from spec.records import projected_splat, surviving_splat, tile_level
from spec.supertiles import supertile_pair
from tb.culling.tile_test_stimuli import Case


class PairsFound(NamedTuple):
    """The pairs of a frame, in the order in which the first phase emits them.

    Attributes:
        splat: (P,) rows of the frame's splats.
        supertile: (P,) numbers of super-tiles.
        mask: (P,) masks of the super-tile's tiles with an intersection.
        levels: (P,) masks of the levels of these tiles.
        of: (E,) the pair of each intersection.
        place: (E,) the number of its tile in the super-tile.
    """

    splat: np.ndarray
    supertile: np.ndarray
    mask: np.ndarray
    levels: np.ndarray
    of: np.ndarray
    place: np.ndarray


def supers_x(width: int) -> int:
    """Columns of super-tiles of a frame."""
    return -(-width // (TILE * SUPER_X))


def pairs_of(
    test: TileTest, index: np.ndarray, levels: np.ndarray, width: int, *, origin: int = 0, columns: int | None = None,
) -> PairsFound:
    """The pairs to which a frame's intersections belong; `index` has the (rising) indices of its splats. With `columns` columns
    of super-tiles, the frame begins `origin` columns of tiles right of the first one's left edge."""
    row, column = np.divmod(test.entries["tile"][:-1].astype(np.int64), -(-width // TILE))
    splat, column = np.searchsorted(index, test.entries["index"][:-1]), column + origin
    supertile = row // SUPER_Y * (columns or supers_x(width)) + column // SUPER_X
    place = row % SUPER_Y * SUPER_X + column % SUPER_X
    count = int(supertile.max(initial=0)) + 1
    found, of = np.unique(splat * count + supertile, return_inverse=True)
    mask, used = np.zeros(len(found), np.int64), np.zeros(len(found), np.int64)
    np.bitwise_or.at(mask, of, 1 << place)
    np.bitwise_or.at(used, of, 1 << levels[test.entries["tile"][:-1], 0])
    return PairsFound(found // count, found % count, mask, used, of, place)


def quarter_masks(case: Case, frame: int, found: PairsFound) -> np.ndarray:
    """(P, streams): for each pair of a frame the tiles of its super-tile whose quarter of a stream is met, one bit each."""
    config, (splats, levels) = case.config, case.frames[frame]
    tile = case.golden[frame].entries["tile"][:-1].astype(np.int64)
    opacity = np.broadcast_to(splats["log2_opacity"].reshape(len(splats), 1), (len(splats), MAX_LEVELS))
    met = np.full(len(tile), (1 << config.streams) - 1) if case.obb else found_regions(
        config, np.ascontiguousarray(splats["mean2d"]), config.formats.conic.to_float(splats["conic"]), opacity, levels[:, 0],
        tile, np.searchsorted(splats["index"], case.golden[frame].entries["index"][:-1]), case.width, case.height)
    masks = np.zeros((len(found.splat), config.streams), np.int64)
    for stream in range(config.streams):
        np.bitwise_or.at(masks[:, stream], found.of, (met >> stream & 1).astype(np.int64) << found.place)
    return masks


def clipped(splats: np.ndarray, supertile: np.ndarray, width: int) -> np.ndarray:
    """ProjectedSplat records with their boxes cut to super-tiles."""
    cut = splats.copy()
    row, column = np.divmod(supertile, supers_x(width))
    for axis, begin, size in (("x", column * SUPER_X, SUPER_X), ("y", row * SUPER_Y, SUPER_Y)):
        cut[f"first_{axis}"] = np.maximum(cut[f"first_{axis}"], begin)
        cut[f"last_{axis}"] = np.minimum(cut[f"last_{axis}"], begin + size - 1)
    return cut


@dataclass(frozen=True)
class SuperCase:
    """Consecutive frames of one size, each in both phases.

    Attributes:
        base: the frames' splats and levels.
        again: whether the pairs come in the second phase; otherwise it has none.
    """

    base: Case
    again: bool = True

    @property
    def name(self) -> str:
        """The case's name, for messages."""
        return self.base.name

    @property
    def config(self) -> AcceleratorConfig:
        """The machine's configuration."""
        return self.base.config

    @cached_property
    def golden(self) -> list[TileTest]:
        """The golden renderer's intersections of each frame."""
        return self.base.golden

    @cached_property
    def found(self) -> list[PairsFound]:
        """The pairs of each frame."""
        return [pairs_of(test, splats["index"], levels, self.base.width)
                for test, (splats, levels) in zip(self.golden, self.base.frames, strict=True)]

    @cached_property
    def second(self) -> list[np.ndarray]:
        """The rows of `found` of each frame in the order of the second phase: by super-tile, depth key and index."""
        orders = []
        for found, (splats, _) in zip(self.found, self.base.frames, strict=True):
            keys = (found.splat, splats["depth_key"][found.splat], found.supertile)
            orders.append(np.lexsort(keys) if self.again else np.zeros(0, np.int64))
        return orders

    @cached_property
    def returning(self) -> list[np.ndarray]:
        """The splats of each frame's second phase."""
        return [clipped(splats[found.splat[order]], found.supertile[order], self.base.width)
                for found, order, (splats, _) in zip(self.found, self.second, self.base.frames, strict=True)]

    @property
    def inputs(self) -> dict[str, np.ndarray]:
        """Items of the bench's input streams."""
        end = np.zeros(1, projected_splat(self.config).dtype)
        end["end"] = 1
        tables = self.base.inputs["table"].astype(tile_level(self.config).dtype)
        parts = [part for (splats, _), back in zip(self.base.frames, self.returning, strict=True)
                 for part in (splats, end, back, end)]
        return {"splats": np.concatenate(parts), "table": tables}

    @property
    def expected(self) -> dict[str, np.ndarray]:
        """Items of the output streams."""
        pairs, survivors = [], []
        for k, ((splats, _), found, order) in enumerate(zip(self.base.frames, self.found, self.second, strict=True)):
            items = np.zeros(len(found.splat) + 1, supertile_pair(self.config).dtype)
            items["supertile"][:-1], items["end"][-1] = found.supertile, 1
            for name in ("index", "depth_key"):
                items[name][:-1] = splats[name][found.splat]
            pairs.append(items)
            back = np.zeros(len(order), surviving_splat(self.config).dtype)
            for name in {*splats.dtype.names} & {*back.dtype.names} - {"end"}:
                back[name] = splats[name][found.splat[order]]
            masks = found.mask if self.config.streams == 1 else quarter_masks(self.base, k, found)
            back["levels"], back["mask"] = found.levels[order], masks[order]
            survivors.append(back)
        return {"pairs": np.concatenate(pairs), "survivors": np.concatenate(survivors)}

    @property
    def observed(self) -> dict[str, int]:
        """Plain outputs after the last frame."""
        golden, found = self.golden[-1], self.found[-1]
        return {
            "touched": golden.touched, "filtered": golden.filtered, "entries": golden.touched - golden.filtered,
            "survivors_count": len(np.unique(found.splat)), "filled": 1, "busy": 0}

    def cycles(self) -> list[tuple[int, int]]:
        """(first phase, second phase): least cycles of each frame's phases, without latencies."""
        return [(self._first_cycles(splats, levels, found), self.config.point_interval * len(order))
                for (splats, levels), found, order in zip(self.base.frames, self.found, self.second, strict=True)]

    def _first_cycles(self, splats: np.ndarray, levels: np.ndarray, found: PairsFound) -> int:
        """Steps enter at their interval, and are walked through a group a cycle. Pairs leave one a cycle while the walk goes
        on; it waits where the pairs of LINES_AHEAD steps have not begun to leave."""
        groups, emits = self._steps(splats, levels, found)
        walked, begun = 0, [0]  # when the walk is over, and when the pairs of each step with any begin to leave
        free = 0
        for k, (cost, pairs) in enumerate(zip(groups.tolist(), emits.tolist(), strict=True)):
            walked = max(k * self.config.point_interval, walked) + cost
            if pairs:
                if len(begun) > LINES_AHEAD:
                    walked = max(walked, begun[-LINES_AHEAD])
                begun.append(max(walked, free))
                free = begun[-1] + pairs
        return max(walked, free)

    def _steps(self, splats: np.ndarray, levels: np.ndarray, found: PairsFound) -> tuple[np.ndarray, np.ndarray]:
        """Of each step of SUPER_Y tile rows that boxes are cut into, its groups, from the first to the last column that the
        splat touches, whatever the level; and its pairs, which leave with the last row of their super-tile or of the box."""
        first, last = splats["first_y"].astype(np.int64), splats["last_y"].astype(np.int64)
        count = (last - first) // SUPER_Y + 1
        begin = np.cumsum(count) - count
        total = int(count.sum())
        touched = tile_test(self.config, splats, np.zeros_like(levels), self.base.width, self.base.height, obb=self.base.obb)
        tile_row, column = np.divmod(touched.entries["tile"][:-1].astype(np.int64), -(-self.base.width // TILE))
        of = np.searchsorted(splats["index"], touched.entries["index"][:-1])
        at = begin[of] + (tile_row - first[of]) // SUPER_Y
        low, high = np.full(total, 1 << 30), np.full(total, -1)
        np.minimum.at(low, at, column // LEVEL_GROUP)
        np.maximum.at(high, at, column // LEVEL_GROUP)
        ends = found.supertile // supers_x(self.base.width) * SUPER_Y + SUPER_Y - 1
        leaves = begin[found.splat] + (np.minimum(ends, last[found.splat]) - first[found.splat]) // SUPER_Y
        return np.maximum(high - low + 1, 1), np.bincount(leaves, minlength=total)


def numbered(case: Case) -> Case:
    """The case with indices that differ and rise in each frame."""
    frames = []
    for splats, levels in case.frames:
        splats = splats.copy()
        splats["index"] = np.arange(len(splats))
        _one_eye(splats)
        frames.append((splats, levels))
    return replace(case, frames=tuple(frames))


def _one_eye(splats: np.ndarray) -> None:
    """Makes splats of frames of one eye, also in a machine with joint frames."""
    for name in {"eye", "none"} & {*splats.dtype.names}:
        splats[name] = 0


def wide_case(config: AcceleratorConfig, rng: np.random.Generator, splats: np.ndarray, name: str) -> SuperCase:
    """Boxes of a row or two of the widest frame, all at one level and with all tiles touched: more pairs than groups."""
    splats, width, tiles = splats.copy(), config.row_width, -(-config.row_width // TILE)
    _one_eye(splats)
    splats["bound"], splats["first_x"], splats["last_x"] = MAX_LEVELS - 1, 0, tiles - 1
    splats["first_y"] = rng.integers(0, 4, len(splats))
    splats["last_y"] = np.minimum(splats["first_y"] + rng.integers(0, 2, len(splats)), 3)
    levels = np.zeros((4 * tiles, 2), np.int64)
    return SuperCase(Case(name, config, width, 4 * TILE, ((splats, levels),), obb=True))


def tiles_met(case: SuperCase) -> np.ndarray:
    """(SUPER_TILES,) how often each place of a super-tile is in a mask."""
    masks = np.concatenate([found.mask for found in case.found])
    return (masks[:, None] >> np.arange(SUPER_TILES) & 1).sum(0)
