"""The memories that only machines with lists by super-tile have (`spec.supertiles`), and those that have other shapes there."""

from __future__ import annotations

from collections.abc import Iterator

from msv2.studies.area.store import Store
from perf.constants import culling
from spec.chunks import chunk_header
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, SUPER_TILES, SUPER_X, SUPER_Y, TILE
from spec.joint import EYES, SHIFT_MOST
from spec.memory import (
    BEAT_BITS,
    BEAT_BYTES,
    BEAT_ENTRIES,
    DIRECTORY_SLOTS,
    FIRST_PAGE_BEATS,
    FIRST_PAGE_ENTRIES,
    splat_record,
)
from spec.queues import (
    HEADERS_MISSED,
    HEADERS_PENDING,
    LEVEL_GROUP,
    LINES_AHEAD,
    LIST_POINTERS,
    LIST_TILES,
    LISTS_AHEAD,
    RECORD_BEATS,
    RECORDS_PENDING,
    TILE_TEST_BESIDE,
)
from spec.records import (
    COUNT_BITS,
    INDEX_BITS,
    frame_lists,
    frame_supertiles,
    list_group,
    list_index,
    projected_splat,
    surviving_splat,
)
from spec.supertiles import BUCKETS, CHUNK_BITS, HEADER_WAYS, batch_tiles, supertile_index
from synth.machine import BLENDING, COLOUR, CULLING, LISTS

_SEARCH_BANKS = (BUCKETS - 1).bit_length()
"""Memories of bounds that are searched side by side."""

_MASK_PLACES = 32
"""Places of a word of masks (rtl.supertiles.batch_masks)."""

_PLACING = ("first", "bound")
"""Fields of a chunk's header that the address of a record needs; the decode unit needs those of _DECODING."""

_DECODING = ("low", "step", "scale_top")


def super_stores(config: AcceleratorConfig) -> Iterator[Store]:
    """The memories of the tile test, the colour unit, lists, record fetch, batch buffer and pixel state."""
    yield from _tile_test(config)
    yield from _lists(config)
    yield from _record_fetch(config)
    yield from _batches(config)


def _tile_test(config: AcceleratorConfig) -> Iterator[Store]:
    paths, rows = culling(config), -(-config.row_width // TILE)
    for width in (26, 42):  # the datapaths of both rows of tiles
        yield Store("supertile_test", f"ellipse {width}", CULLING, paths.ellipse.rows, width)
    codes = 2 if config.levels > 1 else 0
    wide = rows + SHIFT_MOST * config.joint
    groups = 1 << (-(-wide // LEVEL_GROUP) - 1).bit_length() if wide > LEVEL_GROUP else 1
    if codes:
        eyes = EYES if config.joint else 1
        yield Store("supertile_test", "levels", CULLING, eyes * -(-rows // SUPER_Y) * groups, LEVEL_GROUP * codes, SUPER_Y)
    key = next(f.format.width for f in projected_splat(config).fields if f.name == "depth_key")
    kept = surviving_splat(config).width - 1 - MAX_LEVELS - SUPER_TILES * config.streams + key
    yield Store("supertile_test", "queue", CULLING, paths.ellipse.rows + TILE_TEST_BESIDE - 1 + config.joint, kept)
    columns = -(-config.row_width // (TILE * SUPER_X)) + config.joint
    axis = max((wide - 1).bit_length(), LEVEL_GROUP.bit_length())
    line = 2 * columns + axis - (SUPER_Y - 1).bit_length() + INDEX_BITS + key + 1 + config.joint
    if config.joint:
        yield Store("supertile_test", "pairs of the source", CULLING, frame_supertiles(config), INDEX_BITS + 1)
    yield Store("supertile_test", "lines", CULLING, LINES_AHEAD - 1, line)
    if paths.colour.rows:
        for width in (152, 98):
            yield Store("pair_colour", f"path {width}", COLOUR, paths.colour.rows, width)


def _lists(config: AcceleratorConfig) -> Iterator[Store]:
    lists, unit = frame_lists(config), BEAT_BITS - (FIRST_PAGE_BEATS - 1).bit_length()
    pair = INDEX_BITS + config.formats.depth_key.width
    yield Store("pair_writer", "origins", LISTS, lists, unit)
    yield Store("pair_writer", "places", LISTS, lists, (FIRST_PAGE_ENTRIES << DIRECTORY_SLOTS + 1).bit_length())
    yield Store("pair_writer", "pairs", LISTS, lists, pair, BEAT_ENTRIES - 1)
    yield Store("list_reader", "pointers", LISTS, LIST_POINTERS - 1, unit)
    yield Store("list_reader", "waiting", LISTS, LIST_TILES - 1, COUNT_BITS + list_index(config).width + 1)
    yield Store("queue of lists", "lists", LISTS, LISTS_AHEAD - 1, list_group(config).width)
    yield Store("supertile_reader", "counts", LISTS, frame_supertiles(config) - 1, COUNT_BITS)
    if config.buckets:
        numbers = list_index(config).width
        yield Store("depth_buckets", "bounds", LISTS, lists, config.formats.depth_key.width, _SEARCH_BANKS)
        yield Store("depth_buckets", "of lists", LISTS, lists, supertile_index(config))
        yield Store("depth_buckets", "of super-tiles", LISTS, frame_supertiles(config), numbers + _SEARCH_BANKS)
        yield Store("depth_buckets", "ends", LISTS, 2 * lists, 1)


def _record_fetch(config: AcceleratorConfig) -> Iterator[Store]:
    lines, ways = config.header_lines, (HEADER_WAYS - 1).bit_length()
    line = lines.bit_length() - 1
    tag = CHUNK_BITS - (line - ways)
    header = {f.name: f.width for f in chunk_header(config).fields}
    pair = INDEX_BITS + line + 1
    yield Store("record_fetch", "tags", LISTS, lines // HEADER_WAYS, HEADER_WAYS * tag + ways + HEADER_WAYS)
    yield Store("record_fetch", "located", LISTS, HEADERS_PENDING - 1, pair)
    yield Store("record_fetch", "awaited", LISTS, RECORDS_PENDING - 1, pair + header["bound"])
    yield Store("record_fetch", "places of chunks", LISTS, lines, sum(header[name] for name in _PLACING))
    yield Store("record_fetch", "shapes of chunks", LISTS, lines, sum(header[name] for name in _DECODING))
    yield Store("record_fetch", "missed", LISTS, HEADERS_MISSED - 1, sum(header[name] for name in _DECODING))
    yield Store("record_fetch", "beats", LISTS, RECORD_BEATS - 1, 8 * BEAT_BYTES)


def _batches(config: AcceleratorConfig) -> Iterator[Store]:
    n, places = config.formats, config.batch_places
    banks, streams = config.batch_banks, config.streams
    yield Store("batch_buffer", "records", BLENDING, 2 * places // banks, splat_record(config).width, banks)
    mask = min(_MASK_PLACES, places)
    yield Store("batch_buffer", "masks", BLENDING, 2 * batch_tiles(config) * places // mask, mask, streams)
    rows, lanes = batch_tiles(config) * config.region**2 // config.array_x, config.array_x * config.level_banks
    sums = 3 * n.accumulator.width + (n.depth_accumulator.width if config.depth else 0)
    yield Store("pixel_state", "transmittances", BLENDING, rows, lanes * n.transmittance.width, streams)
    yield Store("pixel_state", "sums", BLENDING, rows, lanes * sums, streams)
