"""The shapes of memories for any configuration are those of the RTL, which is elaborated unit by unit."""

from __future__ import annotations

import re
from collections import Counter

import pytest

from msv2.studies.area.stores import Store, stores
from rtl.supertiles.pair_expand import PairExpand
from rtl.supertiles.stream_buffer import StreamBuffer
from rtl.top.list_sets import ListSets
from rtl.top.splat_paths import SplatPaths
from rtl.units import UNITS
from rtl.vrc_array.batch_collect import BatchCollect
from rtl.vrc_array.collect import Collect
from rtl.vrc_array.pixel_state import PixelState
from spec.config import (
    DEFAULT,
    FAST,
    PAPER,
    PAPER_SMALL,
    TINY,
    TINY_EYES,
    TINY_OVERLAP,
    TINY_STREAMS,
    TINY_V3,
    V3,
    V3_EYES,
    V3_STREAMS,
    AcceleratorConfig,
)
from spec.constants import FLIP_FLOP_BITS
from spec.queues import OUTPUT_DRAINS
from synth.design import elaborate

MACHINES = {
    "tiny": TINY, "paper_small": PAPER_SMALL,
    "other": PAPER.with_(splat_cache_lines=512, sort_buffer_bytes=1 << 13, merge_ways=4, line_buffer_bytes=2048, row_width=720,
                         cores_x=8, depth=False),
    "whole": PAPER.with_(incremental=False, sort_buffer_bytes=1 << 12, merge_ways=16, splat_cache_lines=64),
}
LIKE = {
    "entry_writer": "entry_writer", "tile_merge_unit": "tile_merge_unit", "list_reader": "list_reader",
    "header_maker": "header_maker", "hierarchical_sorter": "hierarchical_sorter", "splat_fetch": "splat_fetch"}
"""Units whose memories are all exact, by their names in the registry and in the energy table."""


SUPERTILE_UNITS = {
    "record_fetch": "record_fetch", "batch_buffer": "batch_buffer", "depth_buckets": "depth_buckets",
    "pair_writer": "pair_writer", "supertile_reader": "supertile_reader", "list_reader": "list_reader",
    "tile_merge_unit": "tile_merge_unit", "hierarchical_sorter": "hierarchical_sorter"}
"""The same of machines with super-tiles."""


def of_rtl(component: object) -> Counter[tuple[int, int]]:
    """(words, width) of the memories of a component that are larger than flip-flops, with their number."""
    design = elaborate(component, "unit")
    counts, found = design.counts(), Counter()
    for name, text in design.texts.items():
        for width, words in re.findall(r"(?m)^\s+memory width (\d+) size (\d+) ", text):
            if int(width) * int(words) > FLIP_FLOP_BITS:
                found[int(words), int(width)] += counts[name]
    return found


def of_table(config: AcceleratorConfig, unit: str) -> Counter[tuple[int, int]]:
    return _shapes(store for store in stores(config) if store.unit == unit)


def _shapes(found: object) -> Counter[tuple[int, int]]:
    shapes: Counter[tuple[int, int]] = Counter()
    for store in found:
        if store.words * store.width > FLIP_FLOP_BITS:
            shapes[store.words, store.width] += store.count
    return shapes


@pytest.mark.parametrize("machine", [
    pytest.param(name, marks=() if name == "other" else pytest.mark.long) for name in MACHINES])
@pytest.mark.parametrize("unit", LIKE)
def test_memories_are_the_rtls(unit, machine):
    config = MACHINES[machine]
    assert of_table(config, LIKE[unit]) == of_rtl(UNITS[unit].make(config))


@pytest.mark.parametrize("config", [
    pytest.param(config, marks=() if config in (TINY_V3, TINY_EYES) else pytest.mark.long, id=config.name)
    for config in (TINY_V3, V3, DEFAULT, FAST, TINY_EYES, V3_EYES)])
@pytest.mark.parametrize("unit", SUPERTILE_UNITS)
def test_memories_of_machines_with_super_tiles_are_the_rtls(unit, config):
    assert of_table(config, SUPERTILE_UNITS[unit]) == of_rtl(UNITS[unit].make(config))


