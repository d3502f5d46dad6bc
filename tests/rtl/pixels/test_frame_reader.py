"""The reader of packed frames, with a block unpacker behind it: a memory in, rows of pixels out."""

from collections import deque

import numpy as np
import pytest
from amaranth.hdl import Module
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out
from amaranth.sim import Simulator

from golden.host.packed_frame import by_block, in_frame, unpack_blocks
from rtl.pixels.block_unpacker import BlockUnpacker
from rtl.pixels.frame_reader import FrameReader
from rtl.shapes import layout
from rtl.units import emit
from spec.config import TINY
from spec.memory import BEAT_BYTES, read_data, read_request
from spec.packed import BLOCK_HEIGHT, BLOCKS, SLOT_BEATS, PackedError, display_row, packed_beats, table_beat
from tb.pixels.packer_stimuli import graded_pixels, packed_pixels
from tests.helpers.rtl_streams import assert_rejected

BASE = 7


class Display(wiring.Component):
    """The reader and the unpacker."""

    def __init__(self):
        self.reader, self.unpacker = FrameReader(TINY), BlockUnpacker(TINY)
        super().__init__({
            "reads": Out(stream.Signature(layout(read_request(TINY)))), "data": In(stream.Signature(layout(read_data(TINY)))),
            "rows": Out(stream.Signature(layout(display_row(TINY))))})

    def elaborate(self, platform):
        m = Module()
        m.submodules.reader, m.submodules.unpacker = reader, unpacker = self.reader, self.unpacker
        wiring.connect(m, reader.blocks, unpacker.blocks)
        wiring.connect(m, reader.beats, unpacker.beats)
        wiring.connect(m, unpacker.rows, wiring.flipped(self.rows))
        wiring.connect(m, reader.reads, wiring.flipped(self.reads))
        wiring.connect(m, wiring.flipped(self.data), reader.data)
        return m


