"""Stimuli of the batch buffer: super-tiles and their places, and the visits that `spec.supertiles` wants of them, in plain
Python."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from rtl.supertiles.batch_masks import mask_places
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, SUPER_TILES, SUPER_X
from spec.formats import Fixed
from spec.joint import EYES, grid_origins
from spec.memory import splat_record
from spec.records import TILE_BITS, Record
from spec.supertiles import SEQUENCE_BITS, batch_place, supertile, tile_visit, visit_entry

_Item = TypeVar("_Item")

EVERY = (1 << SUPER_TILES) - 1
"""Mask of all tiles."""


@dataclass(frozen=True)
class Visit:
    """A visit as it is without early stops.

    Attributes:
        row: its TileVisit.
        entries: (N + 1,) VisitEntry, the last of them with `end` and otherwise 0.
        batch: number of its batch in the case.
    """

    row: np.void
    entries: np.ndarray
    batch: int


@dataclass(frozen=True)
class Batch:
    """A batch: the number of its super-tile, the numbers of its places, and whether it is the super-tile's last."""

    supertile: int
    places: list[int]
    final: bool


@dataclass(frozen=True)
class Case:
    """Super-tiles and their places.

    Attributes:
        name: the case's name, for messages.
        supertiles: (super-tiles,) SuperTile.
        places: (places,) BatchPlace, those of all super-tiles.
        joint: whether the frame is a joint one, with two SuperTile items for each super-tile.
        shift: its setting.
    """

    name: str
    supertiles: np.ndarray
    places: np.ndarray
    joint: bool = False
    shift: int = 0

    @property
    def eyes(self) -> int:
        """SuperTile items of a super-tile."""
        return EYES if self.joint else 1


@dataclass(frozen=True)
class Tiles:
    """A hand-made super-tile. In joint frames, the tiles of the target follow those of the source.

    Attributes:
        masks: the mask of each of its pairs.
        levels: level of each tile; one number for all.
        inside: tiles that lie in the frame.
    """

    masks: Sequence[int]
    levels: Sequence[int] = (0,) * SUPER_TILES
    inside: int = EVERY


def random_rows(record: Record, rng: np.random.Generator, count: int) -> np.ndarray:
    """(count,) rows of a record with random bits."""
    rows = np.zeros(count, record.dtype)
    for f in record.fields:
        low, high = f.raw_range if isinstance(f.format, Fixed) else (0, (1 << f.format.width) - 1)
        rows[f.name] = rng.integers(low, high + 1, rows[f.name].shape)
    return rows


def levels_of(mask: int, levels: Sequence[int]) -> list[int]:
    """The levels among the tiles of a mask, lowest first."""
    return sorted({int(levels[tile]) for tile in range(SUPER_TILES) if mask >> tile & 1})


