"""The gather of the second phase, stepped cycle by cycle: records of sorted pairs are fetched, projected and tested again, and
become places of the batch buffer (rtl/supertiles/{record_fetch,clip,tile_test,colour}.py)."""

from __future__ import annotations

from perf import blending, bus, sorter
from perf.bus import CHUNKS, COLOUR, TILES
from perf.constants import HELD
from perf.datapath import ELLIPSE, HARMONICS, NEAR, PROJECTION, accepts, add_paths, enter, fetch
from perf.kernel import step
from perf.layout import Layout
from spec.constants import SUPER_TILES
from spec.memory import BEAT_BYTES, TILE_SETTING_BYTES
from spec.queues import HEADERS_MISSED, HEADERS_PENDING, RECORD_BEATS, RECORDS_PENDING, SUPERTILES_TURNING

layout = Layout(blending.layout)
add_paths(layout)
layout.counters("projection", "tile_test", "colour", "batch")
_PENDING = 256
layout.words("""
    record_beats looked header_requests headers_sent header_misses placed header_there headers_held awaiting asked_second
    record_requests records_sent joined join_second beats_held points_in points_out""")
layout.words("""
    supers_owed supers_asked supers_part supers_whole supers_taken super_beats clip_left clipped walked kept kept_room survivors
    colour_steps sum_left sums_in sums_out place_left place_pair two_eyes eye_points colour_held colour_item pairs_freed
    by_turns supers_passed""")
layout.ring("located_times", _PENDING)
layout.ring("awaited_times", _PENDING)
layout.ring("header_address", 8)
layout.ring("record_address", 8)
_POINTS = 16
layout.ring("point_times", _POINTS)
layout.ring("sum_times", 8)

SUPERTILE_BEATS = SUPER_TILES * TILE_SETTING_BYTES // BEAT_BYTES

LIT, WAITS = 1, 2
"""Bits of `lit` in `step_colour`: colours are computed for a survivor; it waits for that of the other eye behind it."""

_TAGS, _LINES, _DECODE, _PLACES = 4, 3, 9, 4
"""Cycles of the tags; of the lines of headers, before a record's address is known; of the lines and the decode unit behind the
record; and of the colour unit behind its sums."""


@step
def step_look(s, t, granted, missed, header_beat):
    """Looks up the header of the next pair. Returns whether a pair is taken."""
    requests = s.header_requests
    if granted:
        bus.read(s, CHUNKS, s.header_address[s.headers_sent & 7])
        s.headers_sent += 1
        s.header_requests -= 1
    if not sorter.handover_offers(s, t):
        return False
    at = s.looked
    if at - s.placed >= HEADERS_PENDING or requests >= 2:
        s.blocked_fetch += 1
        return False
    s.busy_fetch += 1
    s.located_times[at & _PENDING - 1] = t + _TAGS
    s.looked = at + 1
    if missed[at]:
        s.header_address[s.headers_sent + s.header_requests & 7] = header_beat[at]
        s.header_requests += 1
        s.header_misses += 1
    return True


@step
def step_ask(s, t, granted, missed, record_beat):
    """Requests the beats of the next pair whose header has come."""
    requests = s.record_requests
    if granted:
        bus.read(s, COLOUR, s.record_address[s.records_sent & 7])
        s.records_sent += 1
        s.record_requests -= 1
    at = s.placed
    if at == s.looked or s.located_times[at & _PENDING - 1] > t:
        return
    if missed[at] and s.header_there == 0:
        if s.headers_held < HEADERS_MISSED and bus.offered(s, CHUNKS, t):
            bus.take(s, CHUNKS)
            s.headers_held += 1
            s.header_there = 1
        return
    second = s.asked_second
    if requests >= 2 or (second == 0 and s.awaiting - s.joined >= RECORDS_PENDING):
        return
    s.record_address[s.records_sent + s.record_requests & 7] = record_beat[at] + second
    s.record_requests += 1
    if second == 0:
        s.awaited_times[at & _PENDING - 1] = t + _LINES
        s.awaiting = at + 1
    s.asked_second = s.record_beats > 1 and second == 0
    if s.asked_second == 0:
        s.placed, s.header_there = at + 1, 0


@step
def step_join(s, t, missed):
    """Takes a beat of a record: with the first, its pair goes to projection."""
    if not bus.offered(s, COLOUR, t) or s.beats_held >= RECORD_BEATS:
        return
    if s.join_second:
        s.join_second = 0
    else:
        at = s.joined
        if at == s.awaiting or s.awaited_times[at & _PENDING - 1] > t or s.points_in - s.points_out >= _DECODE + 1:
            return
        s.point_times[s.points_in & _POINTS - 1] = t + _DECODE
        s.points_in += 1
        s.joined = at + 1
        s.headers_held -= missed[at]
        s.join_second = s.record_beats > 1
    bus.take(s, COLOUR)
    s.beats_held += 1


