"""The joint frame that a command line requests: its request, its numbers and its pictures (`spec.joint`)."""

from __future__ import annotations

import argparse
import sys
from copy import copy
from pathlib import Path

import numpy as np

from golden.host.quantise import GaussianWords
from golden.msv2_ref.frame_memory import display_pixels
from golden.msv2_ref.joint import JointFrame, render_joint
from golden.msv2_ref.joint_batches import JointBatches
from golden.scenes.gaze import FoveationMap
from golden.scenes.pictures import anaglyph, depth_picture, save_png
from golden.scenes.request import SHARED, Request, parse_numbers
from golden.scenes.stereo import scene_scale, stereo_pair
from spec.config import AcceleratorConfig


def arguments_of_an_eye(args: argparse.Namespace) -> argparse.Namespace:
    """The arguments whose plan of effects is that of a joint frame: those of one eye with depth, by which the target's gaze is
    found."""
    args = copy(args)
    args.stereo, args.depth = False, True
    return args


def render_request(
    args: argparse.Namespace, request: Request, config: AcceleratorConfig, words: GaussianWords, foveation: FoveationMap, *,
    beta: int | None = None,
) -> JointFrame:
    """Renders the joint frame that a request describes; warnings go to stderr.

    Args:
        args: the command line's arguments.
        request: the request resolved from them.
        config, words, foveation: the machine, Gaussians and tiles as the plan of effects prepared them.
        beta: as in `pipeline.render`.

    Raises:
        InputError: see `golden.scenes.stereo` and `render_joint`.
    """
    units, assumed = scene_scale(request.model.name, args.units_per_metre)
    pair = stereo_pair(request.camera, ipd_metres=args.ipd, units_per_metre=units, source_eye=args.source)
    target = tuple(parse_numbers("gaze", args.gaze_target, 2)) if args.gaze_target else None
    frame = render_joint(words, pair, config=config, foveation=foveation, gaze_target=target, background=request.background,
                         beta=beta, shared_colour=args.eye_colours == SHARED)
    for warning in (*([assumed] if assumed else []), *frame.warnings):
        print(f"warning: {warning}", file=sys.stderr)
    return frame


def joint_statistics(args: argparse.Namespace, request: Request, frame: JointFrame) -> dict[str, object]:
    """The part of stats.json about both eyes, under "stereo"."""
    units, assumed = scene_scale(request.model.name, args.units_per_metre)
    gaze = dict(zip((frame.pair.source_eye, frame.pair.target_eye), map(list, frame.gaze), strict=True))
    return {
        "joint": True, "source_eye": frame.pair.source_eye, "ipd_metres": args.ipd, "units_per_metre": units,
        "baseline": frame.pair.baseline, "gaze": gaze, "shift": frame.registers.shift,
        "eye_colours": args.eye_colours, "target_entries": len(frame.target.entries.splat), "events": frame.counts,
        **JointBatches(frame).statistics, "warnings": [*([assumed] if assumed else []), *frame.warnings]}


def save_pictures(out: Path, frame: JointFrame) -> None:
    """Writes left.png, right.png, anaglyph.png and depth.png."""
    left, right = frame.pair.left_right(*(display_pixels(eye)["colour"].astype(np.uint8) for eye in frame.eyes))
    pictures = {"left": left, "right": right, "anaglyph": anaglyph(left, right), "depth": depth_picture(frame.source.depth)}
    for name, picture in pictures.items():
        save_png(out / f"{name}.png", picture)
