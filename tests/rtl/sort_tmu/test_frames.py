"""Sorter and tile merge unit in Verilator: every suite's runs, and the comparison against faults put there on purpose.

PAPER, and the trained scenes, are long.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from spec.config import PAPER, TINY, TINY_V3
from spec.errors import InputError
from tb import sim
from tb.common.exact import problems
from tb.sort_tmu import chunk_suite as sort
from tb.sort_tmu import handover_suite as handover
from tb.sort_tmu import hierarchical_suite
from tb.sort_tmu import tile_merge_suite as tmu


def quick_plan(suite):
    plan = suite.unit_plan(TINY, 0)
    return [*plan, *sort.rate_plan(TINY, 0)] if suite is sort else plan


@pytest.fixture(scope="module", params=[tmu, sort], ids=["tmu", "sort"])
def tiny(request, tmp_path_factory):
    """A suite, its plan and outcome for TINY."""
    plan = quick_plan(request.param)
    return request.param, plan, request.param.run_plan(TINY, plan, tmp_path_factory.mktemp("tiny"))


def test_tiny_is_exact_and_fast_enough(tiny):
    suite, plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 5000
    if suite is sort:
        assert all("1.0000 entries a cycle" in line for line in sort.figures(TINY, plan, outcome))


def test_lists_of_supertiles_are_counted_and_grouped(tmp_path):
    plan = tmu.unit_plan(TINY_V3, 0)
    assert tmu.run_plan(TINY_V3, plan, tmp_path).failures == {}


def test_faults_are_found(tiny):
    suite, plan, outcome = tiny
    item = next(item for item in plan if item.name.startswith(("largest frame", "long and short")))
    recording, port = outcome.recordings[item.name], suite.PORTS[1]
    assert problems(item, recording) == []
    for name in item.expected[port].dtype.names:
        rows = item.expected[port].copy()
        rows[name][3] ^= 1
        wrong = problems(replace(item, expected={port: rows}), recording)
        assert len(wrong) == 1 and wrong[0].startswith(f"{port} 3: ")
    assert problems(replace(item, expected={port: item.expected[port][:-1]}), recording)[0].startswith(f"{port}: ")
    assert problems(replace(item, observed={"busy": 1}), recording) == ["busy is 0, not 1"]
    slow = problems(replace(item, least_rate={suite.PORTS[0]: 1.01}, most_cycles=10), recording)
    assert [line.split()[-1] for line in slow] == ["1.01", "10"]


@pytest.mark.long
@pytest.mark.parametrize("suite", [tmu, sort], ids=["tmu", "sort"])
@pytest.mark.parametrize("config", [TINY, PAPER], ids=lambda config: config.name)
def test_scenes_and_the_papers_machine_are_exact(suite, config, tmp_path):
    """The embedded scene always, trained ones where they are; rates are held by the plan."""
    plan = suite.full_plan(config, 1)
    outcome = suite.run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and len(suite.figures(config, plan, outcome)) >= 2


def test_traced_groups_of_the_embedded_scene(monkeypatch, tmp_path):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path / "absent"))
    for suite in (tmu, sort):
        plan = suite.traced_plan(TINY, "96x64")
        assert len(plan) >= 2 and suite.run_plan(TINY, plan, tmp_path / "run").failures == {}
    traced = [item for item in plan if item.name == "traced embedded 96x64"]
    items = traced[0].expected["sorted"]
    assert np.all(np.diff(items["tile"]) >= 0)  # groups, cut where they are too long, follow each other in tile order


def test_sim_knows_the_units(monkeypatch, capsys):
    with pytest.raises(InputError, match=r"'gpu' is not accepted: choose one of all, .*tmu.*sort"):
        sim.main(["--test", "gpu"])
    with pytest.raises(InputError, match="'tiny-1-level' is not accepted"):
        sim.main(["--test", "sort", "--config", "tiny-1-level"])
    for suite in (tmu, sort):
        monkeypatch.setattr(suite, "full_plan", lambda config, seed, suite=suite: quick_plan(suite))
    for suite in (hierarchical_suite, handover):
        monkeypatch.setattr(suite, "full_plan", lambda config, seed: [])
    assert sim.main(["--test", "sort", "--config", "tiny", "--runs", "rate, ties"]) == 0
    assert "chunks tiny: rate, ties: " in capsys.readouterr().out
