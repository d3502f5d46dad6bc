"""Splat fetch, the array and the pixel writer, stepped cycle by cycle (rtl/vrc_array/)."""

from __future__ import annotations

from perf import bus, lists, sorter
from perf.bus import VIEWS, W_FRAME
from perf.constants import SETUP_LATENCY
from perf.kernel import step
from perf.layout import Layout
from perf.sorter import layout as before
from perf.watch import (
    BLOCKED_ARRAY,
    BLOCKED_FETCH,
    BLOCKED_PIXELS,
    BUSY_ARRAY,
    BUSY_FETCH,
    BUSY_PIXELS,
)
from spec.constants import TILE
from spec.queues import ARRAY_TILES, HEADERS, VIEWS_PENDING

layout = Layout(before.size)
(WANTED, WANT_TILE, OCCUPIED, MISSED, REQUESTS, REQUESTED, PENDING_IN, PENDING_OUT, PASSED, ENTRY, VIEWS_BASE) = layout.words(
    "wanted want_tile occupied missed requests requested pending_in pending_out passed entry views_base")
(BUSY, TILE_AT, LEFT, SECOND, LEVEL, BLENDS, AT, SLOT_VALID, SLOT_DRAIN, BUFFER, BUFFER_DRAIN, STOP_0, STOP_1, OPS, SKIPPED,
 IN_FLIGHT, LEAVE_IN, LEAVE_OUT, STOP_LATENCY, HEADER_AT) = layout.words(
    "busy tile_at left second level blends at slot_valid slot_drain buffer buffer_drain stop_0 stop_1 ops skipped "
    "in_flight leave_in leave_out stop_latency header_at")
(BLOCKS, CORES_X, CORES_Y, ROW_LATENCY, LEAVE_LATENCY, ISSUE, ISSUE_LEFT, ISSUE_DRAIN, ISSUE_AT, ISSUED_AT, ROWS_FREE, WAIT,
 DRAIN_IN, DRAIN_OUT, DRAIN_ROWS, DRAIN_ROW, HALVES) = layout.words(
    "blocks cores_x cores_y row_latency leave_latency issue issue_left issue_drain issue_at issued_at rows_free wait "
    "drain_in drain_out drain_rows drain_row halves")
(WIDTH, HEIGHT, TILES_X, PIXEL_WORDS, FRAME_BASE, PACKED, PACKED_BEATS, PACKED_AT, SENDS, SEND_AT, TILE_OUT, ROW_OUT, PIXELS,
 RENDERED_TILES, ROWS_DONE) = layout.words(
    "width height tiles_x pixel_words frame_base packed packed_beats packed_at sends send_at tile_out row_out pixels "
    "rendered_tiles rows_done")
PENDING = layout.ring(VIEWS_PENDING)
ASKED = layout.ring(8)
LEAVES, DRAINS = layout.ring(8), layout.ring(64)

_SETUP = SETUP_LATENCY - 1  # the stages before the output buffer


@step
def step_fetch(s, t, granted, array_takes, levels_before, missed, view_beat, tile_counts):
    """Steps SplatFetch: its output, the answers of memory or cache, its requests, its input. Returns whether it takes an item
    from the handover."""
    if array_takes:
        s[ENTRY] = 0
    if s[ENTRY] == 0:
        s[ENTRY], s[PASSED] = s[PASSED], 0
    at = s[PENDING_OUT]
    if s[PASSED] == 0 and at != s[PENDING_IN] and s[PENDING + (at & VIEWS_PENDING - 1)] <= t:
        if missed[at] == 0:
            s[PASSED], s[PENDING_OUT] = 1, at + 1
        elif bus.offered(s, VIEWS, t):
            bus.take(s, VIEWS)
            s[PASSED], s[PENDING_OUT] = 1, at + 1
    requests = s[REQUESTS]
    if granted:
        bus.read(s, VIEWS, s[VIEWS_BASE] + s[ASKED + (s[REQUESTED] & 7)])
        s[REQUESTED] += 1
        s[REQUESTS] -= 1
    found = s[PENDING_IN]
    if s[OCCUPIED] and requests < 2 and found - at < VIEWS_PENDING:
        s[PENDING + (found & VIEWS_PENDING - 1)] = t + 2
        s[PENDING_IN], s[OCCUPIED] = found + 1, 0
        if missed[found]:
            s[ASKED + (s[REQUESTED] + s[REQUESTS] & 7)] = view_beat[found]
            s[REQUESTS] += 1
            s[MISSED] += 1
    wanted = s[WANTED]
    takes = False
    if sorter.handover_offers(s, t):
        takes = wanted != 0 and s[OCCUPIED] == 0
        if takes:
            s[BUSY_FETCH] += 1
            s[OCCUPIED], s[WANTED] = 1, wanted - 1
        else:
            s[BLOCKED_FETCH] += 1
    if (wanted == 0 or (takes and wanted == 1)) and levels_before:
        s[WANTED] = tile_counts[s[WANT_TILE]]
        s[WANT_TILE] += 1
        s[lists.LEVELS] -= 1
    return takes


