"""`python -m tb.frame`: one frame of a scene through the RTL, compared with the golden renderer bit for bit."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from golden.host.run_options import RunOptions, add_run_arguments, run_options
from golden.kernels import compile_note, compile_seconds
from golden.msv2_ref import joint_request
from golden.msv2_ref.eyes import KINDS, render_request, stereo_statistics
from golden.msv2_ref.joint_request import arguments_of_an_eye
from golden.msv2_ref.joint_warp import WarpedJointFrame
from golden.msv2_ref.plan import Work, work_for
from golden.scenes.load import TRAINED
from golden.scenes.pictures import save_png
from golden.scenes.request import (
    add_effect_arguments,
    add_request_arguments,
    add_stereo_arguments,
    resolve,
    take_stereo_arguments,
    write_json,
)
from spec.command_line import add_out_argument, choice, command_parser
from spec.config import AcceleratorConfig
from spec.effects import with_joint_frames, with_packed_frames
from spec.errors import InputError, run_command_line
from spec.overrides import add_config_arguments, config_from, config_record
from spec.paths import BUILD, short_path
from spec.private import output_folder
from tb.common.runner import WAVES_FILE, SimulationError, Waves, parse_window
from tb.common.wave_view import view_path
from tb.frame.eyes import save_eyes, save_joint, simulate_eyes, simulate_joint, simulate_joint_warp
from tb.frame.row import add_row_arguments, check_row, golden_row, row_numbers
from tb.frame.simulate import simulate_frame
from tb.frame.whole import picture, simulate_row
from tb.top import device
from tb.top.memory import MemorySpeed

PARTS = ("machine", "array")

EPILOG = """\
Writes OUT/frame.png (with --stereo left.png, right.png and right_source.png) and OUT/frame.json. The exit status is 1 if a bit
or a counter differs. The most important numbers of frame.json are:

  bit_exact, mismatches, first_mismatches   the comparison of every pixel with the golden renderer
  counter_errors        counters of the machine that differ from the golden frame
  frame_cycles          the cycles of a frame; table_cycles, geometry_cycles and render_cycles are those of its phases, and
                        `cycles` is the number that the host sees
  bound_cycles          the largest of `bounds`, the lower limits of render_cycles: sorting (one intersection a cycle), array
                        (one intersection a cycle for each of its levels, one op a cycle), pixel rows (one a cycle), and
                        memory (its beats at its bandwidth)
  utilisation           bound_cycles / render_cycles
  stage_cycles          cycles in which a stage was busy, starved (it had no input) or blocked (its output was not taken)
  compile_s             seconds to compile the golden renderer's kernels; wall_s and cpu_s are for the simulation alone
  dram_bytes            all bytes read and written, and those of each client
  memory                ideal or lpddr3; of the latter, activates and refreshes are the numbers of these commands

With --frames N the pictures are frame_0.png, frame_1.png, ..., these numbers are those of the last frame (what differs is that
of all frames), and `frames` has the numbers of each of them; `turned` is its camera's angle.

With --stereo these numbers count both eyes together, and there are also:

  source_entries, target_entries   the intersections of each eye

and where the second eye is warped:

  stereo_overhead       cycles / (geometry_cycles + bound_cycles), the cost of warping in addition to the rendering
  shares                shares of the target eye's pixels that are rendered, rerendered, warped, background or filled, and
                        shares of its tiles that are foveal or rerendered
  source_cycles, target_cycles     the cycles of each eye's pass

examples:
  %(prog)s                                        the trained model of the embedded scene
  %(prog)s truck.splat --size 256x144 --gaze 128,72 --levels 4
  %(prog)s --merge 0 --pipeline 0                 the baseline: no merging, double buffers between stages
  %(prog)s --effects all --pixels display --config paper_small    every effect and a second eye, on neutral data
  %(prog)s --pixels display                       4 bytes a pixel instead of 16
  %(prog)s --pixels packed --config v3_packed     a packed frame, which takes about half of that
  %(prog)s --memory lpddr3                        four channels of LPDDR3-1600 instead of the ideal memory
  %(prog)s --frames 3 --turn 5                    three frames in a row, each with the lists that suit the one before
  %(prog)s --stereo --ecc-thresh 27 --config paper_small    two eyes, the second warped beyond 27 degrees
  %(prog)s --stereo --config v3_eyes              two eyes in one set of lists, nothing warped
  %(prog)s --stereo --ecc-thresh 18 --config v3_eyes_warp    the same, the second warped beyond 18 degrees
  %(prog)s --stereo --config v3_eyes_streams --pixels packed    the same by four arrays, both eyes' frames packed
  %(prog)s --part array --config paper            only the array, with the golden renderer's intersections
