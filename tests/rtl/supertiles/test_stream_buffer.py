"""The batch buffer of several streams in Verilator: each stream's visits and entries against the specification."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rtl.supertiles.stream_buffer import StreamBuffer
from spec.config import TINY_STREAMS, TINY_V3, V3
from tb.supertiles import stream_suite
from tb.supertiles.batch_device import Mode


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """The plan of TINY_STREAMS, and its outcome."""
    plan = stream_suite.unit_plan(TINY_STREAMS, 0)
    return plan, stream_suite.run_plan(TINY_STREAMS, plan, tmp_path_factory.mktemp("streams"))


def test_tiny_is_exact(tiny):
    plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 100_000


def test_streams_have_visits_of_their_own(tiny):
    plan, outcome = tiny
    item = next(item for item in plan if item.name == "random 1")
    assert len({len(stream.visits) for stream in item.streams}) > 1
    swapped = replace(item, streams=[item.streams[1], item.streams[0], *item.streams[2:]])
    recording = outcome.recordings["random 1"]
    assert stream_suite.problems(item, recording) == []
    assert {text[:9] for text in stream_suite.problems(swapped, recording)} == {"stream 0:", "stream 1:"}


def test_early_stops_leave_out_entries(tiny):
    plan, outcome = tiny
    left_out = 0
    for item in plan:
        if item.streams[0].mode in (Mode.AT_ONCE, Mode.AT_END):
            wanted = sum(len(visit.entries) for stream in item.streams for visit in stream.visits)
            left_out += wanted - sum(len(outcome.recordings[item.name].outputs[f"entries_{q}"]) for q in range(4))
    assert left_out > 1000


def test_a_count_over_streams_is_checked(tiny):
    plan, outcome = tiny
    item, recording = plan[0], outcome.recordings[plan[0].name]
    wrong = replace(recording, observed={**recording.observed, "visits_count": recording.observed["visits_count"] + 1})
    text, = stream_suite.problems(item, wrong)
    assert text.startswith("visits_count is ")
    rows = recording.outputs["entries_2"].copy()
    rows["depth"][np.flatnonzero(rows["end"] == 0)[0]] ^= 1
    assert stream_suite.problems(item, replace(recording, outputs={**recording.outputs, "entries_2": rows}))


def test_streams_of_both_eyes_are_exact(tmp_path):
    config = stream_suite.VARIANTS["tiny_eyes"]
    plan = [item for item in stream_suite.unit_plan(config, 0) if "joint" in item.name and "pauses" not in item.name]
    outcome = stream_suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == sum(item.run.abort is None for item in plan) > 12


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in stream_suite.VARIANTS if name != "tiny_streams"])
def test_other_machines_are_exact(name, tmp_path):
    config = stream_suite.VARIANTS[name]
    assert stream_suite.run_plan(config, stream_suite.unit_plan(config, 0), tmp_path).failures == {}


def test_one_stream_is_refused():
    with pytest.raises(ValueError, match=r"^streams must be more than 1 for this unit, not 1$"):
        StreamBuffer(V3)
    with pytest.raises(TypeError, match=r"^config must be an AcceleratorConfig, not 3$"):
        StreamBuffer(3)
    assert StreamBuffer(TINY_V3.with_(streams=4)).config.batch_banks == 8
