"""The arguments of a session: the memory and the clock of the machine whose numbers are shown."""

from __future__ import annotations

import argparse

from golden.host.run_options import run_options
from golden.scenes.request import take_stereo_arguments
from msv2.viewer.session import Session
from perf.model import MEMORIES, MemoryModel
from spec.command_line import choice
from spec.errors import InputError
from spec.overrides import config_from

CLOCKS_MHZ = (1.0, 1e5)


def add_session_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds `--memory` and `--clock-mhz`."""
    parser.add_argument("--memory", default="ideal", metavar="|".join(MEMORIES),
                        help="memory of the cycle model (default: ideal)")
    parser.add_argument("--clock-mhz", type=float, default=1000.0, metavar="MHZ",
                        help="clock for frame rate and energy (default: 1000)")


def session_of(args: argparse.Namespace) -> Session:
    """The session that parsed arguments of a request, two eyes, effects, a configuration, a run and a session describe.

    Raises:
        InputError: an argument is not accepted.
    """
    config, options = config_from(args), run_options(args)
    choice("memory", args.memory, MEMORIES)
    low, high = CLOCKS_MHZ
    if not low <= args.clock_mhz <= high:
        raise InputError(f"clock of {args.clock_mhz!r} MHz is not accepted: {low:g} to {high:,.0f} is")
    take_stereo_arguments(args)
    memory = MemoryModel(args.memory, options.latency, options.bytes_per_cycle)
    return Session(args, config, options, memory, 1e6 * args.clock_mhz)
