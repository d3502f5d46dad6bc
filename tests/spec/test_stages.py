"""The table of stages: what it names exists, once each, and the registers watch what it says."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from spec import registers
from spec.stages import BY_NAME, STAGES, StagePhase, watched

ROOT = Path(__file__).parents[2]
NAMES = ("projection", "tile_test", "colour", "tile_lists_write", "tile_merge", "tile_lists_read", "sort", "handover", "fetch",
         "array", "pixel_write", "warp")


def module_file(name: str) -> Path:
    return ROOT / Path(*name.split(".")).with_suffix(".py")


def test_the_stages_in_the_order_of_the_data():
    assert tuple(stage.name for stage in STAGES) == NAMES == tuple(BY_NAME)
    phases = [stage.phase for stage in STAGES]
    assert phases == sorted(phases, key=list(StagePhase).index)


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_every_module_that_a_stage_names_exists(stage):
    for name in (*stage.golden, *stage.rtl, stage.suite):
        assert module_file(name).is_file(), f"{stage.name}: {name}"
    assert stage.rtl and stage.units and stage.title and stage.does.endswith(".")
    assert all(name.startswith("golden.msv2_ref.") for name in stage.golden) and stage.suite.startswith("tb.")


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_a_stage_without_a_golden_module_only_moves_data(stage):
    assert stage.golden or stage.name == "handover"


def test_units_are_registered_and_belong_to_one_stage():
    from rtl.units import UNITS

    units = [unit for stage in STAGES for unit in stage.units]
    assert max(Counter(units).values()) == 1 and set(units) <= set(UNITS)
    arithmetic = {name for name in UNITS if name.startswith(("float_", "fixed_"))}
    assert set(UNITS) - set(units) == arithmetic | {"axi_master", "register_file", "frame_controller"}  # they serve all stages


def test_counters_are_those_of_the_table():
    assert registers.STAGES == watched(StagePhase.GEOMETRY, StagePhase.RENDERING)
    assert registers.STEREO_STAGES == watched(StagePhase.SECOND_EYE)
    assert registers.STAGES == ("geometry", "projection", "tile_test", "colour", "entry_write", "list_read", "sort", "handover",
                                "fetch", "array", "pixel_write")
