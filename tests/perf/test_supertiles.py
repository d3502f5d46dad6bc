"""The cycle model of machines with lists by super-tile, against the golden renderer and frames of the RTL."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref import pipeline, projection
from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.buckets import no_bounds
from golden.msv2_ref.supertiles import chunk_order
from golden.msv2_ref.tile_lists import tile_lists
from golden.scenes.request import parse_request, resolve
from perf.model import MemoryModel
from perf.supertiles import SuperCycles, simulate_supertiles
from perf.supertiles_plan import BEGINS, FILLS, lists_plan, steady_bounds, visit_plan
from perf.supertiles_trace import SuperTrace, load_trace, save_trace, super_trace
from spec.config import TINY_V3, V3, V3_RECORDS, V3_STREAMS
from spec.memory import BEAT_BYTES, BEAT_ENTRIES, DIRECTORY_BEATS, WORDS, pages_beyond_first
from spec.queues import LIST_POINTERS, LISTS_AHEAD
from spec.supertiles import BUCKET_PAIRS, BUCKETS

RTL = {"table": 171, "geometry": 9_977, "render": 34_732}
"""Cycles of the phases of SMALL through the RTL of `v3` (make frame CONFIG=v3), with the ideal memory; of `geometry` through
that of `tiny_v3` with its culling units (SET="culling_units=8"), whose first phase has the same rates."""

STREAMS_RTL = {"table": 171, "geometry": 9_975, "render": 24_211}
"""Cycles of the phases of SMALL with the gaze in its middle through the RTL of `v3_streams`, with the ideal memory."""

SMALL = ("embedded_trained", "--size", "128x128", "--levels", "4")

BUSY = {
    "geometry": 4553, "projection": 15_969, "tile_test": 12_655, "entry_write": 6935, "list_read": 1739, "sort": 6934,
    "handover": 6934, "fetch": 6934, "colour": 6934, "batch": 6934, "array": 13_123, "pixel_write": 1024}
"""Of the same frame, the items at each stage's input."""


def frame_of(*argv: str, config=V3) -> pipeline.Frame:
    asked = resolve(parse_request(*argv))
    return pipeline.render(
        asked.model, asked.camera, config=config, foveation=asked.foveation, background=asked.background)


@pytest.fixture(scope="module")
def foveated() -> pipeline.Frame:
    return frame_of("embedded", "--size", "320x180", "--gaze", "160,90", "--levels", "4", "--levels-from", "random")


@pytest.fixture(scope="module")
def trace(foveated) -> SuperTrace:
    return super_trace(foveated)


@pytest.fixture(scope="module")
def cycles(trace) -> SuperCycles:
    return simulate_supertiles(trace, V3, memory=MemoryModel("ideal"), display=True)


def test_cycles_are_the_rtls_within_a_percent():
    """A frame of whole beats: a frame after a reset, which has no bounds."""
    trace = super_trace(frame_of(*SMALL))
    found = simulate_supertiles(
        trace, V3, memory=MemoryModel("ideal"), display=False, bounds=no_bounds(trace.supertiles))
    for name, wanted in RTL.items():
        assert found.phases[name] == pytest.approx(wanted, rel=0.01), name
    assert {name: stage.busy for name, stage in found.stages.items()} == BUSY
    assert (found.pairs, found.fetch_misses, found.batches, found.visits, found.ops) == (6934, 143, 16, 251, 13_374)
    assert found.reads == {
        "geometry": 145_696, "tiles": 1024, "colour": 443_776, "entries": 55_648, "spill": 0, "chunks": 9760}
    assert found.writes == {"entries": 56_160, "spill": 0, "frame": 262_144}


def test_cycles_of_four_streams_are_the_rtls_within_a_percent():
    """A frame after a reset, with display pixels (make frame CONFIG=v3_streams)."""
    asked = (*SMALL, "--gaze", "64,64")
    trace = super_trace(frame_of(*asked, config=V3_STREAMS))
    found = simulate_supertiles(
        trace, V3_STREAMS, memory=MemoryModel("ideal"), display=True, bounds=no_bounds(trace.supertiles))
    for name, wanted in STREAMS_RTL.items():
        assert found.phases[name] == pytest.approx(wanted, rel=0.01), name
    assert found.ops == pytest.approx(36_450, rel=0.01) and found.stages["pixel_write"].busy == 1024
    one = simulate_supertiles(
        super_trace(frame_of(*asked)), V3, memory=MemoryModel("ideal"), display=True, bounds=no_bounds(trace.supertiles))
    assert found.phases["geometry"] == one.phases["geometry"] and found.phases["render"] < 0.9 * one.phases["render"]
    assert found.pairs == one.pairs and found.writes == one.writes
    halves = simulate_supertiles(trace, V3_STREAMS, memory=MemoryModel("ideal"), display=True, pipeline=False,
                                 bounds=no_bounds(trace.supertiles))
    assert found.total < halves.total < 1.5 * found.total and halves.stages["pixel_write"].busy == 1024


