"""Splat fetch, the array and the pixel writer, stepped cycle by cycle (rtl/vrc_array/)."""

from __future__ import annotations

from perf import bus, sorter
from perf.bus import VIEWS, W_FRAME
from perf.constants import SETUP_LATENCY
from perf.kernel import step
from perf.layout import Layout
from perf.sorter import layout as before
from spec.constants import TILE
from spec.queues import ARRAY_TILES, HEADERS, VIEWS_PENDING

layout = Layout(before)
layout.words("""
    wanted want_tile occupied missed view_requests views_requested pending_in pending_out entry_passed entry_ready
    views_base""")
layout.words("""
    setup_busy tile_at entries_left second_level drain_level tile_blends entry_at slot_valid slot_drain ops_buffered
    buffer_drain stop_0 stop_1 ops skipped in_flight leave_in leave_out stop_latency header_at""")
layout.words("""
    blocks cores_x cores_y row_latency leave_latency issue issue_left issue_drain issue_at issued_at rows_free drain_wait
    drain_in drain_out drain_rows drain_row row_halves""")
layout.words("""
    width height tiles_x pixel_words frame_base packed packed_beats packed_at sends send_at tile_out row_out rendered_tiles
    rows_waiting""")

ROWS_WAITING = 2
"""Rows that fit into the buffer (`rtl.stream.Buffer`) in front of the pixel writer, and into that of the warp unit."""
layout.ring("view_times", VIEWS_PENDING)
layout.ring("view_asked", 8)
layout.ring("leave_times", 8)
layout.ring("drain_times", 64)

_SETUP = SETUP_LATENCY - 1  # the stages before the output buffer


@step
def step_fetch(s, t, granted, array_takes, levels_before, missed, view_beat, tile_counts):
    """Steps SplatFetch: its output, the answers of memory or cache, its requests, its input. Returns whether it takes an item
    from the handover."""
    if array_takes:
        s.entry_ready = 0
    if s.entry_ready == 0:
        s.entry_ready, s.entry_passed = s.entry_passed, 0
    at = s.pending_out
    if s.entry_passed == 0 and at != s.pending_in and s.view_times[at & VIEWS_PENDING - 1] <= t:
        if missed[at] == 0:
            s.entry_passed, s.pending_out = 1, at + 1
        elif bus.offered(s, VIEWS, t):
            bus.take(s, VIEWS)
            s.entry_passed, s.pending_out = 1, at + 1
    requests = s.view_requests
    if granted:
        bus.read(s, VIEWS, s.views_base + s.view_asked[s.views_requested & 7])
        s.views_requested += 1
        s.view_requests -= 1
    found = s.pending_in
    if s.occupied and requests < 2 and found - at < VIEWS_PENDING:
        s.view_times[found & VIEWS_PENDING - 1] = t + 2
        s.pending_in, s.occupied = found + 1, 0
        if missed[found]:
            s.view_asked[s.views_requested + s.view_requests & 7] = view_beat[found]
            s.view_requests += 1
            s.missed += 1
    wanted = s.wanted
    takes = False
    if sorter.handover_offers(s, t):
        takes = wanted != 0 and s.occupied == 0
        if takes:
            s.busy_fetch += 1
            s.occupied, s.wanted = 1, wanted - 1
        else:
            s.blocked_fetch += 1
    if (wanted == 0 or (takes and wanted == 1)) and levels_before:
        s.wanted = tile_counts[s.want_tile]
        s.want_tile += 1
        s.fetch_tiles -= 1
    return takes


@step
def _slot(s, t, valid, drain):
    """Moves a slot into the setup unit's pipeline."""
    s.slot_valid = (s.slot_valid << 1 | valid) & (1 << _SETUP) - 1
    s.slot_drain = (s.slot_drain << 1 | drain) & (1 << _SETUP) - 1


@step
def step_setup(s, t, waiting, use, stop, tile_counts, tile_blend):
    """Steps SetupUnit, which turns headers and entries into slots. Returns whether it takes an entry."""
    while s.leave_out != s.leave_in and s.leave_times[s.leave_out & 7] <= t:
        s.leave_out += 1
        s.in_flight -= 1
    advance = waiting < 2
    if advance:
        s.buffer_drain |= (s.slot_drain >> _SETUP - 1) << s.ops_buffered
        s.ops_buffered += s.slot_valid >> _SETUP - 1
    takes, valid, drain, ends = False, False, False, s.setup_busy == 0
    if s.setup_busy:
        left, blends = s.entries_left, s.tile_blends
        if s.second_level:
            valid = True
            if advance:
                s.second_level = 0
        elif left:
            skip = s.stop_0 <= t and s.stop_1 <= t and s.in_flight == 1
            if s.entry_ready:
                takes = advance or skip
                if takes:
                    s.entries_left = left - 1
                    both = blends and use[s.entry_at] == 3
                    s.entry_at += 1
                    tile, done = s.tile_at, tile_counts[s.tile_at] - left + 1
                    if done == stop[tile, 0]:
                        s.stop_0 = t + s.stop_latency
                    if done == stop[tile, 1]:
                        s.stop_1 = t + s.stop_latency + both
                    if skip:
                        s.skipped += 1
                    else:
                        valid = True
                        s.second_level = both
        else:
            valid = True
            drain = s.drain_level == blends
            if advance:
                s.drain_level = 0 if drain else 1
                ends = drain
    s.busy_array += takes
    s.blocked_array += s.entry_ready and not takes
    if advance:
        _slot(s, t, valid, drain)
    if ends:
        at = s.heads_out
        s.setup_busy = 0
        if at != s.heads_in and s.heads[at & 2 * HEADERS - 1] <= t and s.in_flight < ARRAY_TILES:
            tile = s.header_at
            s.heads_out, s.header_at = at + 1, tile + 1
            s.setup_busy, s.entries_left, s.second_level = 1, tile_counts[tile], 0
            s.tile_at, s.tile_blends = tile, tile_blend[tile]
            s.in_flight += 1
            s.stop_0, s.stop_1 = 1 << 60, (1 << 60) if tile_blend[tile] else 0
    return takes


