"""The cycle model of any machine: each kind of lists has its trace and its simulation, and none is mistaken for the other."""

from __future__ import annotations

import numpy as np
import pytest

from golden.msv2_ref import pipeline
from msv2.studies.energy.frame import frame_energy, model_counts
from msv2.studies.energy.modelled import modelled_energy
from msv2.studies.energy.supertiles import super_counts, super_table
from msv2.studies.energy.table import load_table
from perf import model, supertiles
from perf.frames import simulate, trace_of
from perf.model import MemoryModel
from perf.supertiles_trace import SuperTrace
from perf.trace import FrameTrace
from spec.config import TINY, TINY_V3
from tests.helpers.golden_samples import random_model, turned_view

MEMORY = MemoryModel("ideal")


@pytest.fixture(scope="module")
def traces():
    """By machine, the trace of the same frame."""
    seen, camera = random_model(np.random.default_rng(3), 200, sh=1), turned_view(64, 48)
    return {config: trace_of(pipeline.render(seen, camera, config=config), record={"seed": 3}) for config in (TINY, TINY_V3)}


def test_each_machine_has_its_trace_and_its_simulation(traces):
    assert [type(trace) for trace in traces.values()] == [FrameTrace, SuperTrace]
    assert all(trace.record == {"seed": 3} and trace.golden_seconds > 0 for trace in traces.values())
    tile, supertile = (simulate(trace, config, memory=MEMORY) for config, trace in traces.items())
    assert tile.total == model.simulate(traces[TINY], TINY, memory=MEMORY).total and "views" in tile.reads
    other = supertiles.simulate_supertiles(traces[TINY_V3], TINY_V3, memory=MEMORY)
    assert supertile.total == other.total and "views" not in supertile.reads and "batch" in supertile.stages


def test_a_trace_of_the_other_kind_is_refused(traces):
    with pytest.raises(ValueError, match="config must be a machine with lists by tile, like the trace, not 'tiny_v3'"):
        simulate(traces[TINY], TINY_V3, memory=MEMORY)
    with pytest.raises(ValueError, match="lists must be 'supertile'"):
        simulate(traces[TINY_V3], TINY, memory=MEMORY)


def test_each_machine_has_its_energies(traces):
    table, (tile, supertile) = load_table(), (simulate(trace, config, memory=MEMORY) for config, trace in traces.items())
    found = modelled_energy(traces[TINY], tile, TINY, table, clock_hz=5e8)
    assert found.as_json() == frame_energy(
        model_counts(traces[TINY], tile), tile.total, TINY, table, clock_hz=5e8).as_json()
    trace = traces[TINY_V3]
    found = modelled_energy(trace, supertile, TINY_V3, table)
    assert found.as_json() == frame_energy(
        super_counts(trace, supertile, TINY_V3), supertile.total, TINY_V3, super_table(table, TINY_V3)).as_json()
    assert "record_fetch" in found.by_unit() and "splat_fetch" not in found.by_unit()