def order(width: int, height: int) -> list[int]:
    """The numbers of the blocks of a frame, band by band."""
    columns, bands = -(-width // 16), -(-height // BLOCK_HEIGHT)
    return [BLOCKS * (band // BLOCKS * columns + x) + band % BLOCKS for band in range(bands) for x in range(columns)]


def shown(
    memory: np.ndarray, width: int, height: int, *, latency: int = 5, pauses: float = 0.0, failing: int | None = None,
    frames: int = 1,
) -> tuple[list[tuple[np.ndarray, int]], int, int]:
    """The rows, (BLOCK_WIDTH * CHANNELS,) uint8 with their errors, of a frame in a memory of (beats, BEAT_BYTES) uint8 that
    answers after `latency` cycles, with an error at beat `failing`; the beats that were read, and the cycles."""
    dut, rng, rows, reads = Display(), np.random.default_rng(0), [], []
    count = frames * BLOCK_HEIGHT * len(order(width, height))
    cycles = [0]

    async def bench(ctx):
        reader, coming = dut.reader, deque()
        for port, value in ((reader.width, width), (reader.height, height), (reader.frame_base, BASE),
                            (reader.tile_count, -(-width // 16) * -(-height // 16))):
            ctx.set(port, value)
        ctx.set(dut.rows.ready, 1)
        await ctx.tick()
        started = 0
        for cycle in range(60_000):
            begins = started < frames and not ctx.get(reader.busy) and len(rows) == started * count // frames
            ctx.set(reader.start, begins)
            started += begins
            ctx.set(dut.reads.ready, rng.random() >= pauses)
            ctx.set(dut.rows.ready, rng.random() >= pauses)
            there = bool(coming) and coming[0][0] <= cycle and (ctx.get(dut.data.valid) or rng.random() >= pauses)
            if there:
                beat = coming[0][1]
                ctx.set(dut.data.payload.word.as_value(), int.from_bytes(memory[beat - BASE].tobytes(), "little"))
                ctx.set(dut.data.payload.error, beat == failing)
            ctx.set(dut.data.valid, there)
            _, _, asked, beat, moved, row, leaves = await ctx.tick().sample(
                dut.reads.valid & dut.reads.ready, dut.reads.payload.beat, dut.data.valid & dut.data.ready,
                dut.rows.payload.as_value(), dut.rows.valid & dut.rows.ready)
            if moved:
                coming.popleft()
            if asked:
                reads.append(beat)
                coming.append((cycle + latency, beat))
            if leaves:
                pixels = row & (1 << 512) - 1
                rows.append((np.frombuffer(pixels.to_bytes(64, "little"), np.uint8), row >> 512))
            if len(rows) == count:
                cycles[0] = cycle
                for _ in range(20):
                    await ctx.tick()
                assert not ctx.get(reader.busy) and not coming
                return
        raise AssertionError(f"{len(rows)} of {count} rows, {len(reads)} beats")

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    return rows, reads, cycles[0]


def region(width: int, height: int, most: float = 8.0) -> np.ndarray:
    """A packed frame in a memory that held other things."""
    golden = packed_pixels(TINY, graded_pixels(TINY, np.random.default_rng(width), width, height, most))
    out = np.random.default_rng(1).integers(0, 256, (packed_beats(width, height), BEAT_BYTES), np.uint8)
    slots = out[: table_beat(width, height)].reshape(golden.slots.shape)
    used = np.arange(SLOT_BEATS) < golden.sizes[:, None]
    slots[used] = golden.slots[used]
    out[table_beat(width, height) :].reshape(-1)[: 2 * len(golden.sizes)] = golden.entries().astype("<u2").view(np.uint8)
    return out


def check(rows: list[tuple[np.ndarray, int]], memory: np.ndarray, width: int, height: int) -> None:
    """Compares rows with what the golden unpacker gives."""
    pixels, errors = unpack_blocks(memory.reshape(-1), width, height)
    whole = np.zeros((-(-height // 16) * 16, -(-width // 16) * 16, 4), np.uint8)
    whole[:height, :width] = pixels
    blocks, inside = by_block(whole), in_frame(width, height)
    for n, block in enumerate(order(width, height)):
        for k in range(BLOCK_HEIGHT):
            row, error = rows[BLOCK_HEIGHT * n + k]
            wanted = errors[block] if k == BLOCK_HEIGHT - 1 else 0
            assert error == wanted, (block, k)
            assert (row.reshape(-1, 4)[inside[block, k]] == blocks[block, k][inside[block, k]]).all(), (block, k)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (16, 16), (17, 5), (80, 33), (150, 20)])
@pytest.mark.parametrize(("latency", "pauses"), [(1, 0.0), (60, 0.0), (9, 0.3)])
def test_a_display_gets_every_row(width, height, latency, pauses):
    memory = region(width, height)
    rows, reads, _ = shown(memory, width, height, latency=latency, pauses=pauses, frames=2 if width == 17 else 1)
    check(rows[: BLOCK_HEIGHT * len(order(width, height))], memory, width, height)
    if width == 17:
        check(rows[len(rows) // 2 :], memory, width, height)
        return
    sizes = memory[table_beat(width, height) :].reshape(-1).view("<u2")[: BLOCKS * -(-width // 16) * -(-height // 16)] & 15
    slots = [beat for beat in reads if beat < BASE + table_beat(width, height)]
    assert slots == [BASE + SLOT_BEATS * block + n for block in order(width, height) for n in range(sizes[block])]
    assert max(reads) < BASE + packed_beats(width, height)


def test_it_keeps_the_unpacker_busy_behind_a_slow_memory():
    """Only the first entries and the first block are waited for."""
    memory = region(160, 16, 1.0)
    sizes = memory[table_beat(160, 16) :].reshape(-1).view("<u2")[:40].astype(int) & 15
    _, _, cycles = shown(memory, 160, 16, latency=40)
    assert cycles <= np.maximum(6, sizes + 3).sum() + 2 * 40 + 24


def test_damage_is_told():
    width, height = 80, 33
    memory = region(width, height)
    table = table_beat(width, height)
    memory[table].view("<u2")[2] = 0
    memory[table].view("<u2")[5] |= 15
    memory[SLOT_BEATS * 4, 3] ^= 16
    rows, _, _ = shown(memory, width, height)
    check(rows, memory, width, height)
    assert {error for _, error in rows} >= {PackedError.NONE, PackedError.MISSING, PackedError.SIZE}
    rows, _, _ = shown(memory := region(width, height), width, height, failing=BASE + table)
    broken = {block for block in order(width, height) if block < 16}
    errors = {block: rows[BLOCK_HEIGHT * n + BLOCK_HEIGHT - 1][1] for n, block in enumerate(order(width, height))}
    assert {block for block, error in errors.items() if error} == broken
    assert {errors[block] for block in broken} == {PackedError.MISSING}


def test_verilog():
    text = emit("frame_reader", TINY)
    assert "module frame_reader(" in text and emit("frame_reader", TINY) == text


def test_bad_parameters_are_rejected():
    assert_rejected(lambda: FrameReader("tiny"), TypeError, "tiny")
