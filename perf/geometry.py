"""The phases TABLE and GEOMETRY, stepped cycle by cycle (rtl/top/geometry_phase.py and the units below it).

Within a cycle, units are stepped from the last to the first. Each takes from the register before it, which can then be filled
again in the same cycle, as in hardware where `ready` passes through combinationally. The content of a `Buffer` is read before
its consumer is stepped.
"""

from __future__ import annotations

from perf import bus, chunk_units, colour, memory
from perf.bus import COLOUR, GEOMETRY, TILES, W_ENTRIES, W_VIEWS
from perf.datapath import ELLIPSE, NEAR, PROJECTION, accepts, enter, fetch
from perf.kernel import phase, step
from perf.layout import Layout

NEAR_CULLED, OUTSIDE, VISIBLE, UNREAD = range(4)
"""Classes of points: NEAR_CULLED are behind the near plane or too faint; OUTSIDE touch no tile; VISIBLE are projected; UNREAD
lie in a chunk that is skipped."""

NOT_LAST, CLOSES, ENDS = range(3)
"""Kinds of runs of tiles: others of the same splat follow; the last one of its splat; the end of the frame."""

layout = Layout(colour.layout)
layout.counters("projection", "tile_test", "entry_write")

layout.words("""
    points asked near_point passed visible_at splat_left step walking walked cut cut_left run_full kept kept_room run clipped
    expanding rest has_entry survivors survivor_end writer_held""")
layout.words("""
    writer_first writer_slot writer_pipe writer_linked writer_out writer_buffer writer_sent writer_end writer_ended""")


@step
def pass_near(s, t, point_class):
    """Passes the points that the near test keeps to projection, and drops the others."""
    if s.path_full[NEAR]:
        if point_class[s.near_point] == NEAR_CULLED:
            s.path_full[NEAR] = 0
            s.near_point += 1
        elif accepts(s, PROJECTION, t):
            enter(s, PROJECTION, t)
            s.path_full[NEAR] = 0
            s.near_point += 1
    fetch(s, NEAR, t)


@step
def take_chunk_point(s, t, chunk_points):
    """Takes the point that the chunk reader offers into the near test."""
    if chunk_units.offers_point(s, t, chunk_points):
        if accepts(s, NEAR, t):
            enter(s, NEAR, t)
            s.busy_projection += 1
            s.point_taken = 1
        else:
            s.blocked_projection += 1


@step
def _write_entries(s, t, granted, begins, entry_writes):
    """Steps IntersectionWriter except its input. Returns whether its slots advance."""
    buffered = s.writer_buffer
    room = buffered < 2
    quiet = s.writer_pipe == 0 and buffered == 0 and bus.writes_idle(s, t, W_ENTRIES)
    if granted:
        at = s.writer_out
        bus.write(s, W_ENTRIES, entry_writes[at])
        s.writer_out = at + 1
        s.writer_buffer -= 1
    slot, sends, advance = s.writer_slot, 0, True
    if slot == 2:
        advance = quiet
        if quiet:
            s.writer_ended = 1
    elif slot == 1:
        if begins[s.writer_sent] and s.writer_linked == 0:
            sends, advance = 1, False
            s.writer_linked = room
        else:
            sends, advance = 1, room
    if room:
        pipe = s.writer_pipe
        s.writer_buffer += pipe >> 3
        s.writer_pipe = (pipe << 1 | sends) & 15
    if advance:
        s.writer_linked = 0
        s.writer_sent += slot == 1
    return advance


@step
def _expand(s, t, run_entries, run_closes, survivors_before, entries_ready):
    """Steps TileExpand, which takes one cycle for each intersection of a run, and one cycle for a run without. Returns what the
    entry writer gets: 0 for nothing, 1 for an intersection, 2 for the end."""
    given, load = 0, s.expanding == 0
    if s.expanding:
        run = s.run
        closes, count = run_closes[run], run_entries[run]
        end = closes == ENDS
        emits = end or count != 0
        final = end or s.rest == 0
        lives = final and closes != NOT_LAST and (end or emits or s.has_entry)
        can = survivors_before < 2 or not lives
        if can and emits:
            if entries_ready:
                given = 2 if end else 1
                s.busy_entry_write += 1
            else:
                s.blocked_entry_write += 1
        if can and (entries_ready or not emits):
            if lives:
                s.survivors += 1
                s.survivor_end |= end
            s.has_entry = 0 if final and closes != NOT_LAST else (s.has_entry or emits)
            if final and closes == CLOSES:
                s.kept -= 1
            s.rest -= 1
            load = final
            s.run += final
    if load:
        s.expanding = s.clipped
        if s.clipped:
            s.rest = max(0, int(run_entries[s.run]) - 1)
            s.clipped = 0
    if s.clipped == 0 and s.path_full[ELLIPSE]:
        s.clipped, s.path_full[ELLIPSE] = 1, 0
    return given


@step
def _walk(s, t, step_runs, splat_steps):
    """Steps TileRuns, which cuts the boxes of the splats, one after the other, into runs for the ellipse test."""
    if s.run_full and accepts(s, ELLIPSE, t):
        enter(s, ELLIPSE, t)
        s.run_full = 0
    if s.run_full == 0 and s.cut:
        s.run_full = 1
        s.cut_left -= 1
        s.cut = s.cut_left != 0
    if s.cut == 0 and s.walked:
        s.cut, s.cut_left = 1, step_runs[s.step]
        s.step += 1
        s.walked = 0
    if s.walking and s.walked == 0:
        s.walked = 1
        s.splat_left -= 1
        s.walking = s.splat_left != 0


