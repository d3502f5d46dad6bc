"""A joint frame: both eyes of a rectified pair, rendered from one set of lists by super-tile (`spec.joint`)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from golden.host.joint_registers import JointRegisters, joint_registers
from golden.host.quantise import GaussianWords, quantise_model
from golden.host.registers import FrameRegisters, frame_registers
from golden.kernels import work_clock
from golden.msv2_ref import projection, sort
from golden.msv2_ref.array import ArraySplats, Pixels
from golden.msv2_ref.buckets import Bounds, check_bounds, no_bounds
from golden.msv2_ref.chunk_test import read_chunks
from golden.msv2_ref.pipeline import Frame, array_pixels, array_splats, check_request, found_intersections, render_frame
from golden.msv2_ref.ranges import range_of
from golden.msv2_ref.supertiles import SuperGrid, eye_pairs, index_words, list_counts, merge_lists, ranked_splats, super_grid
from golden.msv2_ref.tile_test import Intersections
from golden.scenes.gaze import Display, FoveationMap, foveation_map, no_foveation
from golden.scenes.model import GaussianModel
from golden.scenes.stereo import StereoPair, check_gaze, target_gaze
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.joint import EYES, check_joint, grid_origins, joint_columns

SOURCE, TARGET = range(EYES)
"""The numbers of the eyes."""


class JointPairs(NamedTuple):
    """The pairs of a joint frame in rendering order: by super-tile, depth key and index.

    Attributes:
        start, splat, index, depth_key: as in `golden.msv2_ref.supertiles.Pairs`; the key is the source's.
        mask: (P, EYES) uint16, for each eye the tiles of the super-tile with an intersection, one bit each.
        levels: (P, EYES) uint8, levels among these tiles, one bit each.
        intersection: for each eye (E,) int64, the pair of each of the eye's intersections.
    """

    start: np.ndarray
    splat: np.ndarray
    index: np.ndarray
    depth_key: np.ndarray
    mask: np.ndarray
    levels: np.ndarray
    intersection: tuple[np.ndarray, np.ndarray]

    @property
    def supertile(self) -> np.ndarray:
        """(P,) int64, the super-tile of each pair."""
        return range_of(self.start)


@dataclass(frozen=True)
class JointFrame:
    """A joint frame.

    Attributes:
        registers: what the host wrote.
        eyes: source and target as frames; their `pairs` are None, their groups and bounds those of the joint lists, and the
            depth keys of both are the source's.
        grids: how the tiles of each eye lie in the joint super-tiles.
        pairs: the joint pairs.
        pair: the cameras, where they are known. gaze: where each eye looks. foveations: the levels of each eye's tiles.
        warnings: for the user.
    """

    registers: JointRegisters
    eyes: tuple[Frame, Frame]
    grids: tuple[SuperGrid, SuperGrid]
    pairs: JointPairs
    pair: StereoPair | None = None
    gaze: tuple[tuple[float, float], tuple[float, float]] | None = None
    foveations: tuple[FoveationMap, FoveationMap] | None = None
    warnings: tuple[str, ...] = ()

    @property
    def config(self) -> AcceleratorConfig:
        """The machine."""
        return self.eyes[SOURCE].config

    @property
    def source(self) -> Frame:
        """The source eye's frame."""
        return self.eyes[SOURCE]

    @property
    def target(self) -> Frame:
        """The target eye's frame."""
        return self.eyes[TARGET]

    @property
    def bounds(self) -> Bounds:
        """The bounds of the lists."""
        return self.source.bounds

    @property
    def images(self) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 3) float64 images of the left and of the right eye; of source and target where the cameras are not known."""
        images = self.source.image, self.target.image
        return self.pair.left_right(*images) if self.pair else images

    @property
    def counts(self) -> dict[str, int]:
        """The machine's counts of Gaussians, chunks and intersections (`spec.joint`, "Counters")."""
        source, target = (eye.projected.reason for eye in self.eyes)
        frames = (source == projection.VISIBLE) | (target == projection.VISIBLE)
        read = source != projection.UNREAD
        near, faint = (int((source == reason).sum()) for reason in (projection.NEAR, projection.FAINT))
        points = int(read.sum())
        return {
            "points": points, "culled_near": near, "culled_opacity": faint,
            "culled_outside": points - near - faint - int(frames.sum()), "survivors": len(np.unique(self.pairs.splat)),
            "entries": sum(len(eye.entries.splat) for eye in self.eyes),
            "filtered": sum(eye.entries.filtered for eye in self.eyes),
            "chunks_read": self.source.chunks_read, "chunks_skipped": self.source.chunks_skipped,
            "pairs": len(self.pairs.splat)}