@pytest.mark.parametrize("config", [TINY_V3, TINY_EYES], ids=lambda config: config.name)
def test_the_pixel_states_memories_are_the_rtls(config):
    assert of_table(config, "pixel_state") == of_rtl(PixelState(config))


@pytest.mark.parametrize("config", [TINY_STREAMS, pytest.param(V3_STREAMS, marks=pytest.mark.long)],
                         ids=lambda config: config.name)
def test_memories_of_several_streams_are_the_rtls(config):
    """Those of the batch buffer, and of four arrays."""
    assert of_table(config, "batch_buffer") == of_rtl(StreamBuffer(config))
    collect = BatchCollect(config, lines=OUTPUT_DRAINS * config.array_y)
    for unit, component in (("pixel_state", PixelState(config)), ("array control and output", collect)):
        wanted = {shape: config.streams * count for shape, count in of_rtl(component).items()}
        assert of_table(config, unit) == wanted, unit


@pytest.mark.parametrize("config", [TINY_V3, V3, V3_EYES], ids=lambda config: config.name)
def test_the_queue_of_lines_is_the_rtls(config):
    lines, = (store for store in stores(config) if store.name == "lines" and store.unit == "supertile_test")
    assert Counter({(lines.words, lines.width): 1}) == of_rtl(PairExpand(config))


def test_memories_of_overlapped_phases_are_the_rtls():
    """Those of both frames in flight: lists, level tables and the tile tests' queues."""
    assert of_rtl(ListSets(TINY_OVERLAP)) == of_table(TINY_OVERLAP, "depth_buckets") + of_table(TINY_OVERLAP, "tile_merge_unit")
    found = of_rtl(SplatPaths(TINY_OVERLAP))
    for name, count in (("levels", 4), ("queue", 2), ("lines", 1)):
        store, = (store for store in stores(TINY_OVERLAP) if (store.unit, store.name) == ("supertile_test", name))
        assert store.count == count
        assert found[store.words, store.width] == count * (store.words * store.width > FLIP_FLOP_BITS)


def test_machines_with_super_tiles_have_no_memories_for_splat_records():
    units = {store.unit for store in stores(V3)}
    assert not units & {"splat_fetch", "header_maker"}
    assert {"record_fetch", "batch_buffer", "pixel_state", "depth_buckets"} <= units


@pytest.mark.parametrize("machine", MACHINES)
def test_the_handover_is_the_rtls(machine):
    config = MACHINES[machine]
    unit = "line_buffer" if config.incremental else "double_buffer"
    assert of_table(config, "line_buffer") == of_rtl(UNITS[unit].make(config))


@pytest.mark.parametrize("machine", ["tiny", "whole", pytest.param("other", marks=pytest.mark.long)])
def test_the_arrays_output_buffer_is_the_rtls(machine):
    config = MACHINES[machine]
    lines = OUTPUT_DRAINS * config.cores_y if config.incremental else None
    assert of_table(config, "array control and output") == of_rtl(Collect(config, lines=lines))


@pytest.mark.parametrize("change", [
    pytest.param({}, marks=pytest.mark.long), {"warp_lanes": 2, "warp_columns": 256, "cores_x": 8, "row_width": 960}], ids=str)
def test_the_warp_units_memories_are_the_rtls(change):
    config = PAPER.with_(stereo=True, **change)
    assert of_table(config, "warp_unit") == of_rtl(UNITS["warp_unit"].make(config))


@pytest.mark.long
@pytest.mark.parametrize("change", [{}, {"culling_units": 4}, {"row_width": 720}, {"stereo": True}], ids=str)
def test_the_tile_tests_memories_are_nearly_the_rtls(change):
    """Exact but for how a schedule groups the outputs of the ellipse test."""
    config = PAPER.with_(**change)
    table, rtl = of_table(config, "tile_test"), of_rtl(UNITS["tile_test"].make(config))
    assert sum((table & rtl).values()) >= sum(rtl.values()) - 2
    assert _bits(table) == pytest.approx(_bits(rtl), rel=0.03)


def _bits(shapes: Counter[tuple[int, int]]) -> int:
    return sum(words * width * count for (words, width), count in shapes.items())


def test_a_store_counts_its_bits():
    assert Store("unit", "name", "group", 8, 4, 3).bits == 96
