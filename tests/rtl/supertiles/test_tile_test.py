"""The tile test by super-tiles and the clip, in Verilator against the golden renderer's intersections of whole frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref.supertiles import binned_pairs
from rtl.supertiles.clip import SuperTileClip
from rtl.supertiles.tile_test import SuperTileTest
from spec.config import TINY, TINY_V3, V3, V3_EYES
from spec.constants import SUPER_TILES
from tb.common.exact import problems
from tb.common.scenes import traced_frame
from tb.culling.tile_test_stimuli import case_of, random_case
from tb.supertiles import clip_suite, tile_test_suite
from tb.supertiles.tile_test_stimuli import tiles_met
from tests.helpers.rtl_streams import assert_rejected

FAST = TINY_V3.with_(culling_units=8, row_width=1104, list_heads=512)  # a step a cycle, nine super-columns, one cut


@pytest.fixture(scope="module", params=[TINY_V3, FAST], ids=["tiny", "fast"])
def played(request, tmp_path_factory):
    """A machine, its plan and outcome."""
    plan = tile_test_suite.unit_plan(request.param, 0)
    return request.param, plan, tile_test_suite.run_plan(request.param, plan, tmp_path_factory.mktemp("tiles"))


def test_every_pair_mask_and_count_is_right_and_no_cycle_is_lost(played):
    _, plan, outcome = played
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 15_000
    assert sum(item.most_cycles is not None for item in plan) == 7


def test_faults_are_found(played):
    _, plan, outcome = played
    item = next(item for item in plan if item.name == "discs in rings")
    recording = outcome.recordings[item.name]
    assert problems(item, recording) == []
    for port in ("pairs", "survivors"):
        for name in item.expected[port].dtype.names:
            rows = item.expected[port].copy()
            rows[name][3] ^= 1
            wrong = problems(replace(item, expected=item.expected | {port: rows}), recording)
            assert len(wrong) == 1 and wrong[0].startswith(f"{port} 3: ")
    for name, value in item.observed.items():
        assert problems(replace(item, observed={name: value + 1}), recording) == [f"{name} is {value}, not {value + 1}"]


def test_stimuli_reach_every_place_and_splats_of_many_pairs():
    rng = np.random.default_rng(1)
    case = tile_test_suite.of(random_case(FAST, rng, "", 700, 150, 200, frames=1, kind="random", shape="giants"))
    (found,), (golden,) = case.found, case.golden
    assert (tiles_met(case) > 20).all() and len(tiles_met(case)) == SUPER_TILES
    assert (found.mask == (1 << SUPER_TILES) - 1).any() and (np.bincount(found.splat) > 9).any()
    assert (found.levels & found.levels - 1 > 0).sum() > 100 and golden.filtered > 1000


def test_stimuli_expect_what_the_golden_renderer_bins():
    """The suite's pairs, which follow from intersections alone, are those that the renderer bins."""
    _, frame = traced_frame(TINY_V3, "embedded", "320x180", "50,40", 4)
    expected, golden = tile_test_suite.of(case_of(frame, "")).expected["pairs"], binned_pairs(frame.config, frame.pairs)
    for name in ("depth_key", "supertile", "end"):
        assert np.array_equal(expected[name], golden[name])


def test_boxes_are_cut_to_super_tiles_a_splat_a_cycle(tmp_path):
    plan = clip_suite.unit_plan(TINY_V3, 0)
    outcome = clip_suite.run_plan(TINY_V3, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(plan) - 3
    assert sum(item.most_cycles is not None for item in plan) == 4


@pytest.mark.parametrize("unit", [SuperTileTest, SuperTileClip])
def test_machines_without_super_tiles_are_refused(unit):
    assert_rejected(lambda: unit(TINY), ValueError, "tile")
    assert_rejected(lambda: unit("tiny"), TypeError, "tiny")


@pytest.mark.long
def test_a_large_machine_with_joint_frames_is_right_and_as_fast(tmp_path):
    plan = tile_test_suite.unit_plan(V3_EYES, 0)
    outcome = tile_test_suite.run_plan(V3_EYES, plan, tmp_path)
    assert outcome.failures == {} and sum(item.most_cycles is not None for item in plan) == 7


@pytest.mark.long
def test_frames_of_scenes_are_right(tmp_path):
    plan = tile_test_suite.traced_plan(V3, "640x360")
    assert tile_test_suite.run_plan(V3, plan, tmp_path).failures == {}
