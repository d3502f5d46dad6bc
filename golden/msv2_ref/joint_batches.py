"""Batches and visits of a joint frame: what fills the batch buffer for both eyes, and what the array takes from it
(`spec.joint`). As in `golden.msv2_ref.batches`, visits are those of a machine that does not know when a tile stops."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from golden.msv2_ref.batches import PairBatches, supertile_records
from golden.msv2_ref.frame_memory import records_at
from golden.msv2_ref.joint import JointFrame, JointPairs
from golden.msv2_ref.ranges import range_of
from spec.constants import SUPER_TILES
from spec.joint import EYES
from spec.supertiles import SEQUENCE_BITS, batch_place, tile_visit, visit_entry


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


class JointBatches(PairBatches[JointFrame, JointPairs]):
    """The batches of a joint frame: everything that follows from its pairs, computed when it is asked for.

    Attributes:
        frame: the frame.
        pairs: its pairs.
    """

    def __init__(self, frame: JointFrame) -> None:
        super().__init__(frame, frame.pairs, frame.pairs.levels)

    @property
    def statistics(self) -> dict[str, int]:
        """Counts of the frame for stats.json; visits are those of a machine that does not know when a tile stops."""
        return self.statistics_with(sum(len(self.stream_visits(q).tile) for q in range(self.frame.config.streams)))

    def stream_visits(self, stream: int = 0) -> JointVisits:
        """The visits of a stream, in order, if no pixel stops."""
        b, frame = self.batches, self.frame
        wanted = np.zeros((len(b.supertile), EYES, SUPER_TILES), bool)
        keys, rows = [], []
        for eye, (drawn, grid, pair) in enumerate(zip(frame.eyes, frame.grids, frame.pairs.intersection, strict=True)):
            here = np.arange(len(pair))
            if drawn.regions is not None:
                here = np.flatnonzero(drawn.regions >> stream & 1)
            tile = range_of(drawn.entries.start)[here]
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

    @property
    def stream_masks(self) -> np.ndarray:
        """(P, EYES, streams) uint16: for each pair and eye the tiles of the super-tile that each stream takes it to, one bit
        each."""
        masks = np.repeat(self.pairs.mask[..., None], self.frame.config.streams, axis=2)
        for eye, (drawn, grid, pair) in enumerate(zip(self.frame.eyes, self.frame.grids, self.pairs.intersection, strict=True)):
            if drawn.regions is not None:
                place = grid.place[range_of(drawn.entries.start)].astype(np.uint16)
                masks[:, eye] = 0
                for stream in range(masks.shape[2]):
                    bits = (drawn.regions >> stream & 1).astype(np.uint16) << place
                    np.bitwise_or.at(masks[:, eye, stream], pair, bits)
        return masks

    @property
    def supertile_records(self) -> np.ndarray:
        """(super-tiles * EYES,) SuperTile records: of each super-tile that of the source, then that of the target."""
        eyes = [supertile_records(drawn, grid, np.diff(self.pairs.start))
                for drawn, grid in zip(self.frame.eyes, self.frame.grids, strict=True)]
        rows = np.stack(eyes, 1)
        if "eye" in rows.dtype.names:
            rows["eye"] = np.arange(EYES)
        return rows.reshape(-1)

    @property
    def place_records(self) -> np.ndarray:
        """(R,) BatchPlace records."""
        p, masks = self.places, self.stream_masks
        rows = np.zeros(len(p.pair), batch_place(self.frame.config).dtype)
        for eye, drawn in enumerate(self.frame.eyes):
            here = p.eye == eye
            rows[here] = records_at(drawn, self.pairs.splat[p.pair[here]], p.level[here], batch_place(self.frame.config))
        mask = masks[p.pair, p.eye]
        rows["level"], rows["mask"], rows["last"] = p.level, mask if mask.shape[1] > 1 else mask[:, 0], p.last
        if "eye" in rows.dtype.names:
            rows["eye"] = p.eye
        return rows

    def records_of(self, eye: int, stream: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """TileVisit and VisitEntry records of the visits of one eye, in order, as an array takes them that renders this eye's
        tiles; an item with `end` follows the entries of each visit."""
        visits = self.stream_visits(stream)
        return self._records(visits, np.flatnonzero(visits.eye == eye))

    def stream_records(self) -> tuple[np.ndarray, np.ndarray]:
        """TileVisit and VisitEntry records of the visits of both eyes, as the array of a machine with one stream takes them."""
        visits = self.stream_visits()
        return self._records(visits, np.arange(len(visits.eye)))

    def _records(self, v: JointVisits, mine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The records of these of the visits."""
        counts, config = np.diff(v.start)[mine], self.frame.config
        visits = np.zeros(len(mine), tile_visit(config).dtype)
        entries, own = np.zeros(int(counts.sum()) + len(mine), visit_entry(config).dtype), v.eye[mine]
        entries["end"][np.cumsum(counts) + np.arange(len(mine))] = 1
        rows = np.concatenate([np.zeros(0, np.int64), *(v.order[v.start[n] : v.start[n + 1]] for n in mine)])
        taken, of_entry = np.flatnonzero(entries["end"] == 0), np.repeat(own, counts)
        for eye, drawn in enumerate(self.frame.eyes):
            r, here = drawn.registers, own == eye
            tile = v.tile[mine][here]
            visits["tile_y"][here], visits["tile_x"][here] = np.divmod(tile, r.tiles_x)
            visits["blend"][here], visits["outer"][here] = r.header[tile, 1], r.header[tile, 2]
            visits["plane"][here] = r.plane[tile]
            splats = drawn.array_entries
            for name in splats.dtype.names:
                entries[name][taken[of_entry == eye]] = splats[name][rows[of_entry == eye]]
        visits["place"], visits["fresh"], visits["final"] = v.place[mine], v.fresh[mine], v.final[mine]
        visits["sequence"] = self.batches.supertile[v.batch[mine]] & (1 << SEQUENCE_BITS) - 1
        if "eye" in visits.dtype.names:
            visits["eye"] = own
        return visits, entries
