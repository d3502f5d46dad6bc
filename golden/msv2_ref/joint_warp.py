"""A joint frame with a warped target (`spec.joint_warp`)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from golden.host.joint_registers import JointRegisters, joint_registers
from golden.host.quantise import GaussianWords
from golden.msv2_ref import eyes
from golden.msv2_ref import warp as warp_unit
from golden.msv2_ref.buckets import Bounds
from golden.msv2_ref.frame_memory import display_pixels, frame_pixels
from golden.msv2_ref.joint import (
    SOURCE,
    TARGET,
    JointFrame,
    JointPairs,
    joint_views,
    of_tiles,
    render_joint_frame,
    some_pixels,
)
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.ranges import range_of
from golden.msv2_ref.supertiles import SuperGrid, list_counts
from golden.scenes.gaze import Display, FoveationMap
from golden.scenes.model import GaussianModel
from golden.scenes.stereo import StereoPair, warpable_tiles
from spec.config import AcceleratorConfig
from spec.constants import ECC_THRESHOLD_DEG
from spec.joint import EYES
from spec.joint_warp import SWEEPS, check_joint_warp


@dataclass(frozen=True)
class WarpedJointFrame:
    """A joint frame with a warped target.

    Attributes:
        joint: both eyes with the intersections of all tiles, and the lists; of the target only the known tiles have pixels.
        warped: the warp unit's result for the source.
        holes: (tiles,) bool, the tiles of the target that the second sweep renders.
        sweeps: what the second phase renders, as a joint frame whose super-tiles are those of the first sweep and, where there
            is a second one, those of the second behind them. The target has the intersections and pixels of its rendered tiles
            alone, and a tile belongs to the super-tile of the sweep that renders it. A pair's masks and levels are those of the
            tiles that its sweep wants.
        threshold_deg: eccentricity beyond which tiles may be warped, where it is known.
    """

    joint: JointFrame
    warped: warp_unit.WarpedFrame
    holes: np.ndarray
    sweeps: JointFrame
    threshold_deg: float | None = None

    @property
    def config(self) -> AcceleratorConfig:
        """The machine."""
        return self.joint.config

    @property
    def registers(self) -> JointRegisters:
        """What the host wrote."""
        return self.joint.registers

    @property
    def source(self) -> Frame:
        """The source eye's frame."""
        return self.joint.source

    @property
    def target(self) -> Frame:
        """The target eye's frame: its rendered tiles alone."""
        return self.sweeps.target

    @property
    def pair(self) -> StereoPair | None:
        """The cameras, where they are known."""
        return self.joint.pair

    @property
    def known(self) -> np.ndarray:
        """(tiles,) bool: the tiles of the target that the host wants rendered."""
        return self.registers.warping.known

    @property
    def rendered(self) -> np.ndarray:
        """(tiles,) bool: the tiles of the target that are rendered, in either sweep."""
        return self.known | self.holes

    @property
    def again(self) -> int:
        """The number of pairs that the second sweep reads."""
        return len(self.sweeps.pairs.splat) - len(self.joint.pairs.splat)

    @property
    def groups(self) -> int:
        """The number of groups of lists, of both sweeps."""
        return int(self.source.groups[-1]) + 1 + int(self.lists_again.sum())

    @property
    def lists_again(self) -> np.ndarray:
        """(lists,) bool: the lists whose pairs the second sweep reads."""
        bounds, wanted = self.joint.bounds, np.zeros(self.joint.bounds.supertiles, bool)
        wanted[self.joint.grids[TARGET].supertile[self.holes]] = True
        owner = np.repeat(np.arange(bounds.supertiles), np.diff(bounds.first))
        return (list_counts(self.joint.pairs, bounds) > 0) & wanted[owner]

    @property
    def source_pixels(self) -> np.ndarray:
        """(H, W) DisplayPixel records of the source eye."""
        return display_pixels(self.source)

    @cached_property
    def target_pixels(self) -> np.ndarray:
        """(H, W) DisplayPixel records of the target eye: the rendered tiles over the warped frame."""
        return eyes.over_warped(self.target, self.rendered, self.warped)

    @cached_property
    def origin(self) -> np.ndarray:
        """(H, W) uint8: where each pixel of the target comes from, one of `eyes.KINDS`; a hole that stays is `eyes.HOLE`."""
        return eyes.origins(self.target, self.known, self.rendered, self.warped)

    @property
    def shares(self) -> dict[str, float]:
        """The share of the target's pixels of each kind, that of holes which stay, and of its tiles that are rendered in either
        sweep."""
        return {**eyes.kind_shares(self.origin, self.known, self.rendered), "holes": float((self.origin == eyes.HOLE).mean())}

    @property
    def images(self) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 3) uint8 images of the left and of the right eye; of source and target where the cameras are not known."""
        pictures = tuple(pixels["colour"].astype(np.uint8) for pixels in (self.source_pixels, self.target_pixels))
        return self.pair.left_right(*pictures) if self.pair else pictures

    @property
    def events(self) -> dict[str, int]:
        """The machine's counts about the target, by the names of `spec.registers.STEREO_EVENTS` and SWEEP_EVENTS."""
        return {**self.warped.events, "target_tiles": int(self.rendered.sum()), "pairs_again": self.again}


