"""The cycle model: against the RTL's committed numbers, its own invariants, what it takes from the RTL's structure."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest

from golden.host.run_options import LPDDR3, MEMORIES
from golden.msv2_ref.fetch import find_misses
from golden.msv2_ref.tile_lists import tile_lists
from golden.scenes.load import EMBEDDED
from msv2.studies.model import study
from perf import bus, dram
from perf.model import MemoryModel, simulate
from perf.perfetto import trace_events
from perf.plan import _merges, eye_lists
from perf.runs import tile_runs
from perf.trace import EyeTrace, FrameTrace, load_trace, save_trace, trace_request
from spec.config import PAPER
from spec.memory import BEAT_BYTES, BEAT_ENTRIES, DIRECTORY_BEATS, WORDS, colour_beats
from spec.paths import ROOT
from spec.queues import CACHE_WAYS

AT_ONE_NANOSECOND = (104_647, 44_416, 13_972, 153)
"""Of the foveated frame `small` on LPDDR3 beside a machine of 1 GHz: cycles of geometry and rendering, activates, refreshes."""


def rtl_rows(name: str = "frames") -> list[dict]:
    rows = json.loads((ROOT / "reports" / f"{name}.json").read_text())["rows"]
    return [row for row in rows if row["scene"] == EMBEDDED and row["entries"]]


def lpddr3_rows() -> list[list[dict]]:
    """Single frames, and the frames of each row."""
    rows = [row for row in rtl_rows("model_rtl") if row.get("memory") == LPDDR3]
    firsts = [place for place, row in enumerate(rows) if not row.get("number")]
    return [rows[a:b] for a, b in pairwise([*firsts, len(rows)])]


@pytest.fixture(scope="module")
def small() -> FrameTrace:
    row = next(row for row in rtl_rows() if row["levels"] > 1)
    return trace_request(study.request(row, EMBEDDED), PAPER)


@pytest.mark.parametrize("merge", (True, False))
@pytest.mark.parametrize("pipeline", (True, False))
def test_cycles_are_the_rtls_within_two_percent(small, merge, pipeline):
    row = next(r for r in rtl_rows() if r["levels"] > 1 and (r["merge"], r["pipeline"]) == (merge, pipeline))
    frame = simulate(small, PAPER, memory=MemoryModel("ideal"), merge=merge, pipeline=pipeline, display=False)
    got = study.compared(row, frame)
    assert abs(got["total"]["error"]) <= study.TOTAL_GOAL
    assert all(abs(phase["error"]) <= study.TOTAL_GOAL for phase in got["phases"].values())
    assert got["phases"]["table"]["error"] == 0
    assert all(stage["busy_equal"] for stage in got["stages"].values())
    assert got["beats_equal"]
    assert got["misses_equal"]
    assert frame.ops == row["ops"]
    assert frame.groups == row["groups"]


@pytest.mark.parametrize("kind", MEMORIES)
def test_counters_add_up_and_events_follow_each_other(small, kind):
    frame = simulate(small, PAPER, memory=MemoryModel(kind))
    assert frame.total == sum(frame.phases.values())
    for stage in frame.stages.values():
        assert stage.busy + stage.blocked + stage.starved == frame.total
        assert min(stage.busy, stage.blocked, stage.starved) >= 0
    phases = {stage: (first, last) for stage, _, group, first, last in frame.timeline if group < 0}
    assert phases["geometry"][1] == phases["render"][0]
    order = ("sort", "handover", "fetch", "array")
    times = {(stage, group): (first, last) for stage, _, group, first, last in frame.timeline if group >= 0}
    groups = sorted({group for stage, group in times if stage == "sort"})
    assert len(groups) == len(set(np.flatnonzero(np.bincount(groups))))
    for group in groups:
        rows = [times[stage, group] for stage in order]
        assert all(first <= last for first, last in rows)
        assert all(a[0] <= b[0] and a[1] <= b[1] for a, b in pairwise(rows))
        assert phases["render"][0] <= rows[0][0] and rows[-1][1] < phases["render"][1]
    events = trace_events(frame)["traceEvents"]
    assert sum(event["ph"] == "X" for event in events) == len(frame.timeline)


def test_less_memory_never_makes_a_frame_faster(small):
    totals = [simulate(small, PAPER, memory=MemoryModel(bytes_per_cycle=rate)).total for rate in (6.4, 12.8, 25.6, None)]
    assert totals == sorted(totals, reverse=True)
    assert totals[0] > 1.5 * totals[2]
    slow = simulate(small, PAPER, memory=MemoryModel("ideal", latency=400)).total
    assert slow > simulate(small, PAPER, memory=MemoryModel("ideal")).total


def test_the_memory_is_lpddr3_where_none_is_named(small):
    frame = simulate(small, PAPER)
    assert frame.as_json() | {"seconds": 0} == simulate(small, PAPER, memory=MemoryModel("lpddr3")).as_json() | {"seconds": 0}
    assert frame.activates > 0 and frame.total > simulate(small, PAPER, memory=MemoryModel("ideal")).total


@pytest.mark.parametrize("memory", [
    MemoryModel(), MemoryModel(latency=1), MemoryModel(bytes_per_cycle=6.4), MemoryModel(bytes_per_cycle=None)])
def test_answers_are_worked_out_as_a_stepped_memory_gives_them(small, monkeypatch, memory):
    worked, prepare = simulate(small, PAPER, memory=memory).as_json(), bus.prepare

    def stepped(s, **settings):
        prepare(s, **settings)
        assert s.kind == bus.COMPUTED
        s.kind = bus.STEPPED

    monkeypatch.setattr(bus, "prepare", stepped)
    assert simulate(small, PAPER, memory=memory).as_json() | {"seconds": 0} == worked | {"seconds": 0}


def test_channels_of_dram_keep_their_bandwidth_and_never_beat_it(small):
    """A run of beats keeps all channels busy but for refreshes; no frame moves more than they can.

    A channel's refresh takes 6 % of the time; answers are in order, so that the other three, whose refreshes come at other
    times, go on for as long as 128 beats in flight let them, and no more.
    """
    peak = dram.CHANNELS * BEAT_BYTES / dram.Lpddr3().burst
    only_points = culled(small, 20_000)
    run = simulate(only_points, PAPER, memory=MemoryModel("lpddr3"))
    moved = run.reads["geometry"] / run.phases["geometry"]
    assert 0.8 * peak <= moved <= peak
    frame = simulate(small, PAPER, memory=MemoryModel("lpddr3"))
    assert frame.dram_bytes["read"] + frame.dram_bytes["write"] <= peak * frame.total
    same = simulate(small, PAPER, memory=MemoryModel("ideal"))
    assert (frame.reads, frame.writes) == (same.reads, same.writes)
    assert frame.total > same.total
    beats = sum((*frame.reads.values(), *frame.writes.values())) // BEAT_BYTES
    assert 0 < frame.activates < beats
    assert abs(frame.refreshes - dram.CHANNELS * frame.total / dram.Lpddr3().refi) <= 2 * dram.CHANNELS
    assert same.activates == same.refreshes == 0


@pytest.mark.parametrize("rows", lpddr3_rows(), ids=lambda rows: f"{rows[0]['config']}-{rows[0]['levels']}")
def test_cycles_on_lpddr3_are_the_rtls_within_two_percent(rows):
    """Frames of the embedded scene that the RTL has rendered on the bench's LPDDR3, as the study keeps them. Where they say
    when they began, the phase TABLE takes its cycles exactly in frames after a reset."""
    for row, _, frame in study.model_rows(rows, lambda name: name):
        got = study.compared(row, frame)
        assert abs(got["total"]["error"]) <= study.TOTAL_GOAL
        assert got["beats_equal"] and got["misses_equal"]
        for name in study.COMMANDS:
            assert got["commands"][name]["model"] == pytest.approx(got["commands"][name]["rtl"], rel=0.05, abs=16)
        if "idle_cycles" in row and not row.get("number"):
            assert got["phases"]["table"]["error"] == 0


def test_cycles_of_dram_at_one_nanosecond_are_what_they_were(small):
    """They change with the mechanisms of the memory alone: with its unit of time, for instance, they did not."""
    frame = simulate(small, PAPER, memory=MemoryModel("lpddr3"))
    assert (frame.phases["geometry"], frame.phases["render"], frame.activates, frame.refreshes) == AT_ONE_NANOSECOND


def test_dram_keeps_its_time_beside_machines_of_other_clocks(small):
    """The ideal memory counts in cycles and does not see the clock. DRAM counts in time: a run of beats that only DRAM limits
    takes as long beside a faster machine, and a machine much slower than DRAM sees a memory that is never busy for long."""
    ideal = [simulate(small, PAPER, memory=MemoryModel(clock_ns=clock)).total for clock in (0.5, 1.0, 4.0)]
    assert len(set(ideal)) == 1
    points = culled(small, 20_000)
    times = {clock: clock * simulate(points, PAPER, memory=MemoryModel("lpddr3", clock_ns=clock)).phases["geometry"]
             for clock in (0.5, 1.0)}
    assert abs(times[0.5] / times[1.0] - 1) < 0.1
    cycles = [simulate(small, PAPER, memory=MemoryModel("lpddr3", clock_ns=clock)).total for clock in (0.5, 1.0, 2.0, 5.0)]
    assert cycles == sorted(cycles, reverse=True) and cycles[0] > 1.5 * cycles[1]
    unlimited = simulate(small, PAPER, memory=MemoryModel(bytes_per_cycle=None, latency=20)).total
    assert unlimited < cycles[-1] < 1.1 * unlimited
    slow = simulate(small, PAPER, memory=MemoryModel("lpddr3", clock_ns=5.0))
    assert abs(slow.refreshes - dram.CHANNELS * 5.0 * slow.total / dram.Lpddr3().refi) <= 2 * dram.CHANNELS
    assert 0 < slow.utilisation["memory"] < 0.5


def culled(trace: FrameTrace, points: int) -> FrameTrace:
    """A frame of so many points, all of them behind the camera."""
    eye = trace.eyes[0]
    tiles = len(eye.counts)
    nothing = {f.name: np.zeros(0, getattr(eye, f.name).dtype) for f in fields(EyeTrace)}
    classes = np.zeros(points + 1, np.uint8)
    classes[-1] = 2
    empty = EyeTrace(**{
        **nothing, "point_class": classes, "splat_steps": np.ones(1, np.int32), "step_runs": np.ones(1, np.uint8),
        "run_entries": np.zeros(1, np.uint8), "run_closes": np.full(1, 2, np.uint8), "counts": np.zeros(tiles, np.int32),
        "rendered": np.ones(tiles, bool), "blend": eye.blend, "level": eye.level, "stop": np.full((tiles, 2), -1, np.int32),
        "filtered": np.zeros(1, np.int64), "chunk_count": eye.chunk_count, "chunk_read": eye.chunk_read})
    return FrameTrace(trace.width, trace.height, points, trace.sh_degree, trace.view_shift, (empty,), trace.holes, 0.0, {})


def test_a_frame_without_entries_writes_its_background(small):
    frame = simulate(culled(small, 100), PAPER, display=True)
    assert frame.entries == 0
    assert frame.writes["frame"] == 4 * small.width * small.height
    assert frame.stages["array"].busy == 0


def test_traces_are_kept_as_they_are(small, tmp_path):
    path = tmp_path / "trace.npz"
    save_trace(small, path)
    again = load_trace(path)
    for f in fields(EyeTrace):
        np.testing.assert_array_equal(getattr(again.eyes[0], f.name), getattr(small.eyes[0], f.name))
    assert simulate(again, PAPER).total == simulate(small, PAPER).total
    path.write_bytes(b"broken")
    assert load_trace(path) is None


def test_runs_end_where_the_tiles_change_and_where_groups_of_sixteen_do():
    kind = np.array([0] * 10 + [1] * 10, np.int64)  # a row of 20 tiles
    box = np.array([[8, 18, 0, 0]], np.int64)
    steps, step_runs, entries, closes = tile_runs(
        box, np.array([7], np.int32), np.full(4, 7, np.int32), np.array([8, 9, 11, 17], np.int32), kind, 20)
    assert steps.tolist() == [2, 1]
    assert step_runs.tolist() == [2, 1, 1]
    assert entries.tolist() == [2, 1, 1, 0]  # tiles 8..9, 10..15, 16..18, the end
    assert closes.tolist() == [0, 0, 1, 2]


def test_the_cache_keeps_four_of_a_set_and_forgets_the_first():
    splat = np.array([0, 4, 8, 12, 0, 16, 0, 4])  # 16 lines are 4 sets: all in set 0
    assert find_misses(splat, np.zeros(8, np.int64), 16, CACHE_WAYS, False, False).tolist() == [1, 1, 1, 1, 0, 1, 1, 1]
    another_level = find_misses(np.array([3, 3]), np.array([0, 1]), 16, CACHE_WAYS, False, False)
    assert another_level.tolist() == [1, 1]


def test_entries_are_written_where_the_golden_lists_have_them(small):
    eye, more = small.eyes[0], 2000  # of one tile, for pages of both beats of its directory
    added = more * (np.arange(len(small.eyes[0].counts)) == 3)
    eye = replace(eye, tile=np.concatenate([eye.tile, np.full(more, 3)]), counts=eye.counts + added)
    found, lists = tile_lists(eye.tile, len(eye.counts), 1 << 28), eye_lists(eye)
    assert lists.beats == found.beats
    entries = lists.writes[lists.writes >= 0][: len(eye.tile)]
    np.testing.assert_array_equal(entries, found.number // BEAT_ENTRIES)
    np.testing.assert_array_equal(
        -1 - lists.writes[lists.writes < 0], DIRECTORY_BEATS * found.page_tile + found.page_slot // WORDS)
    assert lists.begins.sum() == len(found.page_tile)
    for tile in (3, int(eye.counts.argmax())):
        begin, end = lists.page_start[tile : tile + 2]
        np.testing.assert_array_equal(lists.page_beat[begin:end], found.page_beat[found.page_tile == tile])


def test_a_machine_without_harmonics_does_not_wait_for_them(small):
    """The datapath takes a splat every 32 cycles, its record three; points come every 8."""
    plain, totals = replace(small, sh_degree=0), []
    for degree in (0, 3):
        frame = simulate(plain, PAPER.with_(culling_units=1, sh_degree=degree), memory=MemoryModel("ideal"))
        assert frame.reads["colour"] == len(small.eyes[0].survivor) * colour_beats(PAPER, 0) * BEAT_BYTES
        totals.append(frame.phases["geometry"])
    assert totals[0] < 0.9 * totals[1]
    assert totals[0] > 8 * small.points
    with pytest.raises(ValueError, match="SH degree 3"):
        simulate(small, PAPER.with_(sh_degree=2))


def test_merges_are_those_of_the_plan():
    """Nine runs and four ways: four become one, then three; the rest goes out with them (rtl/sort_tmu/merge_plan.py)."""
    run_of = np.tile(np.arange(9), 3)
    start, lengths, entries, out, waits, way, begin, goal = _merges(run_of, np.array([9]), np.array([27]), 4, 10)
    assert np.diff(start).tolist() == [4, 3, 4]
    assert entries.tolist() == [12, 9, 27]
    assert lengths.tolist() == [3] * 7 + [12, 9, 3, 3]
    assert out.tolist() == [False, False, True] and waits.tolist() == [False, False, True]
    assert len(way) == 12 + 9 + 27 and way[:4].tolist() == [0, 1, 2, 3]
    # results lie in the scratch half, which negative numbers mean, where their first runs lie in the ring
    assert begin.tolist() == [0, 10, 20, 30, 40, 50, 60, -1, -41, 70, 80] and goal[:2].tolist() == [-1, -41]


@pytest.mark.parametrize(("arguments", "error"), [
    ({"kind": "ddr5"}, ValueError), ({"latency": 0}, ValueError), ({"latency": 1.5}, ValueError),
    ({"bytes_per_cycle": 0.0}, ValueError), ({"clock_ns": 0.0}, ValueError), ({"clock_ns": 1001}, ValueError),
    ({"clock_ns": True}, ValueError), ({"clock_ns": "1"}, ValueError)])
def test_memories_that_are_none_are_refused(arguments, error):
    with pytest.raises(error, match="not "):
        MemoryModel(**arguments)


def test_two_eyes_need_a_machine_for_them(small):
    two = FrameTrace(small.width, small.height, small.points, small.sh_degree, small.view_shift, small.eyes * 2, small.holes,
                     0.0, {})
    with pytest.raises(ValueError, match="stereo"):
        simulate(two, PAPER)
    with pytest.raises(ValueError, match="display must be True"):
        simulate(two, PAPER.with_(stereo=True), display=False)


@pytest.mark.long
def test_two_eyes_and_smaller_machines_are_the_rtls_within_two_percent():
    if not (ROOT / "reports" / "model_rtl.json").is_file():
        pytest.skip("no reports/model_rtl.json: `msv2 study run model --rtl` makes it")
    rows = rtl_rows("model_rtl")
    assert {row["config"] for row in rows} >= {"paper_small"}
    assert any("target_cycles" in row for row in rows)
    for row in rows:
        assert abs(study.compared(row, study.model_row(row, EMBEDDED)[1])["total"]["error"]) <= study.TOTAL_GOAL
