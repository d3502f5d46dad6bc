"""A frame's trace on a particular machine with lists by super-tile: its lists, groups, header misses, batches and visits, and
where everything lies in memory."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from golden.host.memory_image import lay_out
from golden.msv2_ref.batches import Batches, cut_batches
from golden.msv2_ref.buckets import Bounds, list_numbers, next_bounds
from golden.msv2_ref.fetch import find_misses
from golden.msv2_ref.supertiles import merge_lists
from golden.msv2_ref.tile_lists import rank_in_tile
from perf.kernel import kernel
from perf.plan import SortPlan, sort_plan
from perf.supertiles_trace import SuperTrace
from perf.warp_trace import WarpedTrace
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, SUPER_TILES
from spec.memory import (
    BEAT_BYTES,
    BEAT_ENTRIES,
    DIRECTORY_BEATS,
    DISPLAY_PIXEL_BYTES,
    FIRST_PAGE_BEATS,
    FIRST_PAGE_ENTRIES,
    PIXEL_BYTES,
    TILE_SETTING_BYTES,
    WORDS,
    colour_beats,
    pages_beyond_first,
)
from spec.packed import packed_beats
from spec.records import frame_lists
from spec.supertiles import HEADER_WAYS

BEGINS, FILLS = 1, 2
"""Bits of `ListsPlan.pair_writes`: a pair begins a page other than its list's first one; a pair fills a beat."""


@dataclass(frozen=True)
class ListsPlan:
    """The lists of a frame.

    Attributes:
        number: (pairs,) int64, in rendering order, the list of each pair. counts: (lists,) int64.
        ends: (lists,) bool, whether a list is the last one of its super-tile.
        rank: (pairs,) int32, in rendering order: the place in the list in memory.
        pair_writes: (pairs + 1,) uint8, in the order of arrival: BEGINS, FILLS or both.
        writes: the beats that the pair writer writes, in turn: those of pairs relative to the region's base, and directory
            words as -1 - beat. The last of them are those of lists with a beat that is not full, by falling number.
        flushed: (lists,) uint8, by falling number, whether a list has such a beat.
        page_beat: the first beat of each page beyond the first ones, by list and slot.
        page_start: (lists + 1,) the place in `page_beat` where each list's pages begin.
        beats: the beats that the pages take.
    """

    number: np.ndarray
    counts: np.ndarray
    ends: np.ndarray
    rank: np.ndarray
    pair_writes: np.ndarray
    writes: np.ndarray
    flushed: np.ndarray
    page_beat: np.ndarray
    page_start: np.ndarray
    beats: int

    def overflow(self, capacity: int) -> int:
        """The pairs in lists with more than `capacity` pairs."""
        return int(self.counts[self.counts > capacity].sum())


def steady_bounds(trace: SuperTrace, config: AcceleratorConfig) -> Bounds:
    """The bounds that a frame leaves for the next one. They are those of an unmoved camera."""
    return next_bounds(config, trace.start, trace.key)


def lists_plan(trace: SuperTrace, bounds: Bounds) -> ListsPlan:
    """The lists of a frame with the bounds of the frame before."""
    number = list_numbers(bounds, trace.supertile, trace.key)
    counts = np.bincount(number, minlength=bounds.lists)
    ends = np.zeros(bounds.lists, bool)
    ends[bounds.first[1:] - 1] = True
    coming = number[trace.arrival]
    rank = np.empty(trace.pairs, np.int32)
    rank[trace.arrival] = rank_in_tile(coming)
    start = np.concatenate(([0], np.cumsum(pages_beyond_first(counts))))
    page_beat = np.zeros(int(start[-1]) + 1, np.int64)
    kinds = np.zeros(trace.pairs + 1, np.uint8)
    writes = np.zeros(int(start[-1]) + trace.pairs + bounds.lists + 1, np.int64)
    flushed = np.zeros(bounds.lists, np.uint8)
    made, beats = _pages(coming, start, kinds, writes, page_beat, flushed)
    return ListsPlan(number, counts, ends, rank, kinds, writes[:made].copy(), flushed, page_beat, start, int(beats))