def project_eyes(
    config: AcceleratorConfig, words: GaussianWords, registers: JointRegisters,
) -> tuple[projection.Projected, projection.Projected]:
    """The projection's results for source and target, with the source's depth keys and culls (`spec.joint`)."""
    read = None if words.chunks is None else np.logical_or(
        *(read_chunks(config, words.chunks, len(words.geometry), eye) for eye in registers.eyes))
    source, target = (projection.project(config, words, eye, read=read) for eye in registers.eyes)
    reason = np.where(source.reason == projection.NEAR, source.reason, target.reason)
    return source, target._replace(depth_key=source.depth_key, reason=reason)


def find_joint_pairs(
    registers: JointRegisters, grids: tuple[SuperGrid, SuperGrid], chunks: np.ndarray, depth_key: np.ndarray,
    frames: tuple[Frame, Frame],
) -> JointPairs:
    """The pairs of a joint frame.

    Args:
        registers: the frame's registers.
        grids: how the tiles of each eye lie in super-tiles.
        chunks: (C,) ChunkHeader records.
        depth_key: (N,) sort key of every Gaussian.
        frames: the eyes' frames, of which the intersections are used.
    """
    seen = np.zeros(len(depth_key), bool)
    for frame in frames:
        seen[frame.entries.splat] = True
    ranked, rank = ranked_splats(depth_key, seen)
    found = [eye_pairs(eye, grid, rank, len(ranked), frame.entries)
             for eye, grid, frame in zip(registers.eyes, grids, frames, strict=True)]
    key = np.union1d(found[SOURCE].key, found[TARGET].key)
    mask, levels = np.zeros((len(key), EYES), np.uint16), np.zeros((len(key), EYES), np.uint8)
    places = []
    for eye, mine in enumerate(found):
        at = np.searchsorted(key, mine.key)
        mask[at, eye], levels[at, eye] = mine.mask, mine.levels
        places.append(at[mine.intersection])
    supertile, place = np.divmod(key, max(len(ranked), 1))
    counts, splat = np.bincount(supertile, minlength=len(grids[SOURCE].tile)), ranked[place].astype(np.int32)
    return JointPairs(
        np.concatenate(([0], np.cumsum(counts))), splat, index_words(chunks)[splat], depth_key[splat].astype(np.int64), mask,
        levels, (places[SOURCE], places[TARGET]))


def of_tiles(entries: Intersections, tiles: np.ndarray) -> tuple[Intersections, np.ndarray]:
    """The intersections of some of the tiles, (tiles,) bool, and their rows among all."""
    here = np.flatnonzero(tiles[range_of(entries.start)])
    start = np.concatenate(([0], np.cumsum(np.diff(entries.start) * tiles)))
    return entries._replace(start=start, splat=entries.splat[here], use=entries.use[here]), here


def some_pixels(
    config: AcceleratorConfig, registers: FrameRegisters, splats: ArraySplats, entries: Intersections, tiles: np.ndarray,
) -> Pixels:
    """The pixels of some of the tiles, (tiles,) bool, from the intersections of all; those of the others are 0."""
    return array_pixels(config, registers, splats, of_tiles(entries, tiles)[0], tiles)


def joint_grids(registers: JointRegisters) -> tuple[SuperGrid, SuperGrid]:
    """How the tiles of source and target lie in the joint super-tiles."""
    columns = joint_columns(registers.source.tiles_x, registers.shift)
    source, target = (super_grid(eye, origin, columns)
                      for eye, origin in zip(registers.eyes, grid_origins(registers.shift), strict=True))
    return source, target


def render_joint_frame(
    config: AcceleratorConfig, words: GaussianWords, registers: JointRegisters, *, beta: int | None = None, obb: bool = False,
    bounds: Bounds | None = None,
) -> JointFrame:
    """The machine's part of a joint frame, after the host has written the registers; `beta`, `obb` and `bounds` are as in
    `pipeline.render`. Where the target is warped, its pixels here are those of the known tiles alone (`spec.joint_warp`), and
    all of its intersections are those of the lists.

    Raises:
        InputError: see `spec.joint.check_joint`.
    """
    check_joint(config, registers.source.tiles_x, registers.source.tiles_y, registers.shift)
    projected, grids = project_eyes(config, words, registers), joint_grids(registers)
    drawn = []
    for eye, mine in zip(registers.eyes, projected, strict=True):
        begin = work_clock()
        order = sort.depth_order(mine.depth_key, mine.reason == projection.VISIBLE)
        entries, regions = found_intersections(config, words, eye, mine, order, obb=obb, rendered=None)
        lit = registers.source if registers.shared_colour else eye
        splats = array_splats(config, words, lit, mine, order)
        pixels = some_pixels(config, eye, splats, entries, registers.warping.known) if (
            registers.warping and eye is registers.target) else array_pixels(config, eye, splats, entries)
        drawn.append(Frame(config, eye, words, mine, entries, np.zeros(0, np.int64), splats, pixels,
                           {"eye": work_clock() - begin}, regions=regions))
    source, target = drawn
    pairs = find_joint_pairs(registers, grids, words.chunks, projected[SOURCE].depth_key, (source, target))
    bounds = bounds or no_bounds(len(pairs.start) - 1)
    check_bounds(config, bounds, len(pairs.start) - 1)
    groups = merge_lists(config, list_counts(pairs, bounds), beta)
    source, target = (replace(eye, groups=groups, bounds=bounds) for eye in drawn)
    return JointFrame(registers, (source, target), grids, pairs)


