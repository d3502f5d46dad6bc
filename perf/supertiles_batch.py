"""The batch buffer and the array of machines with super-tiles, stepped cycle by cycle (rtl/supertiles/batch_*.py,
rtl/vrc_array/batch_*.py).

Each stream has a record of its own, of `stream_layout`, for the side of the batch buffer that deals, and for its array.
"""

from __future__ import annotations

from perf import bus
from perf.constants import SETUP_LATENCY
from perf.kernel import step
from perf.layout import Layout
from perf.packing import layout as before
from spec.queues import ARRAY_TILES

layout = Layout(before)
layout.words("""
    batches parts fill_batch fill_left fill_open fill_closed fill_at passed released first_reader read_ahead array_x row_x
    eye_tiles eye_beats tile_in row_in""")
layout.ring("asked", 16)
stream_layout = Layout()
stream_layout.words("""
    passed chosen released dealt dealing deal_end deal_visit deal_entry deal_last visits_in visits_taken items_in items_read
    items_out banks waiting""")
stream_layout.words("""
    visit_busy visit_begun visit_second visit_ground visit_tile visit_blends visit_count visit_ends slot_load buffer_load
    issue_load load_wait issue_visit store_latency""")
stream_layout.words("""
    slot_valid slot_drain ops_buffered buffer_drain stop_0 stop_1 in_flight leave_in leave_out stop_latency blocks cores_y
    row_latency leave_latency issue issue_left issue_drain issue_at issued_at incremental rows_free drain_wait drain_in
    drain_out drain_rows drain_row row_halves""")
_VISITS, _ITEMS, _UNBANKED = 16, 16, 4
_RINGS = (("pass_times", 16), ("visit_ids", _VISITS), ("visit_times", _VISITS), ("item_entry", _ITEMS),
                ("item_half", _ITEMS), ("item_times", _ITEMS), ("leave_times", 8), ("drain_times", 64))
for _name, _size in _RINGS:
    stream_layout.ring(_name, _size)

_SETTLE, _MASKS, _ITEM_LATENCY, _AHEAD = 2, 4, 3, 3
"""Cycles from a batch's last place until the batch is complete; from there to its first entry's place; from there to the entry;
and the visits that leave ahead of the array."""

_SETUP = SETUP_LATENCY - 1  # the stages before the output buffer


@step
def places_taken(s, t):
    """Whether the batch buffer takes the place that is offered."""
    return s.place_left != 0 and s.fill_open and s.fill_left != 0 and s.fill_at <= t and s.passed - s.released < s.parts


@step
def step_fill(s, streams, t, taken, batch_supertile, batch_places):
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
    if s.fill_closed and s.fill_at <= t and s.passed - s.released < s.parts and _pass(s, streams, t):
        s.passed += 1
        s.fill_closed = 0
        s.fill_batch = at + 1


@step
def _pass(s, streams, t):
    """Passes the batch to every stream that can take it. Returns whether all have it."""
    everywhere = True
    for q in range(len(streams)):
        a = streams[q]
        if a.passed == s.passed:
            if a.passed - a.chosen < s.parts - 1:
                a.pass_times[a.passed & 15] = t + _MASKS
                a.passed += 1
            else:
                everywhere = False
    return everywhere


@step
def release(s, streams):
    """Frees the halves of the batch buffer that all streams have done with."""
    least = streams[0].released
    for q in range(1, len(streams)):
        least = min(least, streams[q].released)
    s.released = least


@step
def _next_visit(a, q, t, batch_visit, visit_tile, visit_final, visit_entry, done):
    """Goes on to the next tile to visit, past those that have stopped. A batch without any is released."""
    if a.dealing == 0:
        if a.dealt == a.passed or a.pass_times[a.dealt & 15] > t:
            return
        a.dealing, a.deal_visit, a.deal_end = 1, batch_visit[q, a.dealt], batch_visit[q, a.dealt + 1]
    at, end = a.deal_visit, a.deal_end
    while at < end and visit_final[at] == 0 and done[q, visit_tile[at]] < t:
        at += 1
    a.deal_visit = at
    if at == end:
        a.dealing = 0
        a.dealt += 1
        a.chosen += a.chosen < a.dealt
        a.released += 1
    elif a.visits_in - a.visits_taken < _AHEAD:
        a.dealing = 2
        a.deal_entry, a.deal_last = visit_entry[at], visit_entry[at + 1]
        a.visit_ids[a.visits_in & _VISITS - 1], a.visit_times[a.visits_in & _VISITS - 1] = at, t + 1
        a.visits_in += 1
        if at + 1 == end:
            a.chosen += 1


