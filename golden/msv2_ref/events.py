"""The counts of a frame that the machine's counters report, as far as the frame determines them."""

from __future__ import annotations

import numpy as np

from golden.msv2_ref import projection
from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.saturations import frame_saturations


def expected_events(frame: Frame) -> dict[str, int]:
    """The values that the machine's counters must have after the frame, for those counters that the golden frame determines."""
    reason = frame.projected.reason
    more = {"chunks_read": frame.chunks_read, "chunks_skipped": frame.chunks_skipped} if frame.config.chunks else {}
    if frame.config.supertiles:
        more |= FrameBatches(frame).events
    return {
        "points": int(frame.read.sum()), "culled_near": int((reason == projection.NEAR).sum()),
        "culled_faint": int((reason == projection.FAINT).sum()), "survivors": len(np.unique(frame.entries.splat)),
        "entries": len(frame.entries.splat), "filtered": frame.entries.filtered, "groups": int(frame.groups[-1]) + 1,
        "pixels": frame.registers.width * frame.registers.height, **more, **frame_saturations(frame)}
