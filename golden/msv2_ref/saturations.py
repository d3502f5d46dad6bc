"""The counts of saturated values that the hardware would report, computed from a frame's records."""

from __future__ import annotations

import numpy as np

from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.frame_memory import splat_records
from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.joint_batches import JointBatches
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.projection import OUTSIDE, VISIBLE, Projected
from golden.msv2_ref.ranges import range_of
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.saturations import POINTS, SATURATIONS, Saturation, limits


def misplaced(projected: Projected) -> np.ndarray:
    """(N,) bool: the Gaussians that are culled as outside although their box meets the frame: their mean lies beyond the guard
    band."""
    met = (projected.box[:, ::2] <= projected.box[:, 1::2]).all(axis=1)
    return (projected.reason == OUTSIDE) & met


def transferred(frame: Frame, saturation: Saturation) -> np.ndarray:
    """(records, ...) raw values of the field that a saturation watches, in what its place counts or its stream transfers."""
    if saturation.stream == POINTS:
        return getattr(frame.projected, saturation.field)[misplaced(frame.projected)]
    if saturation.stream == "splats":  # as `projection.projected_splats` makes them
        return getattr(frame.projected, saturation.field)[frame.projected.reason == VISIBLE]
    if frame.config.supertiles:  # one for each level of the tiles that a pair stands for
        return FrameBatches(frame).place_records[saturation.field]
    tile = range_of(frame.entries.start)
    pairs = np.unique(np.stack([frame.entries.splat, frame.registers.header[tile, 0]], 1), axis=0)
    return splat_records(frame, MAX_LEVELS)[saturation.field][pairs[:, 0], pairs[:, 1]]


def count_saturated(config: AcceleratorConfig, saturation: Saturation, values: np.ndarray) -> int:
    """Number of records, each one row of the (records, ...) raw values, that hold a number at a limit of its format."""
    at_limit = np.isin(values, limits(saturation.field_of(config).format))
    return int(at_limit.reshape(len(values), -1).any(axis=1).sum()) if len(values) else 0


def joint_saturations(frame: JointFrame) -> dict[str, int]:
    """The counters of `spec.saturations` after a joint frame, which are sums over both eyes."""
    found = {}
    for s in SATURATIONS:
        watched = [transferred(eye, s) for eye in frame.eyes] if s.stream in (POINTS, "splats") else [
            JointBatches(frame).place_records[s.field]]
        found[s.name] = sum(count_saturated(frame.config, s, values) for values in watched)
    return found


def frame_saturations(frame: Frame) -> dict[str, int]:
    """The counters of `spec.saturations` after a frame, or after the pass of one eye."""
    return {s.name: count_saturated(frame.config, s, transferred(frame, s)) for s in SATURATIONS}
