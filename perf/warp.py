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

from perf import blending, bus
from perf.blending import layout as before
from perf.bus import W_WARP
from perf.constants import FILL_LATENCY, RING_STAGES
from perf.kernel import step
from perf.layout import Layout
from spec.constants import TILE
from spec.memory import WORDS

layout = Layout(before.size)
(PRESENT, DONE, ROW, WRITE, LANES, DEPTH, SETTLE_CYCLES, QUEUE_DEPTH, TARGET_BASE, RING, REACH, RIGHT, TO_TAKE, TO_SCAN, HELD,
 OPENED, TAKE_COLUMN, GONE, SETTLE_IN, SETTLE_OUT, SETTLED, OPEN_COLUMN, STARTS, SCANS, WRITTEN, STRIP, SCAN_AT, GROUP, FREED,
 SLOTS, Q_IN, Q_OUT, Q_LEFT, STRIPS) = layout.words(
    "present done row write lanes depth settle_cycles queue_depth target_base ring reach right to_take to_scan held "
    "opened take_column gone settle_in settle_out settled open_column starts scans written strip scan_at group freed "
    "slots q_in q_out q_left strips")
LANE_ROWS, LANE_LEFT, LANE_IN, LANE_OUT, LANE_TILES = (layout.ring(TILE) for _ in range(5))
_QUEUED = 128  # most rows in a lane's queue
LANE_PIXELS = layout.ring(TILE * _QUEUED)
Q_BEATS, Q_ADDRESS = layout.ring(16), layout.ring(16)
SETTLES = layout.ring(64)
OPEN_AT = layout.ring(512)  # by tile column, the cycle in which it opened


@step
def finished(s, t):
    """Whether all strips are in memory, or there is nothing to warp."""
    return s[PRESENT] == 0 or (s[WRITTEN] and bus.writes_idle(s, t, W_WARP))


@step
def _move_pixels(s, t):
    """Moves a pixel of each lane into the ring buffer. A tile that has left all lanes begins to settle."""
    rows = TILE // s[LANES] * TILE // s[blending.CORES_X]
    every = True
    for lane in range(s[LANES]):
        every = every and s[LANE_TILES + lane] != 0
    for lane in range(s[LANES]):
        left = s[LANE_LEFT + lane]
        if every:
            s[LANE_TILES + lane] -= 1
        if left == 1:
            s[LANE_ROWS + lane] += 1
            if s[LANE_ROWS + lane] == rows:
                s[LANE_ROWS + lane] = 0
                s[LANE_TILES + lane] += 1
        if left <= 1 and s[LANE_IN + lane] != s[LANE_OUT + lane]:
            at = s[LANE_OUT + lane]
            s[LANE_LEFT + lane] = s[LANE_PIXELS + lane * _QUEUED + (at & _QUEUED - 1)]
            s[LANE_OUT + lane] = at + 1
        else:
            s[LANE_LEFT + lane] = max(0, left - 1)
    if every:
        s[SETTLES + (s[SETTLE_IN] & 63)] = t + s[SETTLE_CYCLES]
        s[SETTLE_IN] += 1


@step
def _reached(s, column):
    """The number of tiles by which the reach extends to the right of a tile, in its row."""
    return min(s[REACH], s[blending.TILES_X] - 1 - column)


@step
def _take_row(s, row):
    """Puts a row into the queue of its lane. Returns whether there was free space."""
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
    inside = y < s[blending.HEIGHT] and x < s[blending.WIDTH]
    s[LANE_PIXELS + lane * _QUEUED + (at & _QUEUED - 1)] = min(s[blending.WIDTH] - x, s[blending.CORES_X]) if inside else 1
    s[LANE_IN + lane] = at + 1
    return True


