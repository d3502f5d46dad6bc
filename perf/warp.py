"""The warp unit, a cycle a step (rtl/warp_unit/).

Rows wait in the queues of their lanes, whose pixels leave one by one into the open strip; a full strip is swapped for the one
that is scanned, group by group of `warp_lanes` pixels down its columns. A group takes a cycle, or one for each of its holes
that are filled, and waits where the beats it completes find no room in the queue before memory.
"""

from __future__ import annotations

from perf import blending, bus
from perf.blending import layout as before
from perf.bus import W_WARP
from perf.kernel import step
from perf.layout import Layout
from spec.constants import TILE
from spec.memory import WORDS

layout = Layout(before.size)
(PRESENT, DONE, ROW, WRITE, LANES, DEPTH, SETTLE_CYCLES, START_LATENCY, QUEUE_DEPTH, TARGET_BASE, MOVING, SETTLE, TO_TAKE, FULL,
 SCANS, WRITTEN, STRIP, SCAN_AT, GROUP, SLOTS, Q_IN, Q_OUT, Q_LEFT, STRIPS) = layout.words(
    "present done row write lanes depth settle_cycles start_latency queue_depth target_base moving settle to_take full "
    "scans written strip scan_at group slots q_in q_out q_left strips")
LANE_ROWS, LANE_LEFT, LANE_IN, LANE_OUT = (layout.ring(TILE) for _ in range(4))
_QUEUED = 128  # rows of a lane, at most
LANE_PIXELS = layout.ring(TILE * _QUEUED)
Q_BEATS, Q_ADDRESS = layout.ring(16), layout.ring(16)


@step
def finished(s, t):
    """All strips are in memory, or there is nothing to warp."""
    return s[PRESENT] == 0 or (s[WRITTEN] and bus.writes_idle(s, t, W_WARP))


@step
def _move_pixels(s):
    """A pixel a lane into the open strip; whether one is on its way."""
    moving = False
    for lane in range(s[LANES]):
        left = s[LANE_LEFT + lane]
        if left or s[LANE_IN + lane] != s[LANE_OUT + lane]:
            moving = True
            if left <= 1 and s[LANE_IN + lane] != s[LANE_OUT + lane]:
                at = s[LANE_OUT + lane]
                s[LANE_LEFT + lane] = s[LANE_PIXELS + lane * _QUEUED + (at & _QUEUED - 1)]
                s[LANE_OUT + lane] = at + 1
            else:
                s[LANE_LEFT + lane] = max(0, left - 1)
    return moving


@step
def _take_row(s, row):
    """A row into its lane's queue, if any of it lies in the frame; whether there is room."""
    rows = TILE * TILE // s[blending.CORES_X]
    tile, place = row // rows, row % rows
    columns = TILE // s[blending.CORES_X]
    block, line = place // s[blending.CORES_Y], place % s[blending.CORES_Y]
    inner = block // columns * s[blending.CORES_Y] + line
    lane = inner & s[LANES] - 1
    at = s[LANE_IN + lane]
    if at - s[LANE_OUT + lane] >= s[DEPTH]:
        return False
    y = tile // s[blending.TILES_X] * TILE + inner
    x = tile % s[blending.TILES_X] * TILE + block % columns * s[blending.CORES_X]
    pixels = min(s[blending.WIDTH] - x, s[blending.CORES_X])
    if y < s[blending.HEIGHT] and pixels > 0:
        s[LANE_PIXELS + lane * _QUEUED + (at & _QUEUED - 1)] = pixels
        s[LANE_IN + lane] = at + 1
    if (row + 1) % (rows * s[blending.TILES_X]) == 0:
        s[FULL] = 1
        s[TO_TAKE] -= 1
    return True


@step
def _group(s, fills):
    """Of the group that is scanned: slots that it takes, beats that it completes, and the last of them's address."""
    lanes, width = s[LANES], s[blending.WIDTH]
    groups = TILE // lanes
    x, first = s[GROUP] // groups, s[GROUP] % groups * lanes
    top = s[STRIP] * TILE
    holes, beats, address = 0, 0, 0
    for lane in range(lanes):
        y = top + first + lane
        if y < s[blending.HEIGHT]:
            holes += fills[y, x]
            word = y * width + x
            if word % WORDS == WORDS - 1 or x == width - 1:
                beats += 1
                address = word // WORDS
    return max(1, holes), beats, address


@step
def _scan(s, t, fills):
    """The next slot of the closed strip."""
    if t < s[SCAN_AT]:
        return
    groups = TILE // s[LANES] * s[blending.WIDTH]
    if s[GROUP] == groups:
        if s[Q_IN] == s[Q_OUT] and s[WRITE] == 0:
            s[SCANS] = 0
            s[WRITTEN] = s[FULL] == 0 and s[TO_TAKE] == 0
        return
    slots, beats, address = _group(s, fills)
    if s[SLOTS] + 1 < slots:
        s[SLOTS] += 1
        return
    if beats and s[Q_IN] - s[Q_OUT] >= s[QUEUE_DEPTH]:
        return
    s[SLOTS] = 0
    s[GROUP] += 1
    if beats:
        at = s[Q_IN]
        s[Q_BEATS + (at & 15)], s[Q_ADDRESS + (at & 15)] = beats, address
        s[Q_IN] = at + 1


@step
def step_warp(s, t, granted, offered, row, fills):
    """WarpUnit; whether the row on offer is taken."""
    if granted:
        bus.write(s, W_WARP, s[TARGET_BASE] + s[Q_ADDRESS + (s[Q_OUT] & 15)])
        s[WRITE] = 0
    queued = s[Q_IN]
    scans, full = s[SCANS], s[FULL]
    if scans:
        _scan(s, t, fills)
    if s[WRITE] == 0 and queued != s[Q_OUT]:
        s[WRITE] = 1
        s[Q_LEFT] += 1
        if s[Q_LEFT] == s[Q_BEATS + (s[Q_OUT] & 15)]:
            s[Q_LEFT] = 0
            s[Q_OUT] += 1
    settle = s[SETTLE]
    moving = _move_pixels(s)
    swaps = full and not moving and settle == 0 and scans == 0
    taken = offered and s[TO_TAKE] != 0 and full == 0 and _take_row(s, row)
    if moving:
        s[SETTLE] = s[SETTLE_CYCLES]
    elif settle:
        s[SETTLE] = settle - 1
    if swaps:
        s[FULL], s[SCANS], s[GROUP], s[SLOTS] = 0, 1, 0, 0
        s[SCAN_AT] = t + s[START_LATENCY]
        s[STRIP] = s[STRIPS]
        s[STRIPS] += 1
    return taken
