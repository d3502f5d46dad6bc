"""`python -m tb.frame`: one frame of a scene through the RTL array, compared with the golden renderer bit for bit."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from golden.msv2_ref import pipeline
from golden.scenes.pictures import save_png
from golden.scenes.request import add_request_arguments, make_folder, resolve, write_json
from spec.config import CONFIGS, AcceleratorConfig
from spec.constants import TILE
from spec.errors import InputError, run_command_line
from tb.common.player import Recording, play
from tb.common.runner import ROOT, SimulationError, Waves, build
from tb.sim import parse_window
from tb.vrc.check import Mismatch, mismatches, run_of
from tb.vrc.device import tiles_from_rows, vrc_playback
from tb.vrc.stimuli import Case

_SHOWN = 10


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


def simulate_frame(
    config: AcceleratorConfig, frame: pipeline.Frame, folder: Path, waves: Waves | None = None,
) -> tuple[dict[str, object], pipeline.Frame]:
    """The numbers of frame.json, and the frame with the RTL's pixels instead of the golden ones.

    Raises:
        SimulationError: the build fails, or the array does not give every pixel once.
    """
    case = Case("frame", frame.headers, frame.array_entries, frame.registers.background)
    playback = vrc_playback(config)
    begin = time.perf_counter()
    build(playback.design(), waves)
    build_s = time.perf_counter() - begin
    recording, = play(playback, [run_of(config, case)], folder, waves=waves, progress=True)
    try:
        pixels = tiles_from_rows(config, case.headers, recording.outputs["pixels"])
    except ValueError as error:
        raise SimulationError(", ".join([str(error), *recording.errors])) from error
    wrong = mismatches(pixels, frame.pixels)
    numbers = {
        "bit_exact": not wrong and not recording.errors,
        "pixels_checked": frame.registers.width * frame.registers.height,
        "tiles": len(case.headers),
        "entries": len(case.entries),
        **recording.observed,
        "mismatches": len(wrong),
        "first_mismatches": [_in_frame(case, m) for m in wrong[:_SHOWN]],
        "stream_errors": recording.errors,
        **_speed(recording),
        "build_s": round(build_s, 3),
    }
    return numbers, replace(frame, pixels=pixels)


def _in_frame(case: Case, m: Mismatch) -> dict[str, object]:
    header = case.headers[m.tile]
    x, y = int(header["tile_x"]) * TILE + m.x, int(header["tile_y"]) * TILE + m.y
    return {"field": m.field, "x": x, "y": y, "rtl": m.rtl, "golden": m.golden}


def _speed(recording: Recording) -> dict[str, object]:
    return {
        "cycles": recording.cycles, "stalls": recording.stalls, "wall_s": round(recording.seconds, 3),
        "cycles_per_s": round(recording.cycles / recording.seconds)}


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work; 1 when a bit differs."""
    args = _arguments(argv)
    if args.config not in CONFIGS:
        raise InputError(f"CONFIG {args.config!r} is not accepted: choose one of {', '.join(CONFIGS)}")
    waves = Waves(*parse_window(args.wave_cycles)) if args.waves else None
    config, request, out = CONFIGS[args.config], resolve(args), make_folder(args.out or ROOT / "build" / "frame")
    golden = pipeline.render(
        request.model, request.camera, config=config, foveation=request.foveation, background=request.background)
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
