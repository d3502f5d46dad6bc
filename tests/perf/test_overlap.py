"""Overlapped phases in the cycle model: what must hold whatever the two phases do to each other."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from golden.msv2_ref import pipeline
from golden.msv2_ref.buckets import no_bounds
from golden.scenes.load import EMBEDDED
from golden.scenes.request import parse_request, resolve
from msv2.studies.overlap import rows
from perf.model import MemoryModel
from perf.overlap import OverlapCycles, simulate_overlap
from perf.supertiles import SuperCycles, simulate_supertiles
from perf.supertiles_plan import steady_bounds
from perf.supertiles_trace import SuperTrace, super_trace
from spec.config import MACHINES, V3, V3_RECORDS
from spec.paths import REPORTS

MEMORIES = {
    "ideal": MemoryModel("ideal"), "unlimited": MemoryModel("ideal", bytes_per_cycle=None), "lpddr3": MemoryModel("lpddr3")}


@pytest.fixture(scope="module")
def trace() -> SuperTrace:
    asked = resolve(parse_request(
        "embedded", "--size", "192x128", "--gaze", "96,64", "--levels", "4", "--levels-from", "random"))
    return super_trace(pipeline.render(
        asked.model, asked.camera, config=V3, foveation=asked.foveation, background=asked.background))


@pytest.fixture(scope="module", params=MEMORIES)
def both(request, trace) -> tuple[SuperCycles, OverlapCycles]:
    memory = MEMORIES[request.param]
    return (simulate_supertiles(trace, V3, memory=memory, display=True),
            simulate_overlap(trace, V3, memory=memory, display=True))


def test_a_frame_moves_the_same_bytes_as_with_phases_in_turn(both):
    turns, overlapped = both
    assert overlapped.bytes == sum(turns.reads.values()) + sum(turns.writes.values())


def test_frames_are_faster_than_in_turn_and_no_faster_than_their_slower_phase_alone(both):
    turns, overlapped = both
    begins = turns.phases["clear"] + turns.phases["table"]
    assert overlapped.period == max(overlapped.first, overlapped.second)
    assert max(turns.phases["render"], begins + turns.phases["geometry"]) * 0.98 < overlapped.period < turns.total


def test_with_memory_to_spare_phases_wait_for_the_shared_datapaths_alone(trace):
    """Each phase offers at most a slot a cycle, and either gets every second one at least."""
    memory = MEMORIES["unlimited"]
    turns = simulate_supertiles(trace, V3, memory=memory, display=True)
    overlapped = simulate_overlap(trace, V3, memory=memory, display=True)
    assert overlapped.second < turns.phases["render"] + trace.points_read
    assert overlapped.first < turns.total - turns.phases["render"] + trace.pairs


def test_half_the_bandwidth_takes_about_twice_as_long_where_memory_limits_the_frame(trace):
    slow = simulate_overlap(trace, V3, memory=replace(MEMORIES["ideal"], bytes_per_cycle=12.8), display=True)
    fast = simulate_overlap(trace, V3, memory=MEMORIES["ideal"], display=True)
    assert fast.utilisation["memory"] > 0.9 and slow.period > 1.7 * fast.period and slow.bytes == fast.bytes


def test_bounds_are_those_of_a_camera_that_stands_still_unless_others_are_given(trace):
    """Lists that have no bounds are as long as their super-tiles' pairs, and longer ones are merged from more runs."""
    usual = simulate_overlap(trace, V3, memory=MEMORIES["ideal"], display=True)
    same = simulate_overlap(trace, V3, memory=MEMORIES["ideal"], display=True, bounds=steady_bounds(trace, V3))
    none = simulate_overlap(trace, V3, memory=MEMORIES["ideal"], display=True, bounds=no_bounds(trace.supertiles))
    assert same == usual and steady_bounds(trace, V3).lists > trace.supertiles and none.second != usual.second


def test_a_machine_with_lists_by_tile_is_refused(trace):
    with pytest.raises(ValueError, match="lists"):
        simulate_overlap(trace, V3_RECORDS)


@pytest.mark.parametrize("name", ["v3_overlap", "v3_eyes_overlap"])
def test_the_period_of_a_frame_of_the_rtl(name):
    """The embedded scene's rows of reports/frames_overlap.json, which the RTL played without a difference."""
    row = next(row for row in json.loads((REPORTS / "frames_overlap.json").read_text())["rows"]
               if (row["scene"], row["machine"]) == (EMBEDDED, name))
    config = MACHINES[name]
    still = rows.rows_of(rows.golden_frames(config, row["scene"], row["size"], joint=config.joint), short=False)["still"]
    found = rows.modelled(still[-2], config, packed=config.packed)
    assert row["problems"] == []
    assert abs(found.period / row["period"] - 1) < 0.02
