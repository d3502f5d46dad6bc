"""The one table of the machine's stages: their names, and where each lives in the golden renderer, the RTL and the test bench.

A stage is a part of the way from Gaussians to pixels that reports, counters and the cycle model name. A *unit* is a hardware
module that can be emitted, synthesised and simulated alone (`rtl.units`); a stage consists of one unit or more.

Machines with lists by super-tile (`spec.supertiles`) have stages of their own, and share the others. Their projection and tile
test also work in the second phase, on every pair; cycles are counted in the first phase's stage.

Golden modules, RTL modules and test suites are dotted names and not imported here, because `spec` knows nothing of the
rooms that read it; a test checks that every one of them exists.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class StagePhase(Enum):
    """When a stage works."""

    GEOMETRY = "geometry"
    """While Gaussians are read, culled and converted, and their intersections with tiles are written."""
    RENDERING = "rendering"
    """While the tiles' lists are read, sorted and blended."""
    SECOND_EYE = "second eye"
    """While the source eye's pixels are warped to the target eye's frame."""


@dataclass(frozen=True)
class Stage:
    """One stage.

    Attributes:
        name: as counters, reports and modules use it.
        title: as headings and tables show it.
        phase: when it works.
        does: what it does, in one sentence.
        golden: golden modules that define its result; empty where it only moves or keeps data.
        rtl: modules of its units, in the order of the data.
        units: names of its units in `rtl.units`, in the order of the data.
        suites: modules that simulate it against the golden renderer.
        test: name of these suites together, as `python -m tb.sim --test` takes it.
        counters: watched streams, by the prefix of their counters in `spec.registers`; empty where none is watched.
    """

    name: str
    title: str
    phase: StagePhase
    does: str
    golden: tuple[str, ...]
    rtl: tuple[str, ...]
    units: tuple[str, ...]
    suites: tuple[str, ...]
    test: str
    counters: tuple[str, ...] = ()


