"""`golden/render.py --stereo`: both eyes' pictures, where the second eye's pixels come from, the shares of each."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from golden.msv2_ref.stereo import StereoFrame, render_stereo
from golden.render_effects import Work
from golden.scenes.pictures import anaglyph, depth_picture, kinds_picture, save_png
from golden.scenes.request import Request, parse_numbers
from golden.scenes.stereo import EYES, scene_scale, stereo_pair
from spec.config import AcceleratorConfig
from spec.constants import ECC_THRESHOLD_DEG, IPD_METRES
from spec.errors import InputError

_DEFAULTS = {"ecc_thresh": ECC_THRESHOLD_DEG, "ipd": IPD_METRES, "units_per_metre": None, "source": EYES[0], "gaze_right": None}


def add_stereo_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of a frame of two eyes."""
    group = parser.add_argument_group("two eyes", "the camera is the source eye's; --gaze is the left eye's, or the source's "
                                      "where the other is not given")
    group.add_argument("--stereo", action="store_true", help="render one eye, warp it into the other")
    group.add_argument("--ecc-thresh", type=float, metavar="DEG",
                       help=f"eccentricity beyond which tiles may be warped (default: {ECC_THRESHOLD_DEG:g})")
    group.add_argument("--ipd", type=float, metavar="M", help=f"distance between the eyes in metres (default: {IPD_METRES})")
    group.add_argument("--units-per-metre", type=float, metavar="S",
                       help="scale of the scene; golden/metric_scale.py computes it (default: the scene's, else 1)")
    group.add_argument("--source", metavar="left|right", help="the eye that is rendered as a whole (default: left)")
    group.add_argument("--gaze-right", metavar="X,Y",
                       help="where the right eye looks (default: both eyes look at one point)")


def take_stereo_arguments(args: argparse.Namespace) -> None:
    """Fills in defaults; with --source right, makes `args.gaze` the source's gaze and `args.gaze_target` the other's.

    Raises:
        InputError: an option of two eyes without --stereo, or no such eye.
    """
    for name, default in _DEFAULTS.items():
        if getattr(args, name) is None:
            setattr(args, name, default)
        elif not args.stereo:
            raise InputError(f"--{name.replace('_', '-')} {getattr(args, name)} is not accepted without --stereo")
    if args.source not in EYES:
        raise InputError(f"source eye {args.source!r} is not accepted: choose one of {', '.join(EYES)}")
    args.gaze_target = args.gaze_right
    if args.source == "right" and args.gaze_right is not None:
        left = None if args.gaze.lower() == "none" else args.gaze
        args.gaze, args.gaze_target = args.gaze_right, left


def render_request(
    args: argparse.Namespace, request: Request, config: AcceleratorConfig, *, beta: int | None = None, work: Work | None = None,
) -> StereoFrame:
    """The frame behind a request; warnings go to stderr.

    Args:
        args: the command line's.
        request: the resolved rest of it.
        config: the machine, which gets stereo.
        beta: as in `pipeline.render`.
        work: the request as a plan of effects wants it; None: as it came.

    Raises:
        InputError: see `golden.scenes.stereo`.
    """
    units, assumed = scene_scale(request.model.name, args.units_per_metre)
    pair = stereo_pair(request.camera, ipd_metres=args.ipd, units_per_metre=units, source_eye=args.source)
    target = tuple(parse_numbers("gaze", args.gaze_target, 2)) if args.gaze_target else None
    frame = render_stereo(
        work.words if work else request.model, pair, config=config.with_(stereo=True),
        foveation=work.foveation if work else request.foveation, threshold_deg=args.ecc_thresh,
        gaze_target=target, background=request.background, beta=beta)
    for warning in stereo_warnings(frame, assumed):
        print(f"warning: {warning}", file=sys.stderr)
    return frame


def stereo_warnings(frame: StereoFrame, assumed: str | None) -> list[str]:
    """All that the user should know, what was assumed of the scene's scale first."""
    return [*([assumed] if assumed else []), *frame.warnings]


def stereo_statistics(args: argparse.Namespace, request: Request, frame: StereoFrame) -> dict[str, object]:
    """What stats.json says of the second eye, under "stereo"."""
    units, assumed = scene_scale(request.model.name, args.units_per_metre)
    gaze = dict(zip((frame.pair.source_eye, frame.pair.target_eye), map(list, frame.gaze), strict=True))
    return {
        "source_eye": frame.pair.source_eye, "ipd_metres": args.ipd, "units_per_metre": units,
        "baseline": frame.pair.baseline, "ecc_thresh_deg": args.ecc_thresh, "gaze": gaze, "shares": frame.shares,
        "disparity_scale": frame.registers.disparity_scale, "target_entries": len(frame.target.entries.splat),
        "events": frame.events, "warnings": stereo_warnings(frame, assumed), "target_seconds": frame.target.seconds,
    }


def save_pictures(out: Path, frame: StereoFrame) -> None:
    """left.png, right.png, anaglyph.png, depth.png, and the target's kinds: right_source.png or left_source.png."""
    left, right = frame.images
    target = right if frame.pair.target_eye == "right" else left
    pictures = {
        "left": left, "right": right, "anaglyph": anaglyph(left, right), "depth": depth_picture(frame.source.depth),
        f"{frame.pair.target_eye}_source": kinds_picture(target, frame.origin)}
    for name, picture in pictures.items():
        save_png(out / f"{name}.png", picture)
