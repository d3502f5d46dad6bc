"""What the model says of the RTL's inside is so."""

from __future__ import annotations

import pytest

from perf import constants, model
from rtl.chunks.chunk_test import ChunkTest
from rtl.chunks.geometry_decode import GeometryDecode
from rtl.culling.colour import LEAST_INTERVAL, ColourUnit
from rtl.culling.near import NearTest
from rtl.culling.projection import Projection
from rtl.culling.tile_test import TileTest
from rtl.vrc_array import blend, collect, row, setup
from rtl.warp_unit.disparity import disparity_latency
from rtl.warp_unit.fill import FILL_LATENCY
from rtl.warp_unit.pack import queue_groups
from rtl.warp_unit.queue import queue_rows, ring_tiles
from spec.config import CONFIGS, PAPER, PAPER_SMALL, PRESETS, TINY, V3, V3_RECORDS
from spec.stereo import disparity

UNITS = (1, 2, 4, 8)
MACHINES = [*(PAPER.with_(name=f"units_{units}", culling_units=units) for units in UNITS), *PRESETS.values(),
            PAPER.with_(name="degree_1", culling_units=4, sh_degree=1), TINY.with_(name="degree_2", sh_degree=2),
            *(V3_RECORDS.with_(name=f"records_{units}_{degree}", culling_units=units, sh_degree=degree)
              for units, degree in ((8, 3), (8, 2), (8, 1), (2, 3), (1, 0)))]


@pytest.mark.parametrize("config", MACHINES, ids=lambda config: config.name)
def test_datapaths_have_the_schedules_of_the_rtl(config):
    found = constants.culling(config)
    colour = ColourUnit(config, sh_degree=config.sh_degree)
    paths = [(NearTest(config).datapath, found.near), (Projection(config).datapath, found.projection),
             (TileTest(config)._ellipse, found.ellipse)]
    assert (colour._path is None) == (found.colour.length == 0)
    for path, timing in paths if colour._path is None else [*paths, (colour._path, found.colour)]:
        assert (path.schedule.length, path.schedule.interval, path.schedule.depth) == (
            timing.length, timing.interval, timing.rows)
    assert found.colour_waiting == colour._waiting


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("degree", range(4))
def test_colour_records_are_read_in_the_rtls_steps(units, degree):
    for largest in range(degree, 4):
        config = PAPER.with_(culling_units=units, sh_degree=largest)
        unit = ColourUnit(config, sh_degree=largest)._sum
        steps = [(step.base, step.end[degree]) for step in unit._degree_steps(degree)]
        assert constants.colour_steps(config, degree).tolist() == [list(step) for step in steps]


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("degree", range(4))
def test_compact_colour_records_take_the_rtls_steps(units, degree):
    config = V3_RECORDS.with_(culling_units=units, sh_degree=degree)
    unit = ColourUnit(config, sh_degree=degree)._sum
    for used in range(degree + 1):
        assert len(constants.colour_steps(config, used)) == unit._steps


@pytest.mark.parametrize("config", (V3, V3_RECORDS, V3_RECORDS.with_(name="wide", records="wide"),
                                    V3_RECORDS.with_(name="records_1", culling_units=1)), ids=lambda config: config.name)
def test_the_units_of_chunks_have_the_rtls_latencies(config):
    schedule, timing = ChunkTest(config).datapath.schedule, constants.culling(config).chunk_test
    assert (schedule.length, schedule.interval, schedule.depth) == (timing.length, timing.interval, timing.rows)
    assert constants.DECODE_STAGES == GeometryDecode.latency


@pytest.mark.parametrize("config", CONFIGS.values(), ids=lambda config: config.name)
def test_latencies_and_sizes_are_the_rtls(config):
    assert constants.LEAST_COLOUR_INTERVAL == LEAST_INTERVAL
    assert (constants.ROW_PIPELINE, constants.SUMS_LATER) == (row.PIPELINE, row.SUMS_LATER)
    assert (constants.BLEND_LATENCY, constants.SETUP_LATENCY) == (blend.BLEND_LATENCY, setup.LATENCY)
    s = model.warp.layout.new()
    model._set_array(s, _Size, config, True)
    blending = constants.BLEND_LATENCY if config.level_banks == 2 else 0
    assert s.row_latency == collect.place_latency(config) + blending + 3


class _Size:
    width, height, tiles_x = 64, 48, 4


@pytest.mark.parametrize("config", (TINY, PAPER_SMALL, PAPER, V3_RECORDS), ids=lambda config: config.name)
def test_the_warp_units_sizes_are_the_rtls(config):
    config = config.with_(stereo=True)
    assert disparity(config).width + constants.DISPARITY_STAGES == disparity_latency(config)
    assert constants.FILL_LATENCY == FILL_LATENCY
    s = model.warp.layout.new()
    model.set_warp(s, config, 3, False)
    assert s.warp_queue_depth == queue_groups(config)
    assert s.warp_depth == queue_rows(config)
    assert s.warp_settle_cycles == disparity_latency(config)
    assert s.warp_ring == ring_tiles(config) > s.warp_reach
