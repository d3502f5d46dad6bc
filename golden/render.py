"""Render a scene with the integer renderer, whose pixels equal the hardware's, and write pictures and numbers."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from golden.kernels import compile_note, compile_seconds
from golden.metrics.image import max_abs_error, psnr_vs
from golden.msv2_ref import eyes as warped
from golden.msv2_ref import joint_request as joint
from golden.msv2_ref import pipeline, projection
from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.plan import Work, work_for
from golden.oracle.render import render as render_oracle
from golden.scenes.files import atomic_output
from golden.scenes.load import TRAINED
from golden.scenes.pictures import depth_picture, levels_picture, save_png
from golden.scenes.request import (
    Request,
    add_effect_arguments,
    add_request_arguments,
    add_stereo_arguments,
    resolve,
    take_stereo_arguments,
    write_json,
)
from spec.command_line import add_out_argument, choice, command_parser
from spec.config import AcceleratorConfig
from spec.errors import run_command_line
from spec.overrides import add_config_arguments, config_from, config_record
from spec.paths import BUILD, short_path
from spec.private import output_folder

EXAMPLES = """\
examples:
  %(prog)s                                        the trained model of the embedded scene
  %(prog)s --gaze 128,128                         its four levels
  %(prog)s truck.splat --size 640x360 --compare oracle
  %(prog)s rock_sh3/ --gaze 320,180 --levels 4    foveated; levels are fitted to the model
  %(prog)s --stereo --ecc-thresh 27               two eyes: left.png, right.png, right_source.png
  %(prog)s truck.splat --effects all              every effect, on neutral data where the scene has none
  %(prog)s scene.ply --camera view.json --dump entries --out build/render/view
"""


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = command_parser("python golden/render.py", __doc__, EXAMPLES)
    add_request_arguments(parser, scene=TRAINED)
    add_stereo_arguments(parser)
    add_effect_arguments(parser)
    add_config_arguments(parser, "paper", ", the widest rows")
    parser.add_argument("--compare", metavar="oracle", help="render the float64 oracle too and report the difference")
    parser.add_argument("--dump", metavar="STAGE", help="write an arrow as .npz: gaussians, splats, entries or pixels")
    add_out_argument(parser, "build/render/NAME")
    return parser.parse_args(argv)


def frame_statistics(frame: pipeline.Frame, request: Request) -> dict[str, object]:
    """The content of stats.json: counts, culled points by reason, intersections per tile, coverage, seconds by stage.

    The time of compiling kernels is in `compile` only; neither a stage nor the total includes it.
    """
    counts = np.diff(frame.entries.start)
    reason = np.bincount(frame.projected.reason, minlength=projection.UNREAD + 1)
    used = int((np.bincount(frame.entries.splat, minlength=1) > 0).sum())
    culled = {name: int(reason[code]) for code, name in projection.REASONS.items()}
    return {
        **request.record,
        "config": frame.config.name,
        "splats": len(request.model),
        "visible": used,
        "culled": {**culled, "no_tile": int(reason[projection.VISIBLE]) - used, **request.model.dropped},
        "saturated": frame.words.saturated,
        "entries": len(frame.entries.splat),
        "entries_filtered": frame.entries.filtered,
        "entries_per_tile": {
            "mean": float(counts.mean()), "max": int(counts.max()), "empty": int((counts == 0).sum()),
            **{f"p{p}": float(np.percentile(counts, p)) for p in (5, 25, 50, 75, 95)},
        },
        "tiles": len(counts),
        "blend_tiles": int(request.foveation.blend.sum()),
        "groups": int(frame.groups[-1]) + 1,
        **({} if frame.pairs is None else FrameBatches(frame).statistics),
        "coverage": float((1 - frame.transmittance).mean()),
        "seconds": {**frame.seconds, "total": sum(frame.seconds.values()), "compile": compile_seconds()},
    }


def compare_with_oracle(frame: pipeline.Frame, request: Request) -> dict[str, float]:
    """Errors against the oracle with the same level planes and, if there is a gaze, with exact eccentricities."""
    given = {"foveation": request.foveation, "background": request.background, "support_sigma": frame.config.support_sigma}
    oracle = render_oracle(request.model, request.camera, weights="plane", **given)
    numbers = {"psnr_vs_oracle_db": psnr_vs(frame.image, oracle.image),
               "max_abs_error": max_abs_error(frame.image, oracle.image)}
    if request.foveation.gaze_xy is not None:
        exact = render_oracle(request.model, request.camera, weights="exact", **given)
        numbers["psnr_vs_exact_levels_db"] = psnr_vs(frame.image, exact.image)
    return numbers


def main(argv: Sequence[str] | None = None) -> None:
    """The command line's work."""
    args = parse_arguments(argv)
    config = config_from(args)
    for name, value, accepted in (("compare", args.compare, ("oracle",)), ("stage", args.dump, pipeline.STAGES)):
        if value is not None:
            choice(name, value, accepted)
    both = args.stereo and config.supertiles
    take_stereo_arguments(args, joint=both, warps=config.warps_joint if both else None)
    request = resolve(args)
    work = work_for(joint.arguments_of_an_eye(args) if both else args, request, config)
    with output_folder(args.out, BUILD / "render" / request.model.name) as out:
        (_draw_joint if both else _draw)(args, request, config, work, out)


