"""Plans of frames in a row whose phases overlap: of a camera that turns, of scenes that differ, and frames that end early
beside others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from golden.msv2_ref import pipeline
from golden.msv2_ref.events import expected_events
from golden.msv2_ref.joint import render_joint
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.model import GaussianModel
from golden.scenes.stereo import stereo_pair
from spec.codes import ErrorCode
from spec.config import AcceleratorConfig
from spec.joint import SHIFT_MOST
from spec.memory import FIRST_PAGE_BEATS
from spec.supertiles import BUCKET_PAIRS
from tb.common.exact import Outcome
from tb.common.runner import Waves
from tb.top.check import mismatches
from tb.top.check_joint import joint_events, joint_mismatches
from tb.top.device import machine
from tb.top.overlap_player import Row, RowFrame, RowResult, play_rows
from tb.top.plan_joint import after, joint_case
from tb.top.planned import SPEEDS, PlannedFrame, planned
from tb.top.stimuli import Case, camera_of, case, cloud, crowd

FRAMES_APART = 2
"""The bounds of a frame are those of the frame so many before it."""


class Eyes(NamedTuple):
    """How a joint frame is rendered: which eye is the source, the setting `shift`, None for the host's choice, and whether the
    target has the source's colours."""

    source_eye: str = "left"
    shift: int | None = None
    shared_colour: bool = False


EYES = (Eyes(), Eyes("right", -3), None, Eyes(shared_colour=True), Eyes("right", SHIFT_MOST), None)
"""The eyes of a row's frames in turn, in machines with joint frames; None for frames of one eye."""

_SHOWN = 5


def turned(camera: Camera, degrees: float) -> Camera:
    """A camera that has turned about its own vertical axis."""
    angle = np.deg2rad(degrees)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    return replace(camera, rotation=turn @ camera.rotation, translation=turn @ camera.translation)


def turning(
    config: AcceleratorConfig, name: str, model: GaussianModel, size: tuple[int, int], count: int, *,
    gaze: tuple[float, float] | None = None, beta: int | None = None, degrees: float = 5.0,
) -> list[Case]:
    """Golden frames of a camera that turns and of a gaze that moves right, one pixel for each degree; in machines with joint
    frames those of EYES in turn."""
    cases = []
    for number in range(count):
        camera, eyes = turned(camera_of(*size), number * degrees), EYES[number % len(EYES)] if config.joint else None
        foveation = None if gaze is None else foveation_map(
            Display(*size), (gaze[0] + number * degrees, gaze[1]), model.levels)
        how = {"config": config, "foveation": foveation, "background": (0.2, 0.1 * number, 1.0), "beta": beta}
        cases.append(Case(f"{name} {number}", pipeline.render(model, camera, **how) if eyes is None else render_joint(
            model, stereo_pair(camera, ipd_metres=0.3, source_eye=eyes.source_eye), **how, shift=eyes.shift,
            shared_colour=eyes.shared_colour), beta, False))
    return cases


def in_a_row(cases: Sequence[Case]) -> list[Case]:
    """The cases as the machine renders them in a row after a reset: each with the bounds of the frame before the last."""
    return [each if number < FRAMES_APART else after(each, cases[number - FRAMES_APART]) for number, each in enumerate(cases)]


def row(name: str, cases: Sequence[Case], speed: str = "usual", formats: Sequence[dict[str, bool]] = ({},), **options: object,
        ) -> Row:
    """A row of frames that all end well, with pixel formats in turn."""
    return Row(name, [planned(each, **formats[n % len(formats)]) for n, each in enumerate(in_a_row(cases))], SPEEDS[speed],
               **options)


def good_rows(config: AcceleratorConfig, seed: int) -> list[Row]:
    """Rows that end well."""
    rng, levels = np.random.default_rng(seed), config.levels
    formats = ({}, {"display": True}, *([{"packed": True}] if config.packed else []))
    scene = cloud(rng, 220, levels=levels, sh=1)
    many = crowd(rng, 2 * BUCKET_PAIRS + 700)
    small = _crowded(config, "few", crowd(rng, 40))
    wide = _crowded(config, "wide", crowd(rng, 300), (140, 16))
    spilling = _crowded(config, "spilling", crowd(rng, 2 * config.sort_chunk + 5))
    bounds = [_crowded(config, f"many {n}", replace(many, means=(1 - 0.05 * n) * many.means)) for n in range(3)]
    rows = [
        row("turning", turning(config, "turning", scene, (64, 48), 4, gaze=(20, 30) if levels > 1 else None), formats=formats),
        row("turning, instant", turning(config, "turning", scene, (48, 40), 3, degrees=-20), "instant", formats[::-1]),
        row("bounds", [bounds[0], bounds[1], bounds[2], bounds[0], small, bounds[1], wide, bounds[2]], "instant"),
        row("unlike", [wide, spilling, small, wide, spilling], "pauses", formats),
    ]
    if config.joint:  # both have one super-tile, so that each has the bounds of the other
        one = [case(config, f"one eye {n}", many, (16, 16), beta=0) for n in range(2)]
        two = [joint_case(config, f"two eyes {n}", many, (16, 16), beta=0, shift=shift) for n, shift in enumerate((2, -1))]
        rows += [
            row("one eye, then two", [one[0], one[1], two[0], two[1], one[0], one[1], two[1]], "instant"),
            row("every kind of eyes", turning(config, "eyes", scene, (90, 40), 2 * len(EYES), degrees=3,
                                              gaze=(30, 20) if levels > 1 else None), "far", formats)]
    return rows


