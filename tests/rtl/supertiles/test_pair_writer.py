"""Lists by super-tile in Verilator: pairs through memory and back with late answers, pauses, resets and no free space."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rtl.supertiles.pair_writer import PairWriter
from spec.config import TINY, TINY_V3, V3
from spec.memory import BEAT_ENTRIES
from tb.supertiles import lists_suite as suite
from tb.supertiles.lists_device import OBSERVED
from tests.helpers.rtl_streams import assert_rejected


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    plan = suite.full_plan(TINY_V3, 0)
    return plan, suite.run_plan(TINY_V3, plan, tmp_path_factory.mktemp("tiny"))


def test_tiny_is_exact_and_fast_enough(tiny):
    plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) > 40 and outcome.items > 100_000
    seen = [recording.observed for recording in outcome.recordings.values()]
    assert all(any(observed[name] for observed in seen) for name in OBSERVED if not name.endswith("busy"))
    assert len(suite.figures(TINY_V3, plan, outcome)) == 4


def test_beats_are_written_whole(tiny):
    """A write of pairs for every BEAT_ENTRIES of a list, and one for what is left of it."""
    plan, _ = tiny
    for item in plan:
        ends = np.flatnonzero(item.run.inputs["entries"]["end"])
        if item.name.startswith("rate"):
            beats = sum(
                (-(-np.bincount(frame["tile"][frame["end"] == 0]) // BEAT_ENTRIES)).sum()
                for frame in np.split(item.run.inputs["entries"], ends[:-1] + 1))
            assert (item.expected["written"]["strobe"] == 255).sum() == beats


def test_faults_are_found(tiny):
    plan, outcome = tiny
    item = next(item for item in plan if item.name.startswith("counts next to"))
    recording = outcome.recordings[item.name]
    assert suite.problems(item, recording) == []
    for port, rows in item.expected.items():
        for name in rows.dtype.names:
            wrong = rows.copy()
            wrong[name][3] ^= 1
            found = suite.problems(replace(item, expected={**item.expected, port: wrong}), recording)
            assert len(found) == 1 and found[0].startswith(f"{port} 3: ")
    assert suite.problems(replace(item, observed={"full": 1}), recording) == ["full is 0, not 1"]
    waits = recording.observed["waits"]
    assert suite.problems(replace(item, most_waits=waits - 1), recording) == [
        f"pairs wait in {waits} cycles, more than {waits - 1}"]


def test_bad_parameters_are_rejected():
    assert_rejected(lambda: PairWriter(TINY), ValueError, "tile")
    assert_rejected(lambda: PairWriter(TINY_V3, slots=17), ValueError, 17)
    assert_rejected(lambda: PairWriter(TINY_V3, slots="8"), TypeError, "8")
    assert PairWriter(TINY_V3.with_(list_heads=64)).list_count.shape().width == 7


@pytest.mark.long
def test_the_machines_writer_is_exact(tmp_path):
    assert suite.run_plan(V3, suite.full_plan(V3, 1), tmp_path).failures == {}
