"""How a frame runs on the machine: the options that `msv2 frame` and `msv2 perf` share and understand alike."""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from spec.command_line import choice
from spec.errors import InputError
from spec.memory import BUS_BYTES_PER_CYCLE, DRAM_BYTES_PER_CYCLE
from spec.records import COUNT_BITS

MACHINES = ("scene", "full")
"""`scene` is a machine with only the units that the frame needs; `full` has all units of the configuration, and some of them
idle."""

PIXELS = ("wide", "display", "packed")
"""Formats of the frame in memory: FramePixel and DisplayPixel of `spec.memory`, and DisplayPixels packed (`spec.packed`)."""

IDEAL, LPDDR3 = MEMORIES = ("ideal", "lpddr3")
"""Kinds of memory: `ideal` answers in order, with a bandwidth and a latency; `lpddr3` is four channels of DRAM, whose timing is
in `spec.lpddr3`."""

OF_IDEAL = ("bandwidth", "latency")
"""Options that describe the ideal memory."""

LONGEST_LATENCY = 1 << 20
"""Largest accepted latency of the memory in cycles."""

LATENCY = 100
"""Latency of the ideal memory in cycles where none is given."""

BANDWIDTHS = (0.01, float(BUS_BYTES_PER_CYCLE))
"""Smallest and largest accepted number of bytes that memory moves in a cycle; the bus moves no more than the largest."""


@dataclass(frozen=True)
class RunOptions:
    """How a frame runs.

    Attributes:
        full: whether the machine has all units of its configuration; otherwise it has those that the frame needs.
        merge: whether tiles are merged.
        incremental: whether stages hand over incrementally, or else whole groups through double buffers; None: as the
            configuration says.
        beta: merge threshold in intersections, 0 without merging; None: the machine finds it.
        display: whether a pixel takes 4 bytes in memory instead of 16, or less where the frame is packed.
        latency: latency of the ideal memory in cycles.
        bytes_per_cycle: bandwidth of the ideal memory, for reads and writes together; None: one beat read and one beat written
            in every cycle.
        memory: one of MEMORIES. With `lpddr3`, latency and bandwidth have their defaults, and no effect.
        packed: whether the frame is packed.
    """

    full: bool
    merge: bool
    incremental: bool | None
    beta: int | None
    display: bool
    latency: int
    bytes_per_cycle: float | None
    memory: str = IDEAL
    packed: bool = False


def add_run_arguments(parser: argparse.ArgumentParser, *, memory: str | None = IDEAL) -> None:
    """Adds the arguments that `run_options` reads.

    `memory` is the memory where none is named; None for LPDDR3, or for the ideal one where its bandwidth or latency is named.
    """
    group = parser.add_argument_group("the machine and its memory")
    add = group.add_argument
    add("--machine", default="scene", metavar="|".join(MACHINES),
        help="units for active effects only, or all units of the configuration (default: scene)")
    add("--pixels", metavar="|".join(PIXELS), help="format of the frame in memory (default: wide; display for two eyes)")
    add("--merge", default="1", metavar="0|1", help="merge tiles (default: 1); 0 is the same as --beta 0")
    add("--pipeline", metavar="0|1",
        help="stages hand over incrementally (default: the configuration's, 1); 0 is another machine, with double buffers")
    add("--beta", default="auto", metavar="N|auto", help="merge threshold in intersections (default: auto)")
    first = "ideal" if memory == IDEAL else "lpddr3; ideal with --bandwidth or --latency"
    add("--memory", default=memory, metavar="|".join(MEMORIES),
        help="ideal: a memory that answers in order, with a bandwidth and a latency; lpddr3: four channels of LPDDR3-1600 "
             f"(default: {first})")
    add("--bandwidth", metavar="BYTES|unlimited",
        help=f"bandwidth of the ideal memory in bytes a cycle (default: {DRAM_BYTES_PER_CYCLE}); "
             f"the bus moves {BUS_BYTES_PER_CYCLE} at most")
    add("--latency", type=int, metavar="N", help=f"latency of the ideal memory in cycles (default: {LATENCY})")


def run_options(args: argparse.Namespace) -> RunOptions:
    """The options that parsed arguments describe; the arguments must include `stereo`.

    Raises:
        InputError: a value is not accepted.
    """
    choice("machine", args.machine, MACHINES)
    pixels = choice("pixels", args.pixels or ("display" if args.stereo else "wide"), PIXELS)
    merge = parse_switch("merge", args.merge)
    incremental = None if args.pipeline is None else parse_switch("pipeline", args.pipeline)
    named = [name for name in OF_IDEAL if getattr(args, name) is not None]
    memory = choice("memory", args.memory or (IDEAL if named else LPDDR3), MEMORIES)
    if memory == LPDDR3 and named:
        raise InputError(f"{named[0]} is not accepted with memory {LPDDR3!r}, whose channels have their own")
    latency = LATENCY if args.latency is None else args.latency
    if not 1 <= latency <= LONGEST_LATENCY:
        raise InputError(f"latency {latency} is not accepted: 1..{LONGEST_LATENCY} are")
    bandwidth = DRAM_BYTES_PER_CYCLE if args.bandwidth is None else parse_bandwidth(args.bandwidth)
    return RunOptions(args.machine == "full", merge, incremental, parse_beta(args.beta, merge), pixels != "wide",
                      latency, bandwidth, memory, pixels == "packed")


def parse_beta(text: str, merge: bool) -> int | None:
    """The merge threshold; None for automatic, 0 if nothing is merged.

    Raises:
        InputError: the text is neither 'auto' nor an accepted number.
    """
    most = (1 << COUNT_BITS) - 1
    if text != "auto" and not (text.isdigit() and int(text) <= most):
        raise InputError(f"beta {text!r} is not accepted: 0..{most} or 'auto' are")
    if not merge:
        return 0
    return None if text == "auto" else int(text)


def parse_bandwidth(text: str) -> float | None:
    """Bytes in a cycle; None for "unlimited".

    Raises:
        InputError: the text is neither "unlimited" nor an accepted number.
    """
    if text == "unlimited":
        return None
    low, high = BANDWIDTHS
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not low <= value <= high:
        raise InputError(f"bandwidth {text!r} is not accepted: {low:g}..{high:g} bytes a cycle are, which is what the bus "
                         "moves at most (a beat read and a beat written), or 'unlimited'")
    return value


def parse_switch(name: str, text: str) -> bool:
    """The value of "0" or "1".

    Raises:
        InputError: the text is neither; the message calls the value `name`.
    """
    if text not in ("0", "1"):
        raise InputError(f"{name} {text!r} is not accepted: 0 or 1 is")
    return text == "1"
