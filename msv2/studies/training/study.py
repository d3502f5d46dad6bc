"""Makes the paper's tables of training: foveated representations and points per level, the ablation, pruning, and latency."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from golden.diff import import_torch
from msv2.studies.training.labels import TABLES
from spec.command_line import command_parser
from spec.errors import InputError

EXAMPLES = """examples:
  msv2 study run training                                     the embedded scene
  msv2 study run training embedded fern@504x378 --no-rtl      several scenes, own sizes, no simulation of the RTL
  msv2 study run training fern --tables pruning               one table alone; later ones find what it has trained
  msv2 study run training --out reports --name training      training.json, training.md and training.png in reports/

A finished run of golden/train.py in build/train that fits what is asked for is not trained again; what the tables need beside
it (scale decay alone, levels without opacity enhancement, MMFR, pruning by other gates and criteria) is, once. After Ctrl-C the
same command goes on.
"""


PLOTTED = {"representations", "latency"}
"""The tables that have a plot."""


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """The parsed command line."""
    parser = command_parser("msv2 study run training", __doc__, EXAMPLES)
    add = parser.add_argument
    add("scenes", nargs="*", metavar="SCENE[@WxH]",
        help="scenes that can be trained, each with a size of its own or that of --size (default: embedded)")
    add("--variant", metavar="H|M|L", help="training variant (default: that of a finished run, else H)")
    add("--size", metavar="WxH", help="size to train at (default: that of a finished run, else that of the training)")
    add("--iterations", type=int, metavar="N",
        help="iterations of the recipe; all tables together need 3.9 times as many in addition")
    add("--max-points", type=int, metavar="N", help="largest number of points of the dense model")
    add("--full", action="store_true",
        help="dense models of up to 1.5 points a pixel and more iterations, as of `msv2 train --full`")
    add("--seed", type=int, metavar="N", help="seed of all random numbers")
    add("--device", default="auto", metavar="auto|cpu|cuda", help="where to train (default: auto)")
    add("--tables", default=",".join(TABLES), metavar="NAME,NAME", help=f"some of {', '.join(TABLES)} (default: all)")
    add("--edge", type=int, metavar="PX", help="longest edge of the latency plot's frames (default: 256)")
    add("--no-rtl", dest="rtl", action="store_false", help="take cycles from the cycle model only, without an RTL simulation")
    add("--runs", default="build/train", metavar="DIR", help="folder of finished training runs (default: build/train)")
    add("--work", default="build/tables-training/kept", metavar="DIR", help="folder of checkpoints and simulated frames")
    add("--out", default="build/tables-training", metavar="DIR", help="folder of NAME.md, NAME.json and NAME.png")
    add("--name", default="tables", help="name of those files (default: tables)")
    return parser.parse_args(argv)


def chosen_tables(text: str) -> tuple[str, ...]:
    """The tables that a comma-separated list names, each once, in the order of TABLES.

    Raises:
        InputError: a name is not that of a table, or there is none.
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names or [""]:
        if name not in TABLES:
            raise InputError(f"tables {name!r} is not accepted: choose of {', '.join(TABLES)}, separated by commas")
    return tuple(name for name in TABLES if name in names)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns its exit status."""
    args = parse_arguments(argv)
    if args.edge is not None and args.edge < 16:
        raise InputError(f"edge {args.edge} is not accepted: 16 pixels or more are")
    tables = chosen_tables(args.tables)
    import_torch()
    from golden.diff.device import resolve_device
    from golden.training.chain import Interrupted
    from golden.training.failure import TrainingError
    from msv2.studies.training.tables import make_tables

    try:
        make_tables(args, tables, str(resolve_device(args.device)))
    except (Interrupted, KeyboardInterrupt) as interrupt:
        print(f"\n{str(interrupt) or 'interrupted'}; the same command goes on", file=sys.stderr)
        return 130
    except TrainingError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    plots = " and .png" if PLOTTED & set(tables) else ""
    print(f"written: {args.out}/{args.name}.md, .json{plots}")
    return 0