@step
def _take(s, offered, row):
    """Returns whether the offered row is taken."""
    room = s[HELD] + (_reached(s, s[TAKE_COLUMN]) if s[RIGHT] else 0) < s[RING]
    taken = offered and s[TO_TAKE] != 0 and s[OPENED] != 0 and _take_row(s, row)
    s[HELD] -= s[GONE]
    s[GONE] = 0
    ends = taken and (row + 1) % (TILE * TILE // s[blending.CORES_X]) == 0
    if ends:
        s[HELD] += 1
        s[TAKE_COLUMN] += 1
        if s[TAKE_COLUMN] == s[blending.TILES_X]:
            s[TAKE_COLUMN] = 0
            s[TO_TAKE] -= 1
    s[OPENED] = room and not ends
    return taken


@step
def _open(s, t):
    """Opens tiles that have settled to the scan, and begins strips."""
    opens = s[SCANS] and s[OPEN_COLUMN] < s[blending.TILES_X] and (
        s[SETTLED] > (0 if s[RIGHT] else _reached(s, s[OPEN_COLUMN])))
    if s[STARTS]:
        s[STARTS], s[SCANS], s[OPEN_COLUMN], s[GROUP], s[SLOTS], s[FREED] = 0, 1, 0, 0, 0, 0
        s[STRIP] = s[STRIPS]
        s[STRIPS] += 1
        s[TO_SCAN] -= 1
    elif s[SETTLED] != 0 and s[SCANS] == 0:
        s[STARTS] = 1
    if opens:
        if s[OPEN_COLUMN] == 0:
            s[SCAN_AT] = t + RING_STAGES + TILE // s[LANES] + 2 + FILL_LATENCY
        s[OPEN_AT + (s[OPEN_COLUMN] & 511)] = t + RING_STAGES
        s[OPEN_COLUMN] += 1
        s[SETTLED] -= 1
    if s[SETTLE_OUT] != s[SETTLE_IN] and s[SETTLES + (s[SETTLE_OUT] & 63)] <= t:
        s[SETTLE_OUT] += 1
        s[SETTLED] += 1


@step
def _there(s, t, group, later):
    """Whether the scan could have read a group of a strip `later` cycles ago."""
    column = group // (TILE // s[LANES] * TILE)
    return column < s[OPEN_COLUMN] and s[OPEN_AT + (column & 511)] + later <= t


@step
def _group(s, fills):
    """For the group that is being scanned: the cycles that it takes, whether it completes beats, the number of beats to write,
    and the address of the last."""
    lanes, width = s[LANES], s[blending.WIDTH]
    groups = TILE // lanes
    x, first = s[GROUP] // groups, s[GROUP] % groups * lanes
    top = s[STRIP] * TILE
    holes, beats, address, whole = 0, 0, 0, False
    for lane in range(lanes):
        y = top + first + lane
        word = y * width + x
        ends = word % WORDS == WORDS - 1 or x == width - 1
        whole = whole or ends
        if y < s[blending.HEIGHT]:
            holes += fills[y, x]
            if ends:
                beats += 1
                address = word // WORDS
    return max(1, holes), whole, beats, address


@step
def _scan(s, t, fills):
    """Scans the next slot of the strip."""
    groups = TILE // s[LANES]
    total, ahead = groups * s[blending.WIDTH], groups + 2
    if s[GROUP] == total:
        if s[Q_IN] == s[Q_OUT] and s[WRITE] == 0:
            s[SCANS] = 0
            s[WRITTEN] = s[TO_SCAN] == 0
        return
    read = min(s[GROUP] + ahead + FILL_LATENCY, total - 1)
    if s[FREED] < s[blending.TILES_X] and read >= min((s[FREED] + 1) * TILE * groups, total) - 1 and _there(s, t, read, 0):
        s[FREED] += 1
        s[GONE] = 1
    if s[OPEN_COLUMN] == 0 or t < s[SCAN_AT] or not _there(s, t, min(s[GROUP] + ahead, total - 1), FILL_LATENCY):
        return
    slots, whole, beats, address = _group(s, fills)
    if s[SLOTS] + 1 < slots:
        s[SLOTS] += 1
        return
    if whole and s[Q_IN] - s[Q_OUT] >= s[QUEUE_DEPTH]:
        return
    s[SLOTS] = 0
    s[GROUP] += 1
    if whole:
        at = s[Q_IN]
        s[Q_BEATS + (at & 15)], s[Q_ADDRESS + (at & 15)] = beats, address
        s[Q_IN] = at + 1


@step
def step_warp(s, t, granted, offered, row, fills):
    """Steps WarpUnit. Returns whether the offered row is taken."""
    if granted:
        bus.write(s, W_WARP, s[TARGET_BASE] + s[Q_ADDRESS + (s[Q_OUT] & 15)])
        s[WRITE] = 0
    queued = s[Q_IN]
    taken = _take(s, offered, row)
    scans = s[SCANS]
    _open(s, t)
    if scans:
        _scan(s, t, fills)
    if s[WRITE] == 0 and queued != s[Q_OUT]:
        beats = s[Q_BEATS + (s[Q_OUT] & 15)]
        s[WRITE] = beats != 0
        s[Q_LEFT] += 1
        if s[Q_LEFT] >= beats:
            s[Q_LEFT] = 0
            s[Q_OUT] += 1
    _move_pixels(s, t)
    return taken
