"""The warp unit, stepped cycle by cycle (rtl/warp_unit/).

Rows wait in the queues of their lanes. Their pixels leave one by one into the ring buffer of columns, and a tile has settled
some cycles after its last pixel has left. A tile that no further pixel can reach opens to the scan. The scan goes down the
columns in groups of `warp_lanes` pixels. A group takes one cycle, or one for each of its holes that is filled. It waits if the
queue before memory has no free space for the beats that it completes, or if the following columns are not open. A tile is
accepted if the ring buffer has free space for everything that the tile can reach.

One effect is not modelled: the scan loses cycles when it needs the same memory as the pixels, but the places that it reads
ahead make up for them.
"""

from __future__ import annotations

from perf import bus
from perf.blending import layout as before
from perf.bus import W_WARP
from perf.constants import FILL_LATENCY, RING_STAGES
from perf.kernel import step
from perf.layout import Layout
from spec.constants import TILE
from spec.memory import WORDS

layout = Layout(before)
_QUEUED = 128  # most rows in a lane's queue
layout.words("""
    warp_present warp_done warp_row warp_rows_waiting warp_write warp_lanes warp_depth warp_settle_cycles warp_queue_depth
    warp_target_base
    warp_ring warp_reach warp_right warp_to_take warp_to_scan warp_held warp_opened warp_take_column warp_gone warp_settle_in
    warp_settle_out warp_settled warp_open_column warp_starts warp_scans warp_written warp_strip warp_scan_at warp_group
    warp_freed warp_slots warp_q_in warp_q_out warp_q_left warp_strips""")
for _name in ("rows", "left", "in", "out", "tiles"):
    layout.ring(f"warp_lane_{_name}", TILE)
layout.ring("warp_lane_pixels", TILE, _QUEUED)
layout.ring("warp_beats", 16)
layout.ring("warp_address", 16)
layout.ring("warp_settles", 64)
layout.ring("warp_open_at", 512)  # by tile column, the cycle in which it opened


@step
def finished(s, t):
    """Whether all strips are in memory, or there is nothing to warp."""
    return s.warp_present == 0 or (s.warp_written and bus.writes_idle(s, t, W_WARP))


@step
def _move_pixels(s, t):
    """Moves a pixel of each lane into the ring buffer. A tile that has left all lanes begins to settle."""
    rows = TILE // s.warp_lanes * TILE // s.cores_x
    every = True
    for lane in range(s.warp_lanes):
        every = every and s.warp_lane_tiles[lane] != 0
    for lane in range(s.warp_lanes):
        left = s.warp_lane_left[lane]
        if every:
            s.warp_lane_tiles[lane] -= 1
        if left == 1:
            s.warp_lane_rows[lane] += 1
            if s.warp_lane_rows[lane] == rows:
                s.warp_lane_rows[lane] = 0
                s.warp_lane_tiles[lane] += 1
        if left <= 1 and s.warp_lane_in[lane] != s.warp_lane_out[lane]:
            at = s.warp_lane_out[lane]
            s.warp_lane_left[lane] = s.warp_lane_pixels[lane, at & _QUEUED - 1]
            s.warp_lane_out[lane] = at + 1
        else:
            s.warp_lane_left[lane] = max(0, left - 1)
    if every:
        s.warp_settles[s.warp_settle_in & 63] = t + s.warp_settle_cycles
        s.warp_settle_in += 1


@step
def _reached(s, column):
    """The number of tiles by which the reach extends to the right of a tile, in its row."""
    return min(s.warp_reach, s.tiles_x - 1 - column)


@step
def _take_row(s, row):
    """Puts a row into the queue of its lane. Returns whether there was free space."""
    rows = TILE * TILE // s.cores_x
    tile, place = row // rows, row % rows
    columns = TILE // s.cores_x
    block, line = place // s.cores_y, place % s.cores_y
    inner = block // columns * s.cores_y + line
    lane = inner & s.warp_lanes - 1
    at = s.warp_lane_in[lane]
    if at - s.warp_lane_out[lane] >= s.warp_depth:
        return False
    y = tile // s.tiles_x * TILE + inner
    x = tile % s.tiles_x * TILE + block % columns * s.cores_x
    inside = y < s.height and x < s.width
    s.warp_lane_pixels[lane, at & _QUEUED - 1] = min(s.width - x, s.cores_x) if inside else 1
    s.warp_lane_in[lane] = at + 1
    return True


