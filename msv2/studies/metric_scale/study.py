"""Finds how many units of a scene are a metre, by comparing the rendered depth with a metric depth map of the same view.

The map holds the z depth in metres for a picture of that view, as monocular estimators such as MoGe-2 give it. The metres per
unit are the median of the ratio between the map's and the rendered depth, over the pixels in which both have a depth.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from golden.msv2_ref import pipeline
from golden.scenes.camera_options import ORBIT
from golden.scenes.level_source import RANDOM
from golden.scenes.request import add_request_arguments, resolve
from msv2.studies.record import write_report
from spec.command_line import command_parser
from spec.config import CONFIGS
from spec.errors import InputError

LEAST_SHARE = 0.01
"""The least share of the frame's pixels that must have a depth in both; fewer would not represent the scene."""

ASPECT_TOLERANCE = 0.02
"""Largest relative difference between the aspect ratios of map and frame. It allows a pixel or two of rounding, but not another
view."""

EXAMPLES = """examples:
  msv2 study run metric_scale scene.ply --camera 0 --depth-map depth.npy
  msv2 study run metric_scale scene.ply --camera view.json --size 640x360 --depth-map depth.png --out scale.json
"""


def load_depth_map(path: Path) -> np.ndarray:
    """(H, W) float64 metres, from a .npy file of floats or a 16-bit PNG of millimetres. Pixels without a depth are 0 or not
    finite.

    Raises:
        InputError: the file is missing or of another kind.
    """
    try:
        if path.suffix == ".npy":
            depth = np.load(path)
        elif path.suffix == ".png":
            depth = np.asarray(Image.open(path))
        else:
            raise InputError(f"depth map {path} is not accepted: .npy in metres and 16-bit .png in millimetres are")
    except (OSError, ValueError) as error:
        raise InputError(f"depth map {path} cannot be read: {error}") from error
    if depth.ndim != 2 or depth.size == 0 or depth.dtype.kind not in "fiu":
        raise InputError(f"depth map {path} must be one plane of numbers, not {depth.shape} {depth.dtype}")
    if path.suffix == ".png":
        if depth.dtype.itemsize < 2:
            raise InputError(f"depth map {path} is not accepted: it has 8 bits; 16 bits of millimetres are accepted")
        return depth / 1000.0
    return depth.astype(np.float64)


def units_per_metre(metric: np.ndarray, ours: np.ndarray) -> dict[str, float]:
    """The scale, with the number and the share of the pixels that it is based on.

    Args:
        metric: (h, w) z depth in metres; it is read at the pixels nearest to ours.
        ours: (H, W) z depth in world units, NaN where there is none.

    Raises:
        InputError: the aspect ratios differ, or too few pixels have both depths.
    """
    (height, width), (rows, columns) = ours.shape, metric.shape
    if abs(columns * height / (rows * width) - 1) > ASPECT_TOLERANCE:
        raise InputError(f"a depth map of {columns}x{rows} is not accepted for a frame of {width}x{height}: same shape is")
    row = ((np.arange(height) + 0.5) * rows / height).astype(int)
    column = ((np.arange(width) + 0.5) * columns / width).astype(int)
    sampled = metric[row[:, None], column]
    both = np.isfinite(sampled) & (sampled > 0) & np.isfinite(ours) & (ours > 0)
    if both.mean() < LEAST_SHARE:
        raise InputError(f"{int(both.sum())} pixels with a depth in map and frame are too few: {LEAST_SHARE:.0%} are needed")
    ratio = sampled[both] / ours[both]
    low, middle, high = np.percentile(ratio, [25, 50, 75])
    return {"units_per_metre": float(1 / middle), "metres_per_unit": float(middle), "metres_per_unit_quartiles":
            [float(low), float(high)], "pixels": int(both.sum()), "share": float(both.mean())}


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """The parsed command line."""
    parser = command_parser("msv2 study run metric_scale", __doc__, EXAMPLES)
    add_request_arguments(parser)
    parser.set_defaults(camera=ORBIT, levels_from=RANDOM)
    parser.add_argument("--depth-map", required=True, metavar="FILE",
                        help="depth map of the camera's view: .npy (m) or 16-bit .png (mm)")
    parser.add_argument("--out", metavar="FILE", help="also write the JSON to this file")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> None:
    """Runs the command line."""
    args = parse_arguments(argv)
    metric = load_depth_map(Path(args.depth_map))
    request = resolve(args)
    frame = pipeline.render(request.model, request.camera, config=CONFIGS["paper"], foveation=request.foveation)
    found = {"scene": str(args.scene), "camera": request.camera.name, "depth_map": args.depth_map,
             **units_per_metre(metric, frame.depth)}
    if args.out:
        write_report(Path(args.out), found, [__name__], {"arguments": args}, [args.scene, args.depth_map])
    print(json.dumps(found, indent=1))
