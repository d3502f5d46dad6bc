"""The frame packer and its parts in Verilator: every beat that is written, what memory then holds, and faults put there on
purpose. The other widths of the array and the trained scenes are long."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.host.packed_frame import unpack_frame
from golden.msv2_ref.frame_memory import displayed
from golden.msv2_ref.frame_packing import display_bytes
from rtl.pixels.block_packer import BlockPacker
from rtl.pixels.block_rows import BlockRows
from rtl.pixels.frame_packer import FramePacker
from rtl.units import emit
from spec.config import TINY
from spec.memory import BEAT_BITS, BEAT_BYTES, WORDS, write_request
from spec.packed import SLOT_BEATS, packed_beats, table_beat
from spec.records import pixel_row
from tb.common.exact import problems
from tb.pixels import packer_suite
from tb.pixels.packer_stimuli import graded_pixels, packed_pixels, packed_writes
from tb.vrc_array.pixel_writer_stimuli import rows_of
from tests.helpers.rtl_streams import assert_rejected, exchange


def quick_plan(config):
    return [*packer_suite.unit_plan(config, 0), *packer_suite.rate_plan(config, 0)]


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """TINY's plan and outcome."""
    plan = quick_plan(TINY)
    return plan, packer_suite.run_plan(TINY, plan, tmp_path_factory.mktemp("packer"))


def test_tiny_is_exact_and_fast_enough(tiny):
    plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 7_000
    assert sum(item.most_cycles is not None for item in plan) == 3


def test_faults_are_found(tiny):
    plan, outcome = tiny
    item = next(item for item in plan if item.name == "97 x 20, graded")
    recording = outcome.recordings[item.name]
    assert problems(item, recording) == []
    for name in write_request(TINY).dtype.names:
        rows = item.expected["writes"].copy()
        rows[name][3] ^= 1
        assert problems(replace(item, expected={"writes": rows}), recording)[0].startswith("writes 3: ")
    for name in item.observed:
        assert problems(replace(item, observed={name: item.observed[name] + 1}), recording)


def test_the_stimuli_have_blocks_of_every_size_and_shared_beats_of_the_table():
    frame = packed_pixels(TINY, graded_pixels(TINY, np.random.default_rng(0), 97, 20))
    assert {*frame.sizes.tolist()} >= {0, 3, 4, 5, 6, 7, SLOT_BEATS}
    writes = packed_writes(TINY, frame, list(range(14)), 0)
    table = writes["beat"] >= table_beat(97, 20)
    assert (writes["strobe"][~table] == (1 << WORDS) - 1).all() and writes["strobe"][table].tolist() == [255, 255, 255, 15]


@pytest.mark.parametrize("name", ["97 x 20, graded", "15 x 17, noise", "16 x 16, one colour", "tiles in any order"])
def test_a_display_gets_the_pixels_back(tiny, name):
    """The unit's own writes, put into a memory that held other things."""
    plan, outcome = tiny
    item = next(item for item in plan if item.name == name)
    width, height, base = (item.run.settings[key] for key in ("width", "height", "frame_base"))
    memory = np.random.default_rng(0).integers(0, 1 << 32, (packed_beats(width, height), WORDS), np.uint32)
    for write in outcome.recordings[name].outputs["writes"]:
        written = write["strobe"] >> np.arange(WORDS) & 1 > 0
        memory[(int(write["beat"]) - base) % (1 << BEAT_BITS), written] = write["word"][written]
    found = unpack_frame(memory.view(np.uint8).reshape(-1), width, height)
    rows, whole = item.run.inputs["rows"], np.zeros((-(-height // 16) * 16, -(-width // 16) * 16, 4), np.uint8)
    for row in rows:
        pixels = np.zeros(TINY.cores_x, [("colour", int, 3), ("transmittance", int)])
        pixels["colour"], pixels["transmittance"] = row["colour"].reshape(-1, 3), row["transmittance"]
        y, x = row["tile_y"] * 16 + row["row"], row["tile_x"] * 16 + row["column"]
        whole[y, x : x + TINY.cores_x] = display_bytes(displayed(TINY, pixels))
    assert (found == whole[:height, :width]).all()
    assert len(outcome.recordings[name].outputs["writes"]) * BEAT_BYTES < 1.05 * whole.size


def test_latency_and_a_row_a_cycle():
    """Without pauses, rows of a smooth frame go in one after the other on an array of 16 columns."""
    config = TINY.with_(cores_x=16)
    rng = np.random.default_rng(0)
    frame = graded_pixels(config, rng, 64, 16, 1.0)
    rows = rows_of(config, frame, rng)
    dut, packed = FramePacker(config), packed_pixels(config, frame)
    writes = packed_writes(config, packed, [0, 1, 2, 3], 5)

    def setup(ctx):
        for port, value in ((dut.width, 64), (dut.height, 16), (dut.frame_base, 5), (dut.tile_count, 4)):
            ctx.set(port, value)

    got, cycles = exchange(
        dut, {dut.rows: [pixel_row(config).pack(row) for row in rows]}, dut.writes, len(writes), setup=setup)
    assert got == [write_request(config).pack(row) for row in writes]
    assert cycles[0] <= 16 and cycles[-1] <= max(len(rows), len(writes)) + 24


@pytest.mark.parametrize("unit", [BlockRows, BlockPacker, FramePacker])
def test_bad_parameters_are_rejected(unit):
    assert_rejected(lambda: unit("tiny"), TypeError, "tiny")


def test_verilog():
    text = emit("frame_packer", TINY)
    assert "module frame_packer(" in text and emit("frame_packer", TINY) == text


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in packer_suite.DISTINCT if name != "tiny"])
def test_other_widths_are_exact(name, tmp_path):
    config = packer_suite.VARIANTS[name]
    plan = quick_plan(config)
    assert packer_suite.run_plan(config, plan, tmp_path).failures == {}


@pytest.mark.long
def test_traced_frames_are_exact(tmp_path):
    plan = packer_suite.traced_plan(TINY, "131x75")
    assert plan and packer_suite.run_plan(TINY, plan, tmp_path).failures == {}