STAGES = (
    Stage(
        "chunk_test", "Chunk test", StagePhase.GEOMETRY,
        "Chunks of which nothing can be seen, or only tiles of levels that do not use them, are skipped by their headers.",
        golden=("golden.msv2_ref.chunk_test",),
        rtl=("rtl.chunks.level_bounds", "rtl.chunks.chunk_test"),
        units=("level_bounds", "chunk_test"),
        suites=("tb.chunks.chunk_test_suite", "tb.chunks.chunk_graph_suite"), test="chunk_test"),
    Stage(
        "chunk_read", "Chunk reading", StagePhase.GEOMETRY,
        "Headers of chunks and the Gaussians of chunks that pass their test are read, and compact records are decoded.",
        golden=("golden.host.compact",),
        rtl=("rtl.chunks.header_reader", "rtl.chunks.chunk_reader", "rtl.chunks.geometry_decode"),
        units=("chunk_header_reader", "chunk_reader", "geometry_decode"),
        suites=("tb.chunks.reader_suite", "tb.chunks.decode_suite"), test="chunk_reader"),
    Stage(
        "projection", "Projection", StagePhase.GEOMETRY,
        "Gaussians are read, tested against the near plane and projected to splats.",
        golden=("golden.msv2_ref.projection",),
        rtl=("rtl.tile_lists.geometry_reader", "rtl.culling.eyes", "rtl.culling.near", "rtl.culling.projection",
             "rtl.culling.projection_unit"),
        units=("geometry_reader", "near_test", "projection", "projection_unit"),
        suites=("tb.culling.projection_suite", "tb.culling.joint_suite"), test="culling", counters=("geometry", "projection")),
    Stage(
        "tile_test", "Tile test", StagePhase.GEOMETRY,
        "The tiles that a splat touches are found, and those that the foveation filter drops are left out.",
        golden=("golden.msv2_ref.tile_test",),
        rtl=("rtl.tile_lists.table_loader", "rtl.culling.tile_test"),
        units=("table_loader", "tile_test"),
        suites=("tb.culling.tile_test_suite",), test="culling", counters=("tile_test",)),
    Stage(
        "colour", "Colour", StagePhase.GEOMETRY,
        "Spherical harmonics become one colour a level, and splat records are written to memory.",
        golden=("golden.msv2_ref.colour", "golden.msv2_ref.frame_memory"),
        rtl=("rtl.culling.colour",),
        units=("colour_unit",),
        suites=("tb.culling.colour_suite",), test="culling", counters=("colour",)),
    Stage(
        "tile_lists_write", "Tile lists, writing", StagePhase.GEOMETRY,
        "Intersections are written into the pages of their tiles.",
        golden=("golden.msv2_ref.tile_lists",),
        rtl=("rtl.tile_lists.entry_writer",),
        units=("entry_writer",),
        suites=("tb.tile_lists.suite",), test="lists", counters=("entry_write",)),
    Stage(
        "tile_merge", "Tile merge", StagePhase.GEOMETRY,
        "Intersections are counted by tile, and neighbouring tiles are merged into groups.",
        golden=("golden.msv2_ref.tile_merge",),
        rtl=("rtl.sort_tmu.tile_merge",),
        units=("tile_merge_unit",),
        suites=("tb.sort_tmu.tile_merge_suite",), test="tmu"),
    Stage(
        "tile_lists_read", "Tile lists, reading", StagePhase.RENDERING,
        "The lists of a group's tiles are read, and every tile's header is made.",
        golden=("golden.msv2_ref.tile_lists",),
        rtl=("rtl.tile_lists.list_reader", "rtl.tile_lists.header_maker"),
        units=("list_reader", "header_maker"),
        suites=("tb.tile_lists.suite",), test="lists", counters=("list_read",)),
    Stage(
        "sort", "Sort", StagePhase.RENDERING,
        "The intersections of a group are sorted by tile, depth and index.",
        golden=("golden.msv2_ref.sort",),
        rtl=("rtl.sort_tmu.chunk_sorter", "rtl.sort_tmu.hierarchical_sorter"),
        units=("chunk_sorter", "hierarchical_sorter"),
        suites=("tb.sort_tmu.chunk_suite", "tb.sort_tmu.hierarchical_suite"), test="sort", counters=("sort",)),
    Stage(
        "handover", "Handover", StagePhase.RENDERING,
        "Sorted intersections pass to the array as they come, or group by group through a double buffer.",
        golden=(),
        rtl=("rtl.sort_tmu.handover",),
        units=("line_buffer", "double_buffer", "handover"),
        suites=("tb.sort_tmu.handover_suite",), test="sort", counters=("handover",)),
    Stage(
        "fetch", "Splat fetch", StagePhase.RENDERING,
        "The splat record of every intersection is fetched through the splat cache.",
        golden=("golden.msv2_ref.fetch",),
        rtl=("rtl.vrc_array.splat_fetch",),
        units=("splat_fetch",),
        suites=("tb.vrc_array.fetch_suite",), test="vrc", counters=("fetch",)),
    Stage(
        "array", "Array", StagePhase.RENDERING,
        "Splats are set up as polynomials over a tile and blended into its pixels.",
        golden=("golden.msv2_ref.array",),
        rtl=("rtl.vrc_array.setup", "rtl.vrc_array.blocks", "rtl.vrc_array.expand", "rtl.vrc_array.pixel_core",
             "rtl.vrc_array.row", "rtl.vrc_array.blend", "rtl.vrc_array.collect", "rtl.vrc_array.array"),
        units=("setup", "block_sequencer", "expand", "pixel_core", "vrc_row", "blend", "collect", "vrc_array"),
        suites=("tb.vrc_array.array_suite",), test="vrc", counters=("array",)),
    Stage(
        "pixel_write", "Pixel write", StagePhase.RENDERING,
        "Finished rows of pixels are written to the frame in memory.",
        golden=("golden.msv2_ref.frame_memory",),
        rtl=("rtl.vrc_array.pixel_writer",),
        units=("pixel_writer",),
        suites=("tb.vrc_array.pixel_writer_suite",), test="vrc", counters=("pixel_write",)),
    Stage(
        "warp", "Warp", StagePhase.SECOND_EYE,
        "The source eye's pixels are warped to the target eye's frame, and holes are filled or reported.",
        golden=("golden.msv2_ref.warp",),
        rtl=("rtl.warp_unit.disparity", "rtl.warp_unit.warp_unit"),
        units=("warp_divider", "warp_unit"),
        suites=("tb.warp_unit.suite",), test="warp", counters=("warp",)),
)
"""Every stage of machines with lists by tile, in the order of the data."""

BY_NAME = {stage.name: stage for stage in STAGES}
"""These stages by name."""

