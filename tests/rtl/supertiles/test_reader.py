"""The super-tile reader: exact in every frame, and a whole frame's lists are taken while nothing else moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rtl.supertiles.reader import SuperTileReader
from spec.config import TINY, TINY_EYES, TINY_V3, V3
from spec.records import frame_supertiles, list_group
from tb.common.exact import problems
from tb.supertiles import reader_suite as suite
from tests.helpers.rtl_ports import play
from tests.helpers.rtl_streams import assert_rejected


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    plan = suite.unit_plan(TINY_V3, 0)
    return plan, suite.run_plan(TINY_V3, plan, tmp_path_factory.mktemp("tiny"))


def test_tiny_is_exact_and_fast_enough(tiny):
    plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) > 25 and outcome.items > 5000
    assert len(suite.figures(TINY_V3, plan, outcome)) == 3


def test_faults_are_found(tiny):
    plan, outcome = tiny
    item = next(item for item in plan if item.name == "lists without end")
    for port, rows in item.expected.items():
        for name in rows.dtype.names:
            wrong = rows.copy()
            wrong[name][3] ^= 1
            found = problems(replace(item, expected={port: wrong}), outcome.recordings[item.name])
            assert len(found) == 1 and found[0].startswith(f"{port} 3: ")


def test_a_whole_frames_lists_are_taken_while_nothing_moves():
    record, count = list_group(TINY_V3), frame_supertiles(TINY_V3)
    ends = np.sort(np.random.default_rng(0).choice(127, count - 1, replace=False)).tolist()
    rows = [record.pack({"tile": t, "count": t, "group": 0, "last": 0, "ends": t in ends or t == 127}) for t in range(128)]
    moves = play(SuperTileReader(TINY_V3), {"lists": rows}, {"reads": 1.0, "supertiles": 1.0}, 140,
                 setup={"supertiles_base": 5, "width": 512, "height": 512})
    assert len(moves["lists"]) == 128


def test_both_eyes_are_exact_whatever_the_shift(tmp_path):
    plan = [*suite.joint_plan(TINY_EYES, 0), *suite.unit_plan(TINY_EYES, 0)[:9]]
    outcome = suite.run_plan(TINY_EYES, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == sum(item.run.abort is None for item in plan) > 40
    items = np.concatenate([item.expected["supertiles"] for item in plan])
    cut = items["inside"] != 0xFFFF
    assert {tuple(kind) for kind in np.stack([items["eye"], cut], 1).tolist()} == {(0, 0), (0, 1), (1, 0), (1, 1)}


@pytest.mark.parametrize("field", ["eye", "inside", "x", "pairs"])
def test_faults_of_joint_super_tiles_are_found(field, tmp_path):
    plan = [item for item in suite.joint_plan(TINY_EYES, 0) if item.name.startswith("joint, 344 wide")][:1]
    outcome = suite.run_plan(TINY_EYES, plan, tmp_path)
    rows = plan[0].expected["supertiles"].copy()
    rows[field][3] ^= 1
    found = problems(replace(plan[0], expected={"supertiles": rows}), outcome.recordings[plan[0].name])
    assert len(found) == 1 and found[0].startswith("supertiles 3: ")


def test_machines_without_supertiles_are_rejected():
    assert_rejected(lambda: SuperTileReader(TINY), ValueError, "tile")


@pytest.mark.long
def test_the_machines_reader_is_exact(tmp_path):
    plan = suite.full_plan(V3, 1)
    assert suite.run_plan(V3, plan, tmp_path).failures == {}
