"""Stimuli of the tile lists: the tables that the host has written to memory, and intersections in the order of arrival."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.tile_lists import TileLists, entry_words, grouped_entries, tile_lists
from golden.msv2_ref.tile_merge import count_tiles, tile_groups
from spec.config import AcceleratorConfig
from spec.memory import (
    BEAT_BITS,
    BEAT_BYTES,
    BEAT_ENTRIES,
    DIRECTORY_BEATS,
    FIRST_PAGE_BEATS,
    FIRST_PAGE_ENTRIES,
    TILE_SETTING_BYTES,
    WORDS,
    tile_setting,
    write_request,
)
from spec.packing import pack
from spec.records import (
    INDEX_BITS,
    Record,
    gaussian_geometry,
    gaussian_point,
    intersection,
    intersection_item,
    tile_header,
    tile_level,
    tile_use,
)
from tb.tile_lists.device import load_item
from tb.tile_lists.memory import ADDRESS_BITS

BOUNDARIES = (0, 1, 3, 4, 5, 31, 32, 33, 95, 96, 97, 223, 224, 225)
"""Counts around those at which a page or a beat is full."""

LONG_BOUNDARIES = tuple(
    FIRST_PAGE_ENTRIES * ((1 << pages) - 1) + more for pages in range(4, 12) for more in (0, 1) if more or pages < 10)
"""The same of lists of 4 to 12 pages; those of more than 9 have a second beat of pointers."""


@dataclass(frozen=True)
class Case:
    """Consecutive frames of one shape.

    Attributes:
        name: the case's name, for messages.
        tiles_x, tiles_y: the numbers of tile columns and rows.
        frames: for each frame (intersections,) Intersection records in the order of arrival.
        table: (tiles,) TileSetting records.
        geometry: (gaussians,) GaussianGeometry records.
        beta: the merge threshold.
        entries_beats: the size of the lists' memory region in beats; None for as much as is needed.
        latency: the memory's latency in cycles.
        hesitates: in how many of 256 cycles the memory accepts no request.
        bad: the region whose first beat is answered with an error ("entries", "tiles", "geometry", "directory").
        origin: the first beat of all regions.
    """

    name: str
    tiles_x: int
    tiles_y: int
    frames: tuple[np.ndarray, ...]
    table: np.ndarray
    geometry: np.ndarray
    beta: int = 100
    entries_beats: int | None = None
    latency: int = 100
    hesitates: int = 0
    bad: str | None = None
    origin: int = 0x1234567
    lists: list[TileLists] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.entries_beats is None:
            free = max(tile_lists(frame["tile"], self.tiles, 1 << 26).beats for frame in self.frames)
            object.__setattr__(self, "entries_beats", free)
        object.__setattr__(self, "lists", [tile_lists(f["tile"], self.tiles, self.entries_beats) for f in self.frames])
        used = sum(self._sizes.values()) - self._sizes["entries"] + max(where.beats for where in self.lists)
        if used > 1 << ADDRESS_BITS - 1:
            raise ValueError(f"case must fit {1 << ADDRESS_BITS - 1} beats, not {used!r}")

    @property
    def tiles(self) -> int:
        """Number of tiles of a frame."""
        return self.tiles_x * self.tiles_y

    @property
    def _sizes(self) -> dict[str, int]:
        table = -(-self.tiles * TILE_SETTING_BYTES // BEAT_BYTES)
        return {"geometry": len(self.geometry) + 1, "tiles": table + 1, "directory": self.tiles * DIRECTORY_BEATS + 1,
                "entries": max(self.entries_beats, 1)}

    @property
    def bases(self) -> dict[str, int]:
        """The first beat of each region."""
        starts = np.cumsum([self.origin, *list(self._sizes.values())[:-1]]).tolist()
        return dict(zip(self._sizes, starts, strict=True))

    @property
    def settings(self) -> dict[str, int]:
        """Values of the device's plain inputs."""
        return {
            "tiles_x": self.tiles_x, "tile_count": self.tiles, "beta": self.beta, "entries_beats": self.entries_beats,
            "gaussians": len(self.geometry), **{f"{name}_base": base for name, base in self.bases.items()},
            "latency": self.latency, "hesitates": self.hesitates, "bad": self.bases[self.bad] if self.bad else 0}

    def inputs(self, config: AcceleratorConfig) -> dict[str, np.ndarray]:
        """The beats that the host writes, and the intersections."""
        bases = self.bases
        beats = [(bases["geometry"], _words(gaussian_geometry(config), self.geometry, 1)),
                 (bases["tiles"], _words(tile_setting(config), self.table, BEAT_BYTES // TILE_SETTING_BYTES))]
        load = np.zeros(sum(len(words) for _, words in beats) + 1, load_item(config).dtype)
        load["beat"][:-1] = np.concatenate([base + np.arange(len(words)) for base, words in beats])
        load["word"][:-1] = np.concatenate([words for _, words in beats])
        load["strobe"][:-1], load["frames"][-1] = (1 << WORDS) - 1, len(self.frames)
        items = np.zeros(sum(len(frame) + 1 for frame in self.frames), intersection_item(config).dtype)
        items["end"][np.cumsum([len(frame) + 1 for frame in self.frames]) - 1] = 1
        for f in intersection(config).fields:
            items[f.name][items["end"] == 0] = np.concatenate([frame[f.name] for frame in self.frames])
        return {"load": load, "entries": items}

    def expected(self, config: AcceleratorConfig) -> dict[str, np.ndarray]:
        """Rows of the output streams."""
        groups, lists, headers, uses = [], [], [], []
        for frame, where in zip(self.frames, self.lists, strict=True):
            rows = tile_groups(config, count_tiles(where.hits, self.tiles)[0], self.tiles_x, self.beta)
            groups.append(rows)
            lists.append(grouped_entries(config, frame[where.written], rows))
            headers.append(np.zeros(self.tiles, tile_header(config).dtype))
            uses.append(np.zeros(self.tiles, tile_use(config).dtype))
            headers[-1]["tile_y"], headers[-1]["tile_x"] = np.divmod(np.arange(self.tiles), self.tiles_x)
            headers[-1]["outer"] = self.table["level"] > 0
            for name, rows_of in (("blend", headers), ("plane", headers), ("blend", uses), ("level", uses)):
                rows_of[-1][name] = self.table[name]
            headers[-1]["count"] = uses[-1]["count"] = rows["count"]
        levels = np.zeros(self.tiles, tile_level(config).dtype)
        levels["tile"], levels["level"], levels["blend"] = np.arange(self.tiles), self.table["level"], self.table["blend"]
        points = np.zeros(len(self.geometry) + 1, gaussian_point(config).dtype)
        for f in gaussian_geometry(config).fields:
            points[f.name][:-1] = self.geometry[f.name]
        points["index"], points["end"][-1] = np.arange(len(points)), 1
        return {
            "written": np.concatenate([self._writes(config, *pair) for pair in zip(self.frames, self.lists, strict=True)]),
            "groups": np.concatenate(lists), "headers": np.concatenate(headers), "uses": np.concatenate(uses),
            "levels": levels, "points": points}

    def _writes(self, config: AcceleratorConfig, entries: np.ndarray, where: TileLists) -> np.ndarray:
        """The writer's requests: one for each intersection, and before it one for the directory entry where it begins a page.
        The data of a request is repeated in all words of the beat."""
        number, count = where.number[where.written], int(where.written.sum())
        words = entry_words(config, entries)[where.written]
        rows = np.zeros(count + len(where.page_beat), write_request(config).dtype)
        place = np.arange(count) + np.cumsum(np.isin(number, where.page_beat * BEAT_ENTRIES))
        rows["beat"][place] = (self.bases["entries"] + number // BEAT_ENTRIES) % (1 << BEAT_BITS)
        rows["word"][place] = np.tile(words, BEAT_ENTRIES)
        rows["strobe"][place] = 3 << 2 * (number % BEAT_ENTRIES)
        page = np.setdiff1d(np.arange(len(rows)), place)
        rows["beat"][page] = self.bases["directory"] + where.page_tile * DIRECTORY_BEATS + where.page_slot // WORDS
        rows["word"][page] = where.page_beat[:, None]
        rows["strobe"][page] = 1 << where.page_slot % WORDS
        return rows

    def observed(self) -> dict[str, int]:
        """The plain outputs at the end."""
        return {
            "full": self.lists[-1].full, "list_error": self.bad in ("entries", "directory"),
            "header_error": self.bad == "tiles", "table_error": self.bad == "tiles", "geometry_error": self.bad == "geometry",
            "writer_busy": 0, "merge_busy": 0}


def _words(record: Record, rows: np.ndarray, per_beat: int) -> np.ndarray:
    """(beats, WORDS) uint32: `per_beat` records per beat, each at the start of its share of the beat."""
    share = pack(record, rows, BEAT_BYTES // per_beat)
    return np.pad(share, ((0, -len(rows) % per_beat), (0, 0))).reshape(-1, BEAT_BYTES).view("<u4")


def random_rows(record: Record, rng: np.random.Generator, count: int) -> np.ndarray:
    """Records with random values in every field."""
    rows = np.zeros(count, record.dtype)
    for f in record.fields:
        rows[f.name] = rng.integers(*f.raw_range, size=rows[f.name].shape, endpoint=True)
    return rows


def random_entries(config: AcceleratorConfig, rng: np.random.Generator, tile: np.ndarray) -> np.ndarray:
    """Random intersections of these tiles."""
    rows = random_rows(intersection(config), rng, len(tile))
    rows["tile"] = tile
    return rows


def case(
    config: AcceleratorConfig, rng: np.random.Generator, name: str, tiles_x: int, tiles_y: int, frames: Sequence[np.ndarray],
    *, gaussians: int = 50, **options: object,
) -> Case:
    """Frames given by the tiles of their intersections; everything else is drawn."""
    entries = tuple(random_entries(config, rng, np.asarray(tile, np.int64)) for tile in frames)
    origin = int(rng.integers(1, 1 << 26))
    return Case(
        name, tiles_x, tiles_y, entries, random_rows(tile_setting(config), rng, tiles_x * tiles_y),
        random_rows(gaussian_geometry(config), rng, gaussians), origin=origin, **options)


def mixed_tiles(rng: np.random.Generator, counts: Sequence[int]) -> np.ndarray:
    """Tiles of intersections, so that each tile has its count, in random order with runs of one tile."""
    tile = np.repeat(np.arange(len(counts)), counts)
    rng.shuffle(tile)
    for _ in range(len(tile) // 16):
        at = int(rng.integers(len(tile)))
        tile[at : at + 8].sort()
    return tile


_ROOM_BITS = BEAT_BITS - FIRST_PAGE_BEATS.bit_length()
"""Powers of two of free units are below this one, so that the region has less beats than a beat's number can tell."""


def page_rooms() -> list[tuple[int, int]]:
    """Numbers of free units beyond a list's first page, each with a count whose last entry begins a page. The page just fits,
    lacks one unit, or meets a power of two of free units."""
    found = []
    for pages in range(1, 8):
        before, last = (1 << pages) - 2, 1 << pages
        bits = range(pages + 1, _ROOM_BITS) if pages < 5 else ()
        units = [before + last, before + last - 1, *(before + (1 << bit) for bit in bits)]
        found += [(unit, FIRST_PAGE_ENTRIES * (last - 1) + 1) for unit in units]
    return found


def random_counts(rng: np.random.Generator, tiles: int) -> np.ndarray:
    """Counts over several orders of magnitude, counts around the ends of pages, and empty tiles."""
    counts = np.exp(rng.normal(2.5, 1.5, tiles)).astype(np.int64)
    return np.where(rng.random(tiles) < 0.3, rng.choice(BOUNDARIES, tiles), counts * (rng.random(tiles) < 0.7))


def traced_case(config: AcceleratorConfig, frame: Frame, name: str, beta: int) -> Case:
    """A traced frame with its intersections in the order of their Gaussians."""
    entries, registers = frame.entries, frame.registers
    rows = np.zeros(len(entries.splat), intersection(config).dtype)
    rows["tile"] = np.repeat(np.arange(len(entries.start) - 1), np.diff(entries.start))
    rows["index"], rows["depth_key"] = entries.splat, frame.projected.depth_key[entries.splat]
    table = np.zeros(len(registers.header), tile_setting(config).dtype)
    table["level"], table["blend"], table["plane"] = registers.header[:, 0], registers.header[:, 1], registers.plane
    return Case(
        name, registers.tiles_x, len(table) // registers.tiles_x, (rows[np.lexsort((rows["tile"], rows["index"]))],), table,
        frame.words.geometry[: 1 << min(INDEX_BITS, 14)], beta)

