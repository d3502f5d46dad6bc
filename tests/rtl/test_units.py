"""The registry of units: names, descriptions, emission, and what it says of a name that it does not know."""

from __future__ import annotations

import re
from importlib.util import find_spec

import pytest

from rtl.units import TOP, UNITS, emit, named
from spec.config import TINY
from spec.errors import InputError

QUICK = ("fixed_to_float", "block_sequencer", "line_buffer", "table_loader", "saturation_counters")


@pytest.mark.parametrize("name", QUICK)
def test_a_unit_is_emitted_as_the_module_of_its_name(name: str) -> None:
    text = emit(name, TINY)
    assert len(re.findall(rf"(?m)^module {name}\(", text)) == 1 and emit(name, TINY) == text


def test_every_unit_says_what_it_is() -> None:
    assert TOP in UNITS and len({unit.doc for unit in UNITS.values()}) == len(UNITS)
    assert all(unit.doc and unit.stage and name.isidentifier() for name, unit in UNITS.items())
    assert [name for name, unit in UNITS.items() if unit.golden and not find_spec(unit.golden)] == []


def test_the_handover_is_that_of_the_machine() -> None:
    made = {incremental: type(UNITS["handover"].make(TINY.with_(incremental=incremental))) for incremental in (True, False)}
    assert made == {True: type(UNITS["line_buffer"].make(TINY)), False: type(UNITS["double_buffer"].make(TINY))}


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    with pytest.raises(InputError, match=r"unit 'tile_merge' is not known \(did you mean 'tile_merge_unit'\?\): msv2_top, "):
        named("tile_merge")
    with pytest.raises(InputError, match=r"unit 'zzz' is not known: msv2_top, pixel_core, "):
        emit("zzz", TINY)
