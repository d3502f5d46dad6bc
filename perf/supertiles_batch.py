"""The batch buffer and the array of machines with super-tiles, stepped cycle by cycle (rtl/supertiles/batch_*.py,
rtl/vrc_array/batch_*.py)."""

from __future__ import annotations

from perf import bus
from perf.constants import SETUP_LATENCY
from perf.kernel import step
from perf.layout import Layout
from perf.supertiles_gather import layout as before
from spec.queues import ARRAY_TILES

layout = Layout(before)
layout.words("""
    batches parts fill_batch fill_left fill_open fill_closed fill_at passed chosen released dealt dealing deal_end deal_visit
    deal_entry deal_last visits_in visits_taken items_in items_out""")
layout.words("""
    visit_busy visit_begun visit_second visit_ground visit_tile visit_blends visit_count visit_ends slot_load buffer_load
    issue_load load_wait issue_visit store_latency""")
_VISITS, _ITEMS = 16, 4
layout.ring("pass_times", 16)
layout.ring("visit_ids", _VISITS)
layout.ring("visit_times", _VISITS)
layout.ring("item_entry", _ITEMS)
layout.ring("item_times", _ITEMS)

_SETTLE, _MASKS, _ITEM_LATENCY, _AHEAD = 2, 4, 3, 3
"""Cycles from a batch's last place until the batch is complete; from there to its first entry's place; from there to the entry;
and the visits that leave ahead of the array."""

_SETUP = SETUP_LATENCY - 1  # the stages before the output buffer


@step
def places_taken(s, t):
    """Whether the batch buffer takes the place that is offered."""
    return s.place_left != 0 and s.fill_open and s.fill_left != 0 and s.fill_at <= t and s.passed - s.released < s.parts


@step
def step_fill(s, t, taken, batch_supertile, batch_places):
    """Steps the side of the batch buffer that is filled."""
    if s.place_left:
        if taken:
            s.busy_batch += 1
        else:
            s.blocked_batch += 1
    at = s.fill_batch
    if s.fill_open == 0:
        if s.fill_closed == 0 and at < s.batches and batch_supertile[at] < s.supers_taken:
            s.fill_open, s.fill_left = 1, batch_places[at]
            s.fill_at = t + 1
        if s.fill_open == 0 and s.fill_closed == 0:
            return
    s.fill_left -= taken
    if s.fill_open and s.fill_left == 0:
        s.fill_open, s.fill_closed, s.fill_at = 0, 1, t + _SETTLE
    if s.fill_closed and s.fill_at <= t and s.passed - s.released < s.parts and s.passed - s.chosen < s.parts - 1:
        s.pass_times[s.passed & 15] = t + _MASKS
        s.passed += 1
        s.fill_closed = 0
        s.fill_batch = at + 1


@step
def _next_visit(s, t, batch_visit, visit_tile, visit_final, visit_entry, done):
    """Goes on to the next tile to visit, past those that have stopped. A batch without any is released."""
    if s.dealing == 0:
        if s.dealt == s.passed or s.pass_times[s.dealt & 15] > t:
            return
        s.dealing, s.deal_visit, s.deal_end = 1, batch_visit[s.dealt], batch_visit[s.dealt + 1]
    at, end = s.deal_visit, s.deal_end
    while at < end and visit_final[at] == 0 and done[visit_tile[at]] < t:
        at += 1
    s.deal_visit = at
    if at == end:
        s.dealing = 0
        s.dealt += 1
        s.chosen += s.chosen < s.dealt
        s.released += 1
    elif s.visits_in - s.visits_taken < _AHEAD:
        s.dealing = 2
        s.deal_entry, s.deal_last = visit_entry[at], visit_entry[at + 1]
        s.visit_ids[s.visits_in & _VISITS - 1], s.visit_times[s.visits_in & _VISITS - 1] = at, t + 1
        s.visits_in += 1
        if at + 1 == end:
            s.chosen += 1


@step
def step_deal(s, t, batch_visit, visit_tile, visit_final, visit_entry, done):
    """Deals a batch to its tiles, an entry or a visit's end a cycle."""
    if s.dealing < 2:
        _next_visit(s, t, batch_visit, visit_tile, visit_final, visit_entry, done)
    if s.dealing < 2 or s.items_in - s.items_out >= _ITEMS:
        return
    at, place = s.deal_entry, s.items_in & _ITEMS - 1
    s.item_times[place] = t + _ITEM_LATENCY
    s.items_in += 1
    if at < s.deal_last and done[visit_tile[s.deal_visit]] >= t:
        s.item_entry[place] = at
        s.deal_entry = at + 1
        return
    s.item_entry[place] = -1
    s.deal_visit += 1
    s.dealing = 1
    if s.deal_visit == s.deal_end:
        s.dealing = 0
        s.dealt += 1
        s.released += 1


@step
def _slot(s, valid, load, drain):
    """Moves a slot into the setup unit's pipeline."""
    mask = (1 << _SETUP) - 1
    s.slot_valid = (s.slot_valid << 1 | valid) & mask
    s.slot_drain = (s.slot_drain << 1 | drain) & mask
    s.slot_load = (s.slot_load << 1 | load) & mask


