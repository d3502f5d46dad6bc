"""The energy of frames on machines with lists by super-tile."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from golden.msv2_ref import pipeline
from golden.scenes.request import parse_request, resolve
from msv2.studies.area.stores import stores
from msv2.studies.energy.frame import frame_energy
from msv2.studies.energy.memories import configured
from msv2.studies.energy.supertiles import GONE, OPERATIONS, super_counts, super_table
from msv2.studies.energy.table import load_table
from perf.model import MemoryModel
from perf.supertiles import simulate_supertiles
from perf.supertiles_trace import super_trace
from spec.config import V3, V3_STREAMS, V3_STREAMS_PACKED
from spec.constants import FLIP_FLOP_BITS, TILE
from spec.stages import SUPERTILE_STAGES


@pytest.fixture(scope="module")
def found():
    asked = resolve(parse_request("embedded", "--size", "128x96"))
    trace = super_trace(pipeline.render(asked.model, asked.camera, config=V3, foveation=asked.foveation))
    return trace, simulate_supertiles(trace, V3, memory=MemoryModel("lpddr3"), display=True)


def test_what_works_twice_is_counted_twice(found):
    trace, cycles = found
    counts = super_counts(trace, cycles)
    assert counts.projected == trace.points_read + trace.pairs and counts.tests == 2 * trace.pairs
    assert (counts.chunks, counts.lists) == (len(trace.chunk_count), cycles.lists)
    assert counts.state_rows == (cycles.visits - len(trace.counts)) * TILE and counts.activates == cycles.activates
    assert counts.of("sorted_entries") == trace.pairs + cycles.spilled_entries
    assert counts.of("places") == trace.places.sum()


def test_units_of_splat_records_are_gone_and_new_ones_have_rows(found):
    trace, cycles = found
    report = frame_energy(super_counts(trace, cycles), cycles.total, V3, super_table(load_table()))
    units = report.by_unit()
    assert not set(GONE) & set(units)
    for name in ("record_fetch", "batch_buffer", "pixel_state: sums", "depth_buckets"):
        assert units[name]["sram"] > 0 and units[name]["leakage"] > 0
    projection = next(row for row in report.rows if (row.unit, row.part) == ("projection_unit", "dynamic"))
    assert projection.operations == trace.points_read + trace.pairs
    assert report.chip_mj > 0 and report.sum_mj("dram") > 0


def test_each_unit_of_the_machine_is_measured_or_assumed():
    """Every unit of a stage that these machines have, once; the array's own memories beside it."""
    table = super_table(load_table())
    names = [unit.name for unit in table.units]
    assert len(names) == len(set(names))
    within = {"near_test", "projection", "geometry_decode", "chunk_sorter", "double_buffer", "handover"}  # others, or in others
    elsewhere = {"geometry_reader", "header_maker"}  # of the same stages in other machines
    wanted = {unit for stage in SUPERTILE_STAGES for unit in stage.units} - within - elsewhere - {"batch_array"}
    wanted -= {"stream_buffer", "stream_arrays", "row_join"}  # of machines with streams, for which the batch buffer stands
    assert wanted <= set(names) and {"setup", "pixel cores", "array rows", "array control and output"} <= set(names)
    assert set(OPERATIONS) | set(GONE) <= {unit.name for unit in load_table().units}


def test_every_row_says_where_it_comes_from(found):
    trace, cycles = found
    counts, table = super_counts(trace, cycles), super_table(load_table())
    for unit in table.units:
        counts.of(unit.operation)  # an operation that frames count
        assert re.match("gate-level simulation|clock and leakage of its netlist|assumed|as its", unit.source), unit
        shared = unit.name in {other.name for other in load_table().units}
        assert ("; on PAPER" in unit.source) == shared
    moved = {unit.name: unit.source for unit in table.units if unit.name in OPERATIONS}
    assert "where it counts entries in place of pairs" in moved["line_buffer"] and len(moved) == len(OPERATIONS)


def test_memories_of_measured_units_are_those_of_the_table():
    """The netlists' memories that are larger than flip-flops have the shapes that the table of memories gives them."""
    for unit in load_table().supertile_units:
        shapes = sorted((store.words, store.width) for store in stores(V3) for _ in range(store.count)
                        if store.unit == unit.name and store.words * store.width > FLIP_FLOP_BITS)
        found = sorted((m.words, m.width) for m in unit.memories if m.words * m.width > FLIP_FLOP_BITS)
        assert not shapes or unit.name in ("supertile_test", "pair_colour") or found == shapes, unit.name


def test_a_smaller_machine_has_smaller_memories():
    small, table = V3.with_(batch_places=128), super_table(load_table())
    of = next(unit for unit in table.units if unit.name == "batch_buffer")
    words = {name: {m.words for m in memories} for name, memories in (
        ("measured", of.memories), ("same", configured(of, V3)), ("small", configured(of, small)))}
    assert 1024 in words["measured"] and words["measured"] == words["same"]
    assert 256 in words["small"] and 1024 not in words["small"]


def test_the_units_of_streams_and_of_packed_frames_take_the_places_of_others():
    """Where they are measured; else those of one stream and of unpacked frames stand for them."""
    measured = load_table()
    bare = replace(measured, supertile_units=tuple(
        unit for unit in measured.supertile_units if unit.name not in ("stream_buffer", "frame_packer")))
    like = next(unit for unit in bare.supertile_units if unit.name == "batch_buffer")
    more = replace(bare, supertile_units=(*bare.supertile_units, replace(like, name="stream_buffer", operation="dealt"),
                                          replace(like, name="frame_packer", operation="pixels", memories=())))

    def names(table, config):
        return {unit.name: unit for unit in super_table(table, config).units}

    for table, config, there, gone in (
        (bare, V3_STREAMS_PACKED, "batch_buffer", "stream_buffer"), (more, V3_STREAMS_PACKED, "stream_buffer", "batch_buffer"),
        (more, V3_STREAMS_PACKED, "frame_packer", "batch_buffer"), (more, V3, "batch_buffer", "frame_packer")):
        assert there in names(table, config) and gone not in names(table, config)
    writer, rests, alone = (names(*given)["pixel_writer"] for given in (
        (more, V3), (more, V3_STREAMS_PACKED), (bare, V3_STREAMS_PACKED)))
    assert rests.dynamic_pj == 0 < writer.dynamic_pj == alone.dynamic_pj and rests.clock_pj == writer.clock_pj
    streams = names(more, V3_STREAMS_PACKED)["stream_buffer"]
    assert configured(streams, V3_STREAMS) == streams.memories != configured(streams, V3_STREAMS_PACKED)
