"""The colour unit, stepped cycle by cycle (rtl/culling/colour.py), with wide records and with compact ones."""

from __future__ import annotations

from perf import bus, chunk_units
from perf.bus import COLOUR, W_VIEWS
from perf.datapath import HARMONICS, MASK, RING, accepts, enter, fetch
from perf.kernel import step
from perf.layout import Layout

layout = Layout(chunk_units.layout)
layout.counters("colour")
layout.words("""
    colour_left colour_splat colour_beats colour_in colour_wait_out colour_waiting colour_number colour_place colour_count
    colour_lasts colour_sum colour_views colour_view colour_write colour_left_at colour_inside colour_ending colour_finished
    colour_ended colour_settled""")
layout.words("colour_compact colour_held colour_held_view colour_record colour_harmonics colour_second")
layout.ring("colour_waits", RING)


@step
def _write_views(s, granted, views, view_of):
    """Steps RecordWriter, which writes one beat for every level of the splat whose sums are complete."""
    if granted:
        bus.write(s, W_VIEWS, s.colour_view)
        s.colour_write = 0
    if s.colour_sum and s.colour_write == 0:
        at = s.colour_left_at
        level = s.colour_views
        while views[at] >> level & 1 == 0:
            level += 1
        s.colour_view, s.colour_write = view_of[at] + level, 1
        level += 1
        if views[at] >> level == 0:
            s.colour_sum, level = 0, 0
            s.colour_left_at = at + 1
            s.colour_inside -= 1
        s.colour_views = level


@step
def _sum_colour(s, t, steps):
    """Steps ColourSum, which makes a step of a record once its beats, at most two, are present."""
    lasts, place, count, number = s.colour_lasts, s.colour_place, s.colour_count, s.colour_number
    sums_free = lasts == 0 and s.colour_sum == 0
    last = number == len(steps) - 1
    there = place == steps[number, 0] and place + count >= steps[number, 1]
    step = s.path_full[HARMONICS] and there and (not last or sums_free)
    following = 0 if last else steps[number + 1, 0]
    move = count != 0 and ((last or following != place) if step else place != steps[number, 0])
    takes = (count < 2 or move) and bus.offered(s, COLOUR, t)
    if takes:
        bus.take(s, COLOUR)
    s.colour_count = count + takes - move
    if move:
        s.colour_place = 0 if place + 1 == s.colour_beats else place + 1
    if lasts & 2:
        s.colour_sum = 1
    s.colour_lasts = (lasts << 1 | (step and last)) & 3
    if step:
        s.colour_number = 0 if last else number + 1
        if last:
            s.path_full[HARMONICS] = 0


@step
def _write_compact_views(s, granted, views, view_of):
    """Steps CompactRecordWriter, which decodes a level into a register, and then rounds it into the register for the write."""
    if granted:
        bus.write(s, W_VIEWS, s.colour_view)
        s.colour_write = 0
    if s.colour_held:
        if s.colour_write:
            return
        s.colour_view, s.colour_write = s.colour_held_view, 1
    s.colour_held = s.colour_sum
    if s.colour_sum:
        at = s.colour_left_at
        level = s.colour_views
        while views[at] >> level & 1 == 0:
            level += 1
        s.colour_held_view = view_of[at] + level
        level += 1
        if views[at] >> level == 0:
            s.colour_sum, level = 0, 0
            s.colour_left_at = at + 1
            s.colour_inside -= 1
        s.colour_views = level


@step
def _sum_compact(s, t, steps):
    """Steps CompactColourSum, which makes a step of a splat once its beats, at most two, are present."""
    lanes, lasts = s.path_length[HARMONICS], s.colour_lasts
    move = s.colour_sum == 0 or (lanes and lasts & 4 == 0)
    number, two = s.colour_number, s.colour_beats > 1
    first, last = number == 0, number == steps - 1
    enough = (s.colour_record or not first) and (s.colour_harmonics or not two)
    step = s.path_full[HARMONICS] and enough and move
    leaves, used_up = step and first, step and last
    second = s.colour_second
    free = (s.colour_harmonics == 0 or used_up) if second else (s.colour_record == 0 or leaves)
    if leaves:
        s.colour_record = 0
    if used_up:
        s.colour_harmonics = 0
    if free and bus.offered(s, COLOUR, t):
        bus.take(s, COLOUR)
        if second:
            s.colour_harmonics = 1
        else:
            s.colour_record = 1
        s.colour_second = two and second == 0
    if move:
        if lanes:
            if lasts & 4:
                s.colour_sum = 1
            s.colour_lasts = (lasts << 1 | used_up) & 7
        elif step:
            s.colour_sum = 1
    if step:
        s.colour_number = 0 if last else number + 1
        if last:
            s.path_full[HARMONICS] = 0


@step
def step_colour(s, t, granted_read, granted_write, steps, views, view_of, colour_of):
    """Steps ColourUnit."""
    if s.colour_compact:
        _write_compact_views(s, granted_write, views, view_of)
    else:
        _write_views(s, granted_write, views, view_of)
    at = s.colour_wait_out
    waits = at != s.colour_in and s.colour_waits[at & MASK] <= t
    if s.path_length[HARMONICS]:
        if s.colour_compact:
            _sum_compact(s, t, len(steps))
        else:
            _sum_colour(s, t, steps)
        fetch(s, HARMONICS, t)
        if waits and accepts(s, HARMONICS, t):
            enter(s, HARMONICS, t)
            s.colour_wait_out = at + 1
    else:
        s.path_full[HARMONICS] = waits
        if s.colour_compact:
            _sum_compact(s, t, len(steps))
        else:
            _sum_colour(s, t, steps)
        s.colour_wait_out += waits and s.path_full[HARMONICS] == 0
    left = s.colour_left
    if granted_read:
        bus.read(s, COLOUR, colour_of[s.colour_splat] + s.colour_beats - left)
        s.colour_left = left - 1
    if s.survivors == 0:
        return
    if s.colour_ending == 0 and s.colour_in - at < s.colour_waiting and (left == 0 or (left == 1 and granted_read)):
        s.busy_colour += 1
        s.survivors -= 1
        if s.survivors == 0 and s.survivor_end:
            s.colour_ending, s.colour_ended = 1, 1
            return
        s.colour_waits[s.colour_in & MASK] = t + 2
        s.colour_splat = s.colour_in
        s.colour_in += 1
        s.colour_left = s.colour_beats
        s.colour_inside += 1
        s.colour_finished = 0
    else:
        s.blocked_colour += 1


@step
def finish_colour(s):
    """Updates the flags for the end of the colour unit's work, which follow one cycle later."""
    s.colour_settled = s.colour_ended and s.colour_finished
    empty = s.colour_place == 0 and s.colour_record == 0 and s.colour_harmonics == 0
    if s.colour_ending and s.colour_inside == 0 and empty and s.colour_write == 0 and s.colour_held == 0:
        s.colour_finished, s.colour_ending = 1, 0
