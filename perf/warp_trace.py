"""The trace of a joint frame with a warped target (`spec.joint_warp`) for `perf.supertiles`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from golden.msv2_ref import warp as warp_unit
from golden.msv2_ref.joint import TARGET
from golden.msv2_ref.joint_warp import WarpedJointFrame
from golden.msv2_ref.ranges import range_of
from perf.joint_trace import joint_trace
from perf.supertiles_trace import SuperTrace
from spec.chunks import PLACE_BITS
from spec.constants import MAX_LEVELS, TILE
from spec.joint import EYES
from spec.memory import WORDS

FILLED, UNWRITTEN = 1, 2
"""Bits of `WarpedTrace.fills`: a hole is filled here; a beat ends here of which nothing is written."""


@dataclass(frozen=True, eq=False)
class WarpedTrace:
    """The trace of a frame.

    Attributes:
        joint: the joint frame on whose lists it is.
        drawn: what the second phase renders: its pairs are those of the first sweep and behind them those of the second, as if
            there were twice as many super-tiles; its intersections are those of rendered tiles.
        eyes: (pairs,) uint8, for how many eyes each pair of `drawn` is projected, if each eye has colours of its own.
        second: (pairs,) bool, whether it is one of the second sweep, where a single eye is the target.
        lists_again: (super-tiles,) bool, those whose lists the second sweep reads.
        fills: (height, width) uint8 of the target: FILLED, UNWRITTEN or both.
        source_right: whether the source is the right eye.
    """

    joint: SuperTrace
    drawn: SuperTrace
    eyes: np.ndarray
    second: np.ndarray
    lists_again: np.ndarray
    fills: np.ndarray
    source_right: bool


def warped_trace(frame: WarpedJointFrame, joint: SuperTrace | None = None) -> WarpedTrace:
    """The trace of a frame. `joint` is the trace of the joint frame with the same registers, if it is known: it does not depend
    on what is warped, but for the packed frames."""
    if joint is None:
        joint = joint_trace(replace(frame.joint, registers=replace(frame.registers, warping=None)))
    pairs, first = frame.sweeps.pairs, len(frame.joint.pairs.splat)
    places = (pairs.levels[:, :, None] >> np.arange(MAX_LEVELS) & 1).sum(axis=2).astype(np.uint8)
    rendered, tiles = frame.rendered, len(frame.rendered)
    every = np.concatenate((np.ones(tiles, bool), rendered))
    keep = every[range_of(np.concatenate(([0], np.cumsum(joint.counts))))]
    sweep = np.where(every, np.concatenate((np.zeros(tiles, np.int8), frame.holes.astype(np.int8))), -1).astype(np.int8)
    drawn = replace(
        joint, start=pairs.start, key=pairs.depth_key.astype(np.int64), splat=pairs.splat.astype(np.int32),
        chunk=(pairs.index >> PLACE_BITS).astype(np.int32), places=places.sum(axis=1, dtype=np.uint8),
        counts=(joint.counts * every).astype(np.int32), pair=np.concatenate(pairs.intersection).astype(np.int32),
        use=joint.use[keep], regions=joint.regions[keep], places_by_eye=places, tile_sweep=sweep)
    again, grid = np.zeros(joint.supertiles, bool), frame.joint.grids[TARGET]
    again[grid.supertile[frame.holes]] = True
    known = np.zeros(joint.supertiles, bool)
    known[grid.supertile[frame.known]] = True
    second = np.arange(len(pairs.splat)) >= first
    eyes = np.where(second | ~known[np.minimum(pairs.supertile, joint.supertiles - 1)], 1, EYES).astype(np.uint8)
    return WarpedTrace(joint, drawn, eyes, second, again, _fills(frame), frame.registers.warping.source_right)


def _fills(frame: WarpedJointFrame) -> np.ndarray:
    """`fills` of a frame's trace."""
    filled = frame.warped.origin == warp_unit.FILLED
    height, width = filled.shape
    y, x = np.mgrid[:height, :width]
    before = np.minimum((y * width + x) % WORDS, x)  # pixels of the row in the same beat
    known = frame.known.reshape(-(-height // TILE), -(-width // TILE))
    unwritten = known[y // TILE, x // TILE] & known[y // TILE, (x - before) // TILE]
    return (filled * FILLED + unwritten * UNWRITTEN).astype(np.uint8)


def strip_fills(fills: np.ndarray, odd: int) -> np.ndarray:
    """The rows of `fills` that lie in even or in odd rows of tiles, one behind the other."""
    mine = np.arange(len(fills)) // TILE % 2 == odd
    return np.ascontiguousarray(fills[mine])