@step
def _slot(s, t, valid, drain):
    """Moves a slot into the setup unit's pipeline."""
    s[SLOT_VALID] = (s[SLOT_VALID] << 1 | valid) & (1 << _SETUP) - 1
    s[SLOT_DRAIN] = (s[SLOT_DRAIN] << 1 | drain) & (1 << _SETUP) - 1


@step
def step_setup(s, t, waiting, use, stop, tile_counts, tile_blend):
    """Steps SetupUnit, which turns headers and entries into slots. Returns whether it takes an entry."""
    while s[LEAVE_OUT] != s[LEAVE_IN] and s[LEAVES + (s[LEAVE_OUT] & 7)] <= t:
        s[LEAVE_OUT] += 1
        s[IN_FLIGHT] -= 1
    advance = waiting < 2
    if advance:
        s[BUFFER_DRAIN] |= (s[SLOT_DRAIN] >> _SETUP - 1) << s[BUFFER]
        s[BUFFER] += s[SLOT_VALID] >> _SETUP - 1
    takes, valid, drain, ends = False, False, False, s[BUSY] == 0
    if s[BUSY]:
        left, blends = s[LEFT], s[BLENDS]
        if s[SECOND]:
            valid = True
            if advance:
                s[SECOND] = 0
        elif left:
            skip = s[STOP_0] <= t and s[STOP_1] <= t and s[IN_FLIGHT] == 1
            if s[ENTRY]:
                takes = advance or skip
                if takes:
                    s[LEFT] = left - 1
                    both = blends and use[s[AT]] == 3
                    s[AT] += 1
                    tile, done = s[TILE_AT], tile_counts[s[TILE_AT]] - left + 1
                    if done == stop[tile, 0]:
                        s[STOP_0] = t + s[STOP_LATENCY]
                    if done == stop[tile, 1]:
                        s[STOP_1] = t + s[STOP_LATENCY] + both
                    if skip:
                        s[SKIPPED] += 1
                    else:
                        valid = True
                        s[SECOND] = both
        else:
            valid = True
            drain = s[LEVEL] == blends
            if advance:
                s[LEVEL] = 0 if drain else 1
                ends = drain
    s[BUSY_ARRAY] += takes
    s[BLOCKED_ARRAY] += s[ENTRY] and not takes
    if advance:
        _slot(s, t, valid, drain)
    if ends:
        at = s[lists.HEADS_OUT]
        s[BUSY] = 0
        if at != s[lists.HEADS_IN] and s[lists.HEADS + (at & 2 * HEADERS - 1)] <= t and s[IN_FLIGHT] < ARRAY_TILES:
            tile = s[HEADER_AT]
            s[lists.HEADS_OUT], s[HEADER_AT] = at + 1, tile + 1
            s[BUSY], s[LEFT], s[BLENDS], s[TILE_AT], s[SECOND] = 1, tile_counts[tile], tile_blend[tile], tile, 0
            s[IN_FLIGHT] += 1
            s[STOP_0], s[STOP_1] = 1 << 60, (1 << 60) if tile_blend[tile] else 0
    return takes


@step
def step_issue(s, t):
    """Steps BlockSequencer and reserves space in the buffer behind the array."""
    wait = s[WAIT]
    if wait:
        s[WAIT] = wait - 1
    if s[ISSUE] == 0:
        return
    drain = s[ISSUE_DRAIN]
    first = s[ISSUE_LEFT] == s[BLOCKS]
    room = s[ROWS_FREE] >= s[CORES_Y] if s[sorter.INCREMENTAL] else s[HALVES] != 0 or not first
    if s[ISSUE_AT] > t or (drain and (wait or not room)):
        return
    s[OPS] += 1
    left = s[ISSUE_LEFT] - 1
    s[ISSUE_LEFT] = left
    if drain:
        s[WAIT] = s[CORES_Y] - 1
        if s[sorter.INCREMENTAL]:
            s[ROWS_FREE] -= s[CORES_Y]
            s[DRAINS + (s[DRAIN_IN] & 63)] = t + s[ROW_LATENCY]
            s[DRAIN_IN] += 1
        else:
            s[HALVES] -= first
            if left == 0:
                s[DRAINS + (s[DRAIN_IN] & 63)] = t + s[ROW_LATENCY] + s[CORES_Y] - 2
                s[DRAIN_IN] += 1
        if left == 0:
            s[LEAVES + (s[LEAVE_IN] & 7)] = t + s[LEAVE_LATENCY]
            s[LEAVE_IN] += 1
    if left == 0:
        s[ISSUE], s[ISSUED_AT] = 0, t


