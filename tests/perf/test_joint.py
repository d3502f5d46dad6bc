"""The cycle model of joint frames of two eyes, against the golden renderer's counts."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest

from golden.msv2_ref import projection
from golden.msv2_ref.buckets import no_bounds
from golden.msv2_ref.frame_memory import display_pixels
from golden.msv2_ref.frame_packing import display_bytes, pack_frame, table_writes
from golden.msv2_ref.joint import JointFrame, render_joint
from golden.msv2_ref.joint_batches import JointBatches
from golden.msv2_ref.pipeline import render_frame
from golden.scenes.files import read_json
from golden.scenes.request import parse_request, resolve
from golden.scenes.stereo import scene_scale, stereo_pair
from perf.geometry import CLOSES, ENDS, VISIBLE
from perf.joint_trace import joint_trace
from perf.model import MemoryModel
from perf.supertiles import SuperCycles, simulate_supertiles
from perf.supertiles_plan import visit_plan
from perf.supertiles_trace import SuperTrace, chunk_turns, load_trace, save_trace, super_trace
from spec.config import V3, V3_EYES
from spec.memory import BEAT_BYTES, DISPLAY_PIXEL_BYTES
from spec.paths import REPORTS

IDEAL = MemoryModel("ideal")
ARGUMENTS = ("embedded", "--size", "320x180", "--gaze", "160,90", "--levels", "4", "--levels-from", "random")


@pytest.fixture(scope="module")
def frame() -> JointFrame:
    asked = resolve(parse_request(*ARGUMENTS))
    pair = stereo_pair(asked.camera, ipd_metres=0.2, source_eye="right")
    return render_joint(asked.model, pair, config=V3, foveation=asked.foveation, background=asked.background)


@pytest.fixture(scope="module")
def trace(frame) -> SuperTrace:
    return joint_trace(frame)


@pytest.fixture(scope="module")
def alone(frame) -> SuperTrace:
    """The source's frame as one of one eye."""
    return super_trace(render_frame(V3, frame.source.words, frame.registers.source))


@pytest.fixture(scope="module")
def cycles(trace) -> SuperCycles:
    return simulate_supertiles(trace, V3, memory=IDEAL, display=True)


def test_the_trace_has_the_pairs_of_the_golden_frame(frame, trace):
    assert frame.registers.shift >= 1 and trace.shift == frame.registers.shift and trace.eyes == 2
    masks = frame.pairs.mask != 0
    assert trace.pairs == len(frame.pairs.splat)
    assert int(trace.step_pairs.sum()) == len(trace.pair_drops) - 1 == int(masks.sum())
    assert int(trace.pair_drops.sum()) == int(masks.all(axis=1).sum()) > 100
    assert int(trace.splat_steps.sum()) == len(trace.step_pairs) == len(trace.step_closes)
    assert np.count_nonzero(trace.step_closes == CLOSES) == len(trace.splat_steps) - 1 and trace.step_closes[-1] == ENDS
    visible = np.stack([eye.projected.reason == projection.VISIBLE for eye in frame.eyes])
    assert len(trace.splat_steps) == visible.sum() + 1 == np.count_nonzero(trace.point_class == VISIBLE)
    assert len(trace.point_class) == 2 * frame.counts["points"] + 1
    supertile, place = trace.grid
    for eye, grid in enumerate(frame.grids):
        mine = slice(eye * trace.eye_tiles, (eye + 1) * trace.eye_tiles)
        assert np.array_equal(supertile[mine], grid.supertile) and np.array_equal(place[mine], grid.place + 16 * eye)


