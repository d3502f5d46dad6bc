"""The joint frame that a command line requests: its request, its numbers and its pictures (`spec.joint`,
`spec.joint_warp`)."""

from __future__ import annotations

import argparse
import sys
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np

from golden.host.quantise import GaussianWords
from golden.msv2_ref.frame_memory import display_pixels
from golden.msv2_ref.joint import JointFrame, render_joint
from golden.msv2_ref.joint_batches import JointBatches
from golden.msv2_ref.joint_warp import WarpedJointFrame, render_warped_joint
from golden.msv2_ref.plan import Work
from golden.scenes.gaze import FoveationMap
from golden.scenes.pictures import anaglyph, depth_picture, kinds_picture, save_png
from golden.scenes.request import ON, SHARED, Request, parse_numbers
from golden.scenes.stereo import scene_scale, stereo_pair
from spec.config import AcceleratorConfig


def arguments_of_an_eye(args: argparse.Namespace) -> argparse.Namespace:
    """The arguments whose plan of effects is that of a joint frame: those of one eye with depth, by which the target's gaze is
    found."""
    args = copy(args)
    args.stereo, args.depth = False, True
    return args


def with_warp_unit(work: Work, config: AcceleratorConfig) -> Work:
    """The work of a joint frame on `config`: where it has a warp unit, the target is warped."""
    return replace(work, config=work.config.with_(stereo=True, fine_depth=False)) if config.warps_joint else work


def render_request(
    args: argparse.Namespace, request: Request, config: AcceleratorConfig, words: GaussianWords, foveation: FoveationMap, *,
    beta: int | None = None,
) -> JointFrame | WarpedJointFrame:
    """Renders the joint frame that a request describes, with a warped target where the machine has a warp unit; warnings go to
    stderr.

    Args:
        args: the command line's arguments.
        request: the request resolved from them.
        config, words, foveation: the machine, Gaussians and tiles as the plan of effects prepared them.
        beta: as in `pipeline.render`.

    Raises:
        InputError: see `golden.scenes.stereo`, `render_joint` and `render_warped_joint`.
    """
    units, assumed = scene_scale(request.model.name, args.units_per_metre)
    pair = stereo_pair(request.camera, ipd_metres=args.ipd, units_per_metre=units, source_eye=args.source)
    target = tuple(parse_numbers("gaze", args.gaze_target, 2)) if args.gaze_target else None
    how = {"config": config, "foveation": foveation, "gaze_target": target, "background": request.background, "beta": beta,
           "shared_colour": args.eye_colours == SHARED}
    frame = render_warped_joint(words, pair, **how, threshold_deg=args.ecc_thresh, second_sweep=args.second_sweep == ON) if (
        config.warps_joint) else render_joint(words, pair, **how)
    for warning in (*([assumed] if assumed else []), *_seen(frame).warnings):
        print(f"warning: {warning}", file=sys.stderr)
    return frame


def _seen(frame: JointFrame | WarpedJointFrame) -> JointFrame:
    """The joint frame, or the one that a frame with a warped target is on top of."""
    return frame.joint if isinstance(frame, WarpedJointFrame) else frame


def joint_statistics(
    args: argparse.Namespace, request: Request, frame: JointFrame | WarpedJointFrame,
) -> dict[str, object]:
    """The part of stats.json about both eyes, under "stereo"."""
    units, assumed = scene_scale(request.model.name, args.units_per_metre)
    seen, drawn, warped = _seen(frame), frame, {}
    if isinstance(frame, WarpedJointFrame):
        drawn = frame.sweeps
        warped = {"ecc_thresh_deg": args.ecc_thresh, "second_sweep": args.second_sweep, "shares": frame.shares,
                  "disparity_scale": frame.registers.warping.disparity_scale}
    gaze = dict(zip((seen.pair.source_eye, seen.pair.target_eye), map(list, seen.gaze), strict=True))
    events = {**seen.counts, **(frame.events if isinstance(frame, WarpedJointFrame) else {})}
    return {
        "joint": True, "source_eye": seen.pair.source_eye, "ipd_metres": args.ipd, "units_per_metre": units,
        "baseline": seen.pair.baseline, "gaze": gaze, "shift": frame.registers.shift,
        "eye_colours": args.eye_colours, **warped, "target_entries": len(drawn.target.entries.splat), "events": events,
        **JointBatches(drawn).statistics, "pairs": len(seen.pairs.splat),
        "warnings": [*([assumed] if assumed else []), *seen.warnings]}


def save_pictures(out: Path, frame: JointFrame | WarpedJointFrame) -> None:
    """Writes left.png, right.png, anaglyph.png and depth.png, and for a warped target right_source.png or left_source.png,
    which shows how each of its pixels was obtained."""
    pair = frame.pair
    if isinstance(frame, WarpedJointFrame):
        pixels = frame.source_pixels, frame.target_pixels
    else:
        pixels = tuple(display_pixels(eye) for eye in frame.eyes)
    source, target = (eye["colour"].astype(np.uint8) for eye in pixels)
    left, right = pair.left_right(source, target)
    pictures = {"left": left, "right": right, "anaglyph": anaglyph(left, right), "depth": depth_picture(frame.source.depth)}
    if isinstance(frame, WarpedJointFrame):
        pictures[f"{pair.target_eye}_source"] = kinds_picture(target, frame.origin)
    for name, picture in pictures.items():
        save_png(out / f"{name}.png", picture)