def test_the_trace_has_the_pairs_of_the_golden_frame(foveated, trace):
    assert trace.pairs == len(foveated.pairs.splat) == int(trace.step_pairs.sum())
    assert int(trace.splat_steps.sum()) == len(trace.step_pairs) == len(trace.step_closes)
    assert (trace.step_groups >= 1).all() and trace.step_groups.max() > 1
    np.testing.assert_array_equal(np.sort(trace.arrival), np.arange(trace.pairs))
    turn = np.empty(len(trace.chunk_count), np.int64)
    turn[chunk_order(len(turn))] = np.arange(len(turn))
    splat = turn[trace.chunk[trace.arrival]] * trace.points + trace.splat[trace.arrival]
    assert (np.diff(splat * trace.supertiles + trace.supertile[trace.arrival]) > 0).all()


def test_steps_are_two_rows_of_a_box_and_close_with_the_pairs_of_a_super_tile():
    """A box of two rows takes one step even where these lie in two super-tiles; its pairs of both leave together."""
    frame = frame_of("embedded", "--size", "96x64")
    trace, box = super_trace(frame), frame.projected.box[frame.projected.reason == projection.VISIBLE]
    rows = box[:, 3].astype(int) - box[:, 2] + 1
    assert sorted(trace.splat_steps[:-1]) == sorted((rows + 1) // 2)
    assert ((rows == 2) & (box[:, 2] % 2 == 1)).any() and trace.step_pairs.max() == 2
    firsts = np.cumsum(trace.splat_steps[:-1]) - trace.splat_steps[:-1]
    of = np.repeat(np.arange(len(firsts)), trace.splat_steps[:-1])
    pairs = np.bincount(of, trace.step_pairs[:-1])
    assert sorted(pairs[pairs > 0]) == sorted(np.bincount(frame.pairs.splat)[np.unique(frame.pairs.splat)])


def test_visits_are_those_of_the_golden_frame(foveated, trace):
    golden, found = FrameBatches(foveated), visit_plan(trace, V3)
    np.testing.assert_array_equal(found.batch_supertile, golden.batches.supertile)
    np.testing.assert_array_equal(found.visit_tile, golden.visits.tile)
    np.testing.assert_array_equal(found.visit_final, golden.visits.final)
    np.testing.assert_array_equal(found.visit_entry, golden.visits.start)
    np.testing.assert_array_equal(found.use, foveated.entries.use[golden.visits.order])
    np.testing.assert_array_equal(np.sort(found.drawn), np.arange(len(trace.counts)))
    assert found.batch_places.sum() == golden.place_counts.sum()
    fresh = found.visit_seen == 0
    assert fresh[golden.visits.fresh].all()


@pytest.mark.parametrize("more", (0, 3000))
def test_pairs_are_written_in_whole_beats_where_the_golden_lists_have_them(trace, more):
    """With `more`, all pairs are in one super-tile, whose list has pages of both beats of its directory."""
    if more:
        trace = replace(trace, start=np.where(np.arange(trace.supertiles + 1) > 1, trace.pairs, 0))
    bounds = no_bounds(trace.supertiles)
    found = lists_plan(trace, bounds)
    coming = found.number[trace.arrival]
    golden = tile_lists(coming, bounds.lists, 1 << 28)
    assert found.beats == golden.beats
    pages = found.writes[found.writes < 0]
    np.testing.assert_array_equal(-1 - pages, DIRECTORY_BEATS * golden.page_tile + golden.page_slot // WORDS)
    beats = found.writes[found.writes >= 0]
    assert len(beats) == len(np.unique(beats)) == int((-(-found.counts // BEAT_ENTRIES)).sum())
    np.testing.assert_array_equal(np.unique(golden.number // BEAT_ENTRIES), np.sort(beats))
    assert (found.pair_writes & BEGINS != 0).sum() == pages_beyond_first(found.counts).sum()
    assert (found.pair_writes & FILLS != 0).sum() + found.flushed.sum() == len(beats)


def test_buckets_keep_the_order_and_the_pairs_of_a_super_tile(trace):
    trace = replace(trace, start=np.where(np.arange(trace.supertiles + 1) > 1, trace.pairs, 0), key=np.sort(trace.key))
    bounds = steady_bounds(trace, V3)
    assert bounds.lists == trace.supertiles + (trace.pairs - 1) // BUCKET_PAIRS
    found = lists_plan(trace, bounds)
    assert (np.diff(found.number) >= 0).all()
    assert found.overflow(V3.sort_chunk) == 0
    assert lists_plan(trace, no_bounds(trace.supertiles)).overflow(V3.sort_chunk) == trace.pairs
    many = simulate_supertiles(trace, V3, memory=MemoryModel("ideal"))
    none = simulate_supertiles(trace, V3, memory=MemoryModel("ideal"), bounds=no_bounds(trace.supertiles))
    assert many.spilled_entries == 0 and many.overflow_share == 0
    assert none.spilled_entries >= trace.pairs and none.overflow_share == 1
    assert none.reads["spill"] == none.writes["spill"] >= BEAT_BYTES * trace.pairs // BEAT_ENTRIES
    assert none.total > many.total


def test_a_super_tile_of_as_many_lists_as_possible_ends():
    """The super-tile is known by its last list alone, long after the list reader has no space for the pages of more lists, and
    the sorter none for their pairs: the lists between must wait elsewhere. Where they cannot, the model reaches its limit."""
    asked = resolve(parse_request("embedded", "--size", "128x32"))
    model = asked.model.select(np.tile(np.arange(len(asked.model)), 4))
    trace = super_trace(pipeline.render(model, asked.camera, config=V3))
    bounds = steady_bounds(trace, V3)
    assert trace.supertiles == 1 and bounds.lists == BUCKETS <= LISTS_AHEAD
    counts = lists_plan(trace, bounds).counts
    pages = pages_beyond_first(counts)
    assert pages.min() >= 2 and 2 * pages[:-1].sum() > 3 * LIST_POINTERS
    for config in (V3, TINY_V3):
        found = simulate_supertiles(trace, config, memory=MemoryModel("ideal"), bounds=bounds)
        assert found.lists == BUCKETS and found.stages["fetch"].busy == found.stages["sort"].busy == trace.pairs
        assert found.reads["entries"] >= BEAT_BYTES * int((-(-counts // BEAT_ENTRIES)).sum())


def test_counters_add_up(trace, cycles):
    assert cycles.total == sum(cycles.phases.values())
    for stage in cycles.stages.values():
        assert stage.busy + stage.blocked + stage.starved == cycles.total
        assert min(stage.busy, stage.blocked, stage.starved) >= 0
    assert cycles.stages["fetch"].busy == cycles.stages["colour"].busy == trace.pairs
    assert cycles.stages["batch"].busy == trace.places.sum()
    assert "views" not in cycles.reads and "views" not in cycles.writes
    assert cycles.writes["frame"] == 4 * trace.width * trace.height
    assert cycles.ops + cycles.skipped >= trace.entries + 2 * cycles.visits


def test_memory_limits_frames_and_lpddr3_is_the_memory_where_none_is_named(trace, cycles):
    unlimited = simulate_supertiles(trace, V3, memory=MemoryModel("ideal", bytes_per_cycle=None), display=True)
    slow = simulate_supertiles(trace, V3, memory=MemoryModel("ideal", bytes_per_cycle=6.4), display=True)
    assert unlimited.total <= cycles.total < slow.total
    lpddr3 = simulate_supertiles(trace, V3, display=True)
    assert lpddr3.activates > 0 and lpddr3.total > cycles.total
    assert (lpddr3.reads, lpddr3.writes) == (cycles.reads, cycles.writes)


def test_a_smaller_machine_and_double_buffers_take_longer(trace, cycles):
    whole = simulate_supertiles(trace, V3, memory=MemoryModel("ideal"), display=True, pipeline=False)
    assert whole.total > cycles.total
    small = simulate_supertiles(trace, TINY_V3, memory=MemoryModel("ideal"), display=True)
    assert small.ops > 16 * trace.entries and small.total > small.ops


def test_traces_are_kept_as_they_are(trace, tmp_path):
    save_trace(trace, tmp_path / "trace.npz")
    again = load_trace(tmp_path / "trace.npz")
    for name, value in vars(trace).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(again, name), value)
        elif name != "record":
            assert getattr(again, name) == value
    (tmp_path / "trace.npz").write_bytes(b"broken")
    assert load_trace(tmp_path / "trace.npz") is None


def test_frames_without_super_tiles_and_machines_of_lower_degrees_are_refused(trace):
    with pytest.raises(ValueError, match="super-tiles, not 'v3_records'"):
        super_trace(frame_of("embedded", "--size", "64x64", config=V3_RECORDS))
    with pytest.raises(ValueError, match="lists must be 'supertile'"):
        simulate_supertiles(trace, V3_RECORDS)
    with pytest.raises(ValueError, match="SH degree 3"):
        simulate_supertiles(trace, V3.with_(sh_degree=2))
