"""Frames for the array of machines with super-tiles: frames of `tb.vrc_array.array_stimuli`, whose tiles' lists are split into
batches at random."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from golden.msv2_ref.array import render_tiles
from golden.msv2_ref.regions import region_of
from spec import tables
from spec.config import AcceleratorConfig
from spec.constants import AMP_MAX, SUPER_TILES
from spec.supertiles import SEQUENCE_BITS, batch_tiles, tile_visit, visit_entry
from tb.vrc_array.array_stimuli import Case, TileSpec, flat_entries, frame, random_entries, random_plane


@dataclass(frozen=True)
class Visits:
    """A frame as visits.

        case: the tiles whose pixels must come, with all of their intersections.
        visits: TileVisit records.
        entries: VisitEntry records, with the `end` of every visit.
        done: tiles of the last super-tile that must be known to have stopped at the end, one bit each.
        quarter: with streams, the quarter of the tiles that the array renders.
    """

    case: Case
    visits: np.ndarray
    entries: np.ndarray
    done: int
    quarter: int = 0

    @property
    def eyes(self) -> np.ndarray:
        """(tiles,) the eye of each tile of `case`, in order."""
        return self.visits["eye"][self.visits["final"] == 1]


def split(
    config: AcceleratorConfig, case: Case, seed: int, *, tiles: int | None = None, batches: int = 4, unfinished: bool = False,
) -> Visits:
    """Splits the lists of a case's tiles, taken as those of super-tiles.

    Args:
        config: the machine.
        case: the frame.
        seed: seed of all choices: places of the tiles, numbers of batches, and where lists are split.
        tiles: most tiles of a super-tile, of both eyes in a machine with joint frames; None for all.
        batches: most batches of a super-tile.
        unfinished: whether the last super-tile only has visits whose states are stored. Its pixels are not in the result's
            case.
    """
    rng, quarter = np.random.default_rng(seed), seed % config.streams
    tiles = batch_tiles(config) if tiles is None else tiles
    start = np.concatenate(([0], np.cumsum(case.headers["count"], dtype=np.int64)))
    visits, entries, done, first, sequence = [], [], 0, 0, int(rng.integers(1 << SEQUENCE_BITS))
    while first < len(case.headers):
        end = min(first + int(rng.integers(1, tiles + 1)), len(case.headers))
        keeps = unfinished and end == len(case.headers)
        places = np.sort(rng.choice(batch_tiles(config), end - first, replace=False)).tolist()
        parts = int(rng.integers(1, batches + 1)) + keeps
        cuts = [np.sort(np.concatenate(([start[t], start[t + 1]], rng.integers(start[t], start[t + 1] + 1, parts - 1))))
                for t in range(first, end)]
        seen: set[int] = set()
        for batch in range(parts - keeps):
            final = batch == parts - 1
            for k, place in enumerate(places):
                chosen = case.entries[cuts[k][batch] : cuts[k][batch + 1]]
                if final or len(chosen) or rng.random() < 0.1:
                    visits.append(_visit(config, case.headers[first + k], place, sequence, place not in seen, final))
                    entries.append(_closed(config, chosen))
                    seen.add(place)
                    if keeps:
                        so_far = case.entries[start[first + k] : cuts[k][batch + 1]]
                        done |= _stopped(config, case.headers[first + k], so_far, quarter) << place
        if keeps:
            case = replace(case, headers=case.headers[:first], entries=case.entries[: start[first]])
        first, sequence = end, (sequence + 1) % (1 << SEQUENCE_BITS)
    return Visits(case, np.concatenate(visits), np.concatenate(entries), done, quarter)


def _visit(config: AcceleratorConfig, header: np.void, place: int, sequence: int, fresh: bool, final: bool) -> np.ndarray:
    visit = np.zeros(1, tile_visit(config).dtype)
    for name in visit.dtype.names:
        if name in header.dtype.names:
            visit[name] = header[name]
    visit["place"], visit["sequence"], visit["fresh"], visit["final"] = place % SUPER_TILES, sequence, fresh, final
    if config.joint:
        visit["eye"] = place // SUPER_TILES
    return visit


def _closed(config: AcceleratorConfig, splats: np.ndarray) -> np.ndarray:
    """The intersections of a visit with its `end`, whose other fields mean nothing: they are those of the last intersection."""
    entries = np.zeros(len(splats) + 1, visit_entry(config).dtype)
    for name in splats.dtype.names:
        entries[name][:-1] = splats[name]
        if len(splats):
            entries[name][-1] = splats[name][-1]
    entries["end"][-1] = 1
    return entries


def _stopped(config: AcceleratorConfig, header: np.void, splats: np.ndarray, quarter: int) -> bool:
    """Whether these intersections have stopped all pixels of a tile, or of its quarter, by the golden renderer's transmittances
    of each level."""
    one = np.array([header])
    one["count"] = len(splats)
    background = np.zeros(3, np.int64)
    if not header["blend"]:
        levels = [render_tiles(config, one, splats, background)]
    else:
        levels = []
        for corner in (0, 1 << config.formats.plane.frac_bits):  # weights of 0 and 1
            one["plane"] = corner, 0, 0
            levels.append(render_tiles(config, one, splats, background))
    part = region_of(config, quarter)
    return all((level.transmittance[:, *part] < tables.t_stop(config.formats)).all() for level in levels)


def stopping_case(config: AcceleratorConfig, name: str, seed: int, tiles: int = 32) -> Case:
    """Tiles that stop early: in both levels, in one of them, in all pixels but a few, or not at all."""
    rng, made = np.random.default_rng(seed), []
    for k in range(tiles):
        x, y = rng.integers(0, 60, 2).tolist()
        wall = flat_entries(config, [0] * int(rng.integers(1, 4)))
        wall["use"] = [(1, 1), (1, 0), (0, 1), (1, 1)][k % 4]
        if k % 8 == 3:  # opaque in the middle only
            wall[:] = random_entries(config, rng, len(wall), x, y)
            wall["log2_opacity"] = config.formats.log2_opacity.quantise(np.log2(AMP_MAX))
        around = [random_entries(config, rng, int(rng.integers(0, 24)), x, y) for _ in range(2)]
        made.append(TileSpec(np.concatenate([around[0], wall, around[1]]), x, y, 1, int(rng.random() < 0.5),
                             random_plane(config, rng)))
    return frame(config, name, made, rng.integers(0, config.formats.colour.raw_max + 1, 3))
