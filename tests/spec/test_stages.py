"""The table of stages: what it names exists, once each, and the registers watch what it says."""

from __future__ import annotations

from collections import Counter
from importlib import import_module

import pytest

from rtl.units import UNITS
from spec import registers
from spec.sources import module_file
from spec.stages import BY_NAME, EVERY_STAGE, PACKED_STAGES, STAGES, SUPERTILE_STAGES, StagePhase, watched
from tb.sim import UNITS as TESTS

NAMES = ("chunk_test", "chunk_read", "projection", "tile_test", "colour", "tile_lists_write", "tile_merge", "tile_lists_read",
         "sort", "handover", "fetch", "array", "pixel_write", "warp")


def test_the_stages_in_the_order_of_the_data():
    assert tuple(stage.name for stage in STAGES) == NAMES == tuple(BY_NAME)
    for table in (STAGES, SUPERTILE_STAGES):
        phases = [stage.phase for stage in table]
        assert phases == sorted(phases, key=list(StagePhase).index)
    names = [stage.name for stage in EVERY_STAGE]
    assert len(set(names)) == len(names) and set(EVERY_STAGE) == {*STAGES, *SUPERTILE_STAGES, *PACKED_STAGES}


@pytest.mark.parametrize("stage", EVERY_STAGE, ids=lambda stage: stage.name)
def test_every_module_that_a_stage_names_exists(stage):
    for name in (*stage.golden, *stage.rtl, *stage.suites):
        assert module_file(name), f"{stage.name}: {name}"
    assert stage.rtl and stage.units and stage.title and stage.does.endswith(".")
    known = ("golden.msv2_ref.", "golden.host.compact", "golden.host.packed_frame")
    assert all(name.startswith(known) for name in stage.golden) and stage.suites


@pytest.mark.parametrize("stage", EVERY_STAGE, ids=lambda stage: stage.name)
def test_a_stage_without_a_golden_module_only_moves_data(stage):
    assert stage.golden or stage.name == "handover"


def test_units_are_registered_and_belong_to_one_stage():
    units = [unit for stage in EVERY_STAGE for unit in stage.units]
    assert max(Counter(units).values()) == 1 and set(units) <= set(UNITS)
    arithmetic = {name for name in UNITS if name.startswith(("float_", "fixed_"))}
    shared = {"axi_master", "register_file", "frame_controller", "saturation_counters", "msv2_top"}
    assert set(UNITS) - set(units) == arithmetic | shared  # they serve all stages


def test_counters_are_those_of_the_table():
    assert registers.STAGES == watched(StagePhase.GEOMETRY, StagePhase.RENDERING)
    assert registers.STEREO_STAGES == watched(StagePhase.SECOND_EYE)
    assert registers.STAGES == ("geometry", "projection", "tile_test", "colour", "entry_write", "list_read", "sort", "handover",
                                "fetch", "array", "pixel_write")
    assert registers.SUPERTILE_STAGES == watched(StagePhase.GEOMETRY, StagePhase.RENDERING, supertiles=True)


def test_suites_are_those_that_the_simulation_command_runs():
    for stage in EVERY_STAGE:
        assert {import_module(name) for name in stage.suites} <= set(TESTS[stage.test].values()), stage.name
    tests = {name for name, suites in TESTS.items() for suite in suites.values()
             if suite.__name__ in {module for stage in EVERY_STAGE for module in stage.suites}}
    assert tests == {stage.test for stage in EVERY_STAGE} == set(TESTS) - {"float", "axi", "top"}
    listed = {module for stage in EVERY_STAGE for module in stage.suites}
    assert all(suite.__name__ in listed for name in tests for suite in TESTS[name].values())
