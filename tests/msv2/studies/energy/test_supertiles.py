"""The energy of frames on machines with lists by super-tile."""

from __future__ import annotations

import pytest

from golden.msv2_ref import pipeline
from golden.scenes.request import parse_request, resolve
from msv2.studies.area.super_stores import super_stores
from msv2.studies.energy.frame import frame_energy
from msv2.studies.energy.supertiles import super_counts, super_table
from msv2.studies.energy.table import load_table
from perf.model import MemoryModel
from perf.supertiles import simulate_supertiles
from perf.supertiles_trace import super_trace
from spec.config import V3
from spec.constants import TILE


@pytest.fixture(scope="module")
def found():
    asked = resolve(parse_request("embedded", "--size", "128x96"))
    trace = super_trace(pipeline.render(asked.model, asked.camera, config=V3, foveation=asked.foveation))
    return trace, simulate_supertiles(trace, V3, memory=MemoryModel("lpddr3"), display=True)


def test_what_works_twice_is_counted_twice(found):
    trace, cycles = found
    counts = super_counts(trace, cycles)
    assert counts.projected == trace.points_read + trace.pairs and counts.tested == 2 * trace.entries
    assert counts.state_rows == (cycles.visits - len(trace.counts)) * TILE and counts.activates == cycles.activates
    assert counts.of("sorted_entries") == trace.pairs + cycles.spilled_entries
    assert counts.of("places") == trace.places.sum()


def test_units_of_splat_records_are_gone_and_new_memories_have_rows(found):
    trace, cycles = found
    report = frame_energy(super_counts(trace, cycles), cycles.total, V3, super_table(load_table(), trace))
    units = report.by_unit()
    assert not {"splat_fetch", "header_maker"} & set(units)
    for name in ("record_fetch: beats", "batch_buffer: records", "pixel_state: sums", "depth_buckets: bounds"):
        assert units[name]["sram"] > 0 and units[name]["leakage"] > 0
    projection = next(row for row in report.rows if (row.unit, row.part) == ("projection_unit", "dynamic"))
    assert projection.operations == trace.points_read + trace.pairs
    assert report.chip_mj > 0 and report.sum_mj("dram") > 0


def test_each_new_memory_is_counted_by_some_operation(found):
    table = super_table(load_table(), found[0])
    measured = {unit.name for unit in load_table().units}
    named = {unit.name for unit in table.units}
    for store in super_stores(V3):
        assert store.unit in measured or f"{store.unit}: {store.name}" in named or store.name in (
            "of lists", "of super-tiles", "ends", "counts", "lists"), store