_SUPERTILE = (
    Stage(
        "supertile_test", "Tile test by super-tile", StagePhase.GEOMETRY,
        "The super-tiles in which a splat has intersections are found, and later the tiles of one super-tile.",
        golden=("golden.msv2_ref.supertiles",),
        rtl=("rtl.tile_lists.table_loader", "rtl.supertiles.clip", "rtl.supertiles.tile_test", "rtl.supertiles.pair_union"),
        units=("supertile_clip", "supertile_test"),
        suites=("tb.supertiles.clip_suite", "tb.supertiles.tile_test_suite"), test="supertile_test", counters=("tile_test",)),
    Stage(
        "pair_write", "Lists by super-tile, writing", StagePhase.GEOMETRY,
        "Pairs are assigned to the lists of their super-tile and written, combined to whole beats.",
        golden=("golden.msv2_ref.supertiles", "golden.msv2_ref.buckets"),
        rtl=("rtl.supertiles.buckets", "rtl.supertiles.depth_buckets", "rtl.supertiles.pair_writer"),
        units=("depth_buckets", "pair_writer"),
        suites=("tb.supertiles.buckets_suite", "tb.supertiles.lists_suite", "tb.supertiles.order_suite"), test="pair_lists",
        counters=("entry_write",)),
    Stage(
        "supertile_read", "Super-tile reading", StagePhase.RENDERING,
        "The settings of a super-tile's tiles are read, and its pairs are counted.",
        golden=("golden.msv2_ref.supertiles",),
        rtl=("rtl.supertiles.reader",),
        units=("supertile_reader",),
        suites=("tb.supertiles.reader_suite",), test="pair_lists"),
    Stage(
        "record_fetch", "Record fetch", StagePhase.RENDERING,
        "The Gaussian's compact record and its chunk's header are read for every pair, and its geometry is decoded.",
        golden=("golden.host.compact",),
        rtl=("rtl.supertiles.record_fetch",),
        units=("record_fetch",),
        suites=("tb.supertiles.record_fetch_suite",), test="record_fetch", counters=("fetch",)),
    Stage(
        "pair_colour", "Colour of pairs", StagePhase.RENDERING,
        "A pair's colours become a splat record for each level of its tiles.",
        golden=("golden.msv2_ref.colour", "golden.msv2_ref.supertiles"),
        rtl=("rtl.supertiles.colour",),
        units=("pair_colour",),
        suites=("tb.supertiles.colour_suite",), test="pair_colour", counters=("colour",)),
    Stage(
        "batch", "Batch buffer", StagePhase.RENDERING,
        "Splat records are gathered in batches, and each tile that has any of them is visited.",
        golden=("golden.msv2_ref.batches",),
        rtl=("rtl.supertiles.batch_masks", "rtl.supertiles.batch_visits", "rtl.supertiles.batch_buffer",
             "rtl.supertiles.stream_buffer"),
        units=("batch_buffer", "stream_buffer"),
        suites=("tb.supertiles.batch_suite", "tb.supertiles.stream_suite"), test="batch", counters=("batch",)),
    Stage(
        "batch_array", "Array with kept pixels", StagePhase.RENDERING,
        "Splats are set up and blended as elsewhere, and the state of a tile's pixels is kept between its visits.",
        golden=("golden.msv2_ref.array",),
        rtl=("rtl.vrc_array.batch_setup", "rtl.vrc_array.pixel_state", "rtl.vrc_array.batch_array",
             "rtl.supertiles.stream_arrays", "rtl.supertiles.row_join"),
        units=("batch_array", "stream_arrays", "row_join"),
        suites=("tb.supertiles.array_suite",), test="batch_array", counters=("array",)),
)

_OWN = {stage.name: stage for stage in _SUPERTILE}

SUPERTILE_STAGES = tuple((BY_NAME | _OWN)[name] for name in (
    "chunk_test", "chunk_read", "projection", "supertile_test", "pair_write", "tile_merge", "tile_lists_read", "supertile_read",
    "sort", "handover", "record_fetch", "pair_colour", "batch", "batch_array", "pixel_write"))
"""Every stage of machines with lists by super-tile, in the order of the data."""

PACKED_STAGES = (
    Stage(
        "frame_pack", "Frame packing", StagePhase.RENDERING,
        "Finished rows of pixels are packed in blocks and written to the frame in memory, in place of `pixel_write`.",
        golden=("golden.msv2_ref.frame_packing",),
        rtl=("rtl.pixels.block_rows", "rtl.pixels.block_differences", "rtl.pixels.block_packer", "rtl.pixels.frame_packer",
             "rtl.pixels.frame_writer"),
        units=("block_packer", "frame_packer"),
        suites=("tb.pixels.packer_suite",), test="frame_packer"),
    Stage(
        "frame_unpack", "Frame unpacking", StagePhase.RENDERING,
        "A display's side: blocks of a packed frame become rows of pixels, and damaged blocks are named.",
        golden=("golden.host.packed_frame",),
        rtl=("rtl.pixels.frame_reader", "rtl.pixels.block_unpacker"),
        units=("frame_reader", "block_unpacker"),
        suites=("tb.pixels.unpacker_suite",), test="frame_unpacker"),
)
"""The stages of packed frames (`spec.packed`)."""

EVERY_STAGE = (*STAGES, *_SUPERTILE, *PACKED_STAGES)
"""The stages of all machines, each once."""


def watched(*phases: StagePhase, supertiles: bool = False) -> tuple[str, ...]:
    """Prefixes of the counters of all stages of these phases, in the order of the data."""
    table = SUPERTILE_STAGES if supertiles else STAGES
    return tuple(counter for stage in table if stage.phase in phases for counter in stage.counters)
