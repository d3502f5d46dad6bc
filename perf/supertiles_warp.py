"""The warp unit of joint frames with a warped target, stepped cycle by cycle (rtl/supertiles/warp_strips.py): two warp units,
one for even and one for odd rows of tiles.

Each has a record of its own, of `strip_layout`, and sees a frame of its own rows of tiles alone. Their beats share a client of
the memory, in turn where both have one, through a register.
"""

from __future__ import annotations

from perf import blending, bus, supertiles_batch, supertiles_rows, warp
from perf.bus import W_WARP
from perf.kernel import phase, step
from perf.layout import Layout
from spec.constants import TILE
from spec.memory import WORDS

strip_layout = Layout(warp.layout)

layout = Layout(supertiles_batch.layout)
layout.words("warps strip_done strip_full strip_address strip_turn strip_at strip_row strip_rows again_lists again_open "
             "again_at warp_base")


@step
def strips_finished(s, strips, t):
    """Whether all that is warped is in memory, or nothing is."""
    return s.warps == 0 or (
        _written(strips[0]) and _written(strips[1]) and s.strip_full == 0 and bus.writes_idle(s, t, W_WARP))


@step
def _written(a):
    """Whether a unit has given all of its beats; one without rows has none."""
    return a.height == 0 or (a.warp_written and a.warp_write == 0)


@step
def _address(s, a, odd):
    """The beat of a unit's next write in the whole frame."""
    beat = a.warp_address[a.warp_q_out & 15]
    strip = s.width * TILE // WORDS
    return s.warp_base + beat + (beat // strip + odd) * strip


@phase
def step_strips(s, strips, t, granted, drawn, fills_0, fills_1):
    """Steps both units, which take the first row that waits before them, and what sends their beats."""
    if granted:
        bus.write(s, W_WARP, s.strip_address)
        s.strip_full = 0
    pick = -1
    if s.strip_full == 0:
        if strips[0].warp_write and (strips[1].warp_write == 0 or s.strip_turn == 0):
            pick = 0
        elif strips[1].warp_write:
            pick = 1
    if pick >= 0:
        a = strips[pick]
        s.strip_address, s.strip_full, s.strip_turn = _address(s, a, pick), 1, 1 - pick
        a.warp_write = 0
    offered = s.strip_rows != 0
    odd = drawn[s.strip_at] // s.tiles_x & 1 if offered else 0
    even_taken = warp.step_warp(strips[0], t, False, offered and odd == 0, strips[0].warp_row, fills_0)
    odd_taken = warp.step_warp(strips[1], t, False, offered and odd == 1, strips[1].warp_row, fills_1)
    strips[0].warp_row += even_taken
    strips[1].warp_row += odd_taken
    taken = even_taken or odd_taken
    s.busy_warp += taken
    s.blocked_warp += offered and not taken
    if taken:
        s.strip_rows -= 1
        s.strip_row += 1
        if s.strip_row * s.row_x == TILE * TILE:
            s.strip_row = 0
            s.strip_at = _next_source(s, s.strip_at + 1, drawn)


@step
def _next_source(s, at, drawn):
    """The next tile of the source among those that are drawn, from a place on."""
    while at < len(drawn) and drawn[at] >= s.eye_tiles:
        at += 1
    return at


@step
def step_rows(s, streams, strips, t, granted, sent, drawn, sizes, fills_0, fills_1, tile_times):
    """Moves a row of pixels from the arrays to the buffer in front of the pixel writer and, if it is one of the source, to that
    in front of the warp unit, and a row from each buffer to its unit. `granted`: a beat of the pixel writer is, `sent`: one of
    the warp unit."""
    waiting, warp_waiting = s.rows_waiting, s.strip_rows
    supertiles_rows.write_row(s, t, granted, streams[0].cores_y, drawn, sizes, tile_times)
    step_strips(s, strips, t, sent, drawn, fills_0, fills_1)
    if not supertiles_rows.row_offered(s, streams, t):
        return
    wanted = 3 if drawn[s.tile_in] < s.eye_tiles else 1
    to_pixels = s.strip_done & 1 == 0 and waiting < blending.ROWS_WAITING
    to_warp = wanted & ~s.strip_done & 2 != 0 and warp_waiting < blending.ROWS_WAITING
    s.rows_waiting += to_pixels
    s.strip_rows += to_warp
    s.strip_done |= to_pixels | to_warp << 1
    if s.strip_done == wanted:
        s.strip_done = 0
        supertiles_rows.take_row(s, streams)


@step
def holds_lists(s, strips, t):
    """Whether the lists of the second sweep wait for the end of the first one, or for their turn: one comes every two
    cycles."""
    if s.swept < s.again_lists or s.tile_count == s.again_lists:
        return False
    if s.again_open:
        return (t - s.again_at) & 1 != 0
    if strips_finished(s, strips, t):
        s.again_open, s.again_at = 1, t
    return True