@step
def step_supertiles(s, t, granted, pair_counts):
    """Steps SuperTileReader, and SuperTileClip's side that takes super-tiles."""
    whole = s.supers_whole
    if s.clip_left == 0 and (s.supers_passed != s.supers_taken if s.by_turns else whole):
        s.clip_left = pair_counts[s.supers_taken]
        s.supers_taken += 1
        s.supers_whole &= s.by_turns
    if s.by_turns and whole and s.supers_passed - s.supers_taken < SUPERTILES_TURNING:
        s.supers_passed += 1  # into the queues before the clip and before the points of both eyes
        s.supers_whole = 0
    if whole == 0 and bus.offered(s, TILES, t):
        bus.take(s, TILES)
        s.supers_part += 1
        if s.supers_part == s.super_beats:
            s.supers_part, s.supers_whole = 0, 1
    if granted:
        bus.read(s, TILES, s.table_base + s.supers_asked)
        s.supers_asked += 1
        s.supers_owed -= 1


@step
def step_project(s, t, pair_eyes, pair_supertile):
    """Steps projection, clip and tile test, in which a pair is one step for each eye; `pair_eyes` says for how many."""
    if s.path_full[ELLIPSE] and s.survivors < 2:
        s.path_full[ELLIPSE] = 0
        s.survivors += 1
        s.kept -= 1
    fetch(s, ELLIPSE, t)
    if s.walked and accepts(s, ELLIPSE, t):
        enter(s, ELLIPSE, t)
        s.walked = 0
    if s.clipped:
        if s.walked == 0 and s.kept < s.kept_room:
            s.busy_tile_test += 1
            s.clipped, s.walked = 0, 1
            s.kept += 1
        else:
            s.blocked_tile_test += 1
    if s.path_full[PROJECTION] and s.clipped == 0 and s.clip_left:
        s.path_full[PROJECTION], s.clipped = 0, 1
        s.clip_left -= 1
    fetch(s, PROJECTION, t)
    if s.path_full[NEAR] and accepts(s, PROJECTION, t):
        enter(s, PROJECTION, t)
        s.path_full[NEAR] = 0
    fetch(s, NEAR, t)
    at, entered = s.points_out, accepts(s, NEAR, t)
    if s.eye_points and entered:  # the register in which a point waits for both eyes
        enter(s, NEAR, t)
        s.eye_points -= 1
    turn = s.by_turns == 0 or (at != s.points_in and pair_supertile[at] < s.supers_passed)
    if at != s.points_in and s.point_times[at & _POINTS - 1] <= t:
        if not turn:
            entered = False
        elif s.two_eyes and s.eye_points == 0:
            s.eye_points, entered = pair_eyes[at], True
        elif s.two_eyes:
            entered = False
        elif entered:
            enter(s, NEAR, t)
        s.points_out = at + entered
        s.busy_projection += entered
        s.blocked_projection += entered == 0


@step
def _shade(s, t, shades, frees):
    """Sends a survivor to the harmonics, or past them."""
    if shades:
        enter(s, HARMONICS, t)
        return
    s.sum_times[s.sums_in & 7] = t + _PLACES
    s.sums_in += 1
    s.beats_held -= frees[s.pairs_freed] * s.record_beats
    s.pairs_freed += 1


@step
def _hold_survivors(s, t, room, shades, lit, frees):
    """Steps the register in which a survivor of the source waits for that of the target."""
    at = s.colour_item
    if s.colour_held and (lit[at] & WAITS == 0 or s.survivors) and (room or lit[at] & LIT == 0):
        if lit[at] & LIT:
            _shade(s, t, shades, frees)
        s.colour_held, s.colour_item = 0, at + 1
    if s.survivors:
        if s.colour_held == 0:
            s.colour_held = 1
            s.survivors -= 1
            s.busy_colour += 1
        else:
            s.blocked_colour += 1


@step
def step_colour(s, t, taken, lit, places, frees):
    """Steps PairColour. `taken`: the batch buffer takes the place that is offered. `lit` says of each survivor whether colours
    are computed for it; of each of those, `places` is the number of its places, and `frees` says whether it is the last one of
    its pair, whose record is then needed no longer."""
    s.place_left -= taken
    if s.place_left == 0 and s.sums_out != s.sums_in and s.sum_times[s.sums_out & 7] <= t:
        s.place_left = places[s.place_pair]
        s.place_pair += 1
        s.sums_out += 1
    if s.sum_left:
        s.sum_left -= 1
        if s.sum_left == 0:
            s.sum_times[s.sums_in & 7] = t + _PLACES
            s.sums_in += 1
    room = s.sum_left == 0 and s.sums_in - s.sums_out < _PLACES + HELD
    shades = s.colour_steps != 0
    if shades:
        if room and s.path_full[HARMONICS]:
            s.path_full[HARMONICS] = 0
            s.sum_left = s.colour_steps
            s.beats_held -= frees[s.pairs_freed] * s.record_beats
            s.pairs_freed += 1
        fetch(s, HARMONICS, t)
    if s.two_eyes:
        _hold_survivors(s, t, accepts(s, HARMONICS, t) if shades else room, shades, lit, frees)
    elif s.survivors:
        if accepts(s, HARMONICS, t) if shades else room:
            s.busy_colour += 1
            s.survivors -= 1
            _shade(s, t, shades, frees)
        else:
            s.blocked_colour += 1
