"""`python -m perf`: the cycles of a frame, as the cycle model predicts them."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from golden.host.run_options import IDEAL, RunOptions, add_run_arguments, run_options
from golden.kernels import compile_note, compile_seconds
from golden.msv2_ref.eyes import StereoFrame, render_request
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.plan import Work, plan_for, planned_machine, planned_work
from golden.scenes.files import atomic_output
from golden.scenes.load import TRAINED
from golden.scenes.request import (
    Request,
    add_effect_arguments,
    add_request_arguments,
    add_stereo_arguments,
    resolve,
    take_stereo_arguments,
    write_json,
)
from perf.frames import Trace, simulate, trace_request
from perf.model import FrameCycles, MemoryModel
from perf.perfetto import trace_events
from spec.command_line import add_out_argument, command_parser
from spec.config import AcceleratorConfig
from spec.effects import EffectPlan, with_packed_frames, with_two_eyes
from spec.errors import InputError, run_command_line
from spec.lpddr3 import CLOCKS_NS
from spec.overrides import add_config_arguments, config_from, config_record
from spec.paths import BUILD, cache_folder, short_path
from spec.private import output_folder

CACHE = cache_folder("traces")

EPILOG = """\
Writes OUT/perf.json, and OUT/perfetto.json for ui.perfetto.dev: the times at which each group was in each stage.

examples:
  %(prog)s                                            the trained model of the embedded scene
  %(prog)s truck.splat --size 1280x720 --gaze 640,360 --levels 4 --config paper
  %(prog)s --merge 0 --pipeline 0                     the baseline: no merging, double buffers between stages
  %(prog)s --clock-mhz 600                            a slower machine, which waits fewer cycles for LPDDR3
  %(prog)s --memory ideal                             an ideal memory instead of four channels of LPDDR3-1600: a bound
  %(prog)s --bandwidth 12.8                           an ideal memory with half of their bandwidth
  %(prog)s --stereo --ecc-thresh 27 --config paper    two eyes, the second warped beyond 27 degrees
"""


def command_line() -> argparse.ArgumentParser:
    """The command's parser."""
    parser = command_parser("python -m perf", __doc__, EPILOG)
    add_request_arguments(parser, size="256x144", scene=TRAINED)
    add_stereo_arguments(parser)
    add_effect_arguments(parser)
    add_config_arguments(parser, "default")
    add_run_arguments(parser, memory=None)
    parser.add_argument("--clock-mhz", type=float, default=1000.0, metavar="MHZ",
                        help="clock of the machine, on which the cycles of LPDDR3 depend (default: 1000)")
    add_out_argument(parser, "build/perf/frame")
    parser.add_argument("--no-cache", action="store_true", help="render the golden frame even if its trace is in the cache")
    return parser


def table(frame: FrameCycles) -> str:
    """The numbers of a frame as text."""
    lines = [f"{'phase':<14}{'cycles':>12}"]
    lines += [f"{name:<14}{cycles:>12,}" for name, cycles in (*frame.phases.items(), ("total", frame.total))]
    lines += ["", f"{'stage':<14}{'busy':>12}{'blocked':>12}{'starved':>12}"]
    lines += [f"{name:<14}{s.busy:>12,}{s.blocked:>12,}{s.starved:>12,}" for name, s in frame.stages.items()]
    lines += ["", f"{'bytes':<14}{'read':>12}{'written':>12}"]
    lines += [f"{name:<14}{frame.reads.get(name, 0):>12,}{frame.writes.get(name, 0):>12,}"
              for name in dict.fromkeys((*frame.reads, *frame.writes))]
    return "\n".join(lines)


def _rendered(args: argparse.Namespace, work: Work, options: RunOptions) -> Frame | StereoFrame:
    """The frame that `python -m tb.frame` simulates with the same options."""
    if args.stereo:
        return render_request(args, work.request, work.config, words=work.words, foveation=work.foveation)
    frame = work.render()
    return work.add_eye(frame) if work.second_eye_forced and options.display and not options.packed else frame


