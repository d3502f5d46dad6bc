"""The phases TABLE and GEOMETRY, stepped cycle by cycle (rtl/top/geometry_phase.py and the units below it).

Within a cycle, units are stepped from the last to the first. Each takes from the register before it, which can then be filled
again in the same cycle, as in hardware where `ready` passes through combinationally. The content of a `Buffer` is read before
its consumer is stepped.
"""

from __future__ import annotations

from perf import bus, memory
from perf.bus import COLOUR, CREDITS, GEOMETRY, TILES, W_ENTRIES, W_VIEWS
from perf.kernel import phase, step
from perf.layout import Layout

NEAR_CULLED, OUTSIDE, VISIBLE = range(3)
"""Classes of points: NEAR_CULLED are behind the near plane or too faint; OUTSIDE touch no tile; VISIBLE are projected."""

NOT_LAST, CLOSES, ENDS = range(3)
"""Kinds of runs of tiles: others of the same splat follow; the last one of its splat; the end of the frame."""

layout = Layout(memory.layout.size)
_RING = 128
_MASK = _RING - 1

(BUSY_GEOMETRY, BLOCKED_GEOMETRY, BUSY_PROJECTION, BLOCKED_PROJECTION, BUSY_TILES, BLOCKED_TILES, BUSY_COLOUR, BLOCKED_COLOUR,
 BUSY_ENTRIES, BLOCKED_ENTRIES) = layout.words("geometry . projection . tile_test . colour . entry_write .")
WATCHED = BUSY_GEOMETRY

# The state of a datapath: length, interval, slots entered, slots fetched, free rows, whether the output register is full,
# times.
_LENGTH, _INTERVAL, _IN, _OUT, _FREE, _FULL, _TIMES = range(7)
_PATH = 8 + _RING
NEAR, PROJECTION, ELLIPSE, HARMONICS = (layout.size + i * _PATH for i in range(4))
layout.size += 4 * _PATH

(POINTS, ASKED, POINT, PASSED, VISIBLE_AT, SPLAT_LEFT, STEP, WALKING, WALKED, CUT, CUT_LEFT, RUN_FULL, KEPT, KEPT_ROOM,
 RUN, CLIPPED, EXPANDING, REST, HAS_ENTRY, SURVIVORS, SURVIVOR_IN, SURVIVOR_END) = layout.words(
    "points asked point passed visible splat_left step walking walked cut cut_left run_full kept kept_room "
    "run clipped expanding rest has_entry survivors survivor_in survivor_end")
(E_FIRST, E_SLOT, E_PIPE, E_LINKED, E_OUT, E_BUFFER, E_TAKEN, E_SENT, E_END, E_ENDED) = layout.words(
    "e_first e_slot e_pipe e_linked e_out e_buffer e_taken e_sent e_end e_ended")
(C_LEFT, C_SPLAT, C_BEATS, C_IN, C_WAIT_OUT, C_WAITING, C_NUMBER, C_PLACE, C_COUNT, C_LASTS, C_SUM, C_VIEWS, C_VIEW, C_WRITE,
 C_LEFT_AT, C_INSIDE, C_ENDING, C_FINISHED, C_ENDED, C_SETTLED) = layout.words(
    "c_left c_splat c_beats c_in c_wait_out c_waiting c_number c_place c_count c_lasts c_sum c_views c_view c_write "
    "c_left_at c_inside c_ending c_finished c_ended c_settled")
C_RING = layout.ring(_RING)


def set_path(s, p, length, interval, rows):
    """Initialises an empty datapath whose state begins at p."""
    s[p + _LENGTH], s[p + _INTERVAL], s[p + _FREE] = length, interval, rows


@step
def _fetch(s, p, t):
    """Moves a finished slot into the output register if that is free."""
    if s[p + _FULL] == 0:
        at = s[p + _OUT]
        if at != s[p + _IN] and s[p + _TIMES + (at & _MASK)] <= t:
            s[p + _OUT], s[p + _FULL] = at + 1, 1
            s[p + _FREE] += 1


@step
def _accepts(s, p, t):
    return s[p + _FREE] != 0 and (s[p + _INTERVAL] == 1 or t % s[p + _INTERVAL] == 0)


