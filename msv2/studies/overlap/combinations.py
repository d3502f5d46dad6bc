"""`msv2 study run combinations`: the embedded scene through the RTL of small machines in every combination of streams, packed
frames, overlapped phases and eyes: combinations.json, and its table in docs/results.md.

Machines of one and of four streams, with phases in turn and overlapped, are built; all of them pack frames and render joint
ones, and the settings of a frame choose. On each, rows of frames of a camera that stands still, and then turns, are played: of
one eye and of two, packed and not. Every pixel and every event is compared with the integer renderer, and the cycles of a frame
among equal ones with the cycle model. What was played with the same sources before is not played again.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from itertools import accumulate, product
from pathlib import Path
from typing import Any

from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.pipeline import Frame
from golden.scenes.load import EMBEDDED
from golden.scenes.request import make_folder
from msv2.studies.kept import fingerprint, kept
from msv2.studies.overlap.rows import IN_SHORT, golden_frames, played, rows_of, trace_of
from msv2.studies.progress import Progress
from msv2.studies.record import source_hash, write_report
from msv2.studies.rtl_frame import COMMAND
from perf.model import MemoryModel
from perf.supertiles import simulate_supertiles
from spec.config import TINY_STREAMS, TINY_V3, AcceleratorConfig
from spec.joint import EYES
from spec.paths import REPORTS, ROOT
from tb.top.device import machine
from tb.top.plan_joint import after
from tb.top.planned import planned, problems
from tb.top.player import FrameResult, play_frames
from tb.top.stimuli import Case

SIZE, EVERY = "64x48", 10
"""The frames' size, and how many points of the scene there are for each one that is rendered. The small machines project a
point in eight cycles."""

EACH = (1, EYES)

FRAMES = tuple(product(EACH, (False, True)))
"""Eyes of a frame, and whether it is packed."""

PHASES = ("table", "geometry", "render")


def machines() -> list[AcceleratorConfig]:
    """The machines that are built."""
    return [base.with_(name=f"{base.name}_eyes_packed{'_overlap' * overlap}", packed=True, joint=True, overlap=overlap)
            for overlap in (False, True) for base in (TINY_V3, TINY_STREAMS)]


def rows_of_machine(config: AcceleratorConfig) -> list[dict[str, Any]]:
    """The rows of a machine, JSON-ready: one for each of FRAMES."""
    def made() -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            found = (overlapped if config.overlap else in_turn)(config, Path(folder))
        return {"rows": [{"streams": config.streams, "overlap": config.overlap, "eyes": eyes, "packed": packed,
                          "machine": config.name, **row} for (eyes, packed), row in zip(FRAMES, found, strict=True)]}

    key = f"combinations-{fingerprint((), source_hash([__name__, COMMAND]), config)}"
    return kept(ROOT / "build" / "results" / "overlap", key, made)["rows"]


def overlapped(config: AcceleratorConfig, folder: Path) -> list[dict[str, Any]]:
    """The numbers of each of FRAMES on a machine whose phases overlap."""
    scenes = {eyes: rows_of(_frames(config, eyes), short=True) for eyes in EACH}
    found = played(config, [scenes[eyes] for eyes, _ in FRAMES], [packed for _, packed in FRAMES], folder)
    return [{"frames": row["frames"], "problems": row["problems"], "cycles": row["period"], "model": row["model"],
             "model_over_rtl": row["model_over_rtl"]} for row in found]


def in_turn(config: AcceleratorConfig, folder: Path) -> list[dict[str, Any]]:
    """The numbers of each of FRAMES on a machine whose phases take turns. The second frame of a row, whose bounds an equal one
    has left, is compared with the model."""
    rows = {eyes: _row_in_turn(_frames(config, eyes)) for eyes in EACH}
    plans = [[planned(case, packed=packed, display=not packed, reset=n == 0, poison=n == 0)
              for n, case in enumerate(rows[eyes])] for eyes, packed in FRAMES]
    results = iter(play_frames(machine(config), [item.run for plan in plans for item in plan], folder))
    found = []
    for (eyes, packed), plan in zip(FRAMES, plans, strict=True):
        own = [next(results) for _ in plan]
        cycles, model = _cycles(own[1]), _modelled(rows[eyes][1], config, packed)
        found.append({
            "frames": len(plan), "cycles": cycles, "model": model, "model_over_rtl": model / cycles,
            "problems": [f"{item.name}: {text}" for item, result in zip(plan, own, strict=True)
                         for text in problems(item, result)]})
    return found


def _frames(config: AcceleratorConfig, eyes: int) -> Callable[[float], Frame | JointFrame]:
    return golden_frames(config, EMBEDDED, SIZE, joint=eyes > 1, every=EVERY)


def _row_in_turn(frame: Callable[[float], Frame | JointFrame]) -> list[Case]:
    """Golden frames, each with the bounds of the one before."""
    cases = [Case(f"turned {degrees:g}", frame(degrees), None, False) for degrees in IN_SHORT]
    return list(accumulate(cases, lambda before, case: after(case, before)))


def _cycles(result: FrameResult) -> int:
    return sum(result.registers[f"cycles_{phase}"] for phase in PHASES)


def _modelled(case: Case, config: AcceleratorConfig, packed: bool) -> int:
    """The model's cycles of a frame after an equal one, on the ideal memory."""
    found = simulate_supertiles(trace_of(case), config, memory=MemoryModel("ideal"), display=not packed, packed=packed)
    return sum(found.phases[phase] for phase in PHASES)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    parser = argparse.ArgumentParser(
        prog="msv2 study run combinations", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=REPORTS, help="folder for the report (default %(default)s)")
    args = parser.parse_args(argv)
    out, todo = make_folder(args.out), {config.name: config for config in machines()}
    progress, rows = Progress("combinations", list(todo)), []
    for name, config in todo.items():
        with progress.step(name):
            rows += rows_of_machine(config)
    wrong = sum(len(row["problems"]) for row in rows)
    summary = {"combinations": len(rows), "frames": sum(row["frames"] for row in rows), "differences": wrong,
               "model_error": max(abs(row["model_over_rtl"] - 1) for row in rows)}
    write_report(out / "combinations.json", {"scene": EMBEDDED, "size": SIZE, "every": EVERY, "summary": summary, "rows": rows},
                 [__name__, COMMAND], {"arguments": args, **todo})
    print(f"{len(rows)} combinations, {summary['frames']} frames, {wrong} differences, model within "
          f"{100 * summary['model_error']:.2f} %")
    return int(bool(wrong))
