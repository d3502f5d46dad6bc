"""`python -m tb.frame`: one frame of a scene through the RTL, compared with the golden renderer bit for bit."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from golden.kernels import compile_note
from golden.kernels import compile_note, compile_seconds
from golden.msv2_ref.eyes import KINDS, render_request, stereo_statistics
from golden.msv2_ref.plan import Work, work_for
from golden.scenes.pictures import save_png
from golden.scenes.request import (
    add_effect_arguments,
    add_request_arguments,
    add_stereo_arguments,
    make_folder,
    resolve,
    take_stereo_arguments,
    write_json,
)
from spec.errors import InputError, run_command_line
from spec.memory import DRAM_BYTES_PER_CYCLE
from spec.overrides import add_config_arguments, choice, config_from, config_record
from spec.paths import BUILD, short_path
from spec.records import COUNT_BITS
from tb.common.runner import SimulationError, Waves, parse_window
from tb.frame.eyes import save_eyes, simulate_eyes
from tb.frame.simulate import simulate_frame
from tb.frame.whole import picture, simulate_machine
from tb.top import device
from tb.top.memory import MemorySpeed

PARTS = ("machine", "array")

MACHINES = ("scene", "full")
"""What the frame calls for and no more, or all of the configuration with the rest idle."""

PIXELS = ("wide", "display")
"""Formats of the frame in memory: `spec.memory` FramePixel, DisplayPixel."""

EPILOG = """\
Writes OUT/frame.png (of two eyes left.png, right.png, right_source.png) and OUT/frame.json; exit status 1 where a bit or a
counter differs. Of frame.json:

  bit_exact, mismatches, first_mismatches   every pixel against the golden renderer
  counter_errors        counters of the machine that differ from what the golden frame says
  frame_cycles          of these table_cycles, geometry_cycles and render_cycles; cycles: as the host sees them
  bound_cycles          the largest of `bounds`: least cycles of the rendering phase by sorting (an entry a cycle), array (an
                        entry a level and cycle, an op a cycle), pixel rows (one a cycle), memory (its beats at its bandwidth)
  utilisation           bound_cycles / render_cycles
  stage_cycles          by stage: busy, starved (nothing to take), blocked (could not take it); stalls are the blocked ones
  compile_s             seconds of compiling the golden renderer's kernels; wall_s and cpu_s are of the simulation alone
  dram_bytes            read and write in all, reads and writes by client

and with --stereo, where all of these are of both eyes together:

  stereo_overhead       cycles / (geometry_cycles + bound_cycles): what warping costs beyond the work on what is rendered
  shares                of the target eye's pixels: rendered, rerendered, warped, background, filled; of its tiles: foveal,
                        rerendered
  source_cycles, target_cycles, source_entries, target_entries   by eye

examples:
  python -m tb.frame                                        the embedded scene
  python -m tb.frame truck.splat --size 256x144 --gaze 128,72 --levels 4
  python -m tb.frame --merge 0 --pipeline 0                 the baseline: no merging, double buffers between stages
  python -m tb.frame --effects all --pixels display         every effect, a second eye too, on neutral data
  python -m tb.frame --pixels display                       4 bytes a pixel instead of 16
  python -m tb.frame --stereo --ecc-thresh 27               two eyes, the second warped beyond 27 degrees
  python -m tb.frame --part array                           the golden renderer's entries through the array alone
"""


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tb.frame", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_request_arguments(parser, size="256x144")
    add_stereo_arguments(parser)
    add_effect_arguments(parser)
    parser.add_argument("--scene", dest="scene_option", metavar="SCENE", help="the same as the positional SCENE")
    add_config_arguments(parser, "default")
    parser.add_argument("--machine", default="scene", metavar="scene|full",
                        help="units for active effects only, or all of the configuration's (default: scene)")
    parser.add_argument("--part", default="machine", help=f"{' or '.join(PARTS)} (default: machine)")
    parser.add_argument("--pixels", help=f"{' or '.join(PIXELS)}: of the frame in memory (default: wide; of two eyes display)")
    parser.add_argument("--merge", default="1", metavar="0|1", help="merge tiles (default: 1); 0 is the same as --beta 0")
    parser.add_argument("--pipeline", metavar="0|1",
                        help="stages hand over incrementally (default: the machine's, 1); 0 is another, with double buffers")
    parser.add_argument("--beta", default="auto", metavar="N|auto", help="merge threshold in entries (default: auto)")
    parser.add_argument("--bandwidth", default=str(DRAM_BYTES_PER_CYCLE), metavar="BYTES|unlimited",
                        help=f"of memory, bytes a cycle (default: {DRAM_BYTES_PER_CYCLE})")
    parser.add_argument("--latency", type=int, default=100, metavar="N", help="of memory, cycles (default: 100)")
    parser.add_argument("--out", metavar="DIR", help="output folder (default: build/frame)")
    parser.add_argument("--waves", action="store_true", help="record waves (FST)")
    parser.add_argument("--wave-cycles", default=":", metavar="FIRST:LAST", help="record these cycles only")
    args = parser.parse_args(argv)
    args.scene = args.scene_option or args.scene
    args.pixels = args.pixels or ("display" if args.stereo else "wide")
    return args


def parse_beta(text: str, merge: bool) -> int | None:
    """The threshold; None for automatic, 0 where nothing is merged."""
    most = (1 << COUNT_BITS) - 1
    if text != "auto" and not (text.isdigit() and int(text) <= most):
        raise InputError(f"beta {text!r} is not accepted: 0..{most} or 'auto' are")
    if not merge:
        return 0
    return None if text == "auto" else int(text)


def parse_speed(bandwidth: str, latency: int) -> MemorySpeed:
    """The memory's speed."""
    try:
        return MemorySpeed(latency, None if bandwidth == "unlimited" else float(bandwidth))
    except ValueError as error:
        raise InputError(f"bandwidth {bandwidth!r}, latency {latency}: {error}") from error