@step
def _item_fits(a):
    """Whether the dealer can pass on an item. With banks, two of them can wait to be read."""
    return a.items_in - a.items_read < 2 if a.banks else a.items_in - a.items_out < _UNBANKED


@step
def step_read(s, streams, t, slot):
    """Reads the records of items from the banks of the batch buffer. A bank is read at one address in a cycle, by all streams
    that want it."""
    count = len(streams)
    asked = s.asked
    asked[:] = -1
    for k in range(count):
        q = (k + s.first_reader) % count
        a = streams[q]
        at = a.items_read
        place = at & _ITEMS - 1
        if at == a.items_in or a.item_times[place] > t or at - a.items_out >= s.read_ahead:
            continue
        entry = a.item_entry[place]
        if entry >= 0:
            address = a.item_half[place] << 20 | slot[entry]
            bank = address & a.banks - 1
            if asked[bank] >= 0 and asked[bank] != address:
                continue
            asked[bank] = address
        a.item_times[place] = t + _ITEM_LATENCY - 1
        a.items_read = at + 1
    s.first_reader = (s.first_reader + 1) % count


@step
def step_deal(a, q, t, batch_visit, visit_tile, visit_final, visit_entry, done):
    """Deals a batch to its tiles, an entry or a visit's end a cycle."""
    if a.dealing < 2:
        _next_visit(a, q, t, batch_visit, visit_tile, visit_final, visit_entry, done)
    if a.dealing < 2 or not _item_fits(a):
        return
    at, place = a.deal_entry, a.items_in & _ITEMS - 1
    a.item_times[place] = t + (1 if a.banks else _ITEM_LATENCY)
    a.items_in += 1
    if at < a.deal_last and done[q, visit_tile[a.deal_visit]] >= t:
        a.item_entry[place], a.item_half[place] = at, a.dealt & 1
        a.deal_entry = at + 1
        return
    a.item_entry[place] = -1
    a.deal_visit += 1
    a.dealing = 1
    if a.deal_visit == a.deal_end:
        a.dealing = 0
        a.dealt += 1
        a.released += 1


@step
def _slot(a, valid, load, drain):
    """Moves a slot into the setup unit's pipeline."""
    mask = (1 << _SETUP) - 1
    a.slot_valid = (a.slot_valid << 1 | valid) & mask
    a.slot_drain = (a.slot_drain << 1 | drain) & mask
    a.slot_load = (a.slot_load << 1 | load) & mask


@step
def step_setup(s, a, q, t, waiting, visit_tile, visit_final, visit_seen, use, stop, blend):
    """Steps BatchSetup, which turns visits and entries into slots. Returns whether an entry, or the end of a visit, is offered,
    and whether it is taken."""
    while a.leave_out != a.leave_in and a.leave_times[a.leave_out & 7] <= t:
        a.leave_out += 1
        a.in_flight -= 1
    advance = waiting < 2
    if advance:
        a.buffer_drain |= (a.slot_drain >> _SETUP - 1) << a.ops_buffered
        a.buffer_load |= (a.slot_load >> _SETUP - 1) << a.ops_buffered
        a.ops_buffered += a.slot_valid >> _SETUP - 1
    at = a.items_out
    there = at != (a.items_read if a.banks else a.items_in) and a.item_times[at & _ITEMS - 1] <= t
    takes, valid, load, drain, ends = False, False, False, False, a.visit_busy == 0
    if a.visit_busy:
        if a.visit_begun == 0:
            valid, load = True, True
            if advance:
                a.visit_begun = 1
        elif a.visit_second:
            valid = True
            if advance:
                a.visit_second = 0
        elif there:
            entry = a.item_entry[at & _ITEMS - 1]
            if entry < 0:
                valid = True
                drain = a.visit_ends == 0 or a.visit_ground == a.visit_blends
                takes = advance and drain
                ends = takes
                if advance:
                    a.visit_ground = 0 if drain else 1
            else:
                skip = a.stop_0 <= t and a.stop_1 <= t and a.in_flight == 1
                takes = advance or skip
                if takes:
                    both = a.visit_blends and use[entry] == 3
                    count = a.visit_count + 1
                    a.visit_count = count
                    if count == stop[q, a.visit_tile, 0]:
                        a.stop_0 = t + a.stop_latency
                    if count == stop[q, a.visit_tile, 1]:
                        a.stop_1 = t + a.stop_latency + both
                    if skip:
                        s.skipped += 1
                    else:
                        valid = True
                        a.visit_second = both
    a.items_out = at + takes
    if advance:
        _slot(a, valid, load, drain)
    if ends:
        a.visit_busy = 0
        at = a.visits_taken
        if at != a.visits_in and a.visit_times[at & _VISITS - 1] <= t and a.in_flight < ARRAY_TILES:
            _take_visit(a, q, t, a.visit_ids[at & _VISITS - 1], visit_tile, visit_final, visit_seen, stop, blend)
    return there, takes


