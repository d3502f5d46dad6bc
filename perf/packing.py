"""The frame packer of machines that pack frames, stepped cycle by cycle (rtl/pixels/).

The bytes of a block are taken as spread evenly over its rows, so a beat may leave a cycle or two sooner or later than in RTL.
"""

from __future__ import annotations

from perf import bus
from perf.bus import W_FRAME
from perf.kernel import step
from perf.layout import Layout
from perf.supertiles_gather import layout as before
from spec.constants import TILE
from spec.memory import BEAT_BYTES
from spec.packed import BLOCK_HEIGHT, BLOCKS, ENTRIES, SLOT_BEATS

layout = Layout(before)
layout.words("""
    packs pack_rows pack_taken pack_bytes pack_buffer feed_block feed_beat pop_block pop_beat entries_held entries_beat
    entries_due pack_blocks pack_table pack_eye""")
layout.ring("pack_times", 4)

_ROWS = 11
"""Rows of blocks between the array and the last stage: one that is joined, four of differences, four that wait, two in the
stages that join their groups."""

_LATENCY = 8
"""Cycles from the last row of a block to the cycle in which the last stage may take its first row."""

_ROW_BYTES = BEAT_BYTES // BLOCK_HEIGHT


@step
def _number(drawn, at):
    """The number of the block that leaves as number `at`."""
    return BLOCKS * drawn[at // BLOCKS] + at % BLOCKS


@step
def _of_eye(s, number):
    """The first beat of the frame to which a block belongs, from that of the first eye's frame, and the block's number in it.
    The blocks of a second eye follow those of the first."""
    if number < s.pack_eye:
        return 0, number
    return s.eye_beats, number - s.pack_eye


@step
def _write(s, at):
    """Moves a beat to the register before the bus."""
    s.sends, s.send_at = 1, at


@step
def _pop(s, drawn, sizes):
    """Moves an item out of the buffer behind the last stage: a beat, or the end of a block beyond the frame."""
    number = _number(drawn, s.pop_block)
    size, beat = sizes[number], s.pop_beat
    base, own = _of_eye(s, number)
    last = beat + 1 >= size
    if last and s.entries_held and s.entries_beat != base + own // ENTRIES:
        _write(s, s.pack_table + s.entries_beat)
        s.entries_held = 0
        return
    s.pack_buffer -= 1
    if size:
        _write(s, base + SLOT_BEATS * own + beat)
    s.pop_beat = 0 if last else beat + 1
    if last:
        s.entries_beat = base + own // ENTRIES
        s.entries_held += 1
        s.pop_block += 1
        s.entries_due = s.entries_held == ENTRIES or s.pop_block == s.pack_blocks


@step
def _feed(s, drawn, sizes):
    """Moves an item from the last stage to the buffer."""
    if BLOCK_HEIGHT * s.feed_block >= s.pack_taken:
        return
    size = sizes[_number(drawn, s.feed_block)]
    if size and s.pack_bytes < BEAT_BYTES:
        return
    s.pack_buffer += 1
    s.feed_beat += 1
    if size:
        s.pack_bytes -= BEAT_BYTES
    if s.feed_beat >= size:
        s.feed_beat = 0
        s.feed_block += 1


@step
def step_packer(s, t, granted, drawn, sizes):
    """Steps FramePacker but its input. Returns whether it has space for a row of a block."""
    room = s.pack_rows - s.pack_taken < _ROWS
    if granted:
        bus.write(s, W_FRAME, s.frame_base + s.send_at)
        s.sends = 0
    space = s.pack_buffer < 2
    if s.sends == 0:
        if s.entries_due:
            _write(s, s.pack_table + s.entries_beat)
            s.entries_due = s.entries_held = 0
        elif s.pack_buffer:
            _pop(s, drawn, sizes)
    if space:
        _feed(s, drawn, sizes)
    at = s.pack_taken // BLOCK_HEIGHT
    begins = s.pack_taken % BLOCK_HEIGHT == 0
    if (BLOCK_HEIGHT * at + BLOCK_HEIGHT <= s.pack_rows and s.pack_times[at & 3] <= t and s.pack_bytes < 2 * BEAT_BYTES
            and (not begins or at - s.feed_block < 2)):
        s.pack_bytes += _ROW_BYTES * sizes[_number(drawn, at)]
        s.pack_taken += 1
    s.packed = s.pop_block * BLOCK_HEIGHT != s.pack_rows or s.entries_due
    return room


@step
def completes(s, row, cores_x, cores_y):
    """Whether an array's row of a tile, by its number in the order in which rows leave, completes a row of a block."""
    columns = TILE // cores_x
    return row // cores_y % columns == columns - 1


@step
def take_row(s, t):
    """Takes a row that completes one of a block."""
    s.pack_rows += 1
    s.packed = 1
    if s.pack_rows % BLOCK_HEIGHT == 0:
        s.pack_times[s.pack_rows // BLOCK_HEIGHT - 1 & 3] = t + _LATENCY
