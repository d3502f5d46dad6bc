"""The rows of pixels between the arrays and memory, stepped cycle by cycle: the arrays' outputs side by side, and the buffer in
front of the pixel writer or the frame packer (rtl/top/gather_phase.py).
"""

from __future__ import annotations

from perf import blending, packing
from perf.kernel import step
from spec.constants import TILE


@step
def row_stream(s, row, count, cores_y):
    """The stream whose array gives a row, by its number in the tile, or the left part of it."""
    lower = 2 * row * s.row_x >= TILE * TILE
    if count == 1:
        return 0
    if s.row_x > s.array_x:
        return 2 if lower else 0
    across = TILE // s.row_x
    return 2 * lower + (row // cores_y % across >= across // 2)


@step
def row_taken(s, t, granted, offered, cores_y, drawn, sizes):
    """Steps the pixel writer or the frame packer. Returns whether it takes the row that is offered."""
    if s.packs:
        whole = packing.completes(s, s.row_out, s.row_x, cores_y)
        room = packing.step_packer(s, t, granted, drawn, sizes)
        taken = offered and (room or not whole)
        if taken and whole:
            packing.take_row(s, t)
        return taken
    room = blending.send_beats(s, granted)
    if room:
        s.packed = offered
    return room and offered


@step
def step_rows(s, streams, t, granted, drawn, sizes, tile_times):
    """Moves a row of pixels, of one array or of two side by side, to the buffer in front of the pixel writer or the frame
    packer, and a row from the buffer to that unit."""
    cores_y, waiting = streams[0].cores_y, s.rows_waiting
    write_row(s, t, granted, cores_y, drawn, sizes, tile_times)
    if waiting < blending.ROWS_WAITING and row_offered(s, streams, t):
        take_row(s, streams)
        s.rows_waiting += 1


@step
def row_offered(s, streams, t):
    """Whether the arrays offer the next row of the frame."""
    q = row_stream(s, s.row_in, len(streams), streams[0].cores_y)
    return blending.rows_offered(streams[q], t) and (s.row_x <= s.array_x or blending.rows_offered(streams[q + 1], t))


@step
def take_row(s, streams):
    """Removes the row that is offered from the arrays' output."""
    q = row_stream(s, s.row_in, len(streams), streams[0].cores_y)
    blending.take_row(streams[q])
    if s.row_x > s.array_x:
        blending.take_row(streams[q + 1])
    s.row_in += 1
    if s.row_in * s.row_x == TILE * TILE:
        s.row_in, s.tile_in = 0, s.tile_in + 1


@step
def write_row(s, t, granted, cores_y, drawn, sizes, tile_times):
    """Steps the pixel writer or the frame packer, which takes the first row that waits before it, if it can."""
    offered = s.rows_waiting != 0
    taken = row_taken(s, t, granted, offered, cores_y, drawn, sizes)
    blending.count_rows(s, offered, taken)
    if taken:
        place_row(s, t, cores_y, drawn, tile_times)
        s.rows_waiting -= 1


@step
def place_row(s, t, cores_y, drawn, tile_times):
    """Where the row that the pixel writer takes goes in memory, and the number of the next one."""
    at, row = s.tile_out, s.row_out
    tile = drawn[at]
    eye = tile >= s.eye_tiles  # the second eye's tiles follow those of the first
    tile -= eye * s.eye_tiles
    if s.packs == 0:
        s.packed_beats, s.packed_at = blending.row_beats(
            s, tile % s.tiles_x * TILE, tile // s.tiles_x * TILE, TILE // s.row_x, row, s.row_x, cores_y)
        s.packed_at += eye * s.eye_beats
    if row == 0:
        tile_times[0, at] = t
    row += 1
    if row * s.row_x == TILE * TILE:
        tile_times[1, at] = t
        row = 0
        s.tile_out = at + 1
    s.row_out = row
