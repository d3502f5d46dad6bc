"""A frame of two eyes: the source eye is rendered and its pixels are warped into the target eye; then the target's central
tiles and the tiles with holes are rendered over them."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from golden.host.quantise import GaussianWords, quantise_model
from golden.host.stereo_registers import StereoRegisters, stereo_registers
from golden.msv2_ref import pipeline
from golden.msv2_ref import warp as warp_unit
from golden.msv2_ref.frame_memory import display_pixels, frame_pixels
from golden.scenes.gaze import Display, FoveationMap, foveation_map, no_foveation
from golden.scenes.model import GaussianModel
from golden.scenes.pictures import anaglyph, depth_picture, kinds_picture, save_png
from golden.scenes.request import Request, parse_numbers
from golden.scenes.stereo import StereoPair, check_gaze, scene_scale, stereo_pair, target_gaze, warpable_tiles
from spec.config import AcceleratorConfig
from spec.constants import ECC_THRESHOLD_DEG, TILE
from spec.effects import with_two_eyes
from spec.stereo import (
    background_transmittance,
    reach,
    solid_transmittance,
)

RENDERED, RERENDERED, WARPED, BACKGROUND, FILLED = range(5)
"""Where a pixel of the target comes from: a tile that may not be warped and was rendered, a tile that was rendered because of
its holes, a pixel of the source, the source's background, or, in a filled hole, its neighbours."""

HOLE = 5
"""A hole that stays, in joint frames without a second sweep (`spec.joint_warp`)."""

KINDS = {"rendered": RENDERED, "rerendered": RERENDERED, "warped": WARPED, "background": BACKGROUND, "filled": FILLED}


@dataclass(frozen=True)
class StereoFrame:
    """A frame of two eyes.

    Attributes:
        pair: the cameras.
        registers: what the host wrote for the second eye.
        source: the source eye's frame.
        warped: the warp unit's result for it.
        rendered: (tiles,) bool, tiles of the target that were rendered.
        target: the target eye's frame, with those tiles only.
        gaze: the source's and the target's gaze in pixels.
        foveation: the target's tile levels and planes.
        threshold_deg: eccentricity beyond which tiles may be warped.
        warnings: messages for the user.
    """

    pair: StereoPair
    registers: StereoRegisters
    source: pipeline.Frame
    warped: warp_unit.WarpedFrame
    rendered: np.ndarray
    target: pipeline.Frame
    gaze: tuple[tuple[float, float], tuple[float, float]]
    foveation: FoveationMap
    threshold_deg: float
    warnings: tuple[str, ...]

    @property
    def source_pixels(self) -> np.ndarray:
        """(H, W) DisplayPixel records of the source eye."""
        return display_pixels(self.source)

    @cached_property
    def target_pixels(self) -> np.ndarray:
        """(H, W) DisplayPixel records of the target eye: the rendered tiles over the warped frame."""
        return over_warped(self.target, self.rendered, self.warped)

    @cached_property
    def origin(self) -> np.ndarray:
        """(H, W) uint8: where each pixel of the target comes from, one of KINDS."""
        return origins(self.target, self.registers.warp == 0, self.rendered, self.warped)

    @property
    def shares(self) -> dict[str, float]:
        """The share of the target's pixels of each kind, and of its tiles that are rendered."""
        return kind_shares(self.origin, self.registers.warp == 0, self.rendered)

    @property
    def images(self) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 3) uint8 images of the left and of the right eye."""
        pictures = (pixels["colour"].astype(np.uint8) for pixels in (self.source_pixels, self.target_pixels))
        return self.pair.left_right(*pictures)

    @property
    def events(self) -> dict[str, int]:
        """The machine's counts for stereo, by the names of `spec.registers.STEREO_EVENTS`."""
        return {**self.warped.events, "target_tiles": int(self.rendered.sum())}


def per_pixel(frame: pipeline.Frame, tiles: np.ndarray) -> np.ndarray:
    """(H, W) bool of (tiles,) bool."""
    r = frame.registers
    expanded = tiles.reshape(r.tiles_y, r.tiles_x).repeat(TILE, axis=0).repeat(TILE, axis=1)
    return expanded[: r.height, : r.width]


