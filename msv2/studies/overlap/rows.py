"""Frames in a row through the RTL of a machine whose phases overlap, beside the cycle model: the rows of the reports."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from golden.msv2_ref import pipeline
from golden.msv2_ref.buckets import Bounds
from golden.msv2_ref.joint import JointFrame, render_joint
from golden.msv2_ref.pipeline import Frame
from golden.scenes.captured import scene_argument
from golden.scenes.load import TRAINED
from golden.scenes.request import parse_request, resolve
from golden.scenes.stereo import stereo_pair
from msv2.studies.threshold.scales import table_scale
from perf.joint_trace import joint_trace
from perf.model import MemoryModel
from perf.overlap import OverlapCycles, simulate_overlap
from perf.supertiles_trace import SuperTrace, super_trace
from spec.config import AcceleratorConfig
from tb.top.device import machine
from tb.top.overlap_player import Row, play_rows
from tb.top.plan_overlap import in_a_row, row_problems, turned
from tb.top.planned import planned
from tb.top.stimuli import Case

STILL, TURNS = 5, (0.0, 2.0, 4.0)
"""Frames of the camera that stands still, of which the last three have the bounds of steady frames, and the degrees by which
the other camera has turned in each of its frames."""

IN_SHORT = (0.0, 0.0, 2.0)
"""The degrees in the only row of a captured scene, whose frames take long, and of small machines, of which there are many. The
period is that of the first two frames, which have no bounds."""


def golden_frames(
    config: AcceleratorConfig, scene: str, size: str, *, joint: bool, every: int = 1,
) -> Callable[[float], Frame | JointFrame]:
    """A function from the degrees by which the camera has turned to its golden frame, of two eyes where it is a `joint` one.
    The scene's levels are those that it was trained with, or else random ones. Of its points, one in so many as `every` says is
    rendered."""
    width, height = (int(part) for part in size.split("x"))
    levels = ("--levels", str(config.levels), *(() if scene == TRAINED else ("--levels-from", "random")))
    asked = resolve(parse_request(scene_argument(scene), "--size", size, "--gaze", f"{width // 2},{height // 2}", *levels))
    model = asked.model.select(np.arange(0, len(asked.model), every))
    scale = table_scale(scene, None)["units_per_metre"] if joint else None

    @cache
    def rendered(degrees: float) -> Frame | JointFrame:
        camera = turned(asked.camera, degrees)
        how = {"config": config, "foveation": asked.foveation, "background": asked.background}
        if scale is None:
            return pipeline.render(model, camera, **how)
        return render_joint(model, stereo_pair(camera, units_per_metre=scale), **how)

    return rendered


def rows_of(frame: Callable[[float], Frame | JointFrame], *, short: bool) -> dict[str, list[Case]]:
    """The rows of a scene by name, each of golden frames with their bounds. The camera stands still in the first row, or at
    least in all frames but its last.

    Args:
        frame: the scene's frames (`golden_frames`).
        short: whether there is one row IN_SHORT.
    """
    angles = {"in short": IN_SHORT} if short else {"still": (0.0,) * STILL, "turning": TURNS}
    return {name: in_a_row([Case(f"turned {degrees:g}", frame(degrees), None, False) for degrees in row])
            for name, row in angles.items()}


def played(
    config: AcceleratorConfig, scenes: Sequence[dict[str, list[Case]]], packed: Sequence[bool], folder: Path,
) -> list[dict[str, Any]]:
    """The numbers of the rows of several scenes, which go through the RTL in one simulation.

    Args:
        config: the machine.
        scenes: what `rows_of` gives.
        packed: for each of them whether its frames are packed; others have display pixels.
        folder: for the simulation's files.
    """
    rows = [[Row(name, [planned(case, packed=packs, display=not packs) for case in cases]) for name, cases in scene.items()]
            for scene, packs in zip(scenes, packed, strict=True)]
    results = iter(play_rows(machine(config), [row for own in rows for row in own], folder))
    found = []
    for scene, own, packs in zip(scenes, rows, packed, strict=True):
        pairs = [(row, next(results)) for row in own]
        problems = [f"{row.name}: {text}" for row, result in pairs for text in row_problems(row, result)]
        first, cases = pairs[0][1].frames, next(iter(scene.values()))
        period, registers = first[-1].begun - first[-2].begun, first[-1].registers
        model = modelled(cases[-2], config, packed=packs)
        found.append({
            "frames": sum(len(row.frames) for row in own), "problems": problems, "period": period, "model": model.period,
            "model_over_rtl": model.period / period, "model_first": model.first, "model_second": model.second,
            "lists": bounds_of(cases[-2]).lists,
            "cycles": {name: registers[f"cycles_{name}_low"] for name in ("total", "table", "geometry", "render")}})
    return found


def modelled(case: Case, config: AcceleratorConfig, *, packed: bool) -> OverlapCycles:
    """The cycle model's numbers of a frame among equal ones on the ideal memory, all with its bounds."""
    return simulate_overlap(trace_of(case), replace(config, overlap=False), memory=MemoryModel("ideal"), display=not packed,
                            packed=packed, bounds=bounds_of(case))


def trace_of(case: Case) -> SuperTrace:
    """The trace of a frame of one eye or of two."""
    return joint_trace(case.frame) if isinstance(case.frame, JointFrame) else super_trace(case.frame)


def bounds_of(case: Case) -> Bounds:
    """The bounds of a frame of one eye or of two."""
    return case.frame.source.bounds if isinstance(case.frame, JointFrame) else case.frame.bounds