@step
def _enter(s, p, t):
    at = s[p + _IN]
    s[p + _TIMES + (at & _MASK)] = t + s[p + _LENGTH] + 1
    s[p + _IN] = at + 1
    s[p + _FREE] -= 1


@step
def _write_views(s, granted, views, view_of):
    """Steps ViewWriter, which writes one beat for every level of the splat whose sums are complete."""
    if granted:
        bus.write(s, W_VIEWS, s[C_VIEW])
        s[C_WRITE] = 0
    if s[C_SUM] and s[C_WRITE] == 0:
        at = s[C_LEFT_AT]
        level = s[C_VIEWS]
        while views[at] >> level & 1 == 0:
            level += 1
        s[C_VIEW], s[C_WRITE] = view_of[at] + level, 1
        level += 1
        if views[at] >> level == 0:
            s[C_SUM], level = 0, 0
            s[C_LEFT_AT] = at + 1
            s[C_INSIDE] -= 1
        s[C_VIEWS] = level


@step
def _sum_colour(s, t, steps):
    """Steps ColourSum, which makes a step of a record once its beats, at most two, are present."""
    lasts, place, count, number = s[C_LASTS], s[C_PLACE], s[C_COUNT], s[C_NUMBER]
    sums_free = lasts == 0 and s[C_SUM] == 0
    last = number == len(steps) - 1
    step = s[HARMONICS + _FULL] and place == steps[number, 0] and place + count >= steps[number, 1] and (not last or sums_free)
    following = 0 if last else steps[number + 1, 0]
    move = count != 0 and ((last or following != place) if step else place != steps[number, 0])
    takes = (count < 2 or move) and bus.offered(s, COLOUR, t)
    if takes:
        bus.take(s, COLOUR)
    s[C_COUNT] = count + takes - move
    if move:
        s[C_PLACE] = 0 if place + 1 == s[C_BEATS] else place + 1
    if lasts & 2:
        s[C_SUM] = 1
    s[C_LASTS] = (lasts << 1 | (step and last)) & 3
    if step:
        s[C_NUMBER] = 0 if last else number + 1
        if last:
            s[HARMONICS + _FULL] = 0


@step
def _colour(s, t, granted_read, granted_write, steps, views, view_of, colour_of):
    """Steps ColourUnit."""
    _write_views(s, granted_write, views, view_of)
    at = s[C_WAIT_OUT]
    waits = at != s[C_IN] and s[C_RING + (at & _MASK)] <= t
    if s[HARMONICS + _LENGTH]:
        _sum_colour(s, t, steps)
        _fetch(s, HARMONICS, t)
        if waits and _accepts(s, HARMONICS, t):
            _enter(s, HARMONICS, t)
            s[C_WAIT_OUT] = at + 1
    else:
        s[HARMONICS + _FULL] = waits
        _sum_colour(s, t, steps)
        s[C_WAIT_OUT] += waits and s[HARMONICS + _FULL] == 0
    left = s[C_LEFT]
    if granted_read:
        bus.read(s, COLOUR, colour_of[s[C_SPLAT]] + s[C_BEATS] - left)
        s[C_LEFT] = left - 1
    if s[SURVIVORS] == 0:
        return
    if s[C_ENDING] == 0 and s[C_IN] - at < s[C_WAITING] and (left == 0 or (left == 1 and granted_read)):
        s[BUSY_COLOUR] += 1
        s[SURVIVORS] -= 1
        if s[SURVIVORS] == 0 and s[SURVIVOR_END]:
            s[C_ENDING], s[C_ENDED] = 1, 1
            return
        s[C_RING + (s[C_IN] & _MASK)] = t + 2
        s[C_SPLAT] = s[C_IN]
        s[C_IN] += 1
        s[C_LEFT] = s[C_BEATS]
        s[C_INSIDE] += 1
        s[C_FINISHED] = 0
    else:
        s[BLOCKED_COLOUR] += 1


@step
def _finish_colour(s):
    """Updates the flags for the end of the colour unit's work, which follow one cycle later."""
    s[C_SETTLED] = s[C_ENDED] and s[C_FINISHED]
    if s[C_ENDING] and s[C_INSIDE] == 0 and s[C_PLACE] == 0 and s[C_WRITE] == 0:
        s[C_FINISHED], s[C_ENDING] = 1, 0


