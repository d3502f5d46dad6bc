"""The memories of a machine that are large enough to be SRAM, for any configuration, without elaborating its RTL.

Elaborating a machine takes half a minute; a sweep over configurations has a fraction of a second for each. The shapes here are
those of the RTL's memories (tests/msv2/studies/area/test_stores.py compares them with elaborated units). Only the outputs of
the culling datapaths are approximate: a schedule decides how they are grouped, so PAPER's groups are used, with as many rows as
the configuration's schedules need and widths in proportion to the records.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from msv2.studies.area.store import Store
from msv2.studies.area.super_stores import super_stores
from perf.constants import culling
from spec.config import PAPER, AcceleratorConfig
from spec.constants import ENTRY_BYTES, FLIP_FLOP_BITS, TILE
from spec.memory import (
    BEAT_BITS,
    BEAT_ENTRIES,
    DIRECTORY_SLOTS,
    FIRST_PAGE_BEATS,
    FIRST_PAGE_ENTRIES,
    read_data,
    splat_record,
    write_request,
)
from spec.queues import (
    CACHE_WAYS,
    HEADER_TILES,
    HEADERS,
    LEVEL_GROUP,
    LIST_POINTERS,
    LIST_TILES,
    OUTPUT_DRAINS,
    TILE_TEST_BESIDE,
    VIEWS_PENDING,
    read_depths,
)
from spec.records import (
    COUNT_BITS,
    INDEX_BITS,
    frame_lists,
    frame_tiles,
    gaussian_point,
    intersection,
    list_index,
    pixel_row,
    projected_splat,
    surviving_splat,
    tile_header,
    tile_index,
)
from spec.registers import read_clients
from spec.stereo import disparity
from synth.machine import BLENDING, COLOUR, CULLING, LISTS, SORTING, WARP

_WAY_BEATS = 32
"""Beats that the FIFO of a merge way holds."""


_TWICE = ("projection_unit", "supertile_test", "tile_merge_unit", "depth_buckets")
"""Units with memories of which machines with overlapped phases have two: output queues of shared datapaths, one for each phase,
and level tables and lists, one for each frame in flight."""

_OF_ONE_PHASE = (("supertile_test", "lines"),)
"""Memories of such units that only one phase uses."""


def stores(config: AcceleratorConfig) -> tuple[Store, ...]:
    """The memories of a machine. Those that are always too small for SRAM are left out: they are part of a unit's logic."""
    if config.supertiles:
        found = [*_queues(config), *_projection(config), *_sorting(config), *super_stores(config), *_output(config)]
        return tuple(_of_both_phases(store) if config.overlap else store for store in found)
    found = [*_queues(config), *_projection(config), *_culling(config), *_lists(config), *_sorting(config), *_drawing(config)]
    return (*found, *_warp(config)) if config.stereo else tuple(found)


def _of_both_phases(store: Store) -> Store:
    """A memory as it is in machines whose phases overlap: twice where both phases use one."""
    twice = store.unit in _TWICE and (store.unit, store.name) not in _OF_ONE_PHASE
    return replace(store, count=2 * store.count) if twice else store


def _queues(config: AcceleratorConfig) -> Iterator[Store]:
    width = read_data(PAPER).width
    depths = read_depths(config)
    for client in read_clients(config):  # one word of each queue is its output register
        yield Store("memory queues", client, LISTS, depths[client] - 1, width)


def _projection(config: AcceleratorConfig) -> Iterator[Store]:
    paths, here = culling(config), projected_splat(config).width / projected_splat(PAPER).width
    near = gaussian_point(config).width / gaussian_point(PAPER).width
    for width in (194, 84):
        yield Store("projection_unit", f"near {width}", CULLING, paths.near.rows, round(near * width))
    for width in (185, 24, 50, 42, 22, 44):
        yield Store("projection_unit", f"projection {width}", CULLING, paths.projection.rows, round(here * width))