def over_warped(target: pipeline.Frame, rendered: np.ndarray, warped: warp_unit.WarpedFrame) -> np.ndarray:
    """(H, W) DisplayPixel records of a target eye: its (tiles,) bool rendered tiles over the warped frame."""
    return np.where(per_pixel(target, rendered), display_pixels(target), warped.pixels)


def origins(target: pipeline.Frame, known: np.ndarray, rendered: np.ndarray, warped: warp_unit.WarpedFrame) -> np.ndarray:
    """(H, W) uint8: where each pixel of a target eye comes from, one of KINDS, or HOLE in a tile with holes that is not
    rendered. `known` and `rendered` are (tiles,) bool: the tiles that may not be warped, and all tiles that are rendered."""
    of_warped = np.array([HOLE, WARPED, BACKGROUND, FILLED], np.uint8)[warped.origin]
    of_warped = np.where(per_pixel(target, rendered), RERENDERED, of_warped)
    return np.where(per_pixel(target, known), RENDERED, of_warped).astype(np.uint8)


def kind_shares(origin: np.ndarray, known: np.ndarray, rendered: np.ndarray) -> dict[str, float]:
    """The share of the pixels of each kind in `origins`, of the tiles that may not be warped, and of those that are rendered
    because of their holes."""
    return {**{name: float((origin == kind).mean()) for name, kind in KINDS.items()},
            "tiles_foveal": float(known.mean()), "tiles_rerendered": float((rendered & ~known).mean())}


def warp_warnings(frame: pipeline.Frame, pair: StereoPair, moved: np.ndarray) -> list[str]:
    """Warnings about a source frame that has no usable depth, or whose disparities are too large for the frame or the
    machine."""
    n, t = frame.config.formats, frame_pixels(frame)["transmittance"]
    solid, background = t <= solid_transmittance(n), t >= background_transmittance(n)
    found = []
    if not solid.any() and not background.all() and not frame.config.warp_veiled:
        found.append("no pixel of the source eye has a depth: every tile with holes is rendered")
    dropped, most = solid & (moved["keep"] == 0), reach(frame.config)
    disparity = pair.disparity(np.where(solid, frame.depth, np.inf))
    far = dropped & (disparity >= pair.source.width)
    if far.any():
        found.append(f"{int(far.sum())} pixels have disparities wider than the frame's {pair.source.width} pixels: they are "
                     "dropped; check IPD and scale")
    beyond = int((dropped & ~far & (disparity >= most + 1)).sum())
    if beyond:
        found.append(f"{beyond} pixels have disparities wider than the {most} pixels that the machine moves them by: "
                     "they are dropped; check IPD and scale")
    return found


def render_stereo(
    model: GaussianModel | GaussianWords, pair: StereoPair, *, config: AcceleratorConfig, foveation: FoveationMap | None = None,
    threshold_deg: float = ECC_THRESHOLD_DEG, gaze: tuple[float, float] | None = None,
    gaze_target: tuple[float, float] | None = None, background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    beta: int | None = None, obb: bool = False, source: pipeline.Frame | None = None,
) -> StereoFrame:
    """Renders a frame of two eyes with the integer renderer.

    Args:
        model: the Gaussians, or their words when several frames share them.
        pair: the eyes.
        config: a machine with stereo.
        foveation: the source eye's tile levels and planes; None renders level 1 everywhere, in both eyes.
        threshold_deg: tiles whose pixels all have at least this eccentricity may be warped.
        gaze: where the source eye looks, if `foveation` has no gaze; None: at the frame's centre.
        gaze_target: where the target eye looks; None: at the same point as the source, found from the depth there.
        background, beta, obb: see `pipeline.render`.
        source: the source eye's frame, if it has been rendered already.

    Raises:
        ValueError: the machine has no stereo.
        InputError: as for `pipeline.render`, or a gaze is off-screen, or the threshold is out of range.
    """
    if not config.stereo:
        raise ValueError(f"config must be a machine with stereo, not {config!r}")
    camera = pair.source
    display = Display(camera.width, camera.height)
    gaze = (foveation and foveation.gaze_xy) or gaze or (camera.width / 2, camera.height / 2)
    check_gaze(f"{pair.source_eye} (source)", gaze, camera)
    if gaze_target is not None:
        check_gaze(f"{pair.target_eye} (target)", gaze_target, camera)
    warpable_tiles(display, gaze, threshold_deg)  # raises for a bad threshold before anything is rendered
    words = model if isinstance(model, GaussianWords) else quantise_model(config, model)
    source = source or pipeline.render(
        words, camera, config=config, foveation=foveation, background=background, beta=beta, obb=obb,
        baseline_px=float(pair.disparity(1.0)))

    warnings: list[str] = []
    if gaze_target is None:
        column, row = min(int(gaze[0]), camera.width - 1), min(int(gaze[1]), camera.height - 1)
        gaze_target, warning = target_gaze(pair, gaze, float(source.depth[row, column]))
        warnings += [warning] if warning else []
    foveated = foveation is not None and foveation.gaze_xy is not None
    target_foveation = foveation_map(display, gaze_target, foveation.levels) if foveated else no_foveation(display)
    warp = warpable_tiles(display, gaze_target, threshold_deg)
    registers = stereo_registers(config, source.registers, words, pair, target_foveation, warp)

    warped = warp_unit.warp(config, frame_pixels(source), registers.disparity_scale, registers.source_right)
    warnings += warp_warnings(source, pair, warped.moved)
    rendered = (registers.warp == 0) | warped.invalid
    target = pipeline.render_frame(config, words, registers.target, beta=beta, obb=obb, rendered=rendered)
    return StereoFrame(pair, registers, source, warped, rendered, target, (gaze, gaze_target), target_foveation, threshold_deg,
                       tuple(warnings))