"""


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("python -m tb.frame", __doc__, EPILOG)
    add_request_arguments(parser, size="256x144", scene=TRAINED)
    add_stereo_arguments(parser)
    add_effect_arguments(parser)
    add_row_arguments(parser)
    add_config_arguments(parser, "default")
    add_run_arguments(parser)
    parser.add_argument("--part", default="machine", metavar="|".join(PARTS),
                        help="the part that is simulated (default: machine)")
    add_out_argument(parser, "build/frame")
    parser.add_argument("--waves", action="store_true", help="record waves (FST)")
    parser.add_argument("--wave-cycles", default=":", metavar="FIRST:LAST", help="record these cycles only")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns 1 when a bit or a counter differs."""
    args = _arguments(argv)
    config = config_from(args, "default")
    choice("part", args.part, PARTS)
    args.pixels = args.pixels or ("display" if args.stereo else "wide")
    joint = args.stereo and config.supertiles
    if args.stereo and (args.part != "machine" or (args.pixels != "display" and (
            config.stereo or not config.joint))):
        raise InputError(f"part {args.part!r}, pixels {args.pixels!r} are not accepted with --stereo: 'machine', 'display' are")
    check_row(args)
    options = run_options(args)
    if args.part == "array" and options.display:
        raise InputError(f"pixels {args.pixels!r} is not accepted with part 'array', which writes no memory: 'wide' is")
    if options.incremental is not None:
        config = config.with_(incremental=options.incremental)
    waves = Waves(*parse_window(args.wave_cycles)) if args.waves else None
    take_stereo_arguments(args, joint=joint, warps=config.warps_joint if joint else None)
    if joint:
        with_joint_frames(config)  # raises where the machine has one eye, before the scene is read
    if args.part == "array" and config.supertiles:
        raise InputError(f"part 'array' is not accepted: config {config.name!r} has lists by super-tile, whose array takes "
                         "visits of tiles; config 'paper' has the array of this part")
    if options.packed:
        with_packed_frames(config)  # raises where the machine packs no frames
    asked = arguments_of_an_eye(args) if joint else args
    work = work_for(asked, resolve(args), config, contention=options.bytes_per_cycle is not None, full=options.full)
    if joint:
        work = joint_request.with_warp_unit(work, config)
    with output_folder(args.out, BUILD / "frame") as out:
        return _simulated(args, work, config, options, waves, out)


def _simulated(
    args: argparse.Namespace, work: Work, config: AcceleratorConfig, options: RunOptions, waves: Waves | None, out: Path,
) -> int:
    """Simulates the frame, writes its pictures and numbers into `out`, and prints them; returns 1 when anything differs."""
    try:
        simulate = _one_eye if not args.stereo else _joint if config.joint else _two_eyes
        numbers = simulate(args, work, out, out / "sim", options, waves)
    except SimulationError as error:
        print(f"FAILED: {error}")
        return 1
    if waves:
        wave = out / "sim" / WAVES_FILE
        print(f"{short_path(out)}: waves in {short_path(wave)}, in groups with `gtkwave {short_path(view_path(wave))}`")
    settings = {"config": config.name, "machine": args.machine, "part": args.part, "pixels": args.pixels,
                "merge": options.merge, "pipeline": config.incremental, "beta": options.beta,
                "configuration": config_record(config), "effects": work.plan.record, "compile_s": round(compile_seconds(), 3)}
    write_json(out / "frame.json", {**work.request.record, **settings, **numbers})
    return _verdict(numbers, short_path(out))


def _one_eye(
    args: argparse.Namespace, work: Work, out: Path, folder: Path, options: RunOptions, waves: Waves | None,
) -> dict[str, object]:
    """Simulates one frame, saves its picture and returns its numbers. The machine of a second eye writes display pixels only,
    so with a forced second eye that machine is simulated only for display pixels."""
    how = {"beta": options.beta, "speed": _speed(options), "waves": waves}
    two = work.second_eye_forced and options.display and not options.packed
    if two and args.frames > 1:
        raise InputError(f"frames {args.frames} is not accepted with effects {args.effects!r}, which have a second eye: 1 is")
    golden = golden_row(work, args.frames, args.turn, beta=options.beta)
    (out / "frame.json").unlink(missing_ok=True)  # a failed run must not leave the numbers of an earlier one
    if args.part == "array":
        numbers, rtl = simulate_frame(work.config, golden[0], folder, waves)
        save_png(out / "frame.png", rtl.image)
        return numbers
    if two:
        eyes = work.add_eye(golden[0], beta=options.beta)
        numbers, result = simulate_eyes(eyes, device.machine(work.config), folder, **how)
        save_png(out / "frame.png", picture(golden[0], result.pixels))
        return numbers
    found = simulate_row(
        golden, device.machine(work.config), folder, display=options.display, packed=options.packed, **how)
    for number, (frame, (_, pixels)) in enumerate(zip(golden, found, strict=True)):
        save_png(out / (f"frame_{number}.png" if args.frames > 1 else "frame.png"), picture(frame, pixels))
    return row_numbers([numbers for numbers, _ in found], args.turn)


