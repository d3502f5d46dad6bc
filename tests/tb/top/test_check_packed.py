"""How packed frames from memory are compared with golden ones: every kind of damage is told."""

from dataclasses import replace

import numpy as np
import pytest

from golden.host.memory_image import read_packed
from golden.msv2_ref.events import expected_events
from golden.msv2_ref.frame_memory import display_pixels
from golden.msv2_ref.frame_packing import PackedFrame, display_bytes, pack_frame
from golden.msv2_ref.pipeline import Frame
from spec.codes import ErrorCode
from spec.memory import BEAT_BYTES
from spec.packed import SLOT_BEATS, table_beat
from tb.top.check import mismatches
from tb.top.check_packed import packed_counter_errors
from tb.top.planned import pixels_of, problems
from tb.top.player import FrameResult
from tb.top.suite import VARIANTS, PlannedFrame, broken_plan, good_plan

CONFIG = VARIANTS["tiny_v3_packed"]


@pytest.fixture(scope="module")
def item() -> PlannedFrame:
    """A packed frame of several tiles, cut right and below."""
    found = [i for i in good_plan(CONFIG, 0) if i.run.image.packed and "back" not in i.name]
    return max(found, key=lambda i: i.frame.registers.width * i.frame.registers.height)


def packed(frame: Frame) -> PackedFrame:
    return pack_frame(display_bytes(display_pixels(frame)))


def result(item: PlannedFrame, region: np.ndarray) -> FrameResult:
    """What a machine that wrote this region would give."""
    frame, golden = item.frame, packed(item.frame)
    pixels = read_packed(region.reshape(-1), golden.width, golden.height)
    registers = {**expected_events(frame), "read_beats": 5, "write_beats": 6, "visits": 0, "ops": 0, "skipped": 0}
    return FrameResult(pixels, ErrorCode.NONE, True, registers, 100, 5, 6, 11, 0.1, 0.1, ())


def written(golden: PackedFrame) -> np.ndarray:
    """The region of a frame in a memory that held other things."""
    region = np.random.default_rng(0).integers(0, 256, golden.region().shape, np.uint8)
    slots = region[: SLOT_BEATS * len(golden.sizes)].reshape(golden.slots.shape)
    used = np.arange(SLOT_BEATS) < golden.sizes[:, None]
    slots[used] = golden.slots[used]
    entries = region[SLOT_BEATS * len(golden.sizes) :].reshape(-1).view("<u2")
    entries[: len(golden.sizes)] = golden.entries()
    return region


def test_a_right_frame_passes_whatever_memory_held(item):
    golden = packed(item.frame)
    assert mismatches(item.frame, read_packed(written(golden).reshape(-1), golden.width, golden.height)) == []


def test_every_kind_of_damage_is_told(item):
    golden = packed(item.frame)
    block = int(np.argmax(golden.sizes))
    table = table_beat(golden.width, golden.height)

    def told(place: int, bit: int) -> set[str]:
        region = written(golden).reshape(-1)
        region[place] ^= bit
        return {m["field"] for m in mismatches(item.frame, read_packed(region, golden.width, golden.height))}

    beat = int(golden.sizes[block]) - 1
    assert {f"beat {beat}", "block"} <= told(BEAT_BYTES * (SLOT_BEATS * block + beat) + 9, 4)
    assert {"entry", "block"} <= told(BEAT_BYTES * table + 2 * block, 1) & {"entry", "block"}
    assert {"entry", "block"} <= told(BEAT_BYTES * table + 2 * block + 1, 128)
    names = [m["rtl"] for m in mismatches(item.frame, read_packed(
        np.zeros(golden.region().size, np.uint8), golden.width, golden.height)) if m["field"] == "block"]
    assert set(names) == {"MISSING"} and len(names) == np.count_nonzero(golden.sizes)


def test_beats_are_counted(item):
    region = written(packed(item.frame))
    right = result(item, region)
    (said,) = packed_counter_errors(item.frame, replace(right, registers={**right.registers, "write_beats_frame": -1}))
    wanted = int(said.split()[4].rstrip(","))
    golden, tiles = packed(item.frame), len(item.frame.registers.header)
    assert len(golden.table()) <= wanted - golden.sizes.sum() <= tiles
    assert packed_counter_errors(
        item.frame, replace(right, registers={**right.registers, "write_beats_frame": wanted})) == []


def test_a_frame_that_ended_early_must_have_damaged_blocks(item):
    failing = next(i for i in broken_plan(CONFIG, 0) if "table of a packed frame fails" in i.name)
    assert failing.run.image.packed and failing.error is ErrorCode.WRITE_ERROR
    golden = packed(failing.frame)
    early = replace(result(failing, written(golden)), error=ErrorCode.WRITE_ERROR, done=False,
                    registers={"error_clients": failing.registers["error_clients"]})
    assert problems(failing, early) == ["the frame ended early, but all blocks are whole"]
    empty = read_packed(np.zeros(golden.region().size, np.uint8), golden.width, golden.height)
    assert problems(failing, replace(early, pixels=empty)) == []


def test_plans_of_packed_frames_cover_what_the_machine_can_meet():
    good, broken = good_plan(CONFIG, 0), broken_plan(CONFIG, 0)
    for frame in (i.frame for i in good):
        formats = {(i.run.image.packed, i.run.image.settings["display"]) for i in good if i.frame is frame}
        assert len(formats) == 2 and (1, 1) in formats
    assert {(i.run.image.packed, i.run.image.settings["display"]) for i in good} == {(True, 1), (False, 0), (False, 1)}
    assert all(i.run.image.packed for i in broken)
    assert {i.error for i in broken} == set(ErrorCode) - {ErrorCode.COUNT_SATURATED, ErrorCode.WATCHDOG}
    assert any(i.run.changes == {"display": 0} for i in broken)
    assert pixels_of(VARIANTS["tiny_v3"], 3) == {"display": True}