@step
def step_setup(s, t, waiting, visit_tile, visit_final, visit_seen, use, stop, blend):
    """Steps BatchSetup, which turns visits and entries into slots."""
    while s.leave_out != s.leave_in and s.leave_times[s.leave_out & 7] <= t:
        s.leave_out += 1
        s.in_flight -= 1
    advance = waiting < 2
    if advance:
        s.buffer_drain |= (s.slot_drain >> _SETUP - 1) << s.ops_buffered
        s.buffer_load |= (s.slot_load >> _SETUP - 1) << s.ops_buffered
        s.ops_buffered += s.slot_valid >> _SETUP - 1
    at = s.items_out
    there = at != s.items_in and s.item_times[at & _ITEMS - 1] <= t
    takes, valid, load, drain, ends = False, False, False, False, s.visit_busy == 0
    if s.visit_busy:
        if s.visit_begun == 0:
            valid, load = True, True
            if advance:
                s.visit_begun = 1
        elif s.visit_second:
            valid = True
            if advance:
                s.visit_second = 0
        elif there:
            entry = s.item_entry[at & _ITEMS - 1]
            if entry < 0:
                valid = True
                drain = s.visit_ends == 0 or s.visit_ground == s.visit_blends
                takes = advance and drain
                ends = takes
                if advance:
                    s.visit_ground = 0 if drain else 1
            else:
                skip = s.stop_0 <= t and s.stop_1 <= t and s.in_flight == 1
                takes = advance or skip
                if takes:
                    both = s.visit_blends and use[entry] == 3
                    count = s.visit_count + 1
                    s.visit_count = count
                    if count == stop[s.visit_tile, 0]:
                        s.stop_0 = t + s.stop_latency
                    if count == stop[s.visit_tile, 1]:
                        s.stop_1 = t + s.stop_latency + both
                    if skip:
                        s.skipped += 1
                    else:
                        valid = True
                        s.visit_second = both
    s.items_out = at + takes
    s.busy_array += takes
    s.blocked_array += there and not takes
    if advance:
        _slot(s, valid, load, drain)
    if ends:
        s.visit_busy = 0
        at = s.visits_taken
        if at != s.visits_in and s.visit_times[at & _VISITS - 1] <= t and s.in_flight < ARRAY_TILES:
            _take_visit(s, t, s.visit_ids[at & _VISITS - 1], visit_tile, visit_final, visit_seen, stop, blend)


@step
def _take_visit(s, t, visit, visit_tile, visit_final, visit_seen, stop, blend):
    tile, seen = visit_tile[visit], visit_seen[visit]
    s.visits_taken += 1
    s.in_flight += 1
    s.visit_busy, s.visit_begun, s.visit_second, s.visit_ground = 1, 0, 0, 0
    s.visit_tile, s.visit_blends, s.visit_count, s.visit_ends = tile, blend[tile], seen, visit_final[visit]
    s.stop_0 = t + s.stop_latency if stop[tile, 0] <= seen else bus.NEVER
    s.stop_1 = 0
    if blend[tile]:
        s.stop_1 = t + s.stop_latency if stop[tile, 1] <= seen else bus.NEVER


@step
def load_issue(s, t):
    """Loads the sequencer with the next operation from the setup unit's buffer."""
    if s.issue == 0 and s.ops_buffered:
        s.issue, s.issue_left = 1, s.blocks
        s.issue_drain, s.issue_load = s.buffer_drain & 1, s.buffer_load & 1
        s.ops_buffered -= 1
        s.buffer_drain >>= 1
        s.buffer_load >>= 1
        s.issue_at = t + (2 if s.blocks > 1 and s.issued_at != t - 1 else 0)


@step
def _may_issue(s, t, ends, pending, tile):
    """Whether the operation in the sequencer can be issued."""
    if s.issue_load:
        return s.load_wait == 0 and pending[tile] <= t
    if s.issue_drain == 0:
        return True
    if s.drain_wait:
        return False
    if ends == 0:
        return True
    return s.rows_free >= s.cores_y if s.incremental else s.row_halves != 0 or s.issue_left != s.blocks


@step
def step_issue(s, t, visit_tile, visit_final, visit_entry, visit_seen, stop, blend, pending, done):
    """Steps BatchSequencer, reserves space in the buffer behind the array, and notes when states land."""
    s.drain_wait -= s.drain_wait != 0
    s.load_wait -= s.load_wait != 0
    if s.issue == 0 or s.issue_at > t:
        return
    visit = s.visit_ids[s.issue_visit & _VISITS - 1]
    tile, ends = visit_tile[visit], visit_final[visit]
    if not _may_issue(s, t, ends, pending, tile):
        return
    s.ops += 1
    first = s.issue_left == s.blocks
    left = s.issue_left - 1
    s.issue_left = left
    if s.issue_load:
        s.load_wait = s.cores_y
    if s.issue_drain:
        s.drain_wait = s.cores_y
        if ends:
            _drain(s, t, left, first)
        elif left == 0:
            pending[tile] = t + s.store_latency
            seen = visit_seen[visit] + visit_entry[visit + 1] - visit_entry[visit]
            if stop[tile, 0] <= seen and (blend[tile] == 0 or stop[tile, 1] <= seen):
                done[tile] = t + s.store_latency + 2
        if left == 0:
            s.leave_times[s.leave_in & 7] = t + s.leave_latency
            s.leave_in += 1
            s.issue_visit += 1
    if left == 0:
        s.issue, s.issued_at = 0, t


@step
def _drain(s, t, left, first):
    """Reserves space for the rows of a tile that leaves."""
    if s.incremental:
        s.rows_free -= s.cores_y
        s.drain_times[s.drain_in & 63] = t + s.row_latency
        s.drain_in += 1
        return
    s.row_halves -= first
    if left == 0:
        s.drain_times[s.drain_in & 63] = t + s.row_latency + s.cores_y - 2
        s.drain_in += 1
