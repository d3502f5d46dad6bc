"""The first phase of machines with lists by super-tile, stepped cycle by cycle: from chunks to lists of pairs (rtl/chunks,
rtl/culling, rtl/supertiles).

Units are stepped from the last to the first, for the reason that `perf.geometry` gives.
"""

from __future__ import annotations

from perf import bus, chunk_units, memory
from perf.bus import W_ENTRIES
from perf.datapath import ELLIPSE, NEAR, PROJECTION, accepts, enter, fetch
from perf.geometry import CLOSES, ENDS, OUTSIDE, pass_near
from perf.kernel import phase, step
from perf.layout import Layout
from spec.queues import LINES_AHEAD

layout = Layout(chunk_units.layout)
layout.counters("projection", "tile_test", "entry_write")
layout.words("""
    near_point passed visible_at splat_left walking walked clipped kept kept_room step_full step_left step_at
    line_in line_out pairs_left bucket_pipe two_eyes eye_points points_left pair_given counted
    writer_first writer_slot writer_pipe writer_linked writer_out writer_buffer writer_sent writer_ended flush_at list_count""")

layout.words("table_from table_tiles table_base table_next table_asked table_left table_valid table_taken bin_from")
layout.ring("line_pairs", LINES_AHEAD)
layout.ring("line_times", LINES_AHEAD)

_LINE = LINES_AHEAD - 1
_LINE_LATENCY = 2  # cycles from a step's last group until its pairs can be loaded
_BUCKET_STAGES = 16  # from a pair to its list (rtl.supertiles.depth_buckets)
_PIPE = 15


@step
def _write_pairs(s, t, granted, pair_writes, entry_writes, flushed):
    """Steps PairWriter except its input. Returns whether its slots advance.

    The slot holds 0 for nothing, 1 for a pair, 2 for the frame's end, during which every list is looked at.
    """
    buffered = s.writer_buffer
    room = buffered < 2
    quiet = s.writer_pipe == 0 and buffered == 0 and bus.writes_idle(s, t, W_ENTRIES)
    if granted:
        bus.write(s, W_ENTRIES, entry_writes[s.writer_out])
        s.writer_out += 1
        s.writer_buffer -= 1
    slot, sends, advance = s.writer_slot, 0, True
    if slot == 2:
        advance = False
        if s.flush_at < s.list_count:
            sends = flushed[s.flush_at]
            s.flush_at += room or sends == 0
        elif quiet:
            advance = True
            s.writer_ended = 1
    elif slot == 1:
        kind = pair_writes[s.writer_sent]
        if kind & 1 and s.writer_linked == 0:
            sends, advance = 1, False
            s.writer_linked = room
        elif kind & 2:
            sends, advance = 1, room
    if room:
        pipe = s.writer_pipe
        s.writer_buffer += pipe >> 3
        s.writer_pipe = (pipe << 1 | sends) & _PIPE
    if advance:
        s.writer_linked = 0
        s.writer_sent += slot == 1
    return advance


@step
def _give_pairs(s, t, step_groups, step_pairs, step_closes, pair_drops, ready):
    """Steps the parts of the tile test behind the ellipse test, and the depth buckets, before which pairs with `pair_drops` are
    dropped. `ready`: the pair writer takes an item. Returns what it gets: 0 for nothing, 1 for a pair, 2 for the end."""
    given, pipe = 0, s.bucket_pipe
    last = pipe >> 2 * (_BUCKET_STAGES - 1) & 3
    moves = ready or last == 0
    if last:
        if ready:
            given = last
            s.busy_entry_write += 1
        else:
            s.blocked_entry_write += 1
    room = s.line_in - s.line_out < LINES_AHEAD
    if moves:
        enters = 0
        if s.pairs_left < 0:
            enters, s.pairs_left = 2, 0
        elif s.pairs_left:
            enters = pair_drops[s.pair_given] == 0
            s.pair_given += 1
            s.pairs_left -= 1
        s.bucket_pipe = (pipe << 2 | enters) & (1 << 2 * _BUCKET_STAGES) - 1
    at = s.line_out
    if s.pairs_left == 0 and at != s.line_in and s.line_times[at & _LINE] <= t:
        s.pairs_left = s.line_pairs[at & _LINE]
        s.line_out = at + 1
    if s.step_full and room:
        left = s.step_left
        if left > 1:
            s.step_left = left - 1
        else:
            at = s.step_at
            pairs, closes = step_pairs[at], step_closes[at]
            end = closes == ENDS
            if pairs or end:
                s.line_pairs[s.line_in & _LINE], s.line_times[s.line_in & _LINE] = -1 if end else pairs, t + _LINE_LATENCY
                s.line_in += 1
            s.kept -= closes == CLOSES
            s.step_at = at + 1
            s.step_full = 0
    if s.step_full == 0 and s.path_full[ELLIPSE]:
        s.path_full[ELLIPSE] = 0
        s.step_full, s.step_left = 1, step_groups[s.step_at]
    return given