@step
def load_issue(s, t):
    """Loads the sequencer with the next operation from the setup unit's buffer."""
    if s[ISSUE] == 0 and s[BUFFER]:
        s[ISSUE], s[ISSUE_LEFT], s[ISSUE_DRAIN] = 1, s[BLOCKS], s[BUFFER_DRAIN] & 1
        s[BUFFER] -= 1
        s[BUFFER_DRAIN] >>= 1
        s[ISSUE_AT] = t + (2 if s[BLOCKS] > 1 and s[ISSUED_AT] != t - 1 else 0)  # its two stages stay full between adjacent ops


@step
def buffered(s):
    """Number of operations in the setup unit's buffer, which holds two. With several blocks the sequencer holds two more."""
    waiting = s[BUFFER] + s[ISSUE]
    return max(0, waiting - 2) if s[BLOCKS] > 1 else waiting


@step
def rows_offered(s, t):
    """Whether the array offers a row of pixels."""
    at = s[DRAIN_OUT]
    return at != s[DRAIN_IN] and s[DRAINS + (at & 63)] + s[DRAIN_ROW] <= t


@step
def take_row(s):
    """Removes the offered row from the array's output."""
    row = s[DRAIN_ROW] + 1
    if s[sorter.INCREMENTAL]:
        s[ROWS_FREE] += 1
    if row == s[DRAIN_ROWS]:
        row = 0
        s[DRAIN_OUT] += 1
        if s[sorter.INCREMENTAL] == 0:
            s[HALVES] += 1
    s[DRAIN_ROW] = row


@step
def _row_beats(s, tile, row):
    """The number of beats that a row of a tile occupies in memory, and the address of the first."""
    cores = s[CORES_X]
    columns = TILE // cores
    block, line = row // s[CORES_Y], row % s[CORES_Y]
    y = tile // s[TILES_X] * TILE + block // columns * s[CORES_Y] + line
    x = tile % s[TILES_X] * TILE + block % columns * cores
    words = s[PIXEL_WORDS]
    count = min(s[WIDTH] - x, cores) * words
    start = (y * s[WIDTH] + x) * words
    if y >= s[HEIGHT] or count <= 0:
        return 0, 0
    return (start % 8 + count + 7) // 8, start // 8


@step
def step_pixels(s, t, granted, offered, tile_number, tile_times):
    """Steps PixelWriter. Returns whether it takes the offered row."""
    sends, packed = s[SENDS], s[PACKED]
    if granted:
        bus.write(s, W_FRAME, s[FRAME_BASE] + s[SEND_AT])
        s[SEND_AT] += 1
        s[SENDS] = sends - 1
    room = sends == 0 or (granted and sends == 1)
    if room:
        s[SENDS] = s[PACKED_BEATS] if packed else 0
        s[SEND_AT] = s[PACKED_AT]
    if packed and not room:
        return False
    s[PACKED] = offered
    if not offered:
        return False
    tile, row = s[TILE_OUT], s[ROW_OUT]
    s[PACKED_BEATS], s[PACKED_AT] = _row_beats(s, tile_number[tile], row)
    if row == 0:
        tile_times[0, tile] = t
    row += 1
    if row * s[CORES_X] == TILE * TILE:
        tile_times[1, tile] = t
        row, s[TILE_OUT] = 0, tile + 1
    s[ROW_OUT] = row
    return True


@step
def pixels_finished(s, t):
    """Whether all rows have come and all their pixels are in memory."""
    return s[TILE_OUT] == s[RENDERED_TILES] and s[PACKED] == 0 and s[SENDS] == 0 and bus.writes_idle(s, t, W_FRAME)


@step
def count_rows(s, offered, taken):
    """Counts a cycle of the pixel writer's input as busy or blocked."""
    s[BUSY_PIXELS] += taken
    s[BLOCKED_PIXELS] += offered and not taken