@step
def _take_visit(a, q, t, visit, visit_tile, visit_final, visit_seen, stop, blend):
    tile, seen = visit_tile[visit], visit_seen[visit]
    a.visits_taken += 1
    a.in_flight += 1
    a.visit_busy, a.visit_begun, a.visit_second, a.visit_ground = 1, 0, 0, 0
    a.visit_tile, a.visit_blends, a.visit_count, a.visit_ends = tile, blend[tile], seen, visit_final[visit]
    a.stop_0 = t + a.stop_latency if stop[q, tile, 0] <= seen else bus.NEVER
    a.stop_1 = 0
    if blend[tile]:
        a.stop_1 = t + a.stop_latency if stop[q, tile, 1] <= seen else bus.NEVER


@step
def load_issue(a, t):
    """Loads the sequencer with the next operation from the setup unit's buffer."""
    if a.issue == 0 and a.ops_buffered:
        a.issue, a.issue_left = 1, a.blocks
        a.issue_drain, a.issue_load = a.buffer_drain & 1, a.buffer_load & 1
        a.ops_buffered -= 1
        a.buffer_drain >>= 1
        a.buffer_load >>= 1
        a.issue_at = t + (2 if a.blocks > 1 and a.issued_at != t - 1 else 0)


@step
def _may_issue(a, q, t, ends, pending, tile):
    """Whether the operation in the sequencer can be issued."""
    if a.issue_load:
        return a.load_wait == 0 and pending[q, tile] <= t
    if a.issue_drain == 0:
        return True
    if a.drain_wait:
        return False
    if ends == 0:
        return True
    return a.rows_free >= a.cores_y if a.incremental else a.row_halves != 0 or a.issue_left != a.blocks


@step
def step_issue(s, a, q, t, visit_tile, visit_final, visit_entry, visit_seen, stop, blend, pending, done):
    """Steps BatchSequencer, reserves space in the buffer behind the array, and notes when states land."""
    a.drain_wait -= a.drain_wait != 0
    a.load_wait -= a.load_wait != 0
    if a.issue == 0 or a.issue_at > t:
        return
    visit = a.visit_ids[a.issue_visit & _VISITS - 1]
    tile, ends = visit_tile[visit], visit_final[visit]
    if not _may_issue(a, q, t, ends, pending, tile):
        return
    s.ops += 1
    first = a.issue_left == a.blocks
    left = a.issue_left - 1
    a.issue_left = left
    if a.issue_load:
        a.load_wait = a.cores_y
    if a.issue_drain:
        a.drain_wait = a.cores_y
        if ends:
            _drain(a, t, left, first)
        elif left == 0:
            pending[q, tile] = t + a.store_latency
            seen = visit_seen[visit] + visit_entry[visit + 1] - visit_entry[visit]
            if stop[q, tile, 0] <= seen and (blend[tile] == 0 or stop[q, tile, 1] <= seen):
                done[q, tile] = t + a.store_latency + 2
        if left == 0:
            a.leave_times[a.leave_in & 7] = t + a.leave_latency
            a.leave_in += 1
            a.issue_visit += 1
    if left == 0:
        a.issue, a.issued_at = 0, t


@step
def _drain(a, t, left, first):
    """Reserves space for the rows of a tile that leaves."""
    if a.incremental:
        a.rows_free -= a.cores_y
        a.drain_times[a.drain_in & 63] = t + a.row_latency
        a.drain_in += 1
        return
    a.row_halves -= first
    if left == 0:
        a.drain_times[a.drain_in & 63] = t + a.row_latency + a.cores_y - 2
        a.drain_in += 1
