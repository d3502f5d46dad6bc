"""Batches of splat records and visits of tiles: what fills the batch buffer of a frame, and what the array takes from it
(`spec.supertiles`).

The visits are those of a machine that does not know when a tile stops. A machine that knows leaves out some of these visits,
and ends others early; no pixel depends on it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from golden.msv2_ref.buckets import Bounds, next_bounds, no_bounds
from golden.msv2_ref.fetch import find_misses
from golden.msv2_ref.frame_memory import records_at
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.ranges import range_of
from golden.msv2_ref.supertiles import Pairs, SuperGrid, list_counts, merge_lists, super_grid
from spec.chunks import PLACE_BITS
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, SUPER_TILES, SUPER_X, SUPER_Y
from spec.supertiles import HEADER_WAYS, SEQUENCE_BITS, batch_place, supertile, tile_visit, visit_entry


class Places(NamedTuple):
    """The places of a frame's batches in the order in which they are filled.

    Attributes:
        pair: (R,) int64, the place's pair.
        eye, level: (R,) uint8, whose splat record it is, 0 but for the target of joint frames, and of which level.
        last: (R,) bool, whether it is the last place of its pair.
        batch: (R,) int64, the batch that it lies in.
        slot: (R,) int64, its number in the batch.
    """

    pair: np.ndarray
    eye: np.ndarray
    level: np.ndarray
    last: np.ndarray
    batch: np.ndarray
    slot: np.ndarray


class Batches(NamedTuple):
    """The batches of a frame, in order.

    Attributes:
        supertile: (B,) int64, the super-tile of each batch.
        start: (B + 1,) int64, first pair of each batch.
        final: (B,) bool, whether it is the last one of its super-tile.
    """

    supertile: np.ndarray
    start: np.ndarray
    final: np.ndarray


class Visits(NamedTuple):
    """The visits of a frame, in order.

    Attributes:
        batch: (V,) int64, the batch of each visit.
        tile: (V,) int64, the visited tile.
        place: (V,) int64, its number in its super-tile.
        fresh, final: (V,) bool, whether it is the tile's first visit, whether its last.
        start: (V + 1,) int64, first entry of each visit.
        order: (E,) int64, entries in the order of visits, as rows of the frame's intersections.
    """

    batch: np.ndarray
    tile: np.ndarray
    place: np.ndarray
    fresh: np.ndarray
    final: np.ndarray
    start: np.ndarray
    order: np.ndarray


def cut_batches(start: np.ndarray, places: np.ndarray, batch_places: int, most: int = MAX_LEVELS) -> Batches:
    """The batches of a frame.

    Args:
        start: (super-tiles + 1,) first pair of each super-tile.
        places: (P,) number of places of each pair, 1..most.
        batch_places: number of places of a batch.
        most: most places of a pair.
    """
    total = np.concatenate(([0], np.cumsum(places)))
    supertiles, starts, finals = [], [], []
    for number, (begin, end) in enumerate(zip(start[:-1].tolist(), start[1:].tolist(), strict=True)):
        final = False
        while not final:
            full = total[begin] + batch_places - most  # a batch ends with the pair after which it has more places
            after = min(int(np.searchsorted(total, full, "right")), end)
            final = after == end
            supertiles.append(number)
            starts.append(begin)
            finals.append(final)
            begin = after
    return Batches(np.array(supertiles, np.int64), np.array([*starts, start[-1]], np.int64), np.array(finals, bool))


def following(frame: Frame, before: Frame, beta: int | None) -> Frame:
    """The frame as a machine renders it after another one: with the bounds that this one leaves, and so with other lists and
    groups. Bounds hold for frames of as many super-tiles only.

    Args:
        frame: the frame, with any bounds.
        before: the frame before it, on the same machine.
        beta: the merge threshold that the frame was rendered with.
    """
    bounds = next_bounds(before.config, before.pairs.start, before.pairs.depth_key)
    if bounds.supertiles != len(frame.pairs.start) - 1:
        bounds = no_bounds(len(frame.pairs.start) - 1)
    return replace(frame, bounds=bounds, groups=merge_lists(frame.config, list_counts(frame.pairs, bounds), beta))


def supertile_records(frame: Frame, grid: SuperGrid, pairs: np.ndarray) -> np.ndarray:
    """(super-tiles,) SuperTile records of a frame, or of an eye of a joint frame.

    Args:
        frame: the frame.
        grid: how its tiles lie in super-tiles.
        pairs: (super-tiles,) the number of pairs of each.
    """
    r, rows = frame.registers, np.zeros(len(grid.tile), supertile(frame.config).dtype)
    row, column = np.divmod(np.arange(len(rows)) % (grid.columns * grid.rows), grid.columns)  # once for each sweep
    rows["x"], rows["y"], rows["pairs"] = SUPER_X * column, SUPER_Y * row, pairs
    bits = 1 << np.arange(SUPER_TILES)
    rows["inside"] = grid.inside @ bits
    rows["level"] = np.where(grid.inside, r.header[grid.tile, 0], 0)
    rows["blend"] = (grid.inside & (r.header[grid.tile, 1] == 1)) @ bits
    rows["plane"] = np.where(grid.inside[..., None], r.plane[grid.tile], 0).reshape(len(rows), -1)
    return rows


class _Pairs(Protocol):
    """What the pairs of one eye and joint pairs have in common."""

    @property
    def start(self) -> np.ndarray: ...
    @property
    def splat(self) -> np.ndarray: ...
    @property
    def index(self) -> np.ndarray: ...


class _Framed(Protocol):
    """What a frame of one eye and a joint frame have in common."""

    @property
    def config(self) -> AcceleratorConfig: ...
    @property
    def bounds(self) -> Bounds: ...


FrameT = TypeVar("FrameT", bound=_Framed)
PairsT = TypeVar("PairsT", bound=_Pairs)


class PairBatches(Generic[FrameT, PairsT]):
    """The batches of a frame of one eye or of both: what follows from its pairs alone, computed when it is asked for.

    Attributes:
        frame: the frame.
        pairs: its pairs.
        levels: (P, eyes) uint8, levels of each pair in each eye, one bit each.
    """

    def __init__(self, frame: FrameT, pairs: PairsT, levels: np.ndarray) -> None:
        self.frame, self.pairs, self.levels = frame, pairs, levels

    @cached_property
    def place_counts(self) -> np.ndarray:
        """(P,) int64: places of each pair, of all eyes."""
        return (self.levels[:, :, None] >> np.arange(MAX_LEVELS) & 1).sum(axis=(1, 2))

    @cached_property
    def batches(self) -> Batches:
        """The batches, in order."""
        most = self.levels.shape[1] * MAX_LEVELS
        return cut_batches(self.pairs.start, self.place_counts, self.frame.config.batch_places, most)

    @cached_property
    def batch_of_pair(self) -> np.ndarray:
        """(P,) int64: the batch of each pair."""
        return range_of(self.batches.start)

    @cached_property
    def places(self) -> Places:
        """The places, in order."""
        pair, eye, level = np.nonzero(self.levels[:, :, None] >> np.arange(MAX_LEVELS) & 1)
        batch = self.batch_of_pair[pair]
        filled = np.bincount(batch, minlength=len(self.batches.supertile))
        slot = np.arange(len(pair)) - np.repeat(np.cumsum(filled) - filled, filled)
        return Places(pair, eye.astype(np.uint8), level.astype(np.uint8), np.diff(pair, append=-1) != 0, batch, slot)

    @property
    def header_misses(self) -> int:
        """Pairs whose chunk's header is not in the cache of the second phase, which is empty when a frame begins."""
        chunk, config = self.pairs.index >> PLACE_BITS, self.frame.config
        missed = find_misses(chunk, np.zeros_like(chunk), config.header_lines, HEADER_WAYS, keep_used=False, fold=False)
        return int(missed.sum())

    @property
    def events(self) -> dict[str, int]:
        """The machine's counts that only machines with super-tiles have, as far as the frame determines them."""
        pairs, misses = len(self.pairs.splat), self.header_misses
        return {"pairs": pairs, "header_hits": pairs - misses, "header_misses": misses, "batches": len(self.batches.supertile)}

    def statistics_with(self, visits: int) -> dict[str, int]:
        """Counts of the frame for stats.json, with so many visits."""
        return {**self.events, "supertiles": len(self.pairs.start) - 1, "places": len(self.places.pair), "visits": visits,
                "lists": self.frame.bounds.lists}


