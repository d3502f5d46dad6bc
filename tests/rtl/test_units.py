"""The registry of units: names, descriptions, emission, and what it says of a name that it does not know."""

from __future__ import annotations

import re

import pytest
from amaranth.lib import wiring

from rtl.units import TOP, UNITS, emit, named, stage_of
from spec.config import MACHINES, TINY, AcceleratorConfig
from spec.errors import InputError
from spec.stages import EVERY_STAGE

QUICK = ("fixed_to_float", "block_sequencer", "line_buffer", "table_loader", "saturation_counters")


@pytest.mark.parametrize("name", QUICK)
def test_a_unit_is_emitted_as_the_module_of_its_name(name: str) -> None:
    text = emit(name, TINY)
    assert len(re.findall(rf"(?m)^module {name}\(", text)) == 1 and emit(name, TINY) == text


def test_every_unit_says_what_it_is() -> None:
    assert TOP in UNITS and len({unit.doc for unit in UNITS.values()}) == len(UNITS)
    assert all(unit.doc and name.isidentifier() for name, unit in UNITS.items())
    assert {stage_of(name) for name in UNITS} == {*(stage.name for stage in EVERY_STAGE), "machine", "arithmetic"}
    assert (stage_of("splat_fetch"), stage_of("float_add"), stage_of(TOP)) == ("fetch", "arithmetic", "machine")


def test_the_handover_is_that_of_the_machine() -> None:
    for incremental, name in ((True, "line_buffer"), (False, "double_buffer")):
        config = TINY.with_(incremental=incremental)
        assert emit("handover", config) == emit(name, config).replace(name, "handover")


@pytest.mark.parametrize("config", MACHINES.values(), ids=lambda config: config.name)
def test_single_units_of_v3_can_be_made_for_every_machine(config: AcceleratorConfig) -> None:
    """Those of other machines come with V3's lists: the refusals of a whole machine must not reach a single unit."""
    for name in ("chunk_reader", "supertile_clip", "depth_buckets", "batch_array"):
        assert isinstance(UNITS[name].make(config), wiring.Component)


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(InputError, match=r"unit 'tile_merge' is not accepted: .*tile_test.*; did you mean 'tile_merge_unit'\?"):
        named("tile_merge")
    with pytest.raises(InputError, match=r"unit 'zzz' is not accepted: choose one of msv2_top, .*frame_controller$"):
        emit("zzz", TINY)