def parse_switch(name: str, text: str) -> bool:
    """Of "0" or "1"."""
    if text not in ("0", "1"):
        raise InputError(f"{name} {text!r} is not accepted: 0 or 1 is")
    return text == "1"


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work; 1 when a bit or a counter differs."""
    args = _arguments(argv)
    config = config_from(args, "default")
    choices = (("part", args.part, PARTS), ("pixels", args.pixels, PIXELS), ("machine", args.machine, MACHINES))
    for name, value, accepted in choices:
        choice(name, value, accepted)
    if args.stereo and (args.part, args.pixels) != ("machine", "display"):
        raise InputError(f"part {args.part!r}, pixels {args.pixels!r} are not accepted with --stereo: 'machine', 'display' are")
    if args.part == "array" and args.pixels != "wide":
        raise InputError(f"pixels {args.pixels!r} is not accepted with part 'array', which writes no memory: 'wide' is")
    merge = parse_switch("merge", args.merge)
    if args.pipeline is not None:
        config = config.with_(incremental=parse_switch("pipeline", args.pipeline))
    beta, speed = parse_beta(args.beta, merge), parse_speed(args.bandwidth, args.latency)
    waves = Waves(*parse_window(args.wave_cycles)) if args.waves else None
    take_stereo_arguments(args)
    work = work_for(args, resolve(args), config, contention=speed.bytes_per_cycle is not None, full=args.machine == "full")
    out = make_folder(args.out or BUILD / "frame")
    try:
        numbers = (_two_eyes if args.stereo else _one_eye)(args, work, out, beta, speed, waves)
    except SimulationError as error:
        print(f"FAILED: {error}")
        return 1
    settings = {"config": config.name, "machine": args.machine, "part": args.part, "pixels": args.pixels, "merge": merge,
                "pipeline": config.incremental, "beta": beta, "configuration": config_record(config),
                "effects": work.plan.record, "compile_s": round(compile_seconds(), 3)}
    write_json(out / "frame.json", {**work.request.record, **settings, **numbers})
    return _verdict(numbers, short_path(out))


def _one_eye(
    args: argparse.Namespace, work: Work, out: Path, beta: int | None, speed: MemorySpeed, waves: Waves | None,
) -> dict[str, object]:
    """The frame's numbers; its picture is saved. A second eye is forced on frames for displays, as no other machine's are."""
    golden = work.render(beta=beta)
    (out / "frame.json").unlink(missing_ok=True)  # what an earlier run said does not outlive this one's start
    if args.part == "array":
        numbers, rtl = simulate_frame(work.config, golden, out / "sim", waves)
        image = rtl.image
    elif work.second_eye_forced and args.pixels == "display":
        eyes = work.add_eye(golden, beta=beta)
        numbers, result = simulate_eyes(eyes, device.machine(work.config), out / "sim", beta=beta, speed=speed, waves=waves)
        image = picture(golden, result.pixels)
    else:
        numbers, pixels = simulate_machine(
            golden, device.machine(work.config), out / "sim", beta=beta, speed=speed, display=args.pixels == "display",
            waves=waves)
        image = picture(golden, pixels)
    save_png(out / "frame.png", image)
    return numbers


def _two_eyes(
    args: argparse.Namespace, work: Work, out: Path, beta: int | None, speed: MemorySpeed, waves: Waves | None,
) -> dict[str, object]:
    """Both eyes' numbers; their pictures are saved."""
    golden = render_request(args, work.request, work.config, beta=beta, words=work.words, foveation=work.foveation)
    (out / "frame.json").unlink(missing_ok=True)
    numbers, result = simulate_eyes(
        golden, device.machine(golden.source.config), out / "sim", beta=beta, speed=speed, waves=waves)
    save_eyes(golden, result, out)
    return {**numbers, "stereo": stereo_statistics(args, work.request, golden)}


def _verdict(numbers: dict, out: str) -> int:
    """Prints what came of the frame; 1 when a bit or a counter differs."""
    for mismatch in numbers["first_mismatches"]:
        place = f" of tile {mismatch['tile']}" if "tile" in mismatch else ""
        place += f" of the {mismatch['eye']} eye" if "eye" in mismatch else ""
        print("pixel ({x}, {y}){place}: {field} is {rtl}, golden {golden}".format(**mismatch, place=place))
    wrong_counters = numbers.get("counter_errors", [])
    for problem in (*numbers["stream_errors"], *wrong_counters):
        print(problem)
    verdict = "bit-exact" if numbers["bit_exact"] else f"NOT bit-exact: {numbers['mismatches']} values differ"
    print(f"{out}: {verdict}, {numbers['pixels_checked']:,} pixels, {numbers['entries']:,} entries, "
          f"{numbers['cycles']:,} cycles at {numbers['cycles_per_s']:,} cycles/s{compile_note()}")
    if numbers.get("utilisation"):
        print(f"{out}: table {numbers['table_cycles']:,}, geometry {numbers['geometry_cycles']:,}, rendering "
              f"{numbers['render_cycles']:,} cycles; {100 * numbers['utilisation']:.1f} % of the bound, "
              f"{max(numbers['bounds'], key=numbers['bounds'].get)}")
    if "stereo_overhead" in numbers:
        print(f"{out}: both eyes in {numbers['stereo_overhead']:.4f} of the cycles without warping; of the target's pixels "
              + ", ".join(f"{name} {numbers['shares'][name]:.1%}" for name in KINDS))
    return 0 if numbers["bit_exact"] and not wrong_counters else 1


if __name__ == "__main__":
    run_command_line(main)
