"""`msv2 cases soak`: random legal frames on the machine's RTL, back to back, each compared with the integer renderer in every
pixel and counter: any model, size, gaze, pair of eyes and memory, and between them aborts, resets, bus errors and bad settings.

A run goes on where the one before it in the same folder ended. The first frame that differs ends it: it is made as small as
possible, and its models are kept.

examples:
  msv2 cases soak --cycles 1e6                    some minutes
  msv2 cases soak --cycles 1e9 --out build/soak   days; the same command goes on after Ctrl-C
  msv2 cases soak --machine tiny_v3 --seed 7 --out build/soak7
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from msv2.cases.soak.runs import MACHINES, Soak
from spec.command_line import add_out_argument, choice, command_parser
from spec.errors import InputError
from spec.private import output_folder

FOLDER = Path("build/soak")


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 cases soak", __doc__)
    parser.add_argument("--cycles", type=float, default=1e6, metavar="N", help="cycles in all (default: 1e6)")
    parser.add_argument("--seed", type=int, default=1, help="selects the frames (default: 1)")
    parser.add_argument("--machine", action="append", default=[], metavar="NAME",
                        help=f"only this machine; can be repeated (of {', '.join(MACHINES)})")
    add_out_argument(parser, str(FOLDER))
    args = parser.parse_args(argv)
    for name in args.machine:
        choice("machine", name, list(MACHINES))
    if not 1 <= args.cycles < 1e15 or args.seed < 0:
        raise InputError(f"--cycles {args.cycles:g} --seed {args.seed} is not accepted: cycles from 1 to 1e15, and a seed from "
                         "0 on are")
    return args


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns 1 where a frame differs."""
    args = _arguments(argv)
    with output_folder(args.out or FOLDER, FOLDER) as folder:
        soak = Soak(folder, args.seed, args.machine or list(MACHINES))
        with tqdm(total=int(args.cycles), initial=min(soak.count["cycles"], int(args.cycles)), desc="soak", unit="cycle",
                  unit_scale=True) as bar:
            well = soak.run(int(args.cycles), bar.update)
        count = soak.count
        for name, row in count["by_machine"].items():
            print(f"{name}: {row['frames']:,} frames, {row['cycles']:,} cycles")
        print(f"{count['frames']:,} frames, {count['cycles']:,} cycles: " +
              ", ".join(f"{number:,} {end}" for end, number in sorted(count["by_end"].items())))
        if not well:
            _explain(soak)
    return int(not well)


def _explain(soak: Soak) -> None:
    found = soak.count["differences"][0]
    print(f"DIFFERENT: frame {found['frame']} of batch {found['batch']} on {found['machine']}: {'; '.join(found['words'])}")
    frames, folder = soak.smallest()
    print(f"it takes {len(frames)} frames, the last one with {len(frames[-1].model)} Gaussians; models in {folder}:")
    for number, frame in enumerate(frames):
        print(f"  {number}: {frame.kind} {frame.size[0]}x{frame.size[1]} {frame.view} {frame.pixels} {frame.fate} "
              f"at {frame.where:.4f}, {frame.speed}")
