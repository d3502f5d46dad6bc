"""The cycle model, area and energy over many settings of machine, frame and memory."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from msv2.studies.record import commit
from msv2.sweep.output import write_all
from msv2.sweep.points import Point, read_sweep
from msv2.sweep.run import command_of, kept_points, run_points
from spec.command_line import add_out_argument, command_parser
from spec.errors import InputError, run_command_line
from spec.paths import BUILD, short_path
from spec.private import output_folder

EPILOG = """\
SWEEP.toml has a table [base] of common settings, a table [vary] of lists of which all combinations are made, and any number
of tables [[point]] of single points. Names are options of `msv2 perf` and fields of the configuration (docs/sweep.md).

Writes OUT/points/KEY.json for each point as soon as it is measured, and at the end OUT/results.json, results.csv and, with
matplotlib (extra plots), pareto.png. A second run measures only what is missing or has changed.

examples:
  %(prog)s examples/sweep.toml                        on all cores of this machine
  %(prog)s examples/sweep.toml --list                 the points, as commands
  %(prog)s examples/sweep.toml --scheduler tcp://HOST:8786    on a Dask cluster (extra cluster)
"""

POINT_SECONDS = 0.2
"""Processor time of a point whose golden frame is known: what is said before any point has been measured."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; the exit status is 1 where a point failed."""
    parser = command_parser("msv2 sweep", __doc__, EPILOG)
    parser.add_argument("sweep", type=Path, nargs="?", metavar="SWEEP.toml", help="what to measure")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="processes (default: all cores)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="address of a Dask scheduler, instead of processes here")
    parser.add_argument("--list", action="store_true", help="print the points as commands, and measure nothing")
    add_out_argument(parser, "build/sweep/NAME, of SWEEP.toml's name")
    args = parser.parse_args(argv)
    if args.jobs < 1:
        raise InputError(f"jobs {args.jobs} is not accepted: 1 or more is")
    if args.sweep is None:
        raise InputError("no sweep is named: a file SWEEP.toml is needed, such as examples/sweep.toml")
    points = read_sweep(args.sweep)
    if args.list:
        print("\n".join(f"{point.label:<60} {command_of(point)}" for point in points))
        return 0
    default = BUILD / "sweep" / args.sweep.stem
    with output_folder(args.out or default, default) as out:  # to go on means one certain folder
        rows = _measured(points, out, args.jobs, args.scheduler)
        made = write_all(rows, out, {"commit": commit(), "sweep": args.sweep.name})
    failed = [row for row in rows if "error" in row]
    for row in failed:
        print(f"failed: {', '.join(f'{name}={value}' for name, value in row['settings'].items())}: {row['error']}")
    print(f"{short_path(out)}: {len(rows) - len(failed):,} points; wrote {', '.join(path.name for path in made)}"
          + ("" if any(path.suffix == ".png" for path in made) else "; no diagram without matplotlib (extra plots)"))
    return 1 if failed else 0


def _measured(points: list[Point], out: Path, jobs: int, scheduler: str | None) -> list[dict[str, object]]:
    """The results of all points, with a bar of progress for those that are not known."""
    known = kept_points(points, out)
    missing = len(points) - known
    jobs = max(1, min(jobs, missing))
    where = f"the cluster at {scheduler}" if scheduler else f"{jobs} process{'es' if jobs > 1 else ''}"
    estimate = f", about {max(1, round(POINT_SECONDS * missing / jobs))} s and the golden frames on {where}" if missing else ""
    print(f"{len(points):,} points, {known:,} of them known{estimate}", flush=True)
    with tqdm(total=missing, desc="sweep", unit="point", disable=None, smoothing=0.1) as progress:
        def done(point: Point, row: dict[str, object]) -> None:
            progress.update()
            progress.set_postfix_str(point.label[:60])

        return run_points(points, out, jobs=jobs, scheduler=scheduler, done=done)


if __name__ == "__main__":
    run_command_line(main)