@step
def _write_entries(s, t, granted, begins, entry_writes):
    """Steps EntryWriter except its input. Returns whether its slots advance."""
    buffered = s[E_BUFFER]
    room = buffered < 2
    quiet = s[E_PIPE] == 0 and buffered == 0 and bus.writes_idle(s, t, W_ENTRIES)
    if granted:
        at = s[E_OUT]
        bus.write(s, W_ENTRIES, entry_writes[at])
        s[E_OUT] = at + 1
        s[E_BUFFER] -= 1
    slot, sends, advance = s[E_SLOT], 0, True
    if slot == 2:
        advance = quiet
        if quiet:
            s[E_ENDED] = 1
    elif slot == 1:
        if begins[s[E_SENT]] and s[E_LINKED] == 0:
            sends, advance = 1, False
            s[E_LINKED] = room
        else:
            sends, advance = 1, room
    if room:
        pipe = s[E_PIPE]
        s[E_BUFFER] += pipe >> 3
        s[E_PIPE] = (pipe << 1 | sends) & 15
    if advance:
        s[E_LINKED] = 0
        s[E_SENT] += slot == 1
    return advance


@step
def _expand(s, t, run_entries, run_closes, survivors_before, entries_ready):
    """Steps TileExpand, which takes one cycle for each intersection of a run, and one cycle for a run without. Returns what the
    entry writer gets: 0 for nothing, 1 for an intersection, 2 for the end."""
    given, load = 0, s[EXPANDING] == 0
    if s[EXPANDING]:
        run = s[RUN]
        closes, count = run_closes[run], run_entries[run]
        end = closes == ENDS
        emits = end or count != 0
        final = end or s[REST] == 0
        lives = final and closes != NOT_LAST and (end or emits or s[HAS_ENTRY])
        can = survivors_before < 2 or not lives
        if can and emits:
            if entries_ready:
                given = 2 if end else 1
                s[BUSY_ENTRIES] += 1
            else:
                s[BLOCKED_ENTRIES] += 1
        if can and (entries_ready or not emits):
            if lives:
                s[SURVIVORS] += 1
                s[SURVIVOR_END] |= end
            s[HAS_ENTRY] = 0 if final and closes != NOT_LAST else (s[HAS_ENTRY] or emits)
            if final and closes == CLOSES:
                s[KEPT] -= 1
            s[REST] -= 1
            load = final
            s[RUN] += final
    if load:
        s[EXPANDING] = s[CLIPPED]
        if s[CLIPPED]:
            s[REST] = max(0, int(run_entries[s[RUN]]) - 1)
            s[CLIPPED] = 0
    if s[CLIPPED] == 0 and s[ELLIPSE + _FULL]:
        s[CLIPPED], s[ELLIPSE + _FULL] = 1, 0
    return given


@step
def _walk(s, t, step_runs, splat_steps):
    """Steps TileRuns, which cuts the boxes of the splats, one after the other, into runs for the ellipse test."""
    if s[RUN_FULL] and _accepts(s, ELLIPSE, t):
        _enter(s, ELLIPSE, t)
        s[RUN_FULL] = 0
    if s[RUN_FULL] == 0 and s[CUT]:
        s[RUN_FULL] = 1
        s[CUT_LEFT] -= 1
        s[CUT] = s[CUT_LEFT] != 0
    if s[CUT] == 0 and s[WALKED]:
        s[CUT], s[CUT_LEFT] = 1, step_runs[s[STEP]]
        s[STEP] += 1
        s[WALKED] = 0
    if s[WALKING] and s[WALKED] == 0:
        s[WALKED] = 1
        s[SPLAT_LEFT] -= 1
        s[WALKING] = s[SPLAT_LEFT] != 0


