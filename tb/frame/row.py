"""Frames in a row: a camera that turns from frame to frame, on a machine that is not reset between them.

A machine with depth buckets sorts every frame but the first with the bounds of the one before; others render each frame as if
it were the only one.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from golden.msv2_ref.batches import following
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.plan import Work
from spec.errors import InputError

MOST_FRAMES = 100
MOST_TURN = 180.0
TURN = 2.0
"""Degrees from one frame to the next where none are named: a head that turns by 180 degrees a second, at 90 frames a second."""


def add_row_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of frames in a row."""
    group = parser.add_argument_group("frames in a row", "the machine is not reset between them")
    group.add_argument("--frames", type=int, default=1, metavar="N", help=f"number of frames, 1..{MOST_FRAMES} (default: 1)")
    group.add_argument("--turn", type=float, metavar="DEG",
                       help=f"the camera turns to the right by this angle from frame to frame (default: {TURN:g})")


def check_row(args: argparse.Namespace) -> None:
    """Fills in the default of `--turn`.

    Raises:
        InputError: a value is not accepted, or there are several frames of two eyes or of a part of the machine.
    """
    if not 1 <= args.frames <= MOST_FRAMES:
        raise InputError(f"frames {args.frames} is not accepted: 1..{MOST_FRAMES} is")
    if args.frames == 1 and args.turn is not None:
        raise InputError(f"turn {args.turn:g} is not accepted with one frame: --frames must be 2 or more")
    args.turn = TURN if args.turn is None else args.turn
    if not (math.isfinite(args.turn) and abs(args.turn) <= MOST_TURN):
        raise InputError(f"turn {args.turn:g} is not accepted: {-MOST_TURN:g}..{MOST_TURN:g} degrees are")
    if args.frames > 1 and (args.stereo or args.part != "machine"):
        raise InputError(f"frames {args.frames} is not accepted with two eyes or with part 'array': 1 is")


def golden_row(work: Work, count: int, turn: float, *, beta: int | None) -> list[Frame]:
    """The golden frames of a camera that turns by `turn` degrees from frame to frame. `beta` is as in `pipeline.render`."""
    camera, frames = work.request.camera, []
    for number in range(count):
        request = replace(work.request, camera=camera.turned(number * turn)) if number else work.request
        frame = replace(work, request=request).render(beta=beta)
        frames.append(following(frame, frames[-1], beta) if frames and frame.pairs is not None else frame)
    return frames


def row_numbers(each: Sequence[Mapping[str, object]], turn: float) -> dict[str, object]:
    """The numbers of a frame.json of several frames: those of the last one, with what differs in any of them, and `frames`,
    the numbers of each."""
    if len(each) == 1:
        return dict(each[0])
    named = [{**numbers, "turned": number * turn} for number, numbers in enumerate(each)]
    told = {name: [f"frame {n}: {text}" for n, numbers in enumerate(each) for text in numbers[name]]
            for name in ("stream_errors", "counter_errors")}
    wrong = [{**mismatch, "frame": n} for n, numbers in enumerate(each) for mismatch in numbers["first_mismatches"]]
    return {**each[-1], "turn": turn, "bit_exact": all(numbers["bit_exact"] for numbers in each),
            "pixels_checked": sum(numbers["pixels_checked"] for numbers in each),
            "mismatches": sum(numbers["mismatches"] for numbers in each), "first_mismatches": wrong, **told, "frames": named}
