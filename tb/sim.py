"""`python -m tb.sim`: simulates a unit's RTL and compares it with the golden renderer."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from types import ModuleType

from spec.command_line import choice, command_parser
from spec.errors import InputError, run_command_line
from spec.overrides import add_set_argument, changed, parse_sets
from spec.paths import BUILD
from spec.private import private_folder
from tb.axi import suite as axi
from tb.chunks import chunk_graph_suite, chunk_test_suite, decode_suite, reader_suite
from tb.common.runner import WAVES_FILE, SimulationError, Waves, parse_window
from tb.common.wave_view import view_path
from tb.culling import colour_suite as colour
from tb.culling import joint_suite
from tb.culling import projection_suite as projection
from tb.culling import tile_test_suite as tiles
from tb.float import suite as float_units
from tb.pixels import packer_suite, unpacker_suite
from tb.sort_tmu import chunk_suite as chunks
from tb.sort_tmu import handover_suite as handover
from tb.sort_tmu import hierarchical_suite
from tb.sort_tmu import tile_merge_suite as tmu
from tb.supertiles import array_suite as batch_array
from tb.supertiles import batch_suite, buckets_suite, clip_suite, order_suite, record_fetch_suite, stream_suite
from tb.supertiles import colour_suite as pair_colour
from tb.supertiles import lists_suite as pair_lists
from tb.supertiles import reader_suite as supertile_reader
from tb.supertiles import tile_test_suite as supertile_test
from tb.tile_lists import suite as lists
from tb.top import suite as top
from tb.vrc_array import array_suite as vrc
from tb.vrc_array import fetch_suite as fetch
from tb.vrc_array import pixel_writer_suite as writer
from tb.warp_unit import suite as warp

UNITS = {
    "float": {"float": float_units},
    "chunk_test": {"chunk_test": chunk_test_suite, "chunk_graph": chunk_graph_suite},
    "chunk_reader": {"chunk_reader": reader_suite, "geometry_decode": decode_suite},
    "culling": {"projection": projection, "projection_joint": joint_suite, "tiles": tiles, "colour": colour},
    "lists": {"lists": lists},
    "tmu": {"tmu": tmu},
    "sort": {"chunks": chunks, "hierarchical": hierarchical_suite, "handover": handover},
    "vrc": {"fetch": fetch, "vrc": vrc, "writer": writer},
    "warp": {"warp": warp},
    "axi": {"axi": axi},
    "top": {"top": top},
    "supertile_test": {"supertile_clip": clip_suite, "supertile_test": supertile_test},
    "pair_lists": {"depth_buckets": buckets_suite, "pair_lists": pair_lists, "pair_order": order_suite,
                   "supertile_reader": supertile_reader},
    "record_fetch": {"record_fetch": record_fetch_suite},
    "pair_colour": {"pair_colour": pair_colour},
    "batch": {"batch": batch_suite, "stream_buffer": stream_suite},
    "batch_array": {"batch_array": batch_array},
    "frame_packer": {"frame_packer": packer_suite},
    "frame_unpacker": {"block_unpacker": unpacker_suite},
}
"""The suites of each test. float: the float units; chunk_test: the chunk test; chunk_reader: the reader of chunks and the
decode unit; culling: near test and projection, tile test, colours; lists: tile lists in memory; tmu: the tile merge unit; sort:
the sorters and the handover to the array; vrc: splat fetch, array and pixel writer; warp: the warp unit; axi: the bus and the
registers; top: the whole machine. Of machines with super-tiles, supertile_test: clip and tile test; pair_lists: lists;
record_fetch: the records of pairs; pair_colour: colours; batch: the batch buffer; batch_array: the array. Of packed frames,
frame_packer: rows of pixels to memory; frame_unpacker: back to pixels."""


EXAMPLES = """\
examples:
  %(prog)s --test tmu                             the tile merge unit in every machine
  %(prog)s --test sort --config small --seed 3   the sorters of one variant, other stimuli
  %(prog)s --test vrc --waves --wave-cycles 1000:2000
