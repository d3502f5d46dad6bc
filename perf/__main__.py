"""`python -m perf`: cycles of a frame by the model."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence

from golden.kernels import compile_note, compile_seconds
from golden.scenes.probe import probe
from golden.scenes.request import (
    add_request_arguments,
    add_stereo_arguments,
    make_folder,
    resolve,
    take_stereo_arguments,
    write_json,
)
from perf.model import FrameCycles, MemoryModel, simulate
from perf.perfetto import trace_events
from perf.trace import trace_request
from spec.errors import InputError, run_command_line
from spec.memory import DRAM_BYTES_PER_CYCLE
from spec.overrides import add_config_arguments, config_from, config_record
from spec.paths import BUILD, cache_folder, short_path
from spec.records import COUNT_BITS

CACHE = cache_folder("traces")

MACHINES = ("scene", "full")
"""What the frame calls for and no more, as `python -m tb.frame` builds it by default, or all of the configuration."""

EPILOG = """\
Writes OUT/perf.json, and OUT/perfetto.json for ui.perfetto.dev: when each group was in which stage.

examples:
  python -m perf                                            the embedded scene
  python -m perf truck.splat --size 1280x720 --gaze 640,360 --levels 4 --config paper
  python -m perf --merge 0 --pipeline 0                     the baseline: no merging, double buffers between stages
  python -m perf --memory lpddr3                            four channels of LPDDR3-1600 instead of the bench's memory
  python -m perf --stereo --ecc-thresh 27                   two eyes, the second warped beyond 27 degrees
"""


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m perf", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_request_arguments(parser, size="256x144")
    add_stereo_arguments(parser)
    add_config_arguments(parser, "default")
    parser.add_argument("--machine", default="scene", choices=MACHINES,
                        help="units for active effects only, or all of the configuration's (default: scene)")
    parser.add_argument("--merge", default="1", choices=("0", "1"), help="merge tiles (default: 1)")
    parser.add_argument("--pipeline", choices=("0", "1"), help="stages hand over incrementally (default: the machine's, 1)")
    parser.add_argument("--beta", default="auto", metavar="N|auto", help="merge threshold in entries (default: auto)")
    parser.add_argument("--pixels", default=None, choices=("wide", "display"),
                        help="of the frame in memory (default: wide; of two eyes display)")
    parser.add_argument("--memory", default="ideal", choices=("ideal", "lpddr3"),
                        help="ideal: the RTL bench's, of a bandwidth and a latency (default); lpddr3: four channels")
    parser.add_argument("--bandwidth", default=str(DRAM_BYTES_PER_CYCLE), metavar="BYTES|unlimited",
                        help=f"of the ideal memory, bytes a cycle (default: {DRAM_BYTES_PER_CYCLE})")
    parser.add_argument("--latency", type=int, default=100, metavar="N", help="of the ideal memory, cycles (default: 100)")
    parser.add_argument("--out", metavar="DIR", help="output folder (default: build/perf/frame)")
    parser.add_argument("--no-cache", action="store_true", help="render the golden frame even if its trace is in the cache")
    return parser.parse_args(argv)


def table(frame: FrameCycles) -> str:
    """The numbers as text."""
    lines = [f"{'phase':<14}{'cycles':>12}"]
    lines += [f"{name:<14}{cycles:>12,}" for name, cycles in (*frame.phases.items(), ("total", frame.total))]
    lines += ["", f"{'stage':<14}{'busy':>12}{'blocked':>12}{'starved':>12}"]
    lines += [f"{name:<14}{s.busy:>12,}{s.blocked:>12,}{s.starved:>12,}" for name, s in frame.stages.items()]
    lines += ["", f"{'bytes':<14}{'read':>12}{'written':>12}"]
    lines += [f"{name:<14}{frame.reads.get(name, 0):>12,}{frame.writes.get(name, 0):>12,}"
              for name in dict.fromkeys((*frame.reads, *frame.writes))]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work."""
    args = _arguments(argv)
    config = config_from(args, "default")
    if args.pipeline is not None:
        config = config.with_(incremental=args.pipeline == "1")
    if args.beta != "auto" and not (args.beta.isdigit() and int(args.beta) < 1 << COUNT_BITS):
        raise InputError(f"beta {args.beta!r} is not accepted: 0..{(1 << COUNT_BITS) - 1} or 'auto' are")
    take_stereo_arguments(args)
    try:
        memory = MemoryModel(args.memory, args.latency, None if args.bandwidth == "unlimited" else float(args.bandwidth))
    except ValueError as error:
        raise InputError(f"bandwidth {args.bandwidth!r}, latency {args.latency}: {error}") from error
    out = make_folder(args.out or BUILD / "perf" / "frame")
    request = resolve(args)
    plan = probe(request.model, request.foveation, stereo=args.stereo, contention=memory.bytes_per_cycle is not None)
    machine = plan.machine(config) if args.machine == "scene" else config.with_(stereo=args.stereo or config.stereo)
    trace = trace_request(args, machine, cache=None if args.no_cache else CACHE, request=request)
    frame = simulate(
        trace, machine, memory=memory, merge=args.merge == "1", beta=None if args.beta == "auto" else int(args.beta),
        display=None if args.pixels is None else args.pixels == "display")
    settings = {"config": config.name, "machine": args.machine, "merge": args.merge == "1", "pipeline": config.incremental,
                "memory": args.memory, "bytes_per_cycle": memory.bytes_per_cycle, "latency": memory.latency,
                "configuration": config_record(config), "effects": plan.record}
    write_json(out / "perf.json", {**trace.record, **settings, **frame.as_json(), "golden_seconds": trace.golden_seconds,
                                   "compile_seconds": compile_seconds()})
    (out / "perfetto.json").write_text(json.dumps(trace_events(frame)))
    print(table(frame))
    print(f"{short_path(out)}: {frame.total:,} cycles, {frame.entries:,} entries; simulated in {frame.seconds:.2f} s, "
          f"traced in {trace.golden_seconds:.2f} s{compile_note()}")
    return 0


if __name__ == "__main__":
    run_command_line(main)