@step
def step_issue(s, t):
    """Steps BlockSequencer and reserves space in the buffer behind the array."""
    wait = s.drain_wait
    if wait:
        s.drain_wait = wait - 1
    if s.issue == 0:
        return
    drain = s.issue_drain
    first = s.issue_left == s.blocks
    room = s.rows_free >= s.cores_y if s.incremental else s.row_halves != 0 or not first
    if s.issue_at > t or (drain and (wait or not room)):
        return
    s.ops += 1
    left = s.issue_left - 1
    s.issue_left = left
    if drain:
        s.drain_wait = s.cores_y - 1
        if s.incremental:
            s.rows_free -= s.cores_y
            s.drain_times[s.drain_in & 63] = t + s.row_latency
            s.drain_in += 1
        else:
            s.row_halves -= first
            if left == 0:
                s.drain_times[s.drain_in & 63] = t + s.row_latency + s.cores_y - 2
                s.drain_in += 1
        if left == 0:
            s.leave_times[s.leave_in & 7] = t + s.leave_latency
            s.leave_in += 1
    if left == 0:
        s.issue, s.issued_at = 0, t


@step
def load_issue(s, t):
    """Loads the sequencer with the next operation from the setup unit's buffer."""
    if s.issue == 0 and s.ops_buffered:
        s.issue, s.issue_left, s.issue_drain = 1, s.blocks, s.buffer_drain & 1
        s.ops_buffered -= 1
        s.buffer_drain >>= 1
        s.issue_at = t + (2 if s.blocks > 1 and s.issued_at != t - 1 else 0)  # its two stages stay full between adjacent ops


@step
def buffered(s):
    """Number of operations in the setup unit's buffer, which holds two. With several blocks the sequencer holds two more."""
    waiting = s.ops_buffered + s.issue
    return max(0, waiting - 2) if s.blocks > 1 else waiting


@step
def rows_offered(s, t):
    """Whether the array offers a row of pixels."""
    at = s.drain_out
    return at != s.drain_in and s.drain_times[at & 63] + s.drain_row <= t


@step
def take_row(s):
    """Removes the offered row from the array's output."""
    row = s.drain_row + 1
    if s.incremental:
        s.rows_free += 1
    if row == s.drain_rows:
        row = 0
        s.drain_out += 1
        if s.incremental == 0:
            s.row_halves += 1
    s.drain_row = row


@step
def row_beats(s, x, y, columns, row, cores_x, cores_y):
    """The number of beats that a row of an array's pixels occupies in memory, and the address of the first.

    Args:
        x, y: the first pixel of the array's part of the tile. columns: its blocks side by side.
        row: the number of the row in it, in the order in which rows leave.
        cores_x, cores_y: size of the array.
    """
    block, line = row // cores_y, row % cores_y
    y += block // columns * cores_y + line
    x += block % columns * cores_x
    words = s.pixel_words
    count = min(s.width - x, cores_x) * words
    start = (y * s.width + x) * words
    if y >= s.height or count <= 0:
        return 0, 0
    return (start % 8 + count + 7) // 8, start // 8


@step
def send_beats(s, granted):
    """Sends a beat of the pixel writer's row if it is granted. Returns whether the writer can take another row."""
    sends, packed = s.sends, s.packed
    if granted:
        bus.write(s, W_FRAME, s.frame_base + s.send_at)
        s.send_at += 1
        s.sends = sends - 1
    room = sends == 0 or (granted and sends == 1)
    if room:
        s.sends = s.packed_beats if packed else 0
        s.send_at = s.packed_at
    return room or not packed


@step
def step_pixels(s, t, granted, offered, tile_number, tile_times):
    """Steps PixelWriter. Returns whether it takes the offered row."""
    if not send_beats(s, granted):
        return False
    s.packed = offered
    if not offered:
        return False
    tile, row = s.tile_out, s.row_out
    at, cores = tile_number[tile], s.cores_x
    s.packed_beats, s.packed_at = row_beats(
        s, at % s.tiles_x * TILE, at // s.tiles_x * TILE, TILE // cores, row, cores, s.cores_y)
    if row == 0:
        tile_times[0, tile] = t
    row += 1
    if row * s.cores_x == TILE * TILE:
        tile_times[1, tile] = t
        row, s.tile_out = 0, tile + 1
    s.row_out = row
    return True


@step
def pixels_finished(s, t):
    """Whether all rows have come and all their pixels are in memory."""
    return s.tile_out == s.rendered_tiles and s.packed == 0 and s.sends == 0 and bus.writes_idle(s, t, W_FRAME)


@step
def count_rows(s, offered, taken):
    """Counts a cycle of the pixel writer's input as busy or blocked."""
    s.busy_pixel_write += taken
    s.blocked_pixel_write += offered and not taken