@kernel
def _pages(number, page_start, kinds, writes, page_beat, flushed):
    """Allocates pages in the order of the pairs; returns the number of writes, and of beats that the pages take."""
    lists, at = len(page_start) - 1, 0
    beats = lists * FIRST_PAGE_BEATS
    place, base, page = np.full(lists, FIRST_PAGE_ENTRIES, np.int64), np.empty(lists, np.int64), page_start[:-1].copy()
    for i in range(lists):
        base[i] = (i - 1) * FIRST_PAGE_ENTRIES  # in pairs; as if the page followed one as long as all before it
    for i in range(len(number)):
        to = number[i]
        if place[to] > FIRST_PAGE_ENTRIES and place[to] & (place[to] - 1) == 0:
            kinds[i] |= BEGINS
            writes[at] = -1 - (DIRECTORY_BEATS * to + (page[to] - page_start[to]) // WORDS)
            page_beat[page[to]], base[to] = beats, beats * BEAT_ENTRIES - place[to]
            beats += place[to] // BEAT_ENTRIES
            page[to] += 1
            at += 1
        if place[to] % BEAT_ENTRIES == BEAT_ENTRIES - 1:
            kinds[i] |= FILLS
            writes[at] = (base[to] + place[to]) // BEAT_ENTRIES
            at += 1
        place[to] += 1
    for k in range(lists):
        to = lists - 1 - k
        if place[to] % BEAT_ENTRIES:
            flushed[k] = 1
            writes[at] = (base[to] + place[to]) // BEAT_ENTRIES
            at += 1
    return at, beats


@dataclass(frozen=True)
class VisitPlan:
    """The batches of a frame, and the visits of a machine in which no tile stops. Visits and entries are numbered stream by
    stream.

    Attributes:
        batch_supertile: (batches,) the super-tile of each batch. batch_places: (batches,) the items that fill it: its places,
            and the ends of pairs without a place.
        batch_visit: (streams, batches + 1) the first visit of each batch.
        visit_tile: (visits,) the tile. visit_final: (visits,) uint8, whether it is the tile's last visit of the stream.
        visit_entry: (visits + 1,) the first entry of each visit. visit_seen: (visits,) the stream's entries of the tile before
            it.
        use: (entries,) uint8, by visit: as in `Intersections`. slot: (entries,) int32, the place in the batch.
        drawn: (tiles,) the tiles in the order of their last visits, which is that of every stream.
    """

    batch_supertile: np.ndarray
    batch_places: np.ndarray
    batch_visit: np.ndarray
    visit_tile: np.ndarray
    visit_final: np.ndarray
    visit_entry: np.ndarray
    visit_seen: np.ndarray
    use: np.ndarray
    slot: np.ndarray
    drawn: np.ndarray


def visit_plan(trace: SuperTrace, config: AcceleratorConfig) -> VisitPlan:
    """The batches and visits of a frame on a machine."""
    batches = cut_batches(trace.start, trace.places, config.batch_places, trace.eyes * MAX_LEVELS)
    batch = np.repeat(np.arange(len(batches.supertile)), np.diff(batches.start))
    places = np.bincount(batch, trace.places, len(batches.supertile)).astype(np.int64)
    ahead = np.cumsum(trace.places, dtype=np.int64) - trace.places
    ahead -= np.repeat(np.cumsum(places) - places, np.diff(batches.start))
    tile = np.repeat(np.arange(len(trace.counts)), trace.counts)
    supertile, place = trace.grid
    tile_at = np.full((trace.supertiles, trace.eyes * SUPER_TILES), -1, np.int64)
    if trace.tile_sweep is None:
        tile_at[supertile, place] = np.arange(len(place))
    else:
        here = np.flatnonzero(trace.tile_sweep >= 0)
        sweeps = 1 + int(trace.tile_sweep.max())
        sweep = trace.tile_sweep[here].astype(np.int64)
        tile_at[supertile[here] + trace.supertiles // sweeps * sweep, place[here]] = here
    before = np.cumsum(trace.eye_places, axis=1) - trace.eye_places  # places of a pair before those of each eye
    slot = ahead[trace.pair] + before[trace.pair, tile // trace.eye_tiles]
    of_stream = []
    for stream in range(trace.streams):
        here = np.flatnonzero(trace.regions >> stream & 1)
        key = batch[trace.pair[here]] * tile_at.shape[1] + place[tile[here]]
        order = here[np.argsort(key, kind="stable")]
        visits = _stream_visits(key, batches, tile_at)
        of_stream.append((*visits, batches.final[visits[0]], trace.use[order], slot[order]))
    visited, counts, seen, final, use, slot = (
        np.concatenate(parts) for parts in zip(*(parts[1:] for parts in of_stream), strict=True))
    begins = np.concatenate(([0], np.cumsum([len(parts[0]) for parts in of_stream])))
    first = np.stack([np.searchsorted(parts[0], np.arange(len(places) + 1)) for parts in of_stream]) + begins[:-1, None]
    places += np.bincount(batch, trace.places == 0, len(batches.supertile)).astype(np.int64)
    return VisitPlan(
        batches.supertile, places, first, visited, final.astype(np.uint8), np.concatenate(([0], np.cumsum(counts))), seen, use,
        slot.astype(np.int32), visited[: begins[1]][final[: begins[1]]])


def _stream_visits(key: np.ndarray, batches: Batches, tile_at: np.ndarray) -> tuple[np.ndarray, ...]:
    """The visits of a stream: batch, tile, number of entries, and the tile's entries before them.

    Args:
        key: (entries,) batch * number of places + place of each of the stream's entries.
        batches: the frame's batches.
        tile_at: (super-tiles, places) the tile at each place; -1 beyond the frame.
    """
    held = np.bincount(key, minlength=len(batches.supertile) * tile_at.shape[1]).reshape(-1, tile_at.shape[1])
    wanted = held > 0
    wanted[batches.final] = tile_at[batches.supertile[batches.final]] >= 0
    at, where = np.nonzero(wanted)
    visited, counts = tile_at[batches.supertile[at], where], held[at, where]
    order = np.argsort(visited, kind="stable")
    before = np.cumsum(counts[order]) - counts[order]
    firsts = np.flatnonzero(np.diff(visited[order], prepend=-1))
    seen = np.empty(len(at), np.int64)
    seen[order] = before - np.repeat(before[firsts], np.diff(np.append(firsts, len(at))))
    return at, visited, counts, seen


@dataclass(frozen=True)
class SuperMap:
    """The first beats of the memory regions, which are those of `golden.host.memory_image`; 0 where a frame has none."""

    chunks: int
    geometry: int
    colour: int
    tiles: int
    supertiles: int
    directory: int
    entries: int
    spill: int
    frame: int
    target_tiles: int = 0
    target_frame: int = 0


@dataclass(frozen=True)
class SuperPlan:
    """A frame on a machine.

    Attributes:
        lists: its lists. read: those that the second phase reads, the same in frames of one sweep.
        sorting, visits: how these are sorted, and the frame's visits.
        missed: (pairs,) uint8, in rendering order: whether the chunk's header is not in the cache.
        where: the memory regions.
    """

    lists: ListsPlan
    read: ListsPlan
    sorting: SortPlan
    visits: VisitPlan
    missed: np.ndarray
    where: SuperMap


def frame_beats(trace: SuperTrace, pixel: int) -> int:
    """The beats of the pixels of one eye, which take so many bytes each."""
    return -(-trace.width * trace.height * pixel // BEAT_BYTES)


def super_plan(
    trace: SuperTrace, config: AcceleratorConfig, bounds: Bounds, beta: int | None, display: bool, packed: bool = False,
    warped: WarpedTrace | None = None,
) -> SuperPlan:
    """The data that the phases of a frame need.

    Args:
        trace, config: the frame and the machine.
        bounds: those that the frame before left.
        beta: the merge threshold; None for the automatic one, 0 if nothing is merged.
        display: whether a pixel takes 4 bytes in memory instead of 16. packed: whether the frame is packed instead.
        warped: the trace of a frame with a warped target, of which `trace` is the joint one.
    """
    lists = lists_plan(trace, bounds)
    groups = merge_lists(config, lists.counts, beta)
    largest = int(np.bincount(groups, lists.counts).max(initial=0))
    read, drawn = lists, trace
    if warped is not None:
        read, groups = swept_lists(lists, groups, warped, bounds)
        drawn = warped.drawn
    sorting = sort_plan(read.counts, read.rank, groups, config, largest)
    missed = find_misses(
        drawn.chunk.astype(np.int64), np.zeros(drawn.pairs, np.int64), config.header_lines, HEADER_WAYS, False, False)
    table = -(-trace.eye_tiles * TILE_SETTING_BYTES // BEAT_BYTES)
    pixels = (packed_beats(trace.width, trace.height) if packed else
              frame_beats(trace, DISPLAY_PIXEL_BYTES if display else PIXEL_BYTES))
    regions = lay_out({
        "chunks": len(trace.chunk_count), "geometry": -(-trace.points // 2),
        "colour": trace.points * colour_beats(config, trace.sh_degree), "tiles": table,
        "supertiles": trace.eyes * trace.supertiles * SUPER_TILES * TILE_SETTING_BYTES // BEAT_BYTES,
        "directory": frame_lists(config) * DIRECTORY_BEATS, "entries": lists.beats, "spill": sorting.spill_beats,
        "frame": pixels, **({"target_tiles": table, "target_frame": pixels} if trace.eyes > 1 else {})})
    where = SuperMap(**{name: region.base for name, region in regions.items()})
    return SuperPlan(lists, read, sorting, visit_plan(drawn, config), missed.astype(np.uint8), where)


def swept_lists(lists: ListsPlan, groups: np.ndarray, warped: WarpedTrace, bounds: Bounds) -> tuple[ListsPlan, np.ndarray]:
    """The lists that the second phase of a frame with a warped target reads, those of the second sweep behind those of the
    first, and their groups: in the second sweep each is one of its own."""
    if warped.drawn.supertiles == warped.joint.supertiles:
        return lists, groups
    wanted = warped.lists_again[np.repeat(np.arange(bounds.supertiles), np.diff(bounds.first))]
    pairs = wanted[lists.number]
    return replace(
        lists, number=np.concatenate((lists.number, lists.number[pairs] + bounds.lists)),
        counts=np.concatenate((lists.counts, lists.counts * wanted)), ends=np.concatenate((lists.ends, lists.ends)),
        rank=np.concatenate((lists.rank, lists.rank[pairs])),
        page_start=np.concatenate((lists.page_start[:-1], lists.page_start[:-1], lists.page_start[-1:])),
    ), np.concatenate((groups, groups[-1] + 1 + np.arange(bounds.lists)))