@dataclass(frozen=True)
class Asked:
    """What a command line asks for, but for the scene.

    Attributes:
        config: the machine before the plan of effects.
        options: how the frame runs.
        memory: the memory.
    """

    config: AcceleratorConfig
    options: RunOptions
    memory: MemoryModel


def asked_of(args: argparse.Namespace) -> Asked:
    """Checks everything that can be checked without the scene.

    Raises:
        InputError: a value is not accepted.
    """
    config = config_from(args, "default")
    options = run_options(args)
    if args.stereo and not options.display:
        raise InputError("pixels 'wide' is not accepted with --stereo: 'display' is")
    if args.stereo:
        with_two_eyes(config)  # raises where the machine has one eye
    if options.packed:
        with_packed_frames(config)  # raises where the machine packs no frames
    if options.incremental is not None:
        config = config.with_(incremental=options.incremental)
    low, high = (1e3 / clock for clock in reversed(CLOCKS_NS))
    if not low <= args.clock_mhz <= high:
        raise InputError(f"clock of {args.clock_mhz!r} MHz is not accepted: {low:g}..{high:,.0f} MHz are")
    take_stereo_arguments(args)
    memory = MemoryModel(options.memory, options.latency, options.bytes_per_cycle, clock_ns=1e3 / args.clock_mhz)
    return Asked(config, options, memory)


def traced(
    args: argparse.Namespace, asked: Asked, request: Request, plan: EffectPlan, cache: Path | None,
) -> tuple[Trace, AcceleratorConfig]:
    """The trace of the frame, and the machine with the units that the plan gives it."""
    machine = planned_machine(plan, asked.config, full=asked.options.full)
    return trace_request(
        args, machine, cache=cache, request=request,
        render=lambda: _rendered(
            args, planned_work(request, plan, asked.config, full=asked.options.full), asked.options)), machine


def simulated(trace: Trace, machine: AcceleratorConfig, asked: Asked) -> FrameCycles:
    """The cycles of the frame."""
    options = asked.options
    return simulate(trace, machine, memory=asked.memory, merge=options.merge, beta=options.beta, display=options.display,
                    packed=options.packed)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line: traces and simulates a frame, writes the results and prints them."""
    args = command_line().parse_args(argv)
    asked = asked_of(args)
    request = resolve(args)
    with output_folder(args.out, BUILD / "perf" / "frame") as out:
        _model(args, request, asked, out)
    return 0


def _model(args: argparse.Namespace, request: Request, asked: Asked, out: Path) -> None:
    """Traces and simulates the frame, writes the results into the folder `out` and prints them."""
    config, options, memory = asked.config, asked.options, asked.memory
    plan = plan_for(args, request, config, contention=memory.bytes_per_cycle is not None)
    trace, machine = traced(args, asked, request, plan, None if args.no_cache else CACHE)
    frame = simulated(trace, machine, asked)
    ideal = memory.kind == IDEAL
    settings = {"config": config.name, "machine": args.machine, "merge": options.merge, "pipeline": config.incremental,
                "memory": memory.kind, "bytes_per_cycle": memory.bytes_per_cycle if ideal else None,
                "latency": memory.latency if ideal else None, "clock_mhz": args.clock_mhz,
                "configuration": config_record(config), "effects": plan.record}
    write_json(out / "perf.json", {**trace.record, **settings, **frame.as_json(), "golden_seconds": trace.golden_seconds,
                                   "compile_seconds": compile_seconds()})
    with atomic_output(out / "perfetto.json") as file:
        file.write(json.dumps(trace_events(frame)).encode())
    print(table(frame))
    print(f"{short_path(out)}: {frame.total:,} cycles, {frame.entries:,} entries; simulated in {frame.seconds:.2f} s, "
          f"traced in {trace.golden_seconds:.2f} s{compile_note()}")


if __name__ == "__main__":
    run_command_line(main)