def _draw_joint(args: argparse.Namespace, request: Request, config: AcceleratorConfig, work: Work, out: Path) -> None:
    """As `_draw`, for two eyes of a machine with super-tiles. The numbers beside "stereo" are those of the source."""
    work = joint.with_warp_unit(work, config)
    both = joint.render_request(args, request, work.config, work.words, work.foveation)
    frame = both.source
    frame.seconds["quantise"] = work.prepare_s
    stats = {**frame_statistics(frame, request), "configuration": config_record(config), "effects": work.plan.record,
             "stereo": joint.joint_statistics(args, request, both)}
    if args.compare:
        stats.update(compare_with_oracle(frame, request))
    joint.save_pictures(out, both)
    _finish(args, request, frame, stats, out)
    rtl = "" if config.joint else f"; the RTL of config {config.name!r} renders one eye, that of 'v3_eyes' both"
    print(f"both eyes from {stats['stereo']['pairs']:,} pairs{rtl}")
    if config.warps_joint:
        print(", ".join(f"{name} {share:.1%}" for name, share in both.shares.items()))


def _draw(args: argparse.Namespace, request: Request, config: AcceleratorConfig, work: Work, out: Path) -> None:
    """Renders the frame, writes pictures and numbers into the folder `out`, and prints the most important numbers."""
    eyes = None
    if args.stereo:
        eyes = warped.render_request(args, request, work.config, words=work.words, foveation=work.foveation)
    frame = eyes.source if eyes else work.render()
    if work.second_eye_forced:
        work.add_eye(frame)
    frame.seconds["quantise"] = work.prepare_s
    stats = {**frame_statistics(frame, request), "configuration": config_record(config), "effects": work.plan.record}
    if eyes:
        stats["stereo"] = warped.stereo_statistics(args, request, eyes)
    if args.compare:
        stats.update(compare_with_oracle(frame, request))

    if eyes:
        warped.save_pictures(out, eyes)
    else:
        save_png(out / "frame.png", frame.image)
        if args.depth:
            save_png(out / "depth.png", depth_picture(frame.depth))
    _finish(args, request, frame, stats, out)
    if eyes:
        print(", ".join(f"{name} {share:.1%}" for name, share in eyes.shares.items()))


def _finish(args: argparse.Namespace, request: Request, frame: pipeline.Frame, stats: dict[str, object], out: Path) -> None:
    """Writes what frames of one and of two eyes have in common, and prints the most important numbers."""
    save_png(out / "levels.png", levels_picture(frame.image, request.foveation))
    if args.dump:
        with atomic_output(out / f"{args.dump}.npz") as file:
            np.savez_compressed(file, **frame.stage(args.dump))
    write_json(out / "stats.json", stats)
    shown = ("splats", "visible", "entries", "coverage", "psnr_vs_oracle_db", "psnr_vs_exact_levels_db", "max_abs_error")
    numbers = (f"{key} {stats[key]:{'.4g' if isinstance(stats[key], float) else ','}}" for key in shown if key in stats)
    print(f"{short_path(out)}: {', '.join(numbers)}{compile_note()}")


if __name__ == "__main__":
    run_command_line(main)
