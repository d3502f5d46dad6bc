"""The phases of machines with super-tiles: what they refuse, and that they are all that such a machine has."""

from __future__ import annotations

import pytest

from rtl.top import bin_phase, gather_phase, geometry_phase, machine, overlap, render_phase
from rtl.top.list_sets import ListSets
from rtl.top.overlap_controller import OverlapController
from rtl.top.splat_path import SplatPath
from rtl.top.splat_paths import SplatPaths
from spec import registers
from spec.config import TINY, TINY_OVERLAP, TINY_STREAMS, TINY_V3, V3, V3_STREAMS

UNITS = (bin_phase.BinPhase, gather_phase.GatherPhase, SplatPath)


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.__name__)
def test_other_machines_are_refused(unit):
    with pytest.raises(TypeError, match="config must be an AcceleratorConfig, not 'tiny'"):
        unit("tiny")
    with pytest.raises(ValueError, match="lists must be 'supertile' for this unit, not 'tile'"):
        unit(TINY)
    few = TINY_V3.with_(list_heads=8)
    with pytest.raises(ValueError, match="list_heads must be at least 64 for rows of 512 pixels, not 8"):
        unit(few)


@pytest.mark.parametrize("config", [TINY_V3, V3, V3_STREAMS], ids=lambda config: config.name)
def test_clients_and_stages_are_those_of_both_phases(config):
    assert {*bin_phase.READERS, *gather_phase.READERS} == set(registers.read_clients(config))
    assert set(bin_phase.READERS) & set(gather_phase.READERS) == {"tiles", "chunks"}
    assert sorted((*bin_phase.WRITERS, *gather_phase.WRITERS)) == sorted(registers.write_clients(config))
    assert bin_phase.STAGES + gather_phase.STAGES == registers.stages(config)


def test_clients_of_overlapped_phases_are_apart():
    first, second = bin_phase.BinPhase(TINY_OVERLAP), gather_phase.GatherPhase(TINY_OVERLAP)
    found = {name: overlap.users(name, first, second) for name in registers.read_clients(TINY_OVERLAP)}
    assert [len(users) for users in found.values()] == [1, 1, 1, 1, 1, 1, 2]
    assert found["first"] == [(first.reads_tiles, first.data_tiles), (first.reads_chunks, first.data_chunks)]
    assert found["tiles"] == [(second.reads_tiles, second.data_tiles)]


@pytest.mark.parametrize("unit", [SplatPaths, ListSets, OverlapController], ids=lambda unit: unit.__name__)
def test_units_of_overlapped_phases_are_of_such_machines(unit):
    with pytest.raises(TypeError, match="config must be an AcceleratorConfig, not 'tiny'"):
        unit("tiny")
    with pytest.raises(ValueError, match="overlap must be True, not False"):
        unit(TINY_V3)


def test_every_event_has_one_source():
    for config in (TINY_V3, TINY_STREAMS, TINY_OVERLAP):
        units = bin_phase.BinPhase(config), gather_phase.GatherPhase(config)
        for name in registers.events(config):
            assert sum(name in unit.signature.members for unit in units) == 1, name


def test_each_machine_has_its_own_phases():
    for config, phases in ((TINY, (geometry_phase.GeometryPhase, render_phase.RenderPhase)),
                           (TINY_V3, (bin_phase.BinPhase, gather_phase.GatherPhase))):
        assert machine.phases(config) == phases


def test_machines_with_super_tiles_have_rows_of_more_than_two_tiles():
    assert machine.Machine(TINY.with_(row_width=16)).config.row_width == 16
    with pytest.raises(ValueError, match=r"^row_width must be more than 32 in a machine with lists by super-tile, not 32$"):
        machine.Machine(TINY_V3.with_(row_width=32))