def _crowded(config: AcceleratorConfig, name: str, model: GaussianModel, size: tuple[int, int] = (16, 16)) -> Case:
    """A frame of a crowd, in machines with joint frames of both eyes."""
    if config.joint:
        return joint_case(config, name, model, size, beta=0, shift=1)
    return case(config, name, model, size, beta=0)


def broken_rows(config: AcceleratorConfig, seed: int) -> list[Row]:
    """Rows with a frame that ends early beside another one, and a row that ends well after each; there is no reset between them
    where the machine needs none."""
    rng = np.random.default_rng(seed)
    scene = turning(config, "scene", cloud(rng, 200, sh=1), (64, 48), 4)
    spilling = _crowded(config, "spilling", crowd(rng, 2 * config.sort_chunk + 5))
    none, aborted = ErrorCode.NONE, ErrorCode.ABORTED
    rows: list[Row] = []

    def add(name: str, frames: Sequence[tuple[Case, ErrorCode]], *, reset: bool = False, which: int = -1,
            failing: tuple[int, str] | None = None, cut: int | None = None, **options: object) -> None:
        """A row in which the frame number `which` has these options, and the row after it."""
        made = [planned(each, error=error) for each, error in frames]
        made[which] = replace(made[which], run=replace(made[which].run, **options))
        rows.append(Row(name, made, failing=failing, cut=cut, reset=not rows or reset))
        rows.append(row(f"after: {name}", scene[:3], reset=cut is not None))

    pair = [(scene[0], aborted), (scene[1], aborted)]
    for cycles in (1, 300, 2000):
        add(f"abort {cycles} cycles after the second start", pair, abort=cycles)
    add("abort of a frame alone", [(scene[0], aborted)], abort=900)
    for cycles in (5, 1500):
        add(f"reset {cycles} cycles after the second start", pair, cut=cycles)
    for region in ("geometry", "chunks", "tiles", *(["target_tiles"] if config.joint else [])):
        add(f"{region} of the second frame fails", [(scene[0], aborted), (scene[1], ErrorCode.READ_ERROR)], failing=(1, region))
    add("entries of the second frame fail", [(scene[0], aborted), (scene[1], ErrorCode.WRITE_ERROR)], failing=(1, "entries"))
    for region in ("frame", *(["target_frame"] if config.joint else [])):
        add(f"{region} of the first frame fails", [(scene[0], ErrorCode.WRITE_ERROR), (scene[1], aborted)], failing=(0, region))
    add("no room for second pages", [(scene[0], aborted), (spilling, ErrorCode.ENTRIES_FULL)],
        changes={"entries_beats": FIRST_PAGE_BEATS})
    add("no room for runs", [(spilling, ErrorCode.SPILL_FULL), (scene[1], aborted)], which=0, changes={"spill_beats": 2})
    for name, value in (("near", 0), *([("shift", SHIFT_MOST + 1)] if config.joint else [])):
        add(f"a bad {name} beside a frame", [(scene[0], none), (scene[1], ErrorCode.BAD_SETTING)], changes={name: value})
    return rows


def row_problems(item: Row, result: RowResult) -> list[str]:
    """Descriptions of everything that is wrong with a row; empty when every bit and every event is right."""
    found = list(result.errors)
    for planned_frame, frame in zip(item.frames, result.frames, strict=item.cut is None):
        if frame.error is not planned_frame.error:
            found.append(f"{planned_frame.name} ended with {frame.error.name} instead of {planned_frame.error.name}")
        elif frame.error is ErrorCode.NONE:
            found += [f"{planned_frame.name}: {text}" for text in _differing(planned_frame, frame)]
    if not any(frame.error for frame in item.frames) and result.frames:
        registers = result.frames[-1].registers
        found += [f"counter {name} must be {wanted}, not {registers[name]}" for name, wanted in (
            ("read_beats", result.reads), ("write_beats", result.writes)) if registers[name] != wanted]
    return found


def _differing(item: PlannedFrame, frame: RowFrame) -> list[str]:
    if item.joint is None:
        wrong, events = mismatches(item.frame, frame.pixels), expected_events(item.frame)
    else:
        wrong, events = joint_mismatches(item.joint, frame), joint_events(item.joint)
    found = [str(m) for m in wrong[:_SHOWN]] + [f"and {len(wrong) - _SHOWN} more values"] * (len(wrong) > _SHOWN)
    return found + [f"{name} must be {wanted}, not {frame.events[name]}"
                    for name, wanted in events.items() if frame.events[name] != wanted]


def run_rows(config: AcceleratorConfig, rows: Sequence[Row], folder: Path, *, waves: Waves | None = None) -> Outcome:
    """Plays rows and compares all results. Raises SimulationError when the simulation itself fails."""
    outcome = Outcome()
    for item, result in zip(rows, play_rows(machine(config), rows, folder, waves=waves), strict=True):
        outcome.runs += 1
        outcome.recordings[item.name] = result
        wrong = row_problems(item, result)
        if wrong:
            outcome.failures[item.name] = wrong
    return outcome
