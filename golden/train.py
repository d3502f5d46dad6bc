"""Train a foveated model of four levels, with a report, from posed photographs or a trained 3DGS model."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from golden.diff import import_torch
from golden.scenes.request import add_scene_argument, parse_size
from golden.training.ship import add_ship_arguments, take_ship_arguments
from spec.command_line import add_out_argument, command_parser
from spec.errors import run_command_line

EXAMPLES = """\
examples:
  %(prog)s                                         the embedded scene, some minutes
  %(prog)s fern/ --size 504x378 --variant M        a COLMAP folder; L1 may lose 2 % of the PSNR
  %(prog)s truck/ --from truck.ply                 prune and foveate a trained model; photographs judge
  %(prog)s --baseline smfr --out build/train/smfr  random subsets of the same sizes, to compare with
  %(prog)s fern/ --resume                          go on after Ctrl-C or a crash

In the output folder: model.ply (for `msv2 render` and `msv2 frame`), report.md, report.json, log.jsonl, curves.png,
pictures/ and checkpoints/.
"""


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = command_parser("python golden/train.py", __doc__, EXAMPLES)
    add_scene_argument(parser, "posed photographs: a COLMAP, LLFF, nerfstudio or Blender folder, a transforms.json")
    add = parser.add_argument
    add("--variant", default="H", metavar="H|M|L", help="quality L1 may lose: 1, 2 or 3 %% of the dense model's (default: H)")
    add("--from", dest="source", metavar="DENSE.PLY",
        help="start from this trained model, or from the dense model of the run in this folder, instead of dense training")
    add("--baseline", metavar="ce|smfr|mmfr|count|importance|speedy|pup|compact|lightgs",
        help="points ranked by the paper's computational efficiency, in all levels (ce); levels as random subsets (smfr) or "
             "separate models (mmfr); or one level, pruned in the same loop by opacity "
             "(count), by LightGaussian's importance, by the scores of Speedy-Splat (speedy) or PUP 3D-GS (pup), or by learned "
             "masks as in Compact3DGS (compact); or pruned at once and distilled as LightGaussian does (lightgs)")
    add("--dense", default="adc", metavar="adc|minisplatting", help="dense training: 3DGS's density control, or with "
        "blur split and depth reinitialisation as in Mini-Splatting-D (default: adc)")
    add("--no-opacity-enhancement", dest="enhancement", action="store_false", help="keep opacities below 1, as in the v1 model")
    add("--size", metavar="WxH", help="size to train at (default: the photographs'; 256x256 for the embedded scene)")
    add("--iterations", type=int, metavar="N", help="for the whole chain, including dense training (default: the scene's)")
    add("--max-points", type=int, metavar="N", help="largest number of points in the dense model (default: the scene's)")
    add("--full", action="store_true", help="the size of the tables: up to 1.5 points a pixel in the dense model, and more "
        "iterations; other options take precedence")
    add("--gate", default="psnr", metavar="psnr|both", help="what may not fall below the variant's share of the dense model's: "
        "PSNR, or PSNR and SSIM (default: psnr)")
    add("--pooling", default="blocks", metavar="blocks|box", help="windows over which HVSQ pools: blocks, as behind the "
        "paper's numbers, or a box around each pixel, which is stricter (default: blocks)")
    add("--pooling-width", type=int, metavar="PX", help="HVSQ pools as in frames of this width (default: 1237, which gives the "
        "paper's 1, 3, 7 and 12 pixels; the frame's own width assumes that it is shown as large as the paper's)")
    add("--no-outside", action="store_true", help="refuse photographs, masks and points that a scene's files name and that lie "
        "outside its folder; without it, absolute paths and ../ are followed")
    add("--seed", type=int, default=0, help="seed of everything drawn at random (default: 0)")
    add("--device", default="auto", metavar="auto|cpu|cuda", help="where to train (default: auto)")
    add("--resume", action="store_true", help="continue from the last checkpoint in the output folder")
    add_ship_arguments(parser)
    add_out_argument(parser, "build/train/NAME")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work; its exit status."""
    args = parse_arguments(argv)
    take_ship_arguments(args)
    import_torch()
    from golden.diff.device import resolve_device
    from golden.training.failure import TrainingError
    from golden.training.run import train

    size = parse_size(args.size) if args.size else None
    device = str(resolve_device(args.device))
    try:
        return train(args, size, device)
    except TrainingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    run_command_line(main)