def _gazed_depth(
    config: AcceleratorConfig, words: GaussianWords, pair: StereoPair, foveation: FoveationMap, gaze: tuple[float, float],
    warped: bool,
) -> float:
    """The source's depth at its gaze; of the frame, only the tile that is looked at is rendered."""
    camera, baseline_px = pair.source, float(pair.disparity(1.0)) if warped else None
    registers = frame_registers(config, camera, words, foveation, np.zeros(3), baseline_px)
    column, row = min(int(gaze[0]), camera.width - 1), min(int(gaze[1]), camera.height - 1)
    rendered = np.arange(len(registers.header)) == row // TILE * registers.tiles_x + column // TILE
    return float(render_frame(config, words, registers, rendered=rendered).depth[row, column])


class JointViews(NamedTuple):
    """What both eyes look at: the model's words, each eye's gaze and the levels of its tiles, and a warning for the user."""

    words: GaussianWords
    gaze: tuple[tuple[float, float], tuple[float, float]]
    foveations: tuple[FoveationMap, FoveationMap]
    warning: str | None

    def seen_in(self, frame: JointFrame, pair: StereoPair) -> JointFrame:
        """The frame with what is known of its eyes."""
        return replace(frame, pair=pair, gaze=self.gaze, foveations=self.foveations,
                       warnings=(self.warning,) if self.warning else ())


def joint_views(
    model: GaussianModel | GaussianWords, pair: StereoPair, config: AcceleratorConfig, foveation: FoveationMap | None,
    gaze: tuple[float, float] | None, gaze_target: tuple[float, float] | None, shift: int | None, *, warped: bool,
) -> JointViews:
    """What both eyes of a joint frame look at; the arguments and what is raised are those of `render_joint`. If it is to be
    `warped`, the target's gaze counts even where nothing is foveated."""
    camera = pair.source
    display = Display(camera.width, camera.height)
    check_joint(config, -(-camera.width // TILE), -(-camera.height // TILE), shift or 0)
    words = model if isinstance(model, GaussianWords) else quantise_model(config, model)
    check_request(config, words, camera, foveation)
    gaze = (foveation and foveation.gaze_xy) or gaze or (camera.width / 2, camera.height / 2)
    check_gaze(f"{pair.source_eye} (source)", gaze, camera)
    foveated, warning = foveation is not None and foveation.gaze_xy is not None, None
    levels = foveation or no_foveation(display)
    if gaze_target is not None:
        check_gaze(f"{pair.target_eye} (target)", gaze_target, camera)
    else:
        known = (foveated or warped) and config.depth
        depth = _gazed_depth(config, words, pair, levels, gaze, warped) if known else np.inf
        gaze_target, warning = target_gaze(pair, gaze, depth)
    foveations = levels, foveation_map(display, gaze_target, foveation.levels) if foveated else no_foveation(display)
    return JointViews(words, (gaze, gaze_target), foveations, warning)


def render_joint(
    model: GaussianModel | GaussianWords, pair: StereoPair, *, config: AcceleratorConfig, foveation: FoveationMap | None = None,
    gaze: tuple[float, float] | None = None, gaze_target: tuple[float, float] | None = None,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0), beta: int | None = None, obb: bool = False,
    shift: int | None = None, shared_colour: bool = False, bounds: Bounds | None = None,
) -> JointFrame:
    """Renders a joint frame with the integer renderer.

    Args:
        model: the Gaussians, or their words when several frames share them.
        pair: the eyes.
        config: a machine with super-tiles.
        foveation: the source eye's tile levels and planes; None renders level 1 everywhere, in both eyes.
        gaze: where the source eye looks, if `foveation` has no gaze; None: at the frame's centre.
        gaze_target: where the target eye looks; None: at the same point as the source, found from the depth there, as in
            `golden.msv2_ref.eyes.render_stereo`. Where nothing is foveated, it changes nothing.
        background, beta, obb, bounds: see `pipeline.render`.
        shift: the distance of the grids in tiles; None: that of the median disparity.
        shared_colour: whether the target has the source's colours.

    Raises:
        InputError: as for `pipeline.render`, or a gaze is off-screen; or see `spec.joint.check_joint`.
        ValueError: the shift is out of range.
    """
    views = joint_views(model, pair, config, foveation, gaze, gaze_target, shift, warped=False)
    registers = joint_registers(config, views.words, pair, views.foveations, background, shift=shift,
                                shared_colour=shared_colour)
    frame = render_joint_frame(config, views.words, registers, beta=beta, obb=obb, bounds=bounds)
    return views.seen_in(frame, pair)
