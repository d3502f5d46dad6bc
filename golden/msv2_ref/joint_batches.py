"""Batches and visits of a joint frame: what fills the batch buffer for both eyes, and what the array takes from it
(`spec.joint`). As in `golden.msv2_ref.batches`, visits are those of a machine that does not know when a tile stops."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from golden.msv2_ref.batches import Batches, cut_batches
from golden.msv2_ref.fetch import find_misses
from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.pipeline import Frame
from spec.chunks import PLACE_BITS
from spec.constants import MAX_LEVELS, SUPER_TILES
from spec.joint import EYES, PAIR_PLACES
from spec.supertiles import HEADER_WAYS, SEQUENCE_BITS, tile_visit, visit_entry

_LEVELS = np.arange(MAX_LEVELS)


class JointPlaces(NamedTuple):
    """The places of a joint frame's batches in the order in which they are filled.

    Attributes:
        pair: (R,) int64, the place's pair.
        eye, level: (R,) uint8, whose splat record it is, and of which level.
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


class JointVisits(NamedTuple):
    """The visits of a stream, in order.

    Attributes:
        batch: (V,) int64, the batch of each visit.
        eye: (V,) int64, the eye. tile: (V,) int64, the visited tile of this eye. place: (V,) int64, its number among the tiles
            of this eye in the super-tile.
        fresh, final: (V,) bool, whether it is the tile's first visit, whether its last.
        start: (V + 1,) int64, first entry of each visit.
        order: (E,) int64, entries in the order of visits, as rows of the intersections of the visit's eye.
    """

    batch: np.ndarray
    eye: np.ndarray
    tile: np.ndarray
    place: np.ndarray
    fresh: np.ndarray
    final: np.ndarray
    start: np.ndarray
    order: np.ndarray


class JointBatches:
    """The batches of a joint frame: everything that follows from its pairs, computed when it is asked for.

    Attributes:
        frame: the frame.
    """

    def __init__(self, frame: JointFrame) -> None:
        self.frame = frame

    @cached_property
    def place_counts(self) -> np.ndarray:
        """(P, EYES) int64: places of each pair by eye."""
        return (self.frame.pairs.levels[:, :, None] >> _LEVELS & 1).sum(axis=2)

    @cached_property
    def batches(self) -> Batches:
        """The batches, in order."""
        return cut_batches(self.frame.pairs.start, self.place_counts.sum(axis=1), self.frame.config.batch_places, PAIR_PLACES)

    @cached_property
    def batch_of_pair(self) -> np.ndarray:
        """(P,) int64: the batch of each pair."""
        return np.repeat(np.arange(len(self.batches.supertile)), np.diff(self.batches.start))

    @cached_property
    def places(self) -> JointPlaces:
        """The places, in order."""
        pair, eye, level = np.nonzero(self.frame.pairs.levels[:, :, None] >> _LEVELS & 1)
        batch = self.batch_of_pair[pair]
        filled = np.bincount(batch, minlength=len(self.batches.supertile))
        slot = np.arange(len(pair)) - np.repeat(np.cumsum(filled) - filled, filled)
        return JointPlaces(pair, eye.astype(np.uint8), level.astype(np.uint8), np.diff(pair, append=-1) != 0, batch, slot)

    @property
    def events(self) -> dict[str, int]:
        """The machine's counts that only machines with super-tiles have, as far as the frame determines them."""
        chunk, config = self.frame.pairs.index >> PLACE_BITS, self.frame.config
        missed = find_misses(chunk, np.zeros_like(chunk), config.header_lines, HEADER_WAYS, keep_used=False, fold=False)
        pairs, misses = len(chunk), int(missed.sum())
        return {"pairs": pairs, "header_hits": pairs - misses, "header_misses": misses, "batches": len(self.batches.supertile)}

    @property
    def statistics(self) -> dict[str, int]:
        """Counts of the frame for stats.json."""
        return {**self.events, "supertiles": len(self.frame.pairs.start) - 1, "places": len(self.places.pair),
                "visits": sum(len(self.stream_visits(q).tile) for q in range(self.frame.config.streams)),
                "lists": self.frame.bounds.lists}

    def stream_visits(self, stream: int = 0) -> JointVisits:
        """The visits of a stream, in order, if no pixel stops."""
        b, frame = self.batches, self.frame
        wanted = np.zeros((len(b.supertile), EYES, SUPER_TILES), bool)
        keys, rows = [], []
        for eye, (drawn, grid, pair) in enumerate(zip(frame.eyes, frame.grids, frame.pairs.intersection, strict=True)):
            here = np.arange(len(pair))
            if drawn.regions is not None:
                here = np.flatnonzero(drawn.regions >> stream & 1)
            tile = _tiles(drawn)[here]
            keys.append((self.batch_of_pair[pair[here]] * EYES + eye) * SUPER_TILES + grid.place[tile])
            rows.append(here)
            wanted[b.final, eye] = grid.inside[b.supertile[b.final]]
        key, here = np.concatenate(keys), np.concatenate(rows)
        wanted.reshape(-1)[key] = True
        batch, eye, place = np.nonzero(wanted)
        visited = np.stack([grid.tile for grid in frame.grids])[eye, b.supertile[batch], place]
        fresh = np.zeros(len(batch), bool)
        fresh[np.unique(np.stack([eye, visited]), axis=1, return_index=True)[1]] = True
        counts = np.bincount(key, minlength=wanted.size)[wanted.reshape(-1)]
        return JointVisits(batch, eye, visited, place, fresh, b.final[batch], np.concatenate(([0], np.cumsum(counts))),
                           here[np.argsort(key, kind="stable")])

    def records_of(self, eye: int, stream: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """TileVisit and VisitEntry records of the visits of one eye, in order, as an array takes them that renders this eye's
        tiles; an item with `end` follows the entries of each visit."""
        v, drawn = self.stream_visits(stream), self.frame.eyes[eye]
        r, mine = drawn.registers, np.flatnonzero(v.eye == eye)
        tile, counts = v.tile[mine], np.diff(v.start)[mine]
        visits = np.zeros(len(mine), tile_visit(drawn.config).dtype)
        visits["tile_y"], visits["tile_x"] = np.divmod(tile, r.tiles_x)
        visits["blend"], visits["outer"], visits["plane"] = r.header[tile, 1], r.header[tile, 2], r.plane[tile]
        visits["place"], visits["fresh"], visits["final"] = v.place[mine], v.fresh[mine], v.final[mine]
        visits["sequence"] = self.batches.supertile[v.batch[mine]] & (1 << SEQUENCE_BITS) - 1
        rows = np.concatenate([np.zeros(0, np.int64), *(v.order[v.start[n] : v.start[n + 1]] for n in mine)])
        entries, taken = np.zeros(len(rows) + len(mine), visit_entry(drawn.config).dtype), drawn.array_entries
        entries["end"][np.cumsum(counts) + np.arange(len(mine))] = 1
        for name in taken.dtype.names:
            entries[name][entries["end"] == 0] = taken[name][rows]
        return visits, entries


def _tiles(frame: Frame) -> np.ndarray:
    """(E,) int64: the tile of each of a frame's intersections."""
    return np.repeat(np.arange(len(frame.entries.start) - 1), np.diff(frame.entries.start))
