"""The colour unit by super-tiles, in Verilator against the golden renderer's splat records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.joint_batches import JointBatches
from rtl.supertiles.colour import PairColour
from spec.config import TINY, TINY_EYES, TINY_V3, V3, V3_EYES
from tb.common.exact import problems
from tb.common.scenes import traced_frame, traced_joint_frames
from tb.supertiles import colour_suite
from tb.supertiles.colour_stimuli import frame_case, joint_case, joint_frame_case, places, random_case


@pytest.fixture(scope="module", params=[TINY_V3, V3], ids=["tiny", "v3"])
def played(request, tmp_path_factory):
    """A machine, its plan and outcome."""
    plan = [*colour_suite.unit_plan(request.param, 0), *colour_suite.rate_plan(request.param, 0)]
    return request.param, plan, colour_suite.run_plan(request.param, plan, tmp_path_factory.mktemp("colour"))


def test_every_place_is_right_and_no_cycle_is_lost(played):
    _, plan, outcome = played
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 20_000
    assert sum(item.most_cycles is not None for item in plan) == 8


def test_faults_are_found(played):
    _, plan, outcome = played
    item = next(item for item in plan if item.name == "random of degree 3")
    for name in item.expected["places"].dtype.names:
        rows = item.expected["places"].copy()
        rows[name][5] ^= 1
        wrong = problems(replace(item, expected={"places": rows}), outcome.recordings[item.name])
        assert len(wrong) == 1 and wrong[0].startswith("places 5: ")


@pytest.fixture(scope="module", params=[TINY_EYES, V3_EYES], ids=["tiny", "v3"])
def eyes(request, tmp_path_factory):
    """A machine with joint frames, its plan of them, and the outcome."""
    plan = [*colour_suite.joint_plan(request.param, 0), *colour_suite.rate_plan(request.param, 0)]
    return request.param, plan, colour_suite.run_plan(request.param, plan, tmp_path_factory.mktemp("eyes"))


def test_colours_of_both_eyes_are_right_and_no_cycle_is_lost(eyes):
    _, plan, outcome = eyes
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 20_000
    assert sum(item.most_cycles is not None for item in plan) == 40


def test_shared_colours_are_those_of_the_source():
    """The expected places of a pair with shared colours differ from those with two, in the target alone."""
    own, shared = (joint_case(TINY_EYES, 5, 3, 60, shared=shared).places(TINY_EYES) for shared in (False, True))
    unlike = (own["colour"] != shared["colour"]).any(axis=1)
    assert unlike.any() and (own["eye"][unlike] == 1).all() and (own["mean2d"] == shared["mean2d"]).all()


@pytest.mark.parametrize("name", ["joint, one colour, degree 3", "joint, two colours, degree 3"])
def test_faults_of_joint_frames_are_found(eyes, name):
    _, plan, outcome = eyes
    item = next(item for item in plan if item.name == name)
    for field in ("eye", "last", "colour", "mask"):
        rows = item.expected["places"].copy()
        rows[field][5] ^= 1
        wrong = problems(replace(item, expected={"places": rows}), outcome.recordings[item.name])
        assert len(wrong) == 1 and wrong[0].startswith("places 5: ")


def test_joint_stimuli_expect_the_golden_renderer_s_places():
    """The places of a traced joint frame, from the survivors of both eyes, with colours of each eye and with shared ones."""
    for frame in traced_joint_frames(TINY_EYES, "128x128").values():
        expected = joint_frame_case("", frame).places(TINY_EYES)
        assert len(expected) > 500 and np.array_equal(expected, JointBatches(frame).place_records)


@pytest.mark.parametrize("degree", range(3))
def test_units_of_lower_degrees_are_right(degree, tmp_path):
    plan = [colour_suite.plan_of(TINY_V3, random_case(TINY_V3, k, k, 60)) for k in range(degree + 1)]
    outcome = colour_suite.run_plan(TINY_V3, plan, tmp_path, sh_degree=degree)
    assert outcome.failures == {} and outcome.runs == degree + 1


def test_stimuli_expect_the_golden_renderer_s_places():
    _, frame = traced_frame(TINY_V3, "embedded", "320x180", "50,40", 4)
    expected, golden = places(TINY_V3, frame_case("", frame)), FrameBatches(frame).place_records
    assert len(expected) > 4000 and np.array_equal(expected, golden)


def test_bad_parameters_are_refused():
    with pytest.raises(ValueError, match="lists must be 'supertile' for this unit, not 'tile'"):
        PairColour(TINY)
    for wrong, error in ((4, ValueError), (True, TypeError)):
        with pytest.raises(error, match="sh_degree must be"):
            PairColour(TINY_V3, sh_degree=wrong)
    with pytest.raises(TypeError, match="config must be"):
        PairColour("tiny")


@pytest.mark.long
def test_frames_of_scenes_are_right(tmp_path):
    plan = colour_suite.traced_plan(V3, "320x180")
    assert colour_suite.run_plan(V3, plan, tmp_path).failures == {}
