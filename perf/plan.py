"""A trace on a particular machine: the groups, chunks, cache misses and addresses that the kernels of both phases need."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.host.memory_image import lay_out
from golden.msv2_ref.fetch import find_misses
from golden.msv2_ref.tile_merge import auto_beta, merge_tiles
from perf.kernel import kernel
from perf.trace import EyeTrace, FrameTrace
from spec.config import AcceleratorConfig
from spec.constants import TILE
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
from spec.queues import CACHE_WAYS


@dataclass(frozen=True)
class MemoryMap:
    """The first beats of the memory regions, which are those of `golden.host.memory_image`."""

    geometry: int
    colour: int
    tiles: int
    views: int
    directory: int
    entries: int
    spill: int
    frame: int
    chunks: int = 0
    target_tiles: int = 0
    target_frame: int = 0


def memory_map(trace: FrameTrace, config: AcceleratorConfig, display: bool, entries_beats: int, spill_beats: int) -> MemoryMap:
    """The memory regions of a frame. Those that it does not have begin at 0."""
    tiles, pixel = trace.tiles_x * trace.tiles_y, DISPLAY_PIXEL_BYTES if display else PIXEL_BYTES
    table, frame = -(-tiles * TILE_SETTING_BYTES // BEAT_BYTES), -(-trace.width * trace.height * pixel // BEAT_BYTES)
    beats = {
        "geometry": -(-trace.points // 2) if config.compact else trace.points,
        "colour": trace.points * colour_beats(config, trace.sh_degree), "tiles": table,
        "views": trace.points << trace.view_shift, "directory": tiles * DIRECTORY_BEATS, "entries": entries_beats,
        "spill": spill_beats, "frame": frame}
    if config.chunks:
        beats["chunks"] = len(trace.eyes[0].chunk_count)
    if len(trace.eyes) > 1:
        beats |= {"target_tiles": table, "target_frame": frame}
    return MemoryMap(**{name: region.base for name, region in lay_out(beats).items()})


@dataclass(frozen=True)
class Lists:
    """The tile lists of an eye in memory.

    Attributes:
        beats: the beats that the pages take.
        begins: (intersections + 1,) bool, in the order of arrival: whether the intersection begins a page other than its tile's
            first.
        writes: the beats that the entry writer writes, in turn: intersections relative to the region's base, and directory
            words as -1 - beat.
        page_beat: the first beat of each page beyond the first ones, by tile and slot.
        page_start: the place in `page_beat` where each tile's pages begin.
    """

    beats: int
    begins: np.ndarray
    writes: np.ndarray
    page_beat: np.ndarray
    page_start: np.ndarray


def eye_lists(eye: EyeTrace) -> Lists:
    """Where an eye's intersections are written. `golden.msv2_ref.tile_lists` computes the same for a frame."""
    start = np.concatenate(([0], np.cumsum(pages_beyond_first(eye.counts))))
    begins, page_beat = np.zeros(len(eye.tile) + 1, np.bool_), np.zeros(start[-1] + 1, np.int64)
    writes = np.zeros(len(eye.tile) + start[-1] + 1, np.int64)
    return Lists(_pages(eye.tile, start, begins, writes, page_beat), begins, writes, page_beat, start)


