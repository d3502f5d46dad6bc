"""The phase RENDER, stepped cycle by cycle (rtl/top/render_phase.py and the units below it).

Units are stepped from the last to the first, for the reason that `perf.geometry` gives.
"""

from __future__ import annotations

from perf import blending, bus, chunks, lists, memory, sorter, swap, warp
from perf.blending import ROWS_WAITING
from perf.bus import ENTRIES, SPILL, TILES, VIEWS, W_FRAME, W_SPILL, W_WARP
from perf.kernel import phase, step
from perf.watch import BLENDING, FETCHING, HANDING, SORTING


@step
def _note(s, t, stage, ends, times):
    """Records that an entry has moved into a stage, for the first and last such cycle of its group."""
    if s.group_open[stage] == 0:
        times[2 * stage, s.group[stage]] = t
        s.group_open[stage] = 1
    if ends:
        times[2 * stage + 1, s.group[stage]] = t
        s.group_open[stage] = 0
        s.group[stage] += 1


@step
def _asking(s, t):
    """The clients that ask for a read and those that ask for a write, a bit for each."""
    reads = (1 << TILES) * (s.owed != 0 and s.credits[TILES] != 0)
    reads |= (1 << ENTRIES) * (s.list_requests != 0 and s.credits[ENTRIES] != 0)
    reads |= (1 << SPILL) * (s.spill_read_full != 0 and s.credits[SPILL] != 0)
    reads |= (1 << VIEWS) * (s.view_requests != 0 and s.credits[VIEWS] != 0)
    writes = (1 << W_FRAME) * (s.sends != 0) | (1 << W_SPILL) * sorter.writer_asks(s, t)
    writes |= (1 << W_WARP) * (s.warp_write != 0)
    return reads, writes


@step
def _rows(s, t, writer, tile_number, tile_times, fills):
    """Moves the array's rows to the buffer before the pixel writer and, for the source eye, to the one before the warp unit;
    and from there to the units."""
    offered, waiting, wanted = blending.rows_offered(s, t), s.rows_waiting, 1
    written = blending.step_pixels(s, t, writer == W_FRAME, waiting != 0, tile_number, tile_times)
    blending.count_rows(s, waiting != 0, written)
    to_pixels = offered and s.warp_done & 1 == 0 and waiting < ROWS_WAITING
    s.rows_waiting = waiting + to_pixels - written
    s.warp_done |= to_pixels
    if s.warp_present:
        waiting, wanted = s.warp_rows_waiting, 3
        warped = warp.step_warp(s, t, writer == W_WARP, waiting != 0, s.warp_row, fills)
        s.warp_row += warped
        s.busy_warp += warped
        s.blocked_warp += waiting != 0 and not warped
        to_warp = offered and s.warp_done & 2 == 0 and waiting < ROWS_WAITING
        s.warp_rows_waiting = waiting + to_warp - warped
        s.warp_done |= to_warp << 1
    if s.warp_done == wanted:
        s.warp_done = 0
        blending.take_row(s)


@phase
def render_phase(
    s, ways, tile_counts, tile_lasts, rendered, page_beat, page_start, drawn_counts, drawn_blend, drawn_number, stop, group_end,
    use, missed, view_beat, chunk_length, chunk_spill, chunk_last, chunk_ends, arrival, stages, keys, part_runs, job_start,
    job_length, job_entries, job_out, job_waits, way_of, job_begin, job_goal, group_tile, group_drawn, fills, times, tile_times,
    limit,
):
    """Simulates the phase RENDER. Returns its cycles, or -1 when it has not ended within `limit` cycles."""
    tiles = len(tile_counts)
    for t in range(limit):
        reads, writes = _asking(s, t)
        reader, writer = bus.grant_read(s, t, reads), bus.grant_write(s, t, writes)
        swept = s.swept
        list_before, head_before = swept - s.list_taken, swept - s.head_taken
        levels, buffered = s.fetch_tiles, blending.buffered(s)
        if blending.pixels_finished(s, t) and s.wait_out == tiles and warp.finished(s, t):
            return t + 1
        swap.step_swap(s, group_tile, group_drawn)
        blending.load_issue(s, t)
        blending.step_issue(s, t)
        _rows(s, t, writer, drawn_number, tile_times, fills)
        at = s.entry_at
        entry = blending.step_setup(s, t, buffered, use, stop, drawn_counts, drawn_blend)
        if entry:
            _note(s, t, BLENDING, group_end[at], times)
        at = s.pending_in + s.occupied
        fetched = blending.step_fetch(s, t, reader == VIEWS, entry, levels, missed, view_beat, drawn_counts)
        if fetched:
            _note(s, t, FETCHING, group_end[at], times)
        sorter.step_handover(s, fetched)
        sorter.step_run_writer(s, t, writer == W_SPILL)
        at = s.sorted
        offers = chunks.chunk_offers(stages, at + s.spilled)
        if sorter.step_sort_out(
            s, t, ways, reader == SPILL, offers, group_end, chunk_length, chunk_spill, chunk_last, part_runs, job_start,
            job_length, job_entries, job_out, job_waits, way_of, job_begin, job_goal,
        ):
            _note(s, t, HANDING, group_end[at], times)
        shown = s.entry_shown and swap.may_enter(s)
        room = chunks.step_stages(stages, keys, s.sorted + s.spilled, shown, chunk_ends, arrival)
        if lists.step_unpack(s, t, room and shown):
            s.busy_sort += 1
            _note(s, t, SORTING, group_end[s.sort_taken], times)
            s.sort_taken += 1
        elif shown:
            s.blocked_sort += 1
        lists.step_walk(s, t, reader == ENTRIES, list_before, tile_counts, tile_lasts, page_beat, page_start)
        lists.step_headers(s, t, reader == TILES, head_before, levels, rendered)
        lists.step_sweep(s, t, list_before, head_before)
        memory.end_cycle(s, t)
    return -1