@step
def _project(s, t, point_class, passed_class, splat_steps):
    """Steps the units from memory's points to the input of the tile test."""
    _walks = s[WALKING]
    if s[PROJECTION + _FULL]:
        at = s[PASSED]
        if passed_class[at] == OUTSIDE:
            s[PROJECTION + _FULL] = 0
            s[PASSED] = at + 1
        elif _walks == 0 and s[KEPT] < s[KEPT_ROOM]:
            s[BUSY_TILES] += 1
            s[PROJECTION + _FULL] = 0
            s[PASSED] = at + 1
            s[WALKING], s[SPLAT_LEFT] = 1, splat_steps[s[VISIBLE_AT]]
            s[VISIBLE_AT] += 1
            s[KEPT] += 1
        else:
            s[BLOCKED_TILES] += 1
    _fetch(s, PROJECTION, t)
    if s[NEAR + _FULL]:
        if point_class[s[POINT]] == NEAR_CULLED:
            s[NEAR + _FULL] = 0
            s[POINT] += 1
        elif _accepts(s, PROJECTION, t):
            _enter(s, PROJECTION, t)
            s[NEAR + _FULL] = 0
            s[POINT] += 1
    _fetch(s, NEAR, t)
    points, entered = s[POINTS], s[NEAR + _IN]
    ends = entered == points
    if ends or (entered < points and bus.offered(s, GEOMETRY, t)):
        if _accepts(s, NEAR, t):
            _enter(s, NEAR, t)
            s[BUSY_PROJECTION] += 1
            if not ends:
                bus.take(s, GEOMETRY)
                s[BUSY_GEOMETRY] += 1
        else:
            s[BLOCKED_PROJECTION] += 1
            s[BLOCKED_GEOMETRY] += not ends


@phase
def geometry_phase(
    s, point_class, passed_class, splat_steps, step_runs, run_entries, run_closes, views, view_of, colour_of, geometry_base,
    begins, entry_writes, colour_step, limit,
):
    """Simulates the phase GEOMETRY. Returns its cycles, and the cycle in which the frame's last intersection was in memory."""
    points, t, counted = s[POINTS], 0, -1
    while t < limit:
        asked = s[ASKED]
        asking = (1 << GEOMETRY) if asked < points and s[CREDITS + GEOMETRY] else 0
        if s[C_LEFT] and s[CREDITS + COLOUR]:
            asking |= 1 << COLOUR
        reader = bus.grant_read(s, t, asking)
        asking = 1 << W_ENTRIES if s[E_BUFFER] else 0
        if s[C_WRITE]:
            asking |= 1 << W_VIEWS
        writer = bus.grant_write(s, t, asking)
        survivors = s[SURVIVORS]
        if s[C_SETTLED] and s[C_FINISHED] and bus.writes_idle(s, t, W_VIEWS) and s[E_ENDED] > 1:
            return t + 1, counted
        if s[E_ENDED]:
            if counted < 0:
                counted = t + 1
            s[E_ENDED] = 2
        _finish_colour(s)
        _colour(s, t, reader == COLOUR, writer == W_VIEWS, colour_step, views, view_of, colour_of)
        if (s[EXPANDING] | s[CLIPPED] | s[ELLIPSE + _FULL] | s[E_SLOT] | s[E_FIRST] | s[E_PIPE] | s[E_BUFFER]) != 0:
            advance = _write_entries(s, t, writer == W_ENTRIES, begins, entry_writes)
            given = _expand(s, t, run_entries, run_closes, survivors, advance and s[E_END] == 0)
            if advance:
                s[E_SLOT], s[E_FIRST] = s[E_FIRST], given
                s[E_END] |= given == 2
        _fetch(s, ELLIPSE, t)
        _walk(s, t, step_runs, splat_steps)
        _project(s, t, point_class, passed_class, splat_steps)
        if reader == GEOMETRY:
            bus.read(s, GEOMETRY, geometry_base + asked)
            s[ASKED] = asked + 1
        memory.end_cycle(s, t)
        t += 1
    return -1, counted


@phase
def table_phase(s, tiles, base, limit):
    """Simulates the phase TABLE, in which the table's beats, four tiles each, go to the tile test at one tile per cycle.
    Returns its cycles."""
    beats, asked, left, valid, taken, t = (tiles + 3) // 4, 0, 0, False, 0, 0
    while t < limit:
        reader = bus.grant_read(s, t, 1 << TILES if asked < beats and s[CREDITS + TILES] else 0)
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