class FrameBatches(PairBatches[Frame, Pairs]):
    """The batches of a frame of one eye: everything that follows from its pairs.

    Attributes:
        frame: a frame of a machine with super-tiles.
        grid: how its tiles lie in super-tiles.
        pairs: its pairs.

    Raises:
        ValueError: the frame's machine has no super-tiles.
    """

    def __init__(self, frame: Frame) -> None:
        if frame.pairs is None:
            raise ValueError(f"frame must be one of a machine with super-tiles, not of {frame.config.name!r}")
        super().__init__(frame, frame.pairs, frame.pairs.levels[:, None])
        self.grid: SuperGrid = super_grid(frame.registers)

    @property
    def statistics(self) -> dict[str, int]:
        """Counts of the frame for stats.json; visits are those of a machine that does not know when a tile stops."""
        return self.statistics_with(sum(len(self.stream_visits(q).tile) for q in range(self.frame.config.streams)))

    @cached_property
    def visits(self) -> Visits:
        """The visits, in order, of a machine with one stream in which no tile stops."""
        return self.stream_visits(0)

    def stream_visits(self, stream: int) -> Visits:
        """The visits of a stream, in order, if no pixel stops; `tile` names the tile whose region is visited."""
        b, grid, entries = self.batches, self.grid, self.frame.entries
        here = np.arange(len(entries.splat))
        if self.frame.regions is not None:
            here = np.flatnonzero(self.frame.regions >> stream & 1)
        tile = np.repeat(np.arange(len(grid.supertile)), np.diff(entries.start))[here]
        key = self.batch_of_pair[self.pairs.intersection[here]] * SUPER_TILES + grid.place[tile]
        wanted = np.zeros((len(b.supertile), SUPER_TILES), bool)
        wanted.reshape(-1)[key] = True
        wanted[b.final] = grid.inside[b.supertile[b.final]]
        batch, place = np.nonzero(wanted)
        visited = grid.tile[b.supertile[batch], place]
        fresh = np.zeros(len(batch), bool)
        fresh[np.unique(visited, return_index=True)[1]] = True
        counts = np.bincount(key, minlength=wanted.size)[wanted.reshape(-1)]
        start = np.concatenate(([0], np.cumsum(counts)))
        return Visits(batch, visited, place, fresh, b.final[batch], start, here[np.argsort(key, kind="stable")])

    @property
    def stream_masks(self) -> np.ndarray:
        """(P, streams) uint16: for each pair the tiles of the super-tile that each stream takes it to, one bit each."""
        entries, streams = self.frame.entries, self.frame.config.streams
        if self.frame.regions is None:
            return self.pairs.mask[:, None]
        tile = np.repeat(np.arange(len(self.grid.supertile)), np.diff(entries.start))
        masks = np.zeros((len(self.pairs.splat), streams), np.uint16)
        for stream in range(streams):
            bits = (self.frame.regions >> stream & 1).astype(np.uint16) << self.grid.place[tile].astype(np.uint16)
            np.bitwise_or.at(masks[:, stream], self.pairs.intersection, bits)
        return masks

    @property
    def supertile_records(self) -> np.ndarray:
        """(super-tiles,) SuperTile records."""
        return supertile_records(self.frame, self.grid, np.diff(self.pairs.start))

    @property
    def place_records(self) -> np.ndarray:
        """(R,) BatchPlace records."""
        p = self.places
        rows = records_at(self.frame, self.pairs.splat[p.pair], p.level, batch_place(self.frame.config))
        masks = self.stream_masks[p.pair]
        rows["level"], rows["mask"], rows["last"] = p.level, masks if masks.shape[1] > 1 else masks[:, 0], p.last
        return rows

    def visit_records_from(self, first: int, stream: int = 0) -> np.ndarray:
        """(V,) TileVisit records of a stream in a frame whose first super-tile has this number."""
        r, v = self.frame.registers, self.stream_visits(stream)
        rows = np.zeros(len(v.tile), tile_visit(self.frame.config).dtype)
        rows["tile_y"], rows["tile_x"] = np.divmod(v.tile, r.tiles_x)
        rows["blend"], rows["outer"], rows["plane"] = r.header[v.tile, 1], r.header[v.tile, 2], r.plane[v.tile]
        rows["place"], rows["fresh"], rows["final"] = v.place, v.fresh, v.final
        rows["sequence"] = first + self.batches.supertile[v.batch] & (1 << SEQUENCE_BITS) - 1
        return rows

    @property
    def visit_records(self) -> np.ndarray:
        """(V,) TileVisit records of the first frame after a reset."""
        return self.visit_records_from(0)

    @property
    def entry_records(self) -> np.ndarray:
        """(E + V,) VisitEntry records: the entries of every visit, and an item with `end` behind them."""
        return self.stream_entry_records(0)

    def stream_entry_records(self, stream: int) -> np.ndarray:
        """The `entry_records` of a stream."""
        v, taken = self.stream_visits(stream), self.frame.array_entries
        rows = np.zeros(len(v.order) + len(v.tile), visit_entry(self.frame.config).dtype)
        ends = v.start[1:] + np.arange(len(v.tile))
        rows["end"][ends] = 1
        kept = rows["end"] == 0
        for name in taken.dtype.names:
            rows[name][kept] = taken[name][v.order]
        return rows