def render_warped_joint_frame(
    config: AcceleratorConfig, words: GaussianWords, registers: JointRegisters, *, beta: int | None = None, obb: bool = False,
    bounds: Bounds | None = None,
) -> WarpedJointFrame:
    """The machine's part of a joint frame with a warped target; the arguments are those of `joint.render_joint_frame`.

    Raises:
        InputError: see `spec.joint.check_joint` and `spec.joint_warp.check_joint_warp`.
        ValueError: nothing is to be warped.
    """
    check_joint_warp(config)
    if registers.warping is None:
        raise ValueError("registers must be those of a frame with a warped target")
    joint = render_joint_frame(config, words, registers, beta=beta, obb=obb, bounds=bounds)
    return swept(joint)


def swept(joint: JointFrame) -> WarpedJointFrame:
    """The frame whose first sweep is known."""
    config, warping, target = joint.config, joint.registers.warping, joint.target
    warped = warp_unit.warp(config, frame_pixels(joint.source), warping.disparity_scale, warping.source_right)
    holes = warped.invalid & ~warping.known & warping.second_sweep
    again = some_pixels(config, target.registers, target.splats, target.entries, holes)
    pixels = type(again)(*(first + second for first, second in zip(target.pixels, again, strict=True)))
    grids = joint.grids[SOURCE], joint.grids[TARGET]
    supertiles = len(joint.pairs.start) - 1
    seen = np.zeros(supertiles, bool)
    seen[grids[TARGET].supertile[holes]] = True
    rendered = warping.known | holes
    entries, rows = of_tiles(target.entries, rendered)
    regions = None if target.regions is None else target.regions[rows]
    drawn = replace(target, entries=entries, regions=regions, pixels=pixels, rendered=rendered)
    sweeps = SWEEPS if holes.any() else 1
    both = (_swept_grid(grids[SOURCE], np.ones_like(rendered), np.zeros_like(holes), sweeps),
            _swept_grid(grids[TARGET], rendered, holes, sweeps))
    pairs = _swept_pairs(joint, (joint.source, drawn), both, seen, rows)
    return WarpedJointFrame(joint, warped, holes, replace(joint, eyes=(joint.source, drawn), grids=both, pairs=pairs))


def _swept_grid(grid: SuperGrid, rendered: np.ndarray, again: np.ndarray, sweeps: int) -> SuperGrid:
    """How the tiles of an eye lie in the super-tiles of all sweeps; (tiles,) bool say which are rendered, and which of them
    in the second sweep. Other tiles lie in none."""
    supertiles = len(grid.tile)
    supertile = grid.supertile + supertiles * again
    tile = np.full((sweeps * supertiles, grid.tile.shape[1]), -1, np.int64)
    tile[supertile[rendered], grid.place[rendered]] = np.flatnonzero(rendered)
    return grid._replace(supertile=supertile, tile=tile)


