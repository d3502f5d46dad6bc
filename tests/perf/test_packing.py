"""Packed frames in the cycle model: every beat is written once, and the packer takes a row and writes a beat in every cycle."""

import numpy as np
import pytest

from golden.msv2_ref import pipeline
from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.frame_memory import display_pixels
from golden.msv2_ref.frame_packing import display_bytes, pack_frame, table_writes
from golden.scenes.request import parse_request, resolve
from perf.frames import simulate
from perf.model import MemoryModel
from perf.supertiles import SuperCycles, simulate_supertiles
from perf.supertiles_trace import SuperTrace, super_trace
from perf.trace import trace_of
from spec.config import PAPER, TINY_V3, V3, V3_PACKED, AcceleratorConfig
from spec.memory import BEAT_BYTES
from spec.packed import SLOT_BEATS

UNLIMITED = MemoryModel("ideal", bytes_per_cycle=None)


@pytest.fixture(scope="module")
def frame() -> pipeline.Frame:
    asked = resolve(parse_request(
        "embedded", "--size", "150x100", "--gaze", "75,50", "--levels", "4", "--levels-from", "random"))
    return pipeline.render(asked.model, asked.camera, config=V3, foveation=asked.foveation, background=asked.background)


@pytest.fixture(scope="module")
def trace(frame) -> SuperTrace:
    return super_trace(frame)


def packed(trace: SuperTrace, config: AcceleratorConfig = V3_PACKED, **options: object) -> SuperCycles:
    return simulate_supertiles(trace, config, memory=MemoryModel("ideal"), packed=True, **options)


def test_every_beat_is_written_once(frame, trace):
    sizes = pack_frame(display_bytes(display_pixels(frame))).sizes
    np.testing.assert_array_equal(trace.blocks, sizes)
    visits = FrameBatches(frame).visits
    beats = int(sizes.sum()) + table_writes(visits.tile[visits.final])
    plain = simulate_supertiles(trace, V3, memory=MemoryModel("ideal"), display=True)
    for found in (packed(trace), packed(trace, TINY_V3.with_(packed=True)), packed(trace, pipeline=False)):
        assert found.writes["frame"] == BEAT_BYTES * beats < 0.8 * plain.writes["frame"]
        assert found.reads == plain.reads or found.spilled_entries
    assert packed(trace).stages["pixel_write"].busy == plain.stages["pixel_write"].busy == 7 * 10 * 16


def test_a_packed_frame_takes_fewer_cycles_where_memory_limits_it(trace):
    slow = MemoryModel("ideal", bytes_per_cycle=3.2)
    plain, small = (simulate_supertiles(trace, V3_PACKED, memory=slow, display=True, packed=on) for on in (False, True))
    assert small.total < plain.total and small.phases["geometry"] == plain.phases["geometry"]
    moved = sum(plain.writes.values()) - sum(small.writes.values())
    assert plain.total - small.total == pytest.approx(moved / 3.2, rel=0.25)


def test_plain_blocks_and_whole_beats_of_the_table_take_a_beat_a_cycle(trace):
    """Noise costs 0.8 % more beats than the pixels; then the frame cannot be faster than a beat a cycle."""
    noise = SuperTrace(**{**vars(trace), "blocks": np.where(trace.blocks > 0, SLOT_BEATS, 0).astype(np.uint8)})
    found = simulate_supertiles(noise, V3_PACKED, memory=UNLIMITED, packed=True)
    plain = simulate_supertiles(noise, V3_PACKED, memory=UNLIMITED, display=True)
    beats = found.writes["frame"] // BEAT_BYTES
    assert SLOT_BEATS * np.count_nonzero(trace.blocks) < beats <= found.phases["render"]
    assert found.phases["render"] <= 1.03 * plain.phases["render"]


def test_machines_that_pack_no_frames_are_refused(trace):
    with pytest.raises(ValueError, match="config must be a machine that packs frames, with 1 stream, not 'v3'"):
        simulate(trace, V3, packed=True)
    asked = resolve(parse_request("embedded", "--size", "32x32"))
    plain = trace_of(pipeline.render(asked.model, asked.camera, config=PAPER))
    with pytest.raises(ValueError, match="config must be a machine that packs frames, not 'paper'"):
        simulate(plain, PAPER, display=True, packed=True)