@step
def _project(s, t, point_class, passed_class, splat_steps, chunk_points):
    """Steps the units from memory's points to the input of the tile test."""
    _walks = s.walking
    if s.path_full[PROJECTION]:
        at = s.passed
        if passed_class[at] == OUTSIDE:
            s.path_full[PROJECTION] = 0
            s.passed = at + 1
        elif _walks == 0 and s.kept < s.kept_room:
            s.busy_tile_test += 1
            s.path_full[PROJECTION] = 0
            s.passed = at + 1
            s.walking, s.splat_left = 1, splat_steps[s.visible_at]
            s.visible_at += 1
            s.kept += 1
        else:
            s.blocked_tile_test += 1
    fetch(s, PROJECTION, t)
    pass_near(s, t, point_class)
    if s.chunked:
        take_chunk_point(s, t, chunk_points)
        return
    points, entered = s.points, s.path_in[NEAR]
    ends = entered == points
    if ends or (entered < points and bus.offered(s, GEOMETRY, t)):
        if accepts(s, NEAR, t):
            enter(s, NEAR, t)
            s.busy_projection += 1
            if not ends:
                bus.take(s, GEOMETRY)
                s.busy_geometry += 1
        else:
            s.blocked_projection += 1
            s.blocked_geometry += not ends


@phase
def geometry_phase(
    s, point_class, passed_class, splat_steps, step_runs, run_entries, run_closes, views, view_of, colour_of, geometry_base,
    begins, entry_writes, colour_step, header_base, chunk_at, chunk_read, chunk_first, chunk_points, limit,
):
    """Simulates the phase GEOMETRY. Returns its cycles, and the cycle in which the frame's last intersection was in memory."""
    points, t, counted = s.points, 0, -1
    while t < limit:
        asked = s.asked
        if s.chunked:
            asking = chunk_units.chunk_requests(s)
        else:
            asking = (1 << GEOMETRY) if asked < points and s.credits[GEOMETRY] else 0
        if s.colour_left and s.credits[COLOUR]:
            asking |= 1 << COLOUR
        reader = bus.grant_read(s, t, asking)
        asking = 1 << W_ENTRIES if s.writer_buffer else 0
        if s.colour_write:
            asking |= 1 << W_VIEWS
        writer = bus.grant_write(s, t, asking)
        survivors = s.survivors
        if s.colour_settled and s.colour_finished and bus.writes_idle(s, t, W_VIEWS) and s.writer_ended > 1:
            return t + 1, counted
        if s.writer_ended:
            if counted < 0:
                counted = t + 1
            s.writer_ended = 2
        colour.finish_colour(s)
        colour.step_colour(s, t, reader == COLOUR, writer == W_VIEWS, colour_step, views, view_of, colour_of)
        writing = s.writer_slot | s.writer_first | s.writer_held | s.writer_pipe | s.writer_buffer
        if (writing | s.expanding | s.clipped | s.path_full[ELLIPSE]) != 0:
            advance = _write_entries(s, t, writer == W_ENTRIES, begins, entry_writes)
            held = s.writer_held
            given = _expand(s, t, run_entries, run_closes, survivors, held == 0 and s.writer_end == 0)
            s.writer_end |= given == 2
            s.writer_held = held | given
            if advance:
                s.writer_slot, s.writer_first, s.writer_held = s.writer_first, s.writer_held, 0
        fetch(s, ELLIPSE, t)
        _walk(s, t, step_runs, splat_steps)
        _project(s, t, point_class, passed_class, splat_steps, chunk_points)
        if s.chunked:
            chunk_units.step_chunks(s, t, reader, header_base, geometry_base, chunk_at, chunk_read, chunk_first, chunk_points)
        elif reader == GEOMETRY:
            bus.read(s, GEOMETRY, geometry_base + asked)
            s.asked = asked + 1
        memory.end_cycle(s, t)
        t += 1
    return -1, counted


@phase
def table_phase(s, tiles, base, limit):
    """Simulates the phase TABLE, in which the table's beats, four tiles each, go to the tile test at one tile per cycle.
    Returns its cycles."""
    beats, asked, left, valid, taken, t = (tiles + 3) // 4, 0, 0, False, 0, 0
    while t < limit:
        reader = bus.grant_read(s, t, 1 << TILES if asked < beats and s.credits[TILES] else 0)
        uses_up = left == 0 or taken == tiles - 1
        if valid:
            taken += 1
        if (not valid or uses_up) and bus.offered(s, TILES, t):
            bus.take(s, TILES)
            valid, left = True, 3
        elif valid:
            valid, left = not uses_up, left - 1
        if reader == TILES:
            bus.read(s, TILES, base + asked)
            asked += 1
        memory.end_cycle(s, t)
        t += 1
        if taken == tiles:
            return t + 2  # `done` rises one cycle later and is seen in the cycle after that
    return -1


@phase
def idle_phase(s, cycles):
    """Simulates cycles in which nothing is asked of the memory."""
    for t in range(cycles):
        memory.end_cycle(s, t)
