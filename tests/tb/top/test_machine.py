"""The whole machine, frame after frame, against the golden renderer: every pixel and counter."""

import numpy as np
import pytest

from golden.msv2_ref.frame_memory import list_lengths
from msv2.studies.tradeoff.knobs import WORDS, Setting
from spec.codes import ErrorCode
from spec.config import TINY
from spec.memory import pages_beyond_first
from spec.queues import LIST_POINTERS, LISTS_AHEAD
from spec.supertiles import BUCKETS
from tb.top.device import machine
from tb.top.plan_buckets import bucket_plan
from tb.top.stimuli import case, cloud, crowd
from tb.top.suite import (
    DISTINCT,
    VARIANTS,
    broken_plan,
    full_plan,
    good_plan,
    planned,
    problems,
    run_plan,
)

V2_CYCLES = {"gaze in the middle, usual memory": 15_124, "bounding boxes, usual memory": 16_528}
"""Cycles of some frames of the plan, from start to end."""

IN_SHORT = ("reset after 250", "abort after 40", "geometry fails", "frame fails", "width = 0", "second pages", "room for runs")
"""Of the plan's broken frames, one of each kind."""


def test_frames_failures_and_resets_in_short(tmp_path):
    plan = good_plan(TINY, 0)[::8]
    plan += [item for item in broken_plan(TINY, 0) if any(words in item.name for words in IN_SHORT)]
    assert {item.error for item in plan} >= {
        ErrorCode.NONE, ErrorCode.ABORTED, ErrorCode.READ_ERROR, ErrorCode.WRITE_ERROR, ErrorCode.BAD_SETTING,
        ErrorCode.ENTRIES_FULL, ErrorCode.SPILL_FULL}
    outcome = run_plan(TINY, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(plan)


def test_a_frame_of_the_machine_without_chunks_takes_the_cycles_of_version_2(tmp_path):
    """Version 2 of the register map had no machine with chunks; its units must stay as they were."""
    plan = [item for item in good_plan(TINY, 0) if item.name in V2_CYCLES]
    outcome = run_plan(TINY, plan, tmp_path)
    assert outcome.failures == {}
    assert {name: outcome.recordings[name].registers["cycles_total"] for name in V2_CYCLES} == V2_CYCLES


CHUNKS_IN_SHORT = (
    "clusters, gaze, usual memory", "clusters with giants, pauses memory", "all faint, usual memory", "no Gaussians, usual",
    "SH degree 0, usual", "groups that spill, usual memory")
"""Of the plan's frames of a machine with chunks, a few."""

CHUNKS_BROKEN = ("reset after 250", "abort after 250", "chunks fails", "geometry fails")
"""Of those that end early, some of each kind that the readers of chunks can meet."""


@pytest.mark.long  # test_frames_of_two_eyes_in_short plays chunks, too
def test_frames_of_chunks_in_short(tmp_path):
    config = VARIANTS["tiny_records"]
    plan = [item for item in good_plan(config, 0) if any(words in item.name for words in CHUNKS_IN_SHORT)]
    plan += [item for item in broken_plan(config, 0) if any(words in item.name for words in CHUNKS_BROKEN)]
    assert any(item.frame.chunks_skipped and item.frame.chunks_read for item in plan)
    assert {item.error for item in plan} >= {ErrorCode.NONE, ErrorCode.ABORTED, ErrorCode.READ_ERROR}
    outcome = run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(plan) > 10


@pytest.mark.long
def test_frames_of_chunks_of_wide_records_and_of_two_eyes_in_short(tmp_path):
    for variant in ("tiny_chunks", "tiny_records_stereo"):
        plan = [item for item in good_plan(VARIANTS[variant], 0) if "clusters" in item.name]
        assert any(item.frame.chunks_skipped for item in plan)
        outcome = run_plan(VARIANTS[variant], plan, tmp_path / variant)
        assert outcome.failures == {} and outcome.runs == len(plan) > 1


SUPERTILES_IN_SHORT = (
    "SH degree 0, usual", "SH degree 3, pauses", "gaze in the middle, usual", "gaze at the side, slow",
    "clusters, gaze, instant", "bounding boxes, far", "no Gaussians, usual", "all behind, pauses", "one pixel, slow",
    "odd size, usual")
"""Of the plan's frames of a machine with super-tiles, a few."""

SUPERTILES_BROKEN = (
    "reset after 250", "abort after 250", "abort after 2631", "geometry fails", "supertiles fails", "colour fails",
    "frame fails", "width = 0", "second pages")
"""Of those that end early, some of each kind, in both phases."""


def short_plan(config, good, broken):
    """The frames of the machine's plans whose names have one of these words, which end in every way that a frame can."""
    plan = [item for item in good_plan(config, 0) if any(words in item.name for words in good)]
    plan += [item for item in broken_plan(config, 0) if any(words in item.name for words in broken)]
    assert {item.error for item in plan} >= {
        ErrorCode.NONE, ErrorCode.ABORTED, ErrorCode.READ_ERROR, ErrorCode.WRITE_ERROR, ErrorCode.BAD_SETTING,
        ErrorCode.ENTRIES_FULL}
    return plan


@pytest.mark.parametrize("variant", ["tiny_v3", pytest.param("tiny_streams", marks=pytest.mark.long)])
def test_frames_of_super_tiles_in_short(variant, tmp_path):
    config = VARIANTS[variant]
    plan = short_plan(config, SUPERTILES_IN_SHORT, SUPERTILES_BROKEN)
    outcome = run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(plan) > 25
    ended = [outcome.recordings[item.name].registers for item in plan if item.error is ErrorCode.ABORTED]
    assert {registers["cycles_render"] > 0 for registers in ended} == {False, True}


JOINT_IN_SHORT = (
    "gaze in the middle", "right eye first, usual", "shift -8", "shift 5, far", "clusters", "shared colours, usual",
    "own colours, slow", "alone, usual", "around both", "bounding boxes, pauses", "no Gaussians, usual", "one pixel",
    "odd size")
"""Of the plan's joint frames, a few, with the frames of one eye that follow some of them."""

JOINT_BROKEN = (
    "reset after 250", "abort after 250", "target_tiles fails", "supertiles fails", "geometry fails", "target_frame fails",
    "shift = 9", "shift = -9", "second pages")
"""Of those that end early, some of each kind."""


@pytest.mark.long  # the machine with a warped eye and those whose phases overlap have these units, too
@pytest.mark.parametrize("variant", ["tiny_eyes", "tiny_eyes_streams", "tiny_eyes_packed", "tiny_eyes_full"])
def test_joint_frames_in_short(variant, tmp_path):
    config = VARIANTS[variant]
    plan = short_plan(config, JOINT_IN_SHORT, JOINT_BROKEN)
    both = [item.joint for item in plan if item.joint is not None and item.error is ErrorCode.NONE]
    assert {eye.pairs for frame in both for eye in frame.eyes} == {None} and any(frame.registers.shift < 0 for frame in both)
    assert any(frame.registers.shared_colour for frame in both) and any(item.joint is None for item in plan)
    assert any(item.joint and item.run.image.packed for item in plan) == config.packed
    outcome = run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(plan) > 40


WARPED_IN_SHORT = (
    "gaze in the middle, usual", "right eye first, usual", "holes stay, usual", "all tiles known, usual",
    "no tile known, usual", "shift -8, usual", "shift 8, slow", "wide wall, usual", "shared colours, usual", "alone, far",
    "no Gaussians, usual", "one pixel, pauses", "odd size, usual", "one column, instant")
"""Of the plan's joint frames with a warped eye, a few, with the frames that follow some of them."""

WARPED_BROKEN = (
    "reset after 250 ", "abort after 250 ", "after 300 cycles of the second sweep", "target_tiles fails", "supertiles fails",
    "target_frame fails", "joint = 0", "second pages")
"""Of those that end early, some of each kind, in both sweeps."""


def test_joint_frames_with_a_warped_eye_in_short(tmp_path):
    config = VARIANTS["tiny_eyes_warp"]
    plan = short_plan(config, WARPED_IN_SHORT, WARPED_BROKEN)
    warped = [item.warped for item in plan if item.warped is not None and item.error is ErrorCode.NONE]
    assert {(frame.known.any(), frame.holes.any()) for frame in warped} >= {(True, True), (True, False), (False, True)}
    assert any(frame.registers.shared_colour and frame.again for frame in warped)
    assert any(frame.registers.warping.source_right for frame in warped)
    assert any(frame.shares["holes"] for frame in warped)
    assert any(item.joint for item in plan) and any(item.warped is None and item.joint is None for item in plan)
    outcome = run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(plan) > 30
    late = [outcome.recordings[item.name].registers for item in plan if item.run.late and item.run.abort]
    assert late and all(registers["cycles_target"] > 0 for registers in late)


@pytest.mark.long
def test_frames_with_the_bounds_of_the_frame_before(tmp_path):
    config = VARIANTS["tiny_v3"]
    plan = bucket_plan(config)
    most = next(item.frame for item in plan if item.frame.bounds.lists == BUCKETS <= LISTS_AHEAD)
    pages = pages_beyond_first(list_lengths(most))
    assert pages.min() >= 1 and pages[:-1].sum() > LIST_POINTERS
    assert {len(item.frame.bounds.key) for item in plan} >= {0, 2, BUCKETS - 1}
    outcome = run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(plan)
    assert bucket_plan(config.with_(buckets=False)) == bucket_plan(TINY) == []


STEREO_IN_SHORT = (
    "clusters, usual memory", "one eye, after: clusters, usual memory", "two gazes, usual memory",
    "one eye, after: two gazes, usual memory", "groups that spill in the target eye, usual memory",
    "no Gaussians, nothing rendered, usual memory", "no depth, far memory, back to back")
"""Of the plan's frames of two eyes, a few."""

STEREO_BROKEN = ("reset after 250", "abort after 250", "chunks fails", "geometry fails", "target_frame fails", "second pages")
"""Of those that end early, some of each kind."""


def test_frames_of_two_eyes_in_short(tmp_path):
    config = VARIANTS["tiny_records_stereo"]
    plan = [item for item in good_plan(config, 0) if item.name in STEREO_IN_SHORT]
    assert len(plan) == len(STEREO_IN_SHORT)
    plan += [item for item in broken_plan(config, 0)
             if any(words in item.name for words in STEREO_BROKEN)]
    assert any(item.run.late for item in plan) and sum(item.stereo is None for item in plan) > 2
    assert any(item.frame.chunks_skipped and item.frame.chunks_read for item in plan)
    outcome = run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(plan) > 20
    late = [outcome.recordings[item.name].registers for item in plan if item.run.late and item.run.abort]
    assert late and all(registers["cycles_target"] > 0 for registers in late)


@pytest.mark.long
def test_frames_of_a_presets_numbers_in_short(tmp_path):
    config = VARIANTS["tiny_short"]
    plan = good_plan(config, 0)[3::8]
    frames = [item.frame for item in plan]
    assert 2 in {frame.words.sh_degree for frame in frames} and any(frame.registers.header[:, 0].any() for frame in frames)
    outcome = run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(plan) > 4


SWEPT = [(knob, value) for knob, values in WORDS.items() for value in (next(iter(values)), next(reversed(values)))]
"""The shortest and the longest of every word length that `make tradeoff` tries."""


@pytest.mark.long
@pytest.mark.parametrize(("knob", "value"), SWEPT, ids=map(" ".join, SWEPT))
def test_word_lengths_of_the_tradeoff_are_exact(knob, value, tmp_path):
    config = WORDS[knob][value](Setting(config=TINY)).config.with_(name="swept")
    outcome = run_plan(config, good_plan(config, 0)[3::8], tmp_path)
    assert outcome.failures == {} and outcome.runs > 4


@pytest.mark.long
@pytest.mark.parametrize("variant", DISTINCT)
def test_every_frame_of_the_plan_is_right(variant, tmp_path):
    config = VARIANTS[variant]
    plan = full_plan(config, 0)
    outcome = run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(plan) > 90


@pytest.mark.long
def test_small_frames_with_independent_models_of_axi(tmp_path):
    pytest.importorskip("cocotbext.axi")
    from tb.top.axi_small import play_small

    rng = np.random.default_rng(4)
    foveated = case(TINY, "foveated", cloud(rng, 100, levels=4, sh=1), (40, 20), gaze=(3, 3))
    crowded = case(TINY, "crowded", crowd(rng, 300), (20, 20))
    plan = [
        planned(foveated), planned(crowded, "back to back", display=True, reset=False, poison=False),
        planned(foveated, "pauses", "pauses", reset=False),
        planned(foveated, "cut", cut=700), planned(crowded, "after the cut"),
        planned(foveated, "abort", error=ErrorCode.ABORTED, abort=500), planned(crowded, "after the abort", reset=False)]
    played = play_small(machine(TINY), [item.run for item in plan], tmp_path)
    for item, result in zip(plan, played, strict=True):
        wrong = [text for text in problems(item, result) if not text.startswith(("counter read_beats", "counter write_beats"))]
        assert wrong == [], item.name  # the RAM counts no beats