def _culling(config: AcceleratorConfig) -> Iterator[Store]:
    paths = culling(config)
    for width in (33, 21):
        yield Store("tile_test", f"ellipse {width}", CULLING, paths.ellipse.rows, width)
    rows = -(-config.row_width // TILE)
    codes = (2 if config.levels > 1 else 0) + (config.level_banks == 2) + config.stereo
    groups = 1 << (-(-rows // LEVEL_GROUP) - 1).bit_length() if rows > LEVEL_GROUP else 1
    yield Store("tile_test", "starts", CULLING, rows, tile_index(config).width)
    if codes:
        yield Store("tile_test", "levels", CULLING, rows * groups, LEVEL_GROUP * codes)
    kept = surviving_splat(config).width - 1 - _levels_width(config) + _key_width(config)
    yield Store("tile_test", "queue", CULLING, paths.ellipse.rows + TILE_TEST_BESIDE - 1, kept)
    if paths.colour.rows:
        yield Store("colour_unit", "path", COLOUR, paths.colour.rows, 160 if config.compact else 220)
    waiting = surviving_splat(config).width - 1 - (config.formats.log2_opacity.width if config.compact else 0)
    yield Store("colour_unit", "waiting", COLOUR, paths.colour_waiting - 1, waiting)


def _levels_width(config: AcceleratorConfig) -> int:
    return next(field.format.width for field in surviving_splat(config).fields if field.name == "levels")


def _key_width(config: AcceleratorConfig) -> int:
    return next(field.format.width for field in projected_splat(config).fields if field.name == "depth_key")


def _lists(config: AcceleratorConfig) -> Iterator[Store]:
    tiles, unit = frame_tiles(config), BEAT_BITS - (FIRST_PAGE_BEATS - 1).bit_length()
    yield Store("entry_writer", "origins", LISTS, tiles, unit)
    yield Store("entry_writer", "places", LISTS, tiles, (FIRST_PAGE_ENTRIES << DIRECTORY_SLOTS + 1).bit_length())
    yield Store("list_reader", "pointers", LISTS, LIST_POINTERS - 1, unit)
    yield Store("list_reader", "waiting", LISTS, LIST_TILES - 1, COUNT_BITS + list_index(config).width + 1)
    yield Store("header_maker", "headers", LISTS, HEADERS - 1, tile_header(config).width)
    yield Store("header_maker", "waiting", LISTS, 2 * -(-config.row_width // TILE) + HEADER_TILES - 1, COUNT_BITS + 1)


def _sorting(config: AcceleratorConfig) -> Iterator[Store]:
    entry = intersection(config).width
    yield Store("tile_merge_unit", "counters", SORTING, frame_lists(config), COUNT_BITS)
    stage = entry + 3
    for k in range(config.sort_chunk.bit_length() - 1):
        if (2 << k) * stage > FLIP_FLOP_BITS:
            yield Store("hierarchical_sorter", f"stage {k}", SORTING, 2 << k, stage)
    way = (config.merge_ways - 1).bit_length()
    yield Store("hierarchical_sorter", "fetched", SORTING, config.merge_ways * _WAY_BEATS - 1, way + 2 + _tail_bits())
    yield Store("hierarchical_sorter", "way", SORTING, _WAY_BEATS, 256 + 2 + _tail_bits(), config.merge_ways)
    yield Store("hierarchical_sorter", "writer", SORTING, _WAY_BEATS - 1, write_request(config).width - 5)
    if config.incremental:
        yield Store("line_buffer", "entries", SORTING, config.line_buffer_bytes // ENTRY_BYTES - 1, entry + 2)
    else:
        yield Store("line_buffer", "entries", SORTING, 2 * config.sort_chunk, entry + 2)


def _tail_bits() -> int:
    return (BEAT_ENTRIES - 1).bit_length()


def _drawing(config: AcceleratorConfig) -> Iterator[Store]:
    lines, way_bits = config.splat_cache_lines, (CACHE_WAYS - 1).bit_length()
    line_bits = lines.bit_length() - 1
    yield Store("splat_fetch", "lines", LISTS, lines, splat_record(config).width)
    yield Store("splat_fetch", "pending", LISTS, VIEWS_PENDING - 1, line_bits + 4)
    tag = 1 + INDEX_BITS - (line_bits - way_bits) + 2
    yield Store("splat_fetch", "tags", LISTS, lines // CACHE_WAYS, CACHE_WAYS * tag + way_bits)
    yield from _output(config)


def _output(config: AcceleratorConfig) -> Iterator[Store]:
    rows = OUTPUT_DRAINS * config.array_y if config.incremental else 2 * config.region**2 // config.array_x
    yield Store("array control and output", "lines", BLENDING, rows, _stored_row(config), config.streams)


def _stored_row(config: AcceleratorConfig) -> int:
    """Bits of a row of pixels in the buffer behind the array."""
    left_out = 0 if config.depth else config.array_x * config.formats.depth_accumulator.width
    return pixel_row(config).width - left_out


def _warp(config: AcceleratorConfig) -> Iterator[Store]:
    lanes, rows = config.warp_lanes, TILE // config.warp_lanes
    shift = disparity(config).width
    yield Store("warp_unit", "delay", WARP, shift + 1, (28 + shift) * lanes)
    yield Store("warp_unit", "mask", WARP, frame_tiles(config), 1)
    yield Store("warp_unit", "beats", WARP, 2 * rows, 200, lanes)
    pairs = 1 << (rows * config.warp_columns // 2 - 1).bit_length()
    yield Store("warp_unit", "places", WARP, pairs, 25 + shift, 2 * lanes)
    places = (config.cores_x - 1).bit_length() + (config.row_width - 1).bit_length()
    row = config.cores_x * _pixel_width(config) + 8 + places
    yield Store("warp_unit", "rows", WARP, max(2, rows * TILE // config.cores_x), row, lanes)


def _pixel_width(config: AcceleratorConfig) -> int:
    """Bits of a pixel that leaves the array."""
    n = config.formats
    return 3 * n.accumulator.width + n.depth_accumulator.width + n.transmittance.width