@kernel
def _pages(tile, page_start, begins, writes, page_beat):
    """Allocates pages in the order of the intersections; returns the beats that the pages take."""
    tiles, at = len(page_start) - 1, 0
    beats = tiles * FIRST_PAGE_BEATS
    place, base, page = np.full(tiles, FIRST_PAGE_ENTRIES, np.int64), np.empty(tiles, np.int64), page_start[:-1].copy()
    for i in range(tiles):
        base[i] = (i - 1) * FIRST_PAGE_ENTRIES  # in intersections; as if the page followed one as long as all before it
    for i in range(len(tile)):
        to = tile[i]
        if place[to] > FIRST_PAGE_ENTRIES and place[to] & (place[to] - 1) == 0:
            begins[i] = True
            writes[at] = -1 - (DIRECTORY_BEATS * to + (page[to] - page_start[to]) // WORDS)
            page_beat[page[to]], base[to] = beats, beats * BEAT_ENTRIES - place[to]
            beats += place[to] // BEAT_ENTRIES
            page[to] += 1
            at += 1
        writes[at] = (base[to] + place[to]) // BEAT_ENTRIES
        place[to] += 1
        at += 1
    return beats


@dataclass(frozen=True)
class SortPlan:
    """How the intersections of a frame's lists are merged and sorted; the arrays are those that phases take.

    Attributes:
        groups: (lists,) the group of each list. filled: (groups with intersections,) their numbers.
        lasts: (lists,) whether the list is its group's last.
        group_end: (intersections,) whether the intersection is its group's last.
        chunk_length, chunk_spill, chunk_last: of the chunks into which groups are cut, the length, whether its group is
            spilled, and whether it is its group's last. chunk_ends: the number of intersections up to each chunk's end,
            followed by a number larger than all.
        arrival: (intersections + 1,) int32, in the order of the lists: each intersection's place in the rendering order.
        part_runs: the number of runs of each spilled group. job_start, job_length, job_entries, job_out, job_waits: for each
            merge, the place of its runs in `job_length`, their lengths and sum, whether its result leaves the sorter, and
            whether it waits until the results of earlier merges are in memory.
        way_of: for each intersection of each merge, in order, the run from which it comes.
        job_begin, job_goal: where each run of each merge begins, and each merge's result: in beats from the group's first run
            in the ring, or -1 - beats from the start of the scratch half behind it.
        ring_runs: the runs that the ring buffer in the spill region holds. spill_beats: the size of that region.
    """

    groups: np.ndarray
    filled: np.ndarray
    lasts: np.ndarray
    group_end: np.ndarray
    chunk_length: np.ndarray
    chunk_spill: np.ndarray
    chunk_last: np.ndarray
    chunk_ends: np.ndarray
    arrival: np.ndarray
    part_runs: np.ndarray
    job_start: np.ndarray
    job_length: np.ndarray
    job_entries: np.ndarray
    job_out: np.ndarray
    job_waits: np.ndarray
    way_of: np.ndarray
    job_begin: np.ndarray
    job_goal: np.ndarray
    ring_runs: int
    spill_beats: int


@dataclass(frozen=True)
class RenderPlan(SortPlan):
    """An eye's rendering on a machine with a list for every tile; the arrays are those that `perf.render.render_phase` takes.

    Attributes:
        drawn: (rendered tiles,) their numbers.
        missed: (intersections,) whether its splat record is not in the cache. view: the beat of its splat record.
    """

    drawn: np.ndarray
    missed: np.ndarray
    view: np.ndarray


def render_plan(trace: FrameTrace, eye: EyeTrace, config: AcceleratorConfig, beta: int | None, largest: int) -> RenderPlan:
    """The data that the rendering phase needs.

    Args:
        trace, eye: the frame and its eye.
        config: the machine's configuration.
        beta: the merge threshold; None for the automatic one, 0 if nothing is merged.
        largest: the intersections of the frame's largest group of both eyes; the host reserves memory for two of them
            (golden.host.memory_image.spill_beats).
    """
    counts = eye.counts.astype(np.int64)
    sorting = sort_plan(counts, eye.rank, eye_groups(trace, eye, config, beta), config, largest)
    level = np.repeat(eye.level, counts).astype(np.int64)
    return RenderPlan(
        **vars(sorting), drawn=np.flatnonzero(eye.rendered), missed=_cache_misses(eye, level, config.splat_cache_lines),
        view=(eye.splat.astype(np.int64) << trace.view_shift) + level)


def sort_plan(
    counts: np.ndarray, rank: np.ndarray, groups: np.ndarray, config: AcceleratorConfig, largest: int,
) -> SortPlan:
    """How lists are merged and sorted.

    Args:
        counts: (lists,) int64 the intersections of each list.
        rank: (intersections,) int32, in rendering order: the place in the list in memory.
        groups: (lists,) the group of each list.
        config: the machine's configuration.
        largest: the intersections of the largest group for which memory is reserved.
    """
    lasts = np.append(np.diff(groups) > 0, True)
    sizes = np.bincount(groups, counts).astype(np.int64)
    filled = np.flatnonzero(sizes)
    group_end = np.zeros(len(rank) + 1, np.uint8)
    group_end[np.cumsum(sizes)[filled] - 1] = 1

    capacity = config.sort_chunk
    chunks = -(-sizes[filled] // capacity)
    length = np.full(int(chunks.sum()), capacity, np.int64)
    last = np.zeros(len(length), np.uint8)
    ends = np.cumsum(chunks) - 1
    length[ends], last[ends] = sizes[filled] - (chunks - 1) * capacity, 1
    spill = np.repeat(chunks > 1, chunks).astype(np.uint8)
    arrival = np.zeros(len(rank) + 1, np.int32)
    _arrivals(counts, rank, arrival)
    large = sizes[groups] > capacity
    before = np.cumsum(counts) - counts - (np.cumsum(sizes) - sizes)[groups]  # intersections of the group before the list's own
    place = np.repeat(before[large], counts[large]) + rank[np.repeat(large, counts)]
    runs = -(-largest // capacity) if largest > capacity else 1
    parts, run_of = chunks > 1, (place // capacity).astype(np.int64)
    merges = _merges(run_of, chunks[parts], sizes[filled][parts], config.merge_ways, capacity // BEAT_ENTRIES)
    return SortPlan(
        groups, filled, lasts, group_end, length, spill, last, np.append(np.cumsum(length), 1 << 40), arrival, chunks[parts],
        *merges, 2 * runs, 4 * runs * capacity // BEAT_ENTRIES)


@kernel
def _arrivals(counts, rank, arrival):
    """Fills `arrival` of a SortPlan, list by list."""
    at = 0
    for number in range(len(counts)):
        first = at
        for _ in range(counts[number]):
            arrival[first + rank[at]] = at
            at += 1


def _merges(
    run_of: np.ndarray, part_runs: np.ndarray, part_entries: np.ndarray, ways: int, run_beats: int,
) -> tuple[np.ndarray, ...]:
    """The arrays `job_start` to `job_goal` of a RenderPlan, in the way of rtl.sort_tmu.merge_plan.

    Args:
        run_of: (intersections of spilled groups,) int64, in order: the chunk of its group in which each lies.
        part_runs, part_entries: the runs and the intersections of each such group.
        ways: the number of runs that are merged at a time.
        run_beats: the beats of a full chunk's run.
    """
    start, lengths, entries, out, waits, way_of = [0], [], [], [], [], [np.zeros(0, np.int64)]
    begins, goals = [], []
    firsts = np.cumsum(part_entries) - part_entries
    for count, total, first in zip(part_runs.tolist(), part_entries.tolist(), firsts.tolist(), strict=True):
        run = run_of[first : first + total].copy()
        this, longer, fresh, made = list(range(count)), [], False, count
        places, scratch = [k * run_beats for k in this], False
        while True:
            if not this:
                this, longer, fresh, scratch = longer, [], True, not scratch
            left = len(this) + len(longer)
            last = left <= ways
            chosen = longer + this if last else this[: min(ways, left - ways + 1)]
            place = np.full(made + 1, -1)
            place[chosen] = np.arange(len(chosen))
            way = place[run]
            way_of.append(way[way >= 0])
            lengths += np.bincount(way_of[-1], minlength=len(chosen)).tolist()
            start.append(len(lengths))
            entries.append(len(way_of[-1]))
            out.append(last)
            waits.append(last or fresh)
            begins += [-1 - places[r] if scratch != (r in longer) else places[r] for r in chosen]
            goals.append(places[chosen[0]] if scratch else -1 - places[chosen[0]])
            places.append(places[chosen[0]])  # a result lies in one half where its first run lies in the other
            if last:
                break
            run[way >= 0] = made
            this, longer, fresh, made = this[len(chosen) :], [*longer, made], False, made + 1
    return (np.array(start, np.int64), np.array(lengths, np.int64), np.array(entries, np.int64), np.array(out, np.bool_),
            np.array(waits, np.bool_), np.concatenate(way_of).astype(np.int64), np.array(begins, np.int64),
            np.array(goals, np.int64))


def eye_groups(trace: FrameTrace, eye: EyeTrace, config: AcceleratorConfig, beta: int | None) -> np.ndarray:
    """(tiles,) the group of each tile."""
    counts = eye.counts.astype(np.int64)
    return merge_tiles(counts, trace.tiles_x, auto_beta(counts, config) if beta is None else beta)


def largest_group(trace: FrameTrace, config: AcceleratorConfig, beta: int | None) -> int:
    """The intersections of the largest group of both eyes."""
    return max(int(np.bincount(eye_groups(trace, eye, config, beta), eye.counts).max(initial=0)) for eye in trace.eyes)


def _cache_misses(eye: EyeTrace, level: np.ndarray, lines: int) -> np.ndarray:
    """(intersections,) uint8: whether its splat record is not in the splat cache (rtl/vrc_array/splat_tags.py)."""
    return find_misses(eye.splat.astype(np.int64), level, lines, CACHE_WAYS, False, False).astype(np.uint8)


def tile_rows(config: AcceleratorConfig) -> int:
    """Number of pixel rows in a tile."""
    return TILE * TILE // config.cores_x


def group_ends(plan: RenderPlan) -> tuple[np.ndarray, np.ndarray]:
    """The last tile of each group with intersections, and its place among the tiles that are rendered."""
    last = np.searchsorted(plan.groups, plan.filled, side="right") - 1
    return last, np.searchsorted(plan.drawn, last)