def _speed(options: RunOptions) -> MemorySpeed:
    return MemorySpeed(options.latency, options.bytes_per_cycle, kind=options.memory)


def _two_eyes(
    args: argparse.Namespace, work: Work, out: Path, folder: Path, options: RunOptions, waves: Waves | None,
) -> dict[str, object]:
    """Simulates both eyes, saves their pictures and returns their numbers."""
    golden = render_request(args, work.request, work.config, beta=options.beta, words=work.words, foveation=work.foveation)
    (out / "frame.json").unlink(missing_ok=True)
    numbers, result = simulate_eyes(
        golden, device.machine(golden.source.config), folder, beta=options.beta,
        speed=_speed(options), waves=waves)
    save_eyes(golden, result, out)
    return {**numbers, "stereo": stereo_statistics(args, work.request, golden)}


def _joint(
    args: argparse.Namespace, work: Work, out: Path, folder: Path, options: RunOptions, waves: Waves | None,
) -> dict[str, object]:
    """The same of a joint frame (`spec.joint`)."""
    golden = joint_request.render_request(args, work.request, work.config, work.words, work.foveation, beta=options.beta)
    (out / "frame.json").unlink(missing_ok=True)
    if isinstance(golden, WarpedJointFrame):
        numbers, result = simulate_joint_warp(
            golden, device.machine(golden.config), folder, beta=options.beta, speed=_speed(options), waves=waves)
        save_eyes(golden, result, out)
        return {**numbers, "stereo": joint_request.joint_statistics(args, work.request, golden)}
    numbers, result = simulate_joint(
        golden, device.machine(golden.config), folder, beta=options.beta, speed=_speed(options), display=options.display,
        packed=options.packed, waves=waves)
    save_joint(golden, result, out)
    return {**numbers, "stereo": joint_request.joint_statistics(args, work.request, golden)}


def _verdict(numbers: dict, out: str) -> int:
    """Prints the frame's results; returns 1 when a bit or a counter differs."""
    for mismatch in numbers["first_mismatches"]:
        place = f" of tile {mismatch['tile']}" if "tile" in mismatch else ""
        place += f" of the {mismatch['eye']} eye" if "eye" in mismatch else ""
        place += f" in frame {mismatch['frame']}" if "frame" in mismatch else ""
        print("pixel ({x}, {y}){place}: {field} is {rtl}, golden {golden}".format(**mismatch, place=place))
    wrong_counters = numbers.get("counter_errors", [])
    for problem in (*numbers["stream_errors"], *wrong_counters):
        print(problem)
    verdict = "bit-exact" if numbers["bit_exact"] else f"NOT bit-exact: {numbers['mismatches']} values differ"
    print(f"{out}: {verdict}, {numbers['pixels_checked']:,} pixels, {numbers['entries']:,} intersections, "
          f"{numbers['cycles']:,} cycles at {numbers['cycles_per_s']:,} cycles/s{compile_note()}")
    for number, each in enumerate(numbers.get("frames", ())):
        lists = f", {each['lists']:,} lists" if "lists" in each else ""
        print(f"{out}: frame {number}: {each['frame_cycles']:,} cycles{lists}")
    if numbers.get("utilisation"):
        print(f"{out}: table {numbers['table_cycles']:,}, geometry {numbers['geometry_cycles']:,}, rendering "
              f"{numbers['render_cycles']:,} cycles; {100 * numbers['utilisation']:.1f} % of the bound, "
              f"{max(numbers['bounds'], key=numbers['bounds'].get)}")
    if "stereo_overhead" in numbers:
        print(f"{out}: both eyes in {numbers['stereo_overhead']:.4f} of the cycles without warping; pixels of the target eye: "
              + ", ".join(f"{name} {numbers['shares'][name]:.1%}" for name in KINDS))
    return 0 if numbers["bit_exact"] and not wrong_counters else 1


if __name__ == "__main__":
    run_command_line(main)