@step
def _take(s, offered, row):
    """Returns whether the offered row is taken."""
    room = s.warp_held + (_reached(s, s.warp_take_column) if s.warp_right else 0) < s.warp_ring
    taken = offered and s.warp_to_take != 0 and s.warp_opened != 0 and _take_row(s, row)
    s.warp_held -= s.warp_gone
    s.warp_gone = 0
    ends = taken and (row + 1) % (TILE * TILE // s.cores_x) == 0
    if ends:
        s.warp_held += 1
        s.warp_take_column += 1
        if s.warp_take_column == s.tiles_x:
            s.warp_take_column = 0
            s.warp_to_take -= 1
    s.warp_opened = room and not ends
    return taken


@step
def _open(s, t):
    """Opens tiles that have settled to the scan, and begins strips."""
    opens = s.warp_scans and s.warp_open_column < s.tiles_x and (
        s.warp_settled > (0 if s.warp_right else _reached(s, s.warp_open_column)))
    if s.warp_starts:
        s.warp_starts, s.warp_scans, s.warp_open_column, s.warp_group, s.warp_slots, s.warp_freed = 0, 1, 0, 0, 0, 0
        s.warp_strip = s.warp_strips
        s.warp_strips += 1
        s.warp_to_scan -= 1
    elif s.warp_settled != 0 and s.warp_scans == 0:
        s.warp_starts = 1
    if opens:
        if s.warp_open_column == 0:
            s.warp_scan_at = t + RING_STAGES + TILE // s.warp_lanes + 2 + FILL_LATENCY
        s.warp_open_at[s.warp_open_column & 511] = t + RING_STAGES
        s.warp_open_column += 1
        s.warp_settled -= 1
    if s.warp_settle_out != s.warp_settle_in and s.warp_settles[s.warp_settle_out & 63] <= t:
        s.warp_settle_out += 1
        s.warp_settled += 1


@step
def _there(s, t, group, later):
    """Whether the scan could have read a group of a strip `later` cycles ago."""
    column = group // (TILE // s.warp_lanes * TILE)
    return column < s.warp_open_column and s.warp_open_at[column & 511] + later <= t


@step
def _group(s, fills):
    """For the group that is being scanned: the cycles that it takes, whether it completes beats, the number of beats to write,
    and the address of the last."""
    lanes, width = s.warp_lanes, s.width
    groups = TILE // lanes
    x, first = s.warp_group // groups, s.warp_group % groups * lanes
    top = s.warp_strip * TILE
    holes, beats, address, whole = 0, 0, 0, False
    for lane in range(lanes):
        y = top + first + lane
        word = y * width + x
        ends = word % WORDS == WORDS - 1 or x == width - 1
        whole = whole or ends
        if y < s.height:
            holes += fills[y, x] & 1
            if ends and fills[y, x] & 2 == 0:  # nothing is written of a beat of known tiles (perf.warp_trace)
                beats += 1
                address = word // WORDS
    return max(1, holes), whole, beats, address


@step
def _scan(s, t, fills):
    """Scans the next slot of the strip."""
    groups = TILE // s.warp_lanes
    total, ahead = groups * s.width, groups + 2
    if s.warp_group == total:
        if s.warp_q_in == s.warp_q_out and s.warp_write == 0:
            s.warp_scans = 0
            s.warp_written = s.warp_to_scan == 0
        return
    read = min(s.warp_group + ahead + FILL_LATENCY, total - 1)
    if s.warp_freed < s.tiles_x and read >= min((s.warp_freed + 1) * TILE * groups, total) - 1 and _there(s, t, read, 0):
        s.warp_freed += 1
        s.warp_gone = 1
    if s.warp_open_column == 0 or t < s.warp_scan_at or not _there(s, t, min(s.warp_group + ahead, total - 1), FILL_LATENCY):
        return
    slots, whole, beats, address = _group(s, fills)
    if s.warp_slots + 1 < slots:
        s.warp_slots += 1
        return
    if whole and s.warp_q_in - s.warp_q_out >= s.warp_queue_depth:
        return
    s.warp_slots = 0
    s.warp_group += 1
    if whole:
        at = s.warp_q_in
        s.warp_beats[at & 15], s.warp_address[at & 15] = beats, address
        s.warp_q_in = at + 1


@step
def step_warp(s, t, granted, offered, row, fills):
    """Steps WarpUnit. Returns whether the offered row is taken."""
    if granted:
        bus.write(s, W_WARP, s.warp_target_base + s.warp_address[s.warp_q_out & 15])
        s.warp_write = 0
    queued = s.warp_q_in
    taken = _take(s, offered, row)
    scans = s.warp_scans
    _open(s, t)
    if scans:
        _scan(s, t, fills)
    if s.warp_write == 0 and queued != s.warp_q_out:
        beats = s.warp_beats[s.warp_q_out & 15]
        s.warp_write = beats != 0
        s.warp_q_left += 1
        if s.warp_q_left >= beats:
            s.warp_q_left = 0
            s.warp_q_out += 1
    _move_pixels(s, t)
    return taken
