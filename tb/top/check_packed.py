"""Compares packed frames with the golden renderer's: every entry, every beat and the number of beats that were written."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from golden.host.memory_image import PackedPixels
from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.frame_memory import display_pixels
from golden.msv2_ref.frame_packing import PackedFrame, display_bytes, pack_frame, table_writes
from golden.msv2_ref.joint_batches import JointBatches
from golden.msv2_ref.pipeline import Frame
from spec.constants import TILE
from spec.memory import BEAT_BYTES
from spec.packed import BLOCK_HEIGHT, BLOCKS, SLOT_BEATS, PackedError
from tb.top.player import FrameResult


def packed_differences(wanted: np.ndarray, pixels: PackedPixels) -> list[dict[str, object]]:
    """Every entry and every beat in which a packed frame from memory differs from that of (height, width) golden DisplayPixel
    records, in the order of blocks, and every damaged block. Beats that are not written may hold anything."""
    golden = pack_frame(display_bytes(wanted))
    count = len(golden.sizes)
    slots = pixels.data[: SLOT_BEATS * count].reshape(count, SLOT_BEATS, BEAT_BYTES)
    entries = pixels.data[SLOT_BEATS * count :].reshape(-1).view("<u2")[:count].astype(np.int64)
    found = [_difference(golden, block, "entry", entries[block], golden.entries()[block])
             for block in np.flatnonzero(entries != golden.entries()).tolist()]
    written = np.arange(SLOT_BEATS) < golden.sizes[:, None]
    for block, beat in np.argwhere((slots != golden.slots).any(axis=2) & written).tolist():
        found.append(_difference(golden, block, f"beat {beat}", slots[block, beat], golden.slots[block, beat]))
    for block in np.flatnonzero(pixels.errors).tolist():
        found.append({**_difference(golden, block, "block", 0, 0), "rtl": PackedError(int(pixels.errors[block])).name,
                      "golden": PackedError.NONE.name})
    return found


def _difference(golden: PackedFrame, block: int, field: str, got: np.ndarray, wanted: np.ndarray) -> dict[str, object]:
    """A difference in a block, at the place of its first pixel."""
    tile, part = divmod(block, BLOCKS)
    y, x = divmod(tile, -(-golden.width // TILE))
    return {"field": field, "tile": tile, "x": x * TILE, "y": y * TILE + part * BLOCK_HEIGHT, "rtl": np.ravel(got).tolist(),
            "golden": np.ravel(wanted).tolist()}


def packed_counter_errors(frame: Frame, result: FrameResult) -> list[str]:
    """Descriptions of a count of beats that differs from the golden frame's: each beat of a block is written once, and a beat
    of the table wherever tiles that follow each other share none."""
    visits = FrameBatches(frame).visits
    return _beat_errors([frame], table_writes(visits.tile[visits.final]), result)


def joint_packed_errors(batches: JointBatches, result: FrameResult) -> list[str]:
    """The same of a joint frame, given by its batches; the tables of both eyes are written in the order of their tiles."""
    visits = batches.stream_visits()
    return _beat_errors(batches.frame.eyes, table_writes(visits.tile[visits.final], visits.eye[visits.final]), result)


def _beat_errors(eyes: Sequence[Frame], table: int, result: FrameResult) -> list[str]:
    """Describes a count of beats that is not that of the eyes' blocks and so many beats of tables."""
    wanted = table + sum(int(pack_frame(display_bytes(display_pixels(eye))).sizes.sum()) for eye in eyes)
    got = result.registers["write_beats_frame"]
    return [] if got == wanted else [f"counter write_beats_frame must be {wanted}, not {got!r}"]