@step
def _walk(s, t):
    """Cuts the boxes of splats into steps, one after the other, for the ellipse test."""
    if s.walked and accepts(s, ELLIPSE, t):
        enter(s, ELLIPSE, t)
        s.walked = 0
    if s.walking and s.walked == 0:
        s.walked = 1
        s.splat_left -= 1
        s.walking = s.splat_left != 0


@step
def _take_point(s, t, chunk_points):
    """Takes the point that the chunk reader offers into the near test. In joint frames it waits in a register until it has been
    taken for both eyes; the frame's end is taken once."""
    entered = accepts(s, NEAR, t)
    if s.eye_points and entered:
        enter(s, NEAR, t)
        s.eye_points -= 1
    if chunk_units.offers_point(s, t, chunk_points):
        if s.two_eyes and s.eye_points == 0:
            s.eye_points = 2 if s.points_left else 1
            s.points_left -= 1
            entered = True
        elif s.two_eyes:
            entered = False
        elif entered:
            enter(s, NEAR, t)
        s.point_taken = entered
        s.busy_projection += entered
        s.blocked_projection += entered == 0


@step
def _project(s, t, point_class, passed_class, splat_steps, chunk_points):
    """Steps the units from memory's points to the input of the tile test."""
    if s.clipped:
        if s.walking == 0 and s.kept < s.kept_room:
            s.busy_tile_test += 1
            s.clipped = 0
            s.walking, s.splat_left = 1, splat_steps[s.visible_at]
            s.visible_at += 1
            s.kept += 1
        else:
            s.blocked_tile_test += 1
    if s.path_full[PROJECTION]:
        outside = passed_class[s.passed] == OUTSIDE
        if outside or s.clipped == 0:
            s.path_full[PROJECTION] = 0
            s.passed += 1
            s.clipped |= not outside
    fetch(s, PROJECTION, t)
    pass_near(s, t, point_class)
    _take_point(s, t, chunk_points)


@step
def asking(s):
    """The clients that ask for a read and those that ask for a write, a bit for each."""
    return chunk_units.chunk_requests(s), 1 << W_ENTRIES if s.writer_buffer else 0


@phase
def bin_cycle(
    s, t, reader, writer, point_class, passed_class, splat_steps, step_groups, step_pairs, step_closes, pair_drops,
    pair_writes, entry_writes, flushed, header_base, geometry_base, chunk_at, chunk_read, chunk_first, chunk_points,
):
    """Steps all units of the phase. `reader` and `writer` are the clients whose read and write were granted. Returns whether
    the phase has ended, in which case nothing was stepped."""
    if s.writer_ended > 1:
        return True
    if s.writer_ended:
        s.counted = t + 1
        s.writer_ended = 2
    advance = _write_pairs(s, t, writer == W_ENTRIES, pair_writes, entry_writes, flushed)
    given = _give_pairs(s, t, step_groups, step_pairs, step_closes, pair_drops, advance)
    if advance:
        s.writer_slot, s.writer_first = s.writer_first, given
    fetch(s, ELLIPSE, t)
    _walk(s, t)
    _project(s, t, point_class, passed_class, splat_steps, chunk_points)
    chunk_units.step_chunks(s, t, reader, header_base, geometry_base, chunk_at, chunk_read, chunk_first, chunk_points)
    return False


@phase
def bin_phase(s, arguments, limit):
    """Simulates the phase GEOMETRY; `arguments` are those of `bin_cycle` behind the granted clients. Returns its cycles, or -1
    when it has not ended within `limit` cycles; `counted` is the cycle in which the frame's last pair was in memory."""
    for t in range(limit):
        reads, writes = asking(s)
        reader, writer = bus.grant_read(s, t, reads), bus.grant_write(s, t, writes)
        if bin_cycle(s, t, reader, writer, *arguments):
            return t + 1
        memory.end_cycle(s, t)
    return -1
