"""The host's side of a joint frame of two eyes (`spec.joint`): both eyes' registers, and how far apart their grids lie."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.host.quantise import GaussianWords
from golden.host.registers import FrameRegisters, depths_in_view, frame_registers
from golden.host.stereo_registers import disparity_scale, target_registers
from golden.scenes.gaze import FoveationMap
from golden.scenes.stereo import StereoPair
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.joint import SHIFT_MOST, check_joint
from spec.joint_warp import check_joint_warp


@dataclass(frozen=True)
class JointWarping:
    """What the host writes in addition where the target is warped (`spec.joint_warp`).

    Attributes:
        warp: (tiles,) int64, bit `warp` of each tile in the target's table.
        disparity_scale: raw disparity in pixels at the depth where depth saturates.
        source_right: whether the source is the right eye.
        second_sweep: whether tiles with holes are rendered in a second sweep.
    """

    warp: np.ndarray
    disparity_scale: int
    source_right: bool
    second_sweep: bool = True

    @property
    def known(self) -> np.ndarray:
        """(tiles,) bool: the tiles of the target that the host wants rendered."""
        return self.warp == 0


@dataclass(frozen=True)
class JointRegisters:
    """What the host writes for a joint frame.

    Attributes:
        source, target: the registers of both eyes, which differ in position and table of tiles.
        shift: the distance of the grids in tiles.
        shared_colour: whether the target has the source's colours.
        warping: what the host writes where the target is warped; None where it is not.
    """

    source: FrameRegisters
    target: FrameRegisters
    shift: int
    shared_colour: bool = False
    warping: JointWarping | None = None

    @property
    def eyes(self) -> tuple[FrameRegisters, FrameRegisters]:
        """Source and target."""
        return self.source, self.target


def median_shift(words: GaussianWords, pair: StereoPair) -> int:
    """The median disparity of the points in the source's view, in whole tiles, within what the setting `shift` holds; 0 without
    such points."""
    z = depths_in_view(words.decoded.mean, words.origin, pair.source)
    if not len(z):
        return 0
    shift = np.floor(pair.sign * float(pair.disparity(float(np.median(z)))) / TILE + 0.5)
    return int(np.clip(shift, -SHIFT_MOST, SHIFT_MOST))


def joint_registers(
    config: AcceleratorConfig, words: GaussianWords, pair: StereoPair, foveations: tuple[FoveationMap, FoveationMap],
    background: np.ndarray, *, shift: int | None = None, shared_colour: bool = False, warp: np.ndarray | None = None,
    second_sweep: bool = True,
) -> JointRegisters:
    """The registers of a joint frame.

    Args:
        config: the machine.
        words: the DRAM image.
        pair: the eyes.
        foveations: tile levels and planes of source and target.
        background: (3,) float in [0, 1].
        shift: the distance of the grids in tiles; None for `median_shift`.
        shared_colour: whether the target has the source's colours.
        warp: (tiles_y, tiles_x) bool: whether the target's tile may be warped; None in a frame without warping, whose depth
            scale is another one.
        second_sweep: whether tiles with holes are rendered in a second sweep; only with `warp`.

    Raises:
        InputError: see `spec.joint.check_joint`, `spec.joint_warp.check_joint_warp` and `stereo_registers.disparity_scale`.
        ValueError: the shift is out of range.
    """
    baseline_px = None if warp is None else float(pair.disparity(1.0))
    source = frame_registers(config, pair.source, words, foveations[0], background, baseline_px)
    target = target_registers(config, source, words, pair, foveations[1])
    shift = median_shift(words, pair) if shift is None else shift
    check_joint(config, source.tiles_x, source.tiles_y, shift)
    if warp is None:
        return JointRegisters(source, target, shift, shared_colour)
    check_joint_warp(config)
    return JointRegisters(source, target, shift, shared_colour, JointWarping(
        warp.reshape(-1).astype(np.int64), disparity_scale(config, pair, source.depth_far), pair.source_eye == "right",
        second_sweep))
