"""Tile lists in Verilator: entries through memory and back with late answers, pauses, resets and no room.

PAPER, and the trained scenes, are long.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from spec.config import PAPER, TINY
from tb.common.exact import problems
from tb.tile_lists import suite
from tb.tile_lists.device import OBSERVED

LATE = 180
"""Cycles without an entry that a frame's lists may begin with: its first directory beats, and a queue that is empty."""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    plan = [*suite.unit_plan(TINY, 0), *suite.rate_plan(TINY, 0)]
    return plan, suite.run_plan(TINY, plan, tmp_path_factory.mktemp("tiny"))


def test_tiny_is_exact(tiny):
    plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) > 60 and outcome.items > 300_000
    seen = [recording.observed for recording in outcome.recordings.values()]
    assert all(any(observed[name] for observed in seen) for name in OBSERVED if not name.endswith("busy"))


def test_lists_are_read_at_an_entry_a_cycle(tiny):
    plan, outcome = tiny
    rates = [item for item in plan if item.name.startswith("rate")]
    assert len(rates) == 5 == len(suite.figures(TINY, plan, outcome))
    for item in rates:
        assert item.run.settings["latency"] == 100
        assert outcome.recordings[item.name].observed["gaps"] <= 2 * LATE < len(item.expected["groups"]) / 8


def test_faults_are_found(tiny):
    plan, outcome = tiny
    item = next(item for item in plan if item.name.startswith("counts next to"))
    recording = outcome.recordings[item.name]
    assert problems(item, recording) == []
    for port, rows in item.expected.items():
        for name in rows.dtype.names:
            wrong = rows.copy()
            wrong[name][3] ^= 1
            found = problems(replace(item, expected={port: wrong}), recording)
            assert len(found) == 1 and found[0].startswith(f"{port} 3: ")
    assert problems(replace(item, observed={"full": 1}), recording) == ["full is 0, not 1"]


def test_the_embedded_scenes_lists(monkeypatch, tmp_path):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path / "absent"))
    plan = suite.traced_plan(TINY, "96x64")
    assert len(plan) == 2 and suite.run_plan(TINY, plan, tmp_path / "run").failures == {}


@pytest.mark.long
@pytest.mark.parametrize("config", [TINY, PAPER], ids=lambda config: config.name)
def test_scenes_and_the_papers_machine_are_exact(config, tmp_path):
    plan = suite.full_plan(config, 1)
    outcome = suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and len(suite.figures(config, plan, outcome)) >= 7
