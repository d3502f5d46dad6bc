"""A machine, or one unit of it, as Verilog files for your own design.

Beside the modules it writes file lists, waivers for Verilator's -Wall, a description in JSON and, with the whole machine, the
register map as a page, for C, in SystemRDL and in CMSIS-SVD. docs/verilog.md explains the files.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from msv2.verilog.export import export
from rtl.units import TOP, UNITS
from spec.command_line import add_out_argument, command_parser
from spec.effects import with_two_eyes
from spec.overrides import add_config_arguments, config_from
from spec.private import output_folder

DEFAULT_CONFIG = "tiny"
DEFAULT_OUT = "build/verilog"

EXAMPLES = """\
examples:
  %(prog)s                                            the small machine
  %(prog)s --config paper --stereo --out mine         the paper's machine, for frames of two eyes
  %(prog)s --unit tile_merge_unit --prefix my_        one unit, as module my_tile_merge_unit
  %(prog)s --set splat_cache_lines=256 --prefix big_  a machine with one parameter changed
"""


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work; InputError for what is not accepted."""
    parser = command_parser("python -m msv2.verilog", __doc__, EXAMPLES)
    add_config_arguments(parser, DEFAULT_CONFIG)
    parser.add_argument("--stereo", action="store_true", help="with the warp unit, for frames of two eyes")
    parser.add_argument("--unit", default=TOP, metavar="UNIT",
                        help=f"one of {', '.join(UNITS)} (default: {TOP}, the whole machine)")
    add_out_argument(parser, DEFAULT_OUT)
    parser.add_argument("--prefix", help="what the names of all modules begin with (default: the configuration's name and _)")
    args = parser.parse_args(argv)
    config = config_from(args, DEFAULT_CONFIG)
    with output_folder(args.out, Path(DEFAULT_OUT)) as out:
        written = export(with_two_eyes(config) if args.stereo else config, out, args.unit, args.prefix)
        print(f"wrote module {written.top}: {written.files}, {written.waivers}, {written.description}")
        for path in written.documents:
            print(f"wrote {path}")
    return 0
