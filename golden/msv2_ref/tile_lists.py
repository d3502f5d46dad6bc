"""Tile lists in memory: to which page and beat each intersection goes, and how they are read back (`spec.memory`, "Pages")."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES
from spec.memory import BEAT_ENTRIES, DIRECTORY_BEATS, DIRECTORY_SLOTS, FIRST_PAGE_BEATS, WORDS, entry_page
from spec.packing import pack
from spec.records import chunk_item, intersection


@dataclass(frozen=True)
class TileLists:
    """Where a frame's intersections lie in memory.

    Attributes:
        tiles: number of tiles in the frame.
        tile: (E,) int64 tile of each intersection, in the order of arrival.
        written: (E,) bool: whether it lies in memory. False outside the frame, and from the first one on for which no page was
            left.
        full: whether an intersection found no page.
        number: (E,) int64 place of each intersection relative to the base of the region, in intersections; 0 where not written.
        page_tile, page_slot, page_beat: (pages,) int64, the pages beyond the first ones in the order in which they were handed
            out: the page's tile, its slot in that tile's directory, and its first beat relative to the region's base.
    """

    tiles: int
    tile: np.ndarray
    written: np.ndarray
    full: bool
    number: np.ndarray
    page_tile: np.ndarray
    page_slot: np.ndarray
    page_beat: np.ndarray

    @property
    def beats(self) -> int:
        """Number of beats that were handed out, including first pages."""
        return FIRST_PAGE_BEATS * (self.tiles + int((2 << self.page_slot).sum()))

    @property
    def hits(self) -> np.ndarray:
        """The tile of each intersection that is passed on to the tile merge unit: all except those in the frame that were
        not written."""
        return self.tile[self.written | (self.tile >= self.tiles)]


def rank_in_tile(tile: np.ndarray) -> np.ndarray:
    """(E,) int64: for each intersection, how many of the same tile came before it."""
    order = np.argsort(tile, kind="stable")
    starts = np.flatnonzero(np.diff(tile[order], prepend=-1))
    rank = np.empty(len(tile), np.int64)
    rank[order] = np.arange(len(tile)) - np.repeat(starts, np.diff(np.append(starts, len(tile))))
    return rank


def tile_lists(tile: np.ndarray, tiles: int, entries_beats: int, slots: int = DIRECTORY_SLOTS) -> TileLists:
    """Assigns pages and places to intersections.

    Args:
        tile: (E,) tile of each intersection, in the order of arrival; numbers from `tiles` on are outside the frame.
        tiles: number of tiles in the frame.
        entries_beats: number of beats reserved for the pages.
        slots: number of pages that a tile may have beyond its first.
    """
    tile = np.asarray(tile, np.int64)
    inside, rank = tile < tiles, rank_in_tile(tile)
    page, place = entry_page(rank)
    begins = inside & (page > 0) & (place == 0)
    room_after = entries_beats - FIRST_PAGE_BEATS * (tiles + np.cumsum(np.where(begins, 1 << page, 0)))
    no_first = entries_beats < FIRST_PAGE_BEATS * tiles
    fails = np.flatnonzero(inside & ((begins & ((page > slots) | (room_after < 0))) | no_first))
    stop = int(fails[0]) if len(fails) else len(tile)
    written = inside & (np.arange(len(tile)) < stop)
    opened = np.flatnonzero(begins & written)
    page_beat = entries_beats - room_after[opened] - FIRST_PAGE_BEATS * (1 << page[opened])

    base = np.zeros((tiles, slots + 1), np.int64)
    base[:, 0] = FIRST_PAGE_BEATS * np.arange(tiles)
    base[tile[opened], page[opened]] = page_beat
    number = np.zeros(len(tile), np.int64)
    w = np.flatnonzero(written)
    number[w] = base[tile[w], page[w]] * BEAT_ENTRIES + place[w]
    return TileLists(tiles, tile, written, bool(len(fails)), number, tile[opened], page[opened] - 1, page_beat)


def entry_words(config: AcceleratorConfig, entries: np.ndarray) -> np.ndarray:
    """(entries, 2) uint32: Intersection records, or records that begin as one, as they lie in memory."""
    return pack(intersection(config), entries, ENTRY_BYTES).view("<u4")


def memory_image(config: AcceleratorConfig, lists: TileLists, entries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the tile lists of a frame leave in memory: pages and directory, (beats, WORDS) uint32 each; 0 where nothing was
    written.

    Args:
        config: the machine.
        lists: where the intersections lie.
        entries: (E,) Intersection records in the order of arrival.
    """
    pages = np.zeros((lists.beats, BEAT_ENTRIES, WORDS // BEAT_ENTRIES), np.uint32)
    pages.reshape(-1, WORDS // BEAT_ENTRIES)[lists.number[lists.written]] = entry_words(config, entries)[lists.written]
    directory = np.zeros((lists.tiles, DIRECTORY_SLOTS), np.uint32)
    directory[lists.page_tile, lists.page_slot] = lists.page_beat
    return pages.reshape(-1, WORDS), directory.reshape(lists.tiles * DIRECTORY_BEATS, WORDS)


def grouped_entries(config: AcceleratorConfig, entries: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """(E,) ChunkItem records by group and tile, within a tile in the order of arrival. Groups without intersections give none.

    Args:
        config: the machine.
        entries: (E,) Intersection records in the order of arrival.
        groups: (tiles,) TileGroup records with the counts of these intersections.
    """
    rows = np.zeros(len(entries), chunk_item(config).dtype)
    ordered = entries[np.argsort(entries["tile"], kind="stable")]
    for f in intersection(config).fields:
        rows[f.name] = ordered[f.name]
    ends = np.cumsum(groups["count"].astype(np.int64))[groups["last"] == 1]
    rows["last"][np.unique(ends[ends > 0]) - 1] = 1
    return rows