def case_of(
    config: AcceleratorConfig, name: str, supertiles: Sequence[Tiles], seed: int, *, joint: bool = False, shift: int = 0,
) -> Case:
    """A case of super-tiles with random settings and random records."""
    rng, eyes = np.random.default_rng(seed), EYES if joint else 1
    rows = random_rows(supertile(config), rng, len(supertiles) * eyes)
    count = len(supertiles)
    rows["x"] = np.repeat(SUPER_X * rng.integers(0, (1 << TILE_BITS) // SUPER_X, count), eyes)
    rows["y"] = np.repeat(SUPER_TILES // SUPER_X * rng.integers(0, (1 << TILE_BITS) * SUPER_X // SUPER_TILES, count), eyes)
    rows["pairs"] = np.repeat([len(tiles.masks) for tiles in supertiles], eyes)
    rows["inside"] = [tiles.inside >> SUPER_TILES * eye & EVERY for tiles in supertiles for eye in range(eyes)]
    rows["level"] = np.array([tiles.levels for tiles in supertiles], np.int64).reshape(len(rows), SUPER_TILES)
    if config.joint:
        rows["eye"] = np.arange(len(rows)) % eyes
    found = [(eye, level, mask, last) for tiles in supertiles for pair in tiles.masks
             for (eye, mask, level), last in _with_last(_of_eyes(pair, tiles.levels, eyes))]
    places = np.zeros(len(found), batch_place(config).dtype)
    records = random_rows(splat_record(config), rng, len(found))
    for field in splat_record(config).fields:
        places[field.name] = records[field.name]
    if found:
        eye, places["level"], masks, places["last"] = np.array(found).T
        if config.joint:
            places["eye"] = eye
        places["mask"] = masks if config.streams == 1 else _of_streams(config, masks, places["last"], rng)
    places["bound"] = np.maximum(places["bound"], places["level"])  # tiles of higher levels have no pair
    return Case(name, rows, places, joint, shift)


def _of_streams(config: AcceleratorConfig, masks: np.ndarray, last: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(places, streams) random parts of each pair's mask, for all of its places the same; some are empty, some have all."""
    pair = np.concatenate(([0], np.cumsum(last)[:-1]))
    every = int(pair[-1]) + 1
    bits = rng.random((every, config.streams, SUPER_TILES)) < rng.choice([0.0, 0.5, 0.8, 1.0], (every, config.streams, 1))
    return (bits @ (1 << np.arange(SUPER_TILES)))[pair] & masks[:, None]


def _of_eyes(pair: int, levels: Sequence[int], eyes: int) -> list[tuple[int, int, int]]:
    """Eye, mask and level of each place of a pair, by its mask over the tiles of all eyes."""
    found = []
    for eye in range(eyes):
        mask = pair >> SUPER_TILES * eye & EVERY
        found += [(eye, mask, level) for level in levels_of(mask, levels[SUPER_TILES * eye :])]
    return found


def _with_last(places: list[_Item]) -> list[tuple[_Item, bool]]:
    return [(place, number == len(places) - 1) for number, place in enumerate(places)]


def _pairs(places: np.ndarray) -> list[list[int]]:
    """The places of each pair, by their numbers."""
    ends = np.flatnonzero(places["last"]) + 1
    return [list(range(first, stop)) for first, stop in zip([0, *ends[:-1]], ends, strict=True)]


def wanted_batches(config: AcceleratorConfig, case: Case) -> list[Batch]:
    """All batches of a case: one ends with a pair after which fewer than MAX_LEVELS places, for each eye, are free, or with the
    last pair."""
    pairs, batches = _pairs(case.places), []
    for number, tiles in enumerate(case.supertiles[:: case.eyes]):
        own, pairs = pairs[: tiles["pairs"]], pairs[tiles["pairs"] :]
        places: list[int] = []
        for pair in own[:-1]:
            places = places + pair
            if config.batch_places - len(places) < MAX_LEVELS * case.eyes:
                batches.append(Batch(number, places, False))
                places = []
        batches.append(Batch(number, places + [place for pair in own[-1:] for place in pair], True))
    return batches


def wanted_visits(config: AcceleratorConfig, case: Case, sequence: int = 0, stream: int = 0) -> list[Visit]:
    """All visits of a stream of a case without early stops. The first super-tile has number `sequence`."""
    visits: list[Visit] = []
    seen: set[tuple[int, int, int]] = set()
    for number, batch in enumerate(wanted_batches(config, case)):
        places = case.places[batch.places]
        masks = places["mask"].reshape(len(places), config.streams)[:, stream]
        for eye, tile in np.ndindex(case.eyes, SUPER_TILES):
            tiles = case.supertiles[batch.supertile * case.eyes + eye]
            mine = places[(masks >> tile & 1 == 1) & (places["level"] == tiles["level"][tile])]
            if config.joint:
                mine = mine[mine["eye"] == eye]
            if tiles["inside"] >> tile & 1 and (len(mine) or batch.final):
                fresh = (batch.supertile, eye, tile) not in seen
                row = _visit_row(config, tiles, tile, (sequence + batch.supertile) % (1 << SEQUENCE_BITS), fresh, batch.final)
                if config.joint:
                    row["eye"], row["tile_x"] = eye, (row["tile_x"] - grid_origins(case.shift)[eye]) % (1 << TILE_BITS)
                visits.append(Visit(row, _entries(config, mine, row, tiles["level"][tile]), number))
                seen.add((batch.supertile, eye, tile))
    return visits


def _visit_row(
    config: AcceleratorConfig, tiles: np.void, tile: int, sequence: int, fresh: bool, final: bool,
) -> np.void:
    row = np.zeros(1, tile_visit(config).dtype)[0]
    row["tile_x"], row["tile_y"] = tiles["x"] + tile % SUPER_X, tiles["y"] + tile // SUPER_X
    row["outer"], row["blend"] = tiles["level"][tile] > 0, tiles["blend"] >> tile & 1
    row["plane"] = tiles["plane"][3 * tile : 3 * tile + 3]
    row["place"], row["sequence"], row["fresh"], row["final"] = tile, sequence, fresh, final
    return row


def _entries(config: AcceleratorConfig, places: np.ndarray, visit: np.void, level: int) -> np.ndarray:
    """The entries of a visit with these places, and its end."""
    entries = np.zeros(len(places) + 1, visit_entry(config).dtype)
    for name in ("mean2d", "conic", "log2_opacity", "colour", "depth"):
        entries[name][:-1] = places[name]
    entries["use"][:-1, 0] = 1
    entries["use"][:-1, 1] = visit["blend"] & (places["bound"] > level)
    entries["end"][-1] = 1
    return entries


def random_tiles(rng: np.random.Generator, pairs: int, density: float, levels: int) -> Tiles:
    """A super-tile at random, some of them cut by the frame's edges. Each pair has at least one tile; `density` is the share of
    tiles that a pair has."""
    inside = EVERY
    if rng.random() < 0.3:  # the frame's last columns, its last row, or both
        columns = int(rng.integers(1, SUPER_X + 1))
        row = (1 << columns) - 1
        inside = row | (row << SUPER_X if rng.random() < 0.5 else 0)
    lie = np.flatnonzero([inside >> tile & 1 for tile in range(SUPER_TILES)])
    found = rng.random((pairs, len(lie))) < density
    found[np.arange(pairs), rng.integers(0, len(lie), pairs)] = True
    masks = (found << lie).sum(1).tolist()
    lowest = int(rng.integers(0, MAX_LEVELS - levels + 1))
    return Tiles(masks, rng.integers(lowest, lowest + levels, SUPER_TILES).tolist(), inside)


def random_case(
    config: AcceleratorConfig, name: str, seed: int, *, supertiles: int = 12, mean_pairs: float | None = None,
    density: float | None = None,
) -> Case:
    """A case of random super-tiles. `mean_pairs` defaults to what fills 1.5 batches."""
    rng = np.random.default_rng(seed)
    mean = 1.5 * config.batch_places if mean_pairs is None else mean_pairs
    made = []
    for _ in range(supertiles):
        pairs = 0 if rng.random() < 0.15 else int(rng.exponential(mean))
        share = float(rng.choice([0.0, 0.1, 0.3, 0.9])) if density is None else density
        made.append(random_tiles(rng, pairs, share, int(rng.integers(1, MAX_LEVELS))))
    return case_of(config, name, made, seed)


def _empty(config: AcceleratorConfig) -> Case:
    """Empty super-tiles in rows, whole ones and such with a single tile in the frame, between others."""
    return case_of(config, "empty super-tiles", [
        *[Tiles([])] * 5, Tiles([1]), *[Tiles([], inside=1)] * 30, Tiles([3, 1], inside=3), Tiles([]), Tiles([EVERY]),
        *[Tiles([], inside=0x0101)] * 3], 1)


def _short(config: AcceleratorConfig) -> Case:
    """Super-tiles of one pair each: of one tile, of all tiles, and of all levels."""
    return case_of(config, "single pairs", [
        *[Tiles([1 << tile]) for tile in range(SUPER_TILES)], *[Tiles([EVERY])] * 6,
        *[Tiles([EVERY], (0, 1, 2, 3) * 4)] * 6, *[Tiles([1], inside=1)] * 20], 2)


def _boundaries(config: AcceleratorConfig) -> Case:
    """Super-tiles whose last pair ends a full batch, comes one pair later, or has as many levels as there are places."""
    most, free, levels = config.batch_places, MAX_LEVELS - 1, (0, 1, 2, 3) * 4
    ends = [most - free, most - free + 1, 2 * (most - free), 2 * (most - free) - 1, 2 * (most - free) + 1, most - free - 1]
    full = [[1] * n + [0xF] + [2] * 3 for n in range(most - MAX_LEVELS - 3, most - MAX_LEVELS + 1)]
    last = [[1] * n + [0xF] for n in range(most - MAX_LEVELS - 3, most - MAX_LEVELS + 1)]
    return case_of(config, "ends of batches", [
        *[Tiles([0x11] * n) for n in ends], *[Tiles(masks, levels) for masks in (*full, *last)],
        Tiles([0xFF] * (most // MAX_LEVELS * 2 + 1), levels)], 3)


def _sparse(config: AcceleratorConfig) -> Case:
    """Tiles with a single place in every word, in the first or the last word alone, and in all but one place."""
    most = config.batch_places - MAX_LEVELS + 1
    once = [1 << (k // 32 % SUPER_TILES) if k % 32 == 7 else 2 << (k % 3) for k in range(most)]
    ends = [1 if k == 0 else 0x8000 if k == most - 1 else 0x10 for k in range(most)]
    but_one = [EVERY & ~(1 << k % SUPER_TILES) for k in range(most)]
    return case_of(config, "sparse words", [Tiles(masks) for masks in (once, ends, but_one, [0x8000] * 3, once)], 4)


def _one_tile(config: AcceleratorConfig) -> Case:
    """One tile has all places of many batches, the others none; and the same in a frame of one tile."""
    count = 3 * config.batch_places
    return case_of(config, "one tile", [Tiles([0x20] * count), Tiles([1] * count, inside=1)], 5)


DIRECTED: tuple[Callable[[AcceleratorConfig], Case], ...] = (_empty, _short, _boundaries, _sparse, _one_tile)
"""Cases made by hand."""


def place_behind_word(config: AcceleratorConfig) -> Case:
    """The places of a whole word of masks are of one tile or of two tiles, and one more place ends the batch, while these
    masks are still to be written."""
    size = mask_places(config)
    sets = [1 << tile for tile in range(SUPER_TILES)]
    sets += [1 << tile | 1 << tile + far for far in (1, 2, 4, 8) for tile in range(SUPER_TILES - far)]
    return case_of(config, "a place behind a whole word", [Tiles([mask] * size + [EVERY & ~mask]) for mask in sets], 6)


def few_entries(config: AcceleratorConfig) -> Case:
    """Super-tiles of one tile in the frame, which has a whole word of masks and one place more: where the tile stops early,
    filling takes longer than dealing."""
    count = mask_places(config) + 1
    return case_of(config, "filling takes longer than dealing", [
        Tiles([1 << tile] * count, inside=1 << tile) for tile in range(SUPER_TILES) for _ in range(20)], 7)


def one_stream(config: AcceleratorConfig, stream: int) -> Case:
    """All places are of tiles of one stream: some fill words of masks, some have a few places in a word and in the next."""
    size, last = mask_places(config), 1 << SUPER_TILES - 1
    full = config.batch_places - MAX_LEVELS + 1
    short = [EVERY if place % size < 8 else last for place in range(full)]
    tiles = [[EVERY] * full, short] * 2
    case = case_of(config, f"stream {stream} alone", [Tiles(masks) for masks in tiles], 8)
    masks = np.zeros_like(case.places["mask"])
    masks[:, stream] = np.concatenate(tiles)
    case.places["mask"] = masks
    return case