"""


def _variants(test: str) -> list[str]:
    """Names of the configurations in which the test, or any test for "all", can run."""
    suites = [suite for name, units in UNITS.items() if test in ("all", name) for suite in units.values()]
    return list(dict.fromkeys(name for suite in suites for name in suite.VARIANTS))


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("python -m tb.sim", __doc__, EXAMPLES)
    parser.add_argument("--test", default="all", help=f"the test to run: all (default), {', '.join(UNITS)}")
    parser.add_argument("--config", default="all", help=f"the configuration: all (default), {', '.join(_variants('all'))}")
    add_set_argument(parser)
    parser.add_argument("--seed", type=int, default=0, help="seed of random stimuli and pauses (default: 0)")
    parser.add_argument("--runs", default="", help="run only the runs whose name contains this text")
    parser.add_argument("--waves", action="store_true", help="record waves (FST) of the first configuration, or of --config")
    parser.add_argument("--wave-cycles", default=":", metavar="FIRST:LAST", help="record only these cycles")
    parser.add_argument("--wave-scopes", default="", metavar="GLOB,...", help="record only these scopes, such as tb.dut.setup*")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the suites of the chosen test; returns 1 when anything differs."""
    args = _arguments(argv)
    choice("TEST", args.test, ("all", *UNITS))
    choice("CONFIG", args.config, ("all", *_variants(args.test)))
    values = parse_sets(args.sets)
    if args.seed < 0:
        raise InputError(f"SEED {args.seed} is not accepted: 0 or more is")
    begin, end = parse_window(args.wave_cycles)
    waves = Waves(begin, end, tuple(s for s in args.wave_scopes.split(",") if s)) if args.waves else None
    statuses = []
    for test, units in UNITS.items():
        for unit, suite in units.items() if args.test in ("all", test) else ():
            every = suite.DISTINCT[:1] if waves else suite.DISTINCT
            names = every if args.config == "all" else {args.config} & suite.VARIANTS.keys()
            statuses += [_run_variant(unit, suite, name, values, args.seed, args.runs, waves) for name in names]
    if all(status is None for status in statuses):
        raise InputError(f"runs {args.runs!r}: no run has that in its name")
    return max(status for status in statuses if status is not None)


def _run_variant(
    unit: str, suite: ModuleType, variant: str, values: Mapping[str, object], seed: int, only: str, waves: Waves | None,
) -> int | None:
    """Runs one unit in one configuration, changed by `values`. Returns 1 when anything differs, and None when no run is
    chosen."""
    base = suite.VARIANTS[variant]
    config = changed(base, values)
    label = variant if config is base else f"{variant}-{config.name}"
    name = f"{unit} {label}"
    plan = [planned for planned in suite.full_plan(config, seed) if only in planned.name]
    if not plan:
        return None
    print(f"{name}: {len(plan)} runs, seed {seed}", flush=True)
    try:
        with private_folder(BUILD / unit / label) as folder:
            outcome = suite.run_plan(config, plan, folder, waves=waves, progress=True)
    except SimulationError as error:
        print(f"{name}: FAILED\n{error}")
        return 1
    for run, wrong in outcome.failures.items():
        print(f"{name}: {run}: FAILED", *wrong, sep="\n    ")
    for line in suite.figures(config, plan, outcome):
        print(f"{name}: {line}")
    print(f"{name}: {outcome.runs - len(outcome.failures)} of {outcome.runs} runs equal, {outcome.amount}, "
          f"{outcome.cycles} cycles, {outcome.seconds:.1f} s", flush=True)
    if waves:
        print(f"{name}: waves in {folder / WAVES_FILE}, in groups with `gtkwave {view_path(folder / WAVES_FILE)}`")
    return 1 if outcome.failures else 0


if __name__ == "__main__":
    run_command_line(main)
