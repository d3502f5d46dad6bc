"""`msv2 verilog`: a machine, or one unit of it, as Verilog files with file lists, lint waivers and register documents."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from msv2.verilog.export import export
from rtl.units import TOP, UNITS
from spec.command_line import add_out_argument, choice, command_parser
from spec.overrides import add_config_arguments, config_from

EXAMPLES = """\
examples:
  %(prog)s                                          the machine `tiny` into build/verilog
  %(prog)s --config paper --unit tile_merge_unit --out my_design/tmu
  %(prog)s --set sh_degree=1 --prefix my            modules whose names begin with my_
"""


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work; InputError for what is not accepted."""
    parser = command_parser("python -m msv2.verilog", __doc__, EXAMPLES)
    add_config_arguments(parser, "tiny")
    parser.add_argument("--stereo", action="store_true", help="with the warp unit, for frames of two eyes")
    parser.add_argument("--unit", default=TOP, metavar="UNIT",
                        help=f"one of {', '.join(UNITS)} (default: {TOP}, the whole machine)")
    parser.add_argument("--prefix", help="what the names of all modules begin with (default: the configuration's name)")
    add_out_argument(parser, "build/verilog")
    args = parser.parse_args(argv)
    config = config_from(args, "tiny")
    written = export(config.with_(stereo=args.stereo or config.stereo), Path(args.out or "build/verilog"),
                     choice("unit", args.unit, UNITS), args.prefix)
    print(f"wrote module {written.top}: {written.files}, {written.waivers}, {written.description}")
    for path in written.documents:
        print(f"wrote {path}")
    return 0