def test_splats_of_both_eyes_are_tested_one_after_the_other(frame, trace):
    """The steps of each Gaussian, in the order in which Gaussians are read: those of the source's rows, then those of the
    target's; and the pairs that they give, of which those that the source has are dropped."""
    order = np.argsort(chunk_turns(frame.source.words.chunks["count"].astype(np.uint8)))
    of_splat = defaultdict(list)
    for pair in np.lexsort((frame.pairs.supertile, frame.pairs.splat)).tolist():
        of_splat[int(frame.pairs.splat[pair])].append(pair)
    steps, drops, arrival = [], [], []
    for splat in order.tolist():
        for eye, drawn in enumerate(frame.eyes):
            if drawn.projected.reason[splat] == projection.VISIBLE:
                first, last = drawn.projected.box[splat, 2:].astype(int)
                steps.append((last - first) // 2 + 1)
            given = [pair for pair in of_splat[splat] if frame.pairs.mask[pair, eye]]
            dropped = [bool(eye and frame.pairs.mask[pair, 0]) for pair in given]
            drops += dropped
            arrival += [pair for pair, drop in zip(given, dropped, strict=True) if not drop]
    assert trace.splat_steps[:-1].tolist() == steps
    assert trace.pair_drops[:-1].tolist() == drops and trace.arrival.tolist() == arrival


def test_visits_are_those_of_the_golden_frame(frame, trace):
    plan, batches = visit_plan(trace, V3), JointBatches(frame)
    wanted = batches.stream_visits()
    assert np.array_equal(plan.visit_tile, wanted.eye * trace.eye_tiles + wanted.tile)
    assert np.array_equal(plan.visit_final, wanted.final) and np.array_equal(plan.visit_entry, wanted.start)
    assert np.array_equal(plan.batch_supertile, batches.batches.supertile)
    assert plan.batch_places.sum() == len(batches.places.pair)
    first = {}
    for key, slot in zip(zip(batches.places.pair.tolist(), batches.places.eye.tolist(), strict=True),
                         batches.places.slot.tolist(), strict=True):
        first.setdefault(key, slot)
    eyes = np.repeat(wanted.eye, np.diff(wanted.start))
    pairs = [frame.pairs.intersection[eye][row] for eye, row in zip(eyes, wanted.order, strict=True)]
    assert plan.slot.tolist() == [first[int(pair), int(eye)] for pair, eye in zip(pairs, eyes, strict=True)]


def test_counters_are_the_golden_ones(frame, trace, cycles):
    events = JointBatches(frame).events
    assert (cycles.pairs, cycles.fetch_misses, cycles.batches) == tuple(
        events[name] for name in ("pairs", "header_misses", "batches"))
    assert cycles.entries == frame.counts["entries"]
    stages = {name: stage.busy for name, stage in cycles.stages.items()}
    assert stages["fetch"] == stages["sort"] == stages["handover"] == trace.pairs
    assert stages["projection"] == frame.counts["points"] + 1 + trace.pairs  # each of which is projected twice
    assert stages["tile_test"] == len(trace.splat_steps) + 2 * trace.pairs
    assert stages["batch"] == int(trace.places.sum()) == len(JointBatches(frame).places.pair)
    assert stages["colour"] == 2 * trace.pairs
    assert cycles.writes["frame"] == 2 * 320 * 180 * DISPLAY_PIXEL_BYTES
    assert cycles.reads["tiles"] == 2 * (32 * -(-20 * 12 // 4) + trace.supertiles * 128)


def test_two_eyes_cost_less_than_two_frames_and_more_than_one(frame, alone, trace, cycles):
    one = simulate_supertiles(alone, V3, memory=IDEAL, display=True)
    assert one.total < cycles.total < 2 * one.total
    assert one.reads["geometry"] <= cycles.reads["geometry"] < 1.05 * one.reads["geometry"]  # a chunk more is seen
    assert one.reads["colour"] < cycles.reads["colour"] < 1.4 * one.reads["colour"]
    assert cycles.phases["geometry"] > 1.2 * one.phases["geometry"]


def test_an_eye_beside_itself_has_the_sources_pairs(frame, alone):
    """Without a distance, both eyes see the same: lists, records and batches are the source's, and places twice as many."""
    asked = resolve(parse_request(*ARGUMENTS))
    pair = stereo_pair(asked.camera, ipd_metres=1e-12)
    same = joint_trace(render_joint(frame.source.words, pair, config=V3, foveation=asked.foveation))
    assert same.shift == 0 and same.pairs == alone.pairs and np.array_equal(same.splat, alone.splat)
    assert np.array_equal(same.places, 2 * alone.places) and int(same.pair_drops.sum()) == same.pairs
    got = simulate_supertiles(same, V3, memory=IDEAL, display=True)
    one = simulate_supertiles(alone, V3, memory=IDEAL, display=True)
    assert got.reads["colour"] == one.reads["colour"] and got.writes["entries"] == one.writes["entries"]
    assert got.stages["projection"].busy == one.stages["projection"].busy
    assert got.stages["tile_test"].busy == 2 * one.stages["tile_test"].busy - 1
    assert got.ops + got.skipped >= 1.9 * (one.ops + one.skipped)


def test_shared_colours_are_computed_once_for_a_pair(trace, cycles):
    shared = simulate_supertiles(trace, V3, memory=IDEAL, display=True, shared_colour=True)
    assert shared.stages["colour"].busy == 2 * trace.pairs and shared.stages["batch"].busy == cycles.stages["batch"].busy
    assert shared.ops + shared.skipped == cycles.ops + cycles.skipped and shared.total <= cycles.total


def test_four_streams_and_lpddr3(frame, trace):
    asked = resolve(parse_request(*ARGUMENTS))
    four = V3.with_(streams=4)
    other = joint_trace(render_joint(frame.source.words, stereo_pair(asked.camera, ipd_metres=0.2, source_eye="right"),
                                     config=four, foveation=asked.foveation))
    assert other.pairs == trace.pairs and other.streams == 4
    slow, fast = (simulate_supertiles(t, c, memory=IDEAL, display=True) for t, c in ((trace, V3), (other, four)))
    assert fast.total < slow.total
    assert simulate_supertiles(other, four, display=True).total > fast.total


def test_packed_frames_of_both_eyes(frame, trace, cycles):
    """Every block of either eye is written once, and a beat of a table wherever tiles that follow each other share none."""
    sizes = [pack_frame(display_bytes(display_pixels(eye))).sizes for eye in frame.eyes]
    assert np.array_equal(trace.blocks, np.concatenate(sizes))
    visits = JointBatches(frame).stream_visits()
    beats = sum(map(np.sum, sizes)) + table_writes(visits.tile[visits.final], visits.eye[visits.final])
    found = simulate_supertiles(trace, V3.with_(packed=True), memory=IDEAL, packed=True)
    assert found.writes["frame"] == BEAT_BYTES * beats < 0.8 * cycles.writes["frame"]
    assert found.reads == cycles.reads and found.stages["pixel_write"].busy == cycles.stages["pixel_write"].busy
    assert found.total < 1.02 * cycles.total
    with pytest.raises(ValueError, match="config must be a machine that packs frames, not 'v3'"):
        simulate_supertiles(trace, V3, memory=IDEAL, packed=True)


def test_traces_are_kept_as_they_are(trace, tmp_path):
    save_trace(trace, tmp_path / "kept.npz")
    again = load_trace(tmp_path / "kept.npz")
    assert again.eyes == 2 and again.shift == trace.shift
    for name in ("places_by_eye", "pair_drops", "pair", "step_pairs", "point_class"):
        assert np.array_equal(getattr(again, name), getattr(trace, name)), name


def test_cycles_are_those_of_the_full_machines_rtl():
    """The joint frames of the embedded scene in reports/frames_eyes.json, which the RTL of `v3_eyes` rendered after a reset."""
    rows = [row for row in read_json(REPORTS / "frames_eyes.json")["rows"]
            if (row["scene"], row["config"]) == ("embedded", V3_EYES.name)]
    assert [bool(row["gaze"]) for row in rows] == [False, True]
    for row in rows:
        gaze = ["--gaze", "{:g},{:g}".format(*row["gaze"]), "--levels", str(row["levels"]), "--levels-from", "random"
                ] if row["gaze"] else []
        asked = resolve(parse_request(
            row["scene"], "--camera", row["camera"], "--size", "{}x{}".format(*row["size"]), *gaze))
        pair = stereo_pair(asked.camera, units_per_metre=scene_scale(asked.model.name, None)[0])
        trace = joint_trace(render_joint(
            asked.model, pair, config=V3_EYES, foveation=asked.foveation, background=asked.background))
        memory = MemoryModel("ideal", latency=row["latency"], bytes_per_cycle=row["bytes_per_cycle"])
        found = simulate_supertiles(trace, V3_EYES, memory=memory, display=True, bounds=no_bounds(trace.supertiles))
        assert found.total == pytest.approx(row["frame_cycles"], rel=0.002)
        for phase in ("geometry", "render"):
            assert found.phases[phase] == pytest.approx(row[f"{phase}_cycles"], rel=0.005)
        assert {name: stage.busy for name, stage in found.stages.items()} == {
            name: stage["busy"] for name, stage in row["stage_cycles"].items()}