def render_request(
    args: argparse.Namespace, request: Request, config: AcceleratorConfig, *, beta: int | None = None,
    words: GaussianWords | None = None, foveation: FoveationMap | None = None,
) -> StereoFrame:
    """Renders the frame of two eyes that a request describes; warnings go to stderr.

    Args:
        args: the command line's arguments.
        request: the request resolved from them.
        config: the machine, to which stereo is added.
        beta: as in `pipeline.render`.
        words, foveation: the request's Gaussians and tiles as a plan of effects prepared them; None: those of the request.

    Raises:
        InputError: see `golden.scenes.stereo` and `spec.effects.with_two_eyes`.
    """
    units, assumed = scene_scale(request.model.name, args.units_per_metre)
    pair = stereo_pair(request.camera, ipd_metres=args.ipd, units_per_metre=units, source_eye=args.source)
    target = tuple(parse_numbers("gaze", args.gaze_target, 2)) if args.gaze_target else None
    frame = render_stereo(
        words or request.model, pair, config=with_two_eyes(config),
        foveation=foveation or request.foveation, threshold_deg=args.ecc_thresh,
        gaze_target=target, background=request.background, beta=beta)
    for warning in stereo_warnings(frame, assumed):
        print(f"warning: {warning}", file=sys.stderr)
    return frame


def stereo_warnings(frame: StereoFrame, assumed: str | None) -> list[str]:
    """All warnings for the user; the one about an assumed scale of the scene comes first."""
    return [*([assumed] if assumed else []), *frame.warnings]


def stereo_statistics(args: argparse.Namespace, request: Request, frame: StereoFrame) -> dict[str, object]:
    """The part of stats.json about the second eye, under "stereo"."""
    units, assumed = scene_scale(request.model.name, args.units_per_metre)
    gaze = dict(zip((frame.pair.source_eye, frame.pair.target_eye), map(list, frame.gaze), strict=True))
    return {
        "source_eye": frame.pair.source_eye, "ipd_metres": args.ipd, "units_per_metre": units,
        "baseline": frame.pair.baseline, "ecc_thresh_deg": args.ecc_thresh, "gaze": gaze, "shares": frame.shares,
        "disparity_scale": frame.registers.disparity_scale, "target_entries": len(frame.target.entries.splat),
        "events": frame.events, "warnings": stereo_warnings(frame, assumed), "target_seconds": frame.target.seconds,
    }


def save_pictures(out: Path, frame: StereoFrame) -> None:
    """Writes left.png, right.png, anaglyph.png, depth.png and, for the kinds of the target's pixels, right_source.png or
    left_source.png."""
    left, right = frame.images
    target = right if frame.pair.target_eye == "right" else left
    pictures = {
        "left": left, "right": right, "anaglyph": anaglyph(left, right), "depth": depth_picture(frame.source.depth),
        f"{frame.pair.target_eye}_source": kinds_picture(target, frame.origin)}
    for name, picture in pictures.items():
        save_png(out / f"{name}.png", picture)
