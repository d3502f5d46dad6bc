"""The batch buffer in Verilator: visits and entries against the specification and the golden renderer, speed, stops, and faults
put there on purpose; its latency in Amaranth's simulator."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from amaranth.hdl import Module

from rtl.emit import to_rtlil
from rtl.supertiles import batch_buffer
from rtl.supertiles.batch_buffer import LATENCY, BatchBuffer
from rtl.supertiles.batch_masks import BatchMasks
from rtl.supertiles.batch_visits import BatchVisits
from rtl.units import emit
from spec.config import PAPER, TINY, TINY_EYES, TINY_V3, V3
from spec.memory import splat_record
from spec.supertiles import batch_place, supertile, tile_visit, visit_entry
from tb.common.scenes import traced_frames, traced_joint_frames
from tb.supertiles import batch_suite
from tb.supertiles.batch_device import BatchBench, Mode
from tb.supertiles.batch_stimuli import Tiles, case_of, random_case, wanted_batches, wanted_visits
from tb.supertiles.joint_stimuli import JOINT, random_joint_case
from tests.helpers.rtl_ports import cycles_of, play, words_of
from tests.helpers.rtl_streams import assert_rejected

SMALL = TINY_V3.with_(batch_places=16)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """The plan of TINY_V3, and its outcome."""
    frames = traced_frames(TINY_V3, "128x128", ())
    plan = [*batch_suite.unit_plan(TINY_V3, 0), *batch_suite.rate_plan(TINY_V3, 0),
            *batch_suite.traced_plan(TINY_V3, frames)]
    return plan, batch_suite.run_plan(TINY_V3, plan, tmp_path_factory.mktemp("batch"))


def named(outcome, plan, name):
    """The planned run of this name, and its recording."""
    return next(item for item in plan if item.name == name), outcome.recordings[name]


def test_tiny_is_exact_and_fast_enough(tiny):
    plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 100_000
    assert sum(item.most_cycles is not None for item in plan) == 11


def test_a_place_and_an_entry_a_cycle(tiny):
    """Besides filling the first batch, next to no cycle passes without an entry where a batch takes longer to be dealt than to
    be filled."""
    plan, outcome = tiny
    for name in ("rate, 0.4 of the tiles", "traced embedded 128x128"):
        _, recording = named(outcome, plan, name)
        assert recording.items["entries"] / (recording.cycles - TINY_V3.batch_places) > 0.98
        assert recording.items["places"] > 20 * TINY_V3.batch_places


def test_stops_leave_entries_out(tiny):
    """Runs in which nothing is left out would prove nothing; whole visits and parts of visits are."""
    plan, outcome = tiny
    for mode in (Mode.AT_ONCE, Mode.AT_END, Mode.LATE):
        for kind in ("dense", "random"):
            item, recording = named(outcome, plan, f"{kind}, {mode.name.lower()} after 2")
            whole = sum(len(visit.entries) for visit in item.visits)
            assert recording.items["entries"] < 0.6 * whole and recording.items["visits"] < len(item.visits)
    item, recording = named(outcome, plan, "dense, at_once after 32")
    assert 0.5 * len(item.visits) < recording.items["visits"] < len(item.visits)
    item, recording = named(outcome, plan, "dense, at_once after 128")  # the last batch alone, where all tiles are visited
    assert recording.items["visits"] == len(item.visits)


def test_cases_meet_what_they_are_for():
    """The directed cases have empty and full batches, and pairs that end a batch in every possible way."""
    config, free = TINY_V3, set()
    for make in batch_suite.DIRECTED:
        batches = wanted_batches(config, make(config))
        free |= {config.batch_places - len(batch.places) for batch in batches}
        assert all(batch.final or config.batch_places - len(batch.places) < 4 for batch in batches)
    assert {0, 1, 2, 3, 4, config.batch_places} <= free


@pytest.mark.parametrize("fault", [
    lambda visits, entries: (np.delete(visits, 5), entries),
    lambda visits, entries: (visits, np.delete(entries, 0)),
    lambda visits, entries: (visits, np.delete(entries, np.flatnonzero(entries["end"])[7])),
    lambda visits, entries: (visits, changed(entries, 3, "use", 1)),
    lambda visits, entries: (visits, changed(entries, 3, "depth", 1)),
    lambda visits, entries: (changed(visits, 3, "fresh", 1), entries),
    lambda visits, entries: (changed(visits, 3, "sequence", 1), entries),
    lambda visits, entries: (changed(visits, len(visits) - 1, "final", 1), entries),
    lambda visits, entries: (visits[:-1], entries),
])
@pytest.mark.parametrize("name", ["random 0", "dense, at_once after 128", "random, late after 128"])
def test_faults_of_a_recording_are_found(tiny, name, fault):
    plan, outcome = tiny
    item, recording = named(outcome, plan, name)
    assert batch_suite.problems(item, recording) == []
    visits, entries = fault(*(recording.outputs[port].copy() for port in ("visits", "entries")))
    assert batch_suite.problems(item, replace(recording, outputs={"visits": visits, "entries": entries}))


def changed(rows, place, name, bit):
    """The rows with a bit of a field changed."""
    rows[name][place] ^= bit
    return rows


def test_entries_of_a_tile_that_has_not_stopped_may_not_be_missing(tiny):
    """The last entry of a whole visit, taken away where its tile has not reached its limit."""
    plan, outcome = tiny
    item, recording = named(outcome, plan, "dense, at_end after 128")
    entries = np.delete(recording.outputs["entries"], np.flatnonzero(recording.outputs["entries"]["end"])[0] - 1)
    found = batch_suite.problems(item, replace(recording, outputs={**recording.outputs, "entries": entries}))
    assert any("has not stopped" in text for text in found)


class HastyMasks(BatchMasks):
    """Masks whose words may be read before they are written."""

    def elaborate(self, platform: object) -> Module:
        m = super().elaborate(platform)
        m.d.comb += self.waiting.eq(0)
        return m


class HastyVisits(BatchVisits):
    """Visits of which the first item gives the half free."""

    def elaborate(self, platform: object) -> Module:
        m = super().elaborate(platform)
        m.d.comb += self.items.payload.closes.eq(1)
        return m


NEEDED = {"masks": ("only the last tile goes on",), "half": ("random 0",), "levels": ("ends of batches",)}
"""Runs that find each fault."""


@pytest.mark.parametrize("name", NEEDED)
def test_faults_of_the_unit_are_found(name, monkeypatch, tmp_path):
    """Masks read too early, halves written too early, and batches that close with too few free places."""
    if name == "levels":
        monkeypatch.setattr(batch_buffer, "MAX_LEVELS", 2)
    else:
        monkeypatch.setattr(batch_buffer, *{"masks": ("BatchMasks", HastyMasks), "half": ("BatchVisits", HastyVisits)}[name])
    playback = BatchBench(SMALL).playback(f"batch-fault-{name}", "batch_bench")
    plan = [item for item in batch_suite.unit_plan(SMALL, 0) if item.name in NEEDED[name]]
    outcome = batch_suite.exact.run_plan(playback, plan, tmp_path, judge=batch_suite.problems, watchdog=2000)
    assert outcome.failures


@pytest.fixture(scope="module")
def eyes(tmp_path_factory):
    """The plan of TINY_EYES, and its outcome."""
    frames = traced_joint_frames(TINY_EYES, "128x128")
    plan = [*batch_suite.unit_plan(TINY_EYES, 0), *batch_suite.rate_plan(TINY_EYES, 0),
            *batch_suite.joint_traced_plan(TINY_EYES, frames)]
    return plan, batch_suite.run_plan(TINY_EYES, plan, tmp_path_factory.mktemp("eyes"))


def test_frames_of_one_eye_and_of_two_are_exact_and_fast_enough(eyes):
    plan, outcome = eyes
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 200_000
    assert sum(item.most_cycles is not None and "joint" in item.name for item in plan) == 5  # by hand and traced
    item, recording = named(outcome, plan, "traced joint embedded 128x128, foveated")
    visits = recording.outputs["visits"]
    assert item.run.settings["shift"] == 3 and set(visits["eye"].tolist()) == {0, 1}
    source, target = (visits[visits["eye"] == eye] for eye in range(2))
    assert source["tile_x"].max() == target["tile_x"].max() == 7 and source["tile_x"].min() == target["tile_x"].min() == 0


@pytest.mark.parametrize("name", ["joint, outside", "joint, ends of batches", "joint, one eye", "joint 1"])
def test_faults_of_a_joint_recording_are_found(eyes, name):
    plan, outcome = eyes
    item, recording = named(outcome, plan, name)
    for field in ("eye", "tile_x"):
        visits = changed(recording.outputs["visits"].copy(), 3, field, 1)
        found = batch_suite.problems(item, replace(recording, outputs={**recording.outputs, "visits": visits}))
        assert len(found) == 1 and found[0].startswith("visits 3: ")


def test_joint_cases_meet_what_they_are_for():
    """Batches of joint frames end with fewer than 8 free places, with each number of them, and hold pairs of all kinds."""
    free, kinds = set(), set()
    for make in (*JOINT, lambda config: random_joint_case(config, "", 1)):
        case = make(TINY_EYES)
        batches = wanted_batches(TINY_EYES, case)
        free |= {TINY_EYES.batch_places - len(batch.places) for batch in batches if not batch.final}
        pair = np.cumsum(case.places["last"]) - case.places["last"]
        of_pair = [case.places["eye"][pair == number] for number in range(int(pair.max(initial=0)) + 1)]
        kinds |= {tuple(np.unique(eyes).tolist()) for eyes in of_pair}
    assert {0, 7} <= free <= set(range(8)) and {(0,), (1,), (0, 1)} <= kinds


@pytest.mark.long
@pytest.mark.parametrize("name", ["16-places", "v3", "16-places-eyes", "v3_eyes"])
def test_other_machines_are_exact(name, tmp_path):
    config = batch_suite.VARIANTS[name]
    plan = [*batch_suite.unit_plan(config, 1), *batch_suite.rate_plan(config, 1)]
    assert batch_suite.run_plan(config, plan, tmp_path).failures == {}


@pytest.mark.parametrize("tiles", [1, 2, 16])
def test_latency(tiles):
    """LATENCY cycles from the only place to its first entry, however many words of masks there are; then an item a cycle."""
    case = case_of(SMALL, "", [Tiles([(1 << tiles) - 1])], 0)
    dut = BatchBuffer(SMALL)
    feeds = {name: [record(SMALL).pack(row) for row in rows] for name, record, rows in (
        ("supertiles", supertile, case.supertiles), ("places", batch_place, case.places))}
    moves = play(dut, feeds, {"visits": 0.0, "entries": 0.0}, 80)
    first = cycles_of(moves, "entries")[0] - cycles_of(moves, "places")[0]
    assert first == LATENCY
    wanted = wanted_visits(SMALL, case)
    assert words_of(moves, "visits") == [tile_visit(SMALL).pack(visit.row) for visit in wanted]
    entries = [visit_entry(SMALL).unpack(word) for word in words_of(moves, "entries")]
    assert [entry["end"] for entry in entries] == [int(end) for visit in wanted for end in visit.entries["end"]]
    assert np.diff(cycles_of(moves, "entries")).tolist() == [1] * (len(entries) - 1)


def test_counts_restart_and_stay_without_counters():
    """`clear` between two frames; a machine without counters has none."""
    case = random_case(SMALL, "", 3, supertiles=3, mean_pairs=5)
    feeds = {name: [record(SMALL).pack(row) for row in rows] for name, record, rows in (
        ("supertiles", supertile, case.supertiles), ("places", batch_place, case.places))}
    batches, visits = len(wanted_batches(SMALL, case)), len(wanted_visits(SMALL, case))
    for config, wanted in ((SMALL, (batches, visits, 0, 0)), (SMALL.with_(counters=False), (0, 0, 0, 0))):
        dut, seen = BatchBuffer(config), []

        def each(ctx, cycle, dut=dut, seen=seen):
            ctx.set(dut.clear, cycle == 590)
            if cycle in (580, 595):
                assert not ctx.get(dut.busy)
                seen.extend((ctx.get(dut.batches), ctx.get(dut.visits_count)))

        play(dut, feeds, {"visits": 0.3, "entries": 0.3}, 600, pauses=0.3, each=each)
        assert tuple(seen) == wanted


@pytest.mark.parametrize(("config", "masks"), [(TINY_V3, (32, 64)), (V3, (32, 512)), (SMALL, (16, 32)), (TINY_EYES, (32, 128))])
def test_sizes(config, masks):
    """Two halves of records, and of words of masks for each tile."""
    found = {tuple(map(int, size)) for size in
             re.findall(r"memory width (\d+) size (\d+)", to_rtlil(BatchBuffer(config), "batch_buffer"))}
    assert found == {masks, (splat_record(config).width, 2 * config.batch_places)}


def test_units_are_registered_and_bad_parameters_are_refused():
    assert "module batch_buffer(" in emit("batch_buffer", TINY)
    for unit in (BatchBuffer, BatchMasks, BatchVisits):
        assert_rejected(lambda unit=unit: unit("tiny"), TypeError, "tiny")
        assert_rejected(lambda unit=unit: unit(PAPER), ValueError, "tile")