def _swept_pairs(
    joint: JointFrame, drawn: tuple[Frame, Frame], grids: tuple[SuperGrid, SuperGrid], seen: np.ndarray, rows: np.ndarray,
) -> JointPairs:
    """The pairs of both sweeps.

    Args:
        joint: the frame with the pairs of the first sweep.
        drawn: what is rendered of each eye.
        grids: how the tiles of each eye lie in the super-tiles of both sweeps.
        seen: (super-tiles,) bool, those with a tile in the second sweep.
        rows: the rows of the rendered target's intersections among those of all its tiles.
    """
    p, supertiles = joint.pairs, len(seen)
    again = np.flatnonzero(seen[p.supertile])
    place = np.full(len(p.splat), -1, np.int64)
    place[again] = len(p.splat) + np.arange(len(again))
    start = p.start
    if len(grids[TARGET].tile) > supertiles:
        start = np.concatenate((start, len(p.splat) + np.cumsum(np.diff(start) * seen)))
    which = np.concatenate((np.arange(len(p.splat)), again))
    mine = p.intersection[TARGET][rows]
    later = grids[TARGET].supertile[range_of(drawn[TARGET].entries.start)] >= supertiles
    intersection = p.intersection[SOURCE], np.where(later, place[mine], mine)
    mask, levels = np.zeros((len(which), EYES), np.uint16), np.zeros((len(which), EYES), np.uint8)
    for eye, (frame, grid, pair) in enumerate(zip(drawn, grids, intersection, strict=True)):
        tile = range_of(frame.entries.start)
        np.bitwise_or.at(mask[:, eye], pair, (1 << grid.place[tile]).astype(np.uint16))
        np.bitwise_or.at(levels[:, eye], pair, (1 << frame.registers.header[tile, 0]).astype(np.uint8))
    return JointPairs(start, p.splat[which], p.index[which], p.depth_key[which], mask, levels, intersection)


def render_warped_joint(
    model: GaussianModel | GaussianWords, pair: StereoPair, *, config: AcceleratorConfig, foveation: FoveationMap | None = None,
    threshold_deg: float = ECC_THRESHOLD_DEG, second_sweep: bool = True, gaze: tuple[float, float] | None = None,
    gaze_target: tuple[float, float] | None = None, background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    beta: int | None = None, obb: bool = False, shift: int | None = None, shared_colour: bool = False,
    bounds: Bounds | None = None,
) -> WarpedJointFrame:
    """Renders a joint frame with a warped target with the integer renderer.

    Args:
        threshold_deg: tiles whose pixels all have at least this eccentricity may be warped.
        second_sweep: whether tiles with holes are rendered in a second sweep.
        others: those of `golden.msv2_ref.joint.render_joint`; the config must have a warp unit.

    Raises:
        InputError: as for `render_joint`; the threshold is out of range; or see `spec.joint_warp.check_joint_warp`.
        ValueError: the shift is out of range.
    """
    check_joint_warp(config)
    camera = pair.source
    views = joint_views(model, pair, config, foveation, gaze, gaze_target, shift, warped=True)
    warp = warpable_tiles(Display(camera.width, camera.height), views.gaze[TARGET], threshold_deg)
    registers = joint_registers(config, views.words, pair, views.foveations, background, shift=shift,
                                shared_colour=shared_colour, warp=warp, second_sweep=second_sweep)
    frame = render_warped_joint_frame(config, views.words, registers, beta=beta, obb=obb, bounds=bounds)
    warnings = eyes.warp_warnings(frame.source, pair, frame.warped.moved)
    seen, drawn = (views.seen_in(part, pair) for part in (frame.joint, frame.sweeps))
    seen = replace(seen, warnings=(*seen.warnings, *warnings))
    return replace(frame, joint=seen, sweeps=drawn, threshold_deg=threshold_deg)
