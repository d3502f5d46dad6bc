"""The array of machines with super-tiles: its pixels are the golden array's, however lists are split into batches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rtl.vrc_array.batch_array import BatchArray
from spec.config import TINY, TINY_STREAMS, TINY_V3, V3
from tb.supertiles import array_suite
from tb.supertiles.array_stimuli import split, stopping_case
from tb.vrc_array.array_stimuli import random_case


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """The plan of TINY_V3, and its outcome."""
    plan = array_suite.full_plan(TINY_V3, 0)
    return plan, array_suite.run_plan(TINY_V3, plan, tmp_path_factory.mktemp("batch_array"))


def test_tiny_is_bit_exact(tiny):
    plan, outcome = tiny
    assert outcome.failures == {} and outcome.runs == len(plan) - 3  # three runs are cut off


def test_early_stops_happen(tiny):
    """Runs in which nothing stops would show nothing of early stops."""
    plan, outcome = tiny
    assert any(item.frame.done for item in plan)
    assert sum(outcome.recordings[f"stopping {k}"].observed["skipped"] for k in range(6)) > 50


def test_a_wrong_bit_of_done_is_caught(tiny):
    plan, outcome = tiny
    item = next(item for item in plan if item.name == "stopping 3")
    wrong = replace(item, frame=replace(item.frame, done=item.frame.done ^ 1))
    assert array_suite.judge(TINY_V3, item, outcome.recordings[item.name]) == []
    text, = array_suite.judge(TINY_V3, wrong, outcome.recordings[item.name])
    assert text.startswith("done is 0x")


def test_a_state_that_is_not_loaded_is_caught(tmp_path):
    """With `fresh` set in a tile's second visit, the intersections of its first one are missing in the picture."""
    frame = split(TINY_V3, random_case(TINY_V3, "fresh", 0), 0)
    later = np.flatnonzero(frame.visits["fresh"] == 0)
    assert len(later) > 5
    frame.visits["fresh"][later] = 1
    outcome = array_suite.run_plan(TINY_V3, [array_suite.plan_of(TINY_V3, frame)], tmp_path)
    assert "colour is" in outcome.failures["fresh"][0]


def test_an_array_of_four_renders_its_quarter(tmp_path):
    """Each quarter in some of the runs; lists have entries of the other quarters, too."""
    config = TINY_STREAMS
    plan = [*array_suite.random_plan(config, 0), *array_suite.hazard_plan(config, 1), *array_suite.stop_plan(config, 0)]
    assert {item.frame.quarter for item in plan} == {0, 1, 2, 3} and any(item.frame.done for item in plan)
    outcome = array_suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {}
    item = plan[1]
    other = replace(item, frame=replace(item.frame, quarter=item.frame.quarter ^ 1))
    assert array_suite.judge(config, other, outcome.recordings[item.name])


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in array_suite.DISTINCT if name != "tiny_v3"])
def test_other_machines_are_bit_exact(name, tmp_path):
    config = array_suite.VARIANTS[name]
    assert array_suite.run_plan(config, array_suite.full_plan(config, 0), tmp_path).failures == {}


def test_frames_are_split_as_the_specification_says():
    case = stopping_case(V3, "x", 1)
    frame = split(V3, case, 1)
    ends = np.flatnonzero(frame.entries["end"])
    assert len(ends) == len(frame.visits) and ends[-1] == len(frame.entries) - 1
    assert len(frame.entries) - len(ends) == len(case.entries)
    assert frame.visits["final"].sum() == frame.visits["fresh"].sum() == len(case.headers)
    for sequence in set(frame.visits["sequence"].tolist()):
        assert (np.diff(np.flatnonzero(frame.visits["sequence"] == sequence)) > 0).all()


def test_a_machine_with_lists_by_tile_has_no_such_array():
    with pytest.raises(ValueError, match="lists must be 'supertile'"):
        BatchArray(TINY)
