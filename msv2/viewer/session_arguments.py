"""The arguments of a session: what is drawn, and the machine, its memory and its clock, whose numbers are shown."""

from __future__ import annotations

import argparse

from golden.host.run_options import add_run_arguments, run_options
from golden.scenes.load import TRAINED
from golden.scenes.request import (
    add_effect_arguments,
    add_request_arguments,
    add_stereo_arguments,
    take_stereo_arguments,
)
from msv2.viewer.session import Session
from perf.model import MemoryModel
from spec.effects import with_packed_frames
from spec.errors import InputError
from spec.overrides import add_config_arguments, config_from

CLOCKS_MHZ = (1.0, 1e5)


def add_session_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of a request, of two eyes, of effects, of a configuration and of a run, and
    `--clock-mhz`."""
    add_request_arguments(parser, scene=TRAINED)
    add_stereo_arguments(parser)
    add_effect_arguments(parser)
    add_config_arguments(parser, "paper", ", whose energy was measured")
    add_run_arguments(parser, memory=None)
    parser.add_argument("--clock-mhz", type=float, default=1000.0, metavar="MHZ",
                        help="clock of the machine, for frame rate, energy and the cycles of LPDDR3 (default: 1000)")


def session_of(args: argparse.Namespace) -> Session:
    """The session that parsed arguments describe.

    Raises:
        InputError: an argument is not accepted.
    """
    config, options = config_from(args), run_options(args)
    if options.packed:
        with_packed_frames(config)  # raises where the machine packs no frames
    low, high = CLOCKS_MHZ
    if not low <= args.clock_mhz <= high:
        raise InputError(f"clock of {args.clock_mhz!r} MHz is not accepted: {low:g} to {high:,.0f} is")
    take_stereo_arguments(args)
    memory = MemoryModel(options.memory, options.latency, options.bytes_per_cycle, clock_ns=1e3 / args.clock_mhz)
    return Session(args, config, options, memory, 1e6 * args.clock_mhz)
