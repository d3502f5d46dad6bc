"""`python -m tb.frame`: one frame of a scene through the RTL array, compared with the golden renderer bit for bit."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from golden.msv2_ref import pipeline
from golden.scenes.pictures import save_png
from golden.scenes.request import add_request_arguments, make_folder, resolve, write_json
from spec.config import CONFIGS
from spec.errors import InputError, run_command_line
from tb.common.runner import ROOT, SimulationError, Waves
from tb.frame.simulate import simulate_frame
from tb.sim import parse_window


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tb.frame", description=__doc__)
    add_request_arguments(parser, size="256x144")
    parser.add_argument("--scene", dest="scene_option", metavar="SCENE", help="the same as the positional SCENE")
    parser.add_argument("--config", default="default", help=f"machine: {', '.join(CONFIGS)} (default: default)")
    parser.add_argument("--out", metavar="DIR", help="output folder (default: build/frame)")
    parser.add_argument("--waves", action="store_true", help="record waves (FST)")
    parser.add_argument("--wave-cycles", default=":", metavar="FIRST:LAST", help="record these cycles only")
    args = parser.parse_args(argv)
    args.scene = args.scene_option or args.scene
    return args


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work; 1 when a bit differs."""
    args = _arguments(argv)
    if args.config not in CONFIGS:
        raise InputError(f"CONFIG {args.config!r} is not accepted: choose one of {', '.join(CONFIGS)}")
    waves = Waves(*parse_window(args.wave_cycles)) if args.waves else None
    config, request, out = CONFIGS[args.config], resolve(args), make_folder(args.out or ROOT / "build" / "frame")
    golden = pipeline.render(
        request.model, request.camera, config=config, foveation=request.foveation, background=request.background)
    (out / "frame.json").unlink(missing_ok=True)  # what an earlier run said does not outlive this one's start
    try:
        numbers, rtl = simulate_frame(config, golden, out / "sim", waves)
    except SimulationError as error:
        print(f"FAILED: {error}")
        return 1
    save_png(out / "frame.png", rtl.image)
    write_json(out / "frame.json", {**request.record, "config": config.name, **numbers})
    for mismatch in numbers["first_mismatches"]:
        print("pixel ({x}, {y}): {field} is {rtl}, golden {golden}".format(**mismatch))
    verdict = "bit-exact" if numbers["bit_exact"] else f"NOT bit-exact: {numbers['mismatches']} values differ"
    print(f"{out}: {verdict}, {numbers['pixels_checked']:,} pixels, {numbers['entries']:,} entries, "
          f"{numbers['cycles']:,} cycles at {numbers['cycles_per_s']:,} cycles/s")
    return 0 if numbers["bit_exact"] else 1


if __name__ == "__main__":
    run_command_line(main)
