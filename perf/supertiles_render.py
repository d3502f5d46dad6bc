"""The second phase of machines with lists by super-tile, stepped cycle by cycle (rtl/top/gather_phase.py and the units below
it).

Units are stepped from the last to the first, for the reason that `perf.geometry` gives.
"""

from __future__ import annotations

from perf import (
    blending,
    bus,
    chunks,
    lists,
    memory,
    sorter,
    supertiles_batch,
    supertiles_gather,
    supertiles_rows,
    supertiles_warp,
)
from perf.bus import CHUNKS, COLOUR, ENTRIES, SPILL, TILES, W_FRAME, W_SPILL, W_WARP
from perf.kernel import phase, step
from perf.supertiles_batch import stream_layout
from perf.supertiles_warp import layout, strip_layout
from spec.queues import LISTS_AHEAD

layout.words("swept_before swept_since")

__all__ = ["asking", "layout", "render_cycle", "render_phase", "stream_layout", "strip_layout"]


@step
def asking(s, t):
    """The clients that ask for a read and those that ask for a write, a bit for each."""
    reads = (1 << TILES) * (s.supers_owed != 0 and s.credits[TILES] != 0)
    reads |= (1 << ENTRIES) * (s.list_requests != 0 and s.credits[ENTRIES] != 0)
    reads |= (1 << SPILL) * (s.spill_read_full != 0 and s.credits[SPILL] != 0)
    reads |= (1 << CHUNKS) * (s.header_requests != 0 and s.credits[CHUNKS] != 0)
    reads |= (1 << COLOUR) * (s.record_requests != 0 and s.credits[COLOUR] != 0)
    writes = (1 << W_FRAME) * (s.sends != 0) | (1 << W_SPILL) * sorter.writer_asks(s, t)
    return reads, writes | (1 << W_WARP) * (s.strip_full != 0)


@step
def _arrays(s, streams, strips, t, writer, batch_visit, visit_tile, visit_final, visit_entry, visit_seen, use, slot, stop,
            blend, drawn, sizes, pending, done, tile_times, fills_0, fills_1):
    """Steps the arrays, the pixel writer, and the sides of the batch buffer that deal."""
    count, some, takes = len(streams), False, False
    for q in range(count):
        a = streams[q]
        a.waiting = blending.buffered(a)
        supertiles_batch.load_issue(a, t)
        supertiles_batch.step_issue(s, a, q, t, visit_tile, visit_final, visit_entry, visit_seen, stop, blend, pending, done)
    if s.warps:
        supertiles_warp.step_rows(
            s, streams, strips, t, writer == W_FRAME, writer == W_WARP, drawn, sizes, fills_0, fills_1, tile_times)
    else:
        supertiles_rows.step_rows(s, streams, t, writer == W_FRAME, drawn, sizes, tile_times)
    for q in range(count):
        a = streams[q]
        there, taken = supertiles_batch.step_setup(
            s, a, q, t, a.waiting, visit_tile, visit_final, visit_seen, use, stop, blend)
        some, takes = some or there, takes or taken
    s.busy_array += takes
    s.blocked_array += some and not takes
    if count > 1:
        supertiles_batch.step_read(s, streams, t, slot)
    for q in range(count):
        supertiles_batch.step_deal(streams[q], q, t, batch_visit, visit_tile, visit_final, visit_entry, done)
    supertiles_batch.release(s, streams)


@phase
def render_cycle(
    s, streams, t, reader, writer, ways, list_counts, list_lasts, list_ends, page_beat, page_start, group_end, chunk_length,
    chunk_spill, chunk_last, chunk_ends, arrival, stages, keys, part_runs, job_start, job_length, job_entries, job_out,
    job_waits, way_of, job_begin, job_goal, missed, header_beat, record_beat, lit, places, frees, pair_counts,
    batch_supertile, batch_places, batch_visit, visit_tile, visit_final, visit_entry, visit_seen, use, slot, stop, blend,
    drawn, sizes, done, pending, tile_times, pair_eyes, pair_supertile, strips, fills_0, fills_1,
):
    """Steps all units of the phase. `reader` and `writer` are the clients whose read and write were granted. Returns whether
    the phase has ended, in which case nothing was stepped."""
    swept = s.swept
    list_before = s.swept_before - s.list_taken
    waits = swept - s.list_taken - LISTS_AHEAD
    s.swept_before, s.swept_since = s.swept_since, swept  # an item takes two cycles through the queue before the reader
    if blending.pixels_finished(s, t) and supertiles_warp.strips_finished(s, strips, t):
        return True
    _arrays(
        s, streams, strips, t, writer, batch_visit, visit_tile, visit_final, visit_entry, visit_seen, use, slot, stop,
        blend, drawn, sizes, pending, done, tile_times, fills_0, fills_1)
    taken = supertiles_batch.places_taken(s, t)
    supertiles_batch.step_fill(s, streams, t, taken, batch_supertile, batch_places)
    supertiles_gather.step_colour(s, t, taken, lit, places, frees)
    supertiles_gather.step_project(s, t, pair_eyes, pair_supertile)
    supertiles_gather.step_supertiles(s, t, reader == TILES, pair_counts)
    supertiles_gather.step_join(s, t, missed)
    supertiles_gather.step_ask(s, t, reader == COLOUR, missed, record_beat)
    fetched = supertiles_gather.step_look(s, t, reader == CHUNKS, missed, header_beat)
    sorter.step_handover(s, fetched)
    sorter.step_run_writer(s, t, writer == W_SPILL)
    at = s.sorted
    sorter.step_sort_out(
        s, t, ways, reader == SPILL, chunks.chunk_offers(stages, at + s.spilled), group_end, chunk_length, chunk_spill,
        chunk_last, part_runs, job_start, job_length, job_entries, job_out, job_waits, way_of, job_begin, job_goal)
    shown = s.entry_shown
    room = chunks.step_stages(stages, keys, s.sorted + s.spilled, shown, chunk_ends, arrival)
    if lists.step_unpack(s, t, room):
        s.busy_sort += 1
    elif shown:
        s.blocked_sort += 1
    lists.step_walk(s, t, reader == ENTRIES, list_before, list_counts, list_lasts, page_beat, page_start)
    if not supertiles_warp.holds_lists(s, strips, t):
        lists.step_sweep(s, t, waits, 0)
    if s.swept != swept and list_ends[swept]:
        s.supers_owed += s.super_beats
    return False


@phase
def render_phase(s, streams, arguments, limit):
    """Simulates the phase RENDER; `arguments` are those of `render_cycle` behind the granted clients. Returns its cycles, or -1
    when it has not ended within `limit` cycles."""
    for t in range(limit):
        reads, writes = asking(s, t)
        reader, writer = bus.grant_read(s, t, reads), bus.grant_write(s, t, writes)
        if render_cycle(s, streams, t, reader, writer, *arguments):
            return t + 1
        memory.end_cycle(s, t)
    return -1
