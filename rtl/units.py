"""The registry of units: every piece of the machine that can be emitted, simulated or synthesised by its name.

A unit's name is also the name of its Verilog module. `rtl.units.emit("tile_merge_unit", TINY)` gives its Verilog.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from amaranth.lib import wiring

from rtl.axi.master import AxiMaster
from rtl.axi.registers import RegisterFile
from rtl.chunks.chunk_reader import ChunkReader
from rtl.chunks.chunk_test import ChunkTest
from rtl.chunks.geometry_decode import GeometryDecode
from rtl.chunks.header_reader import ChunkHeaderReader
from rtl.chunks.level_bounds import LevelBounds
from rtl.culling.colour import ColourUnit
from rtl.culling.near import NearTest
from rtl.culling.projection import Projection
from rtl.culling.projection_unit import ProjectionUnit
from rtl.culling.saturations import SaturationCounters
from rtl.culling.tile_test import TileTest
from rtl.emit import to_verilog
from rtl.float.add import FloatAdd
from rtl.float.convert import FixedToFloat, FloatToFixed
from rtl.float.divide import FloatDivide, FloatReciprocal
from rtl.float.multiply import FloatMul
from rtl.float.roots import FloatRsqrt, FloatSqrt
from rtl.pixels.block_packer import BlockPacker
from rtl.pixels.block_unpacker import BlockUnpacker
from rtl.pixels.frame_packer import FramePacker
from rtl.pixels.frame_reader import FrameReader
from rtl.sort_tmu.chunk_sorter import ChunkSorter
from rtl.sort_tmu.handover import DoubleBuffer, LineBuffer, handover
from rtl.sort_tmu.hierarchical_sorter import HierarchicalSorter
from rtl.sort_tmu.tile_merge import TileMergeUnit
from rtl.supertiles.batch_buffer import BatchBuffer
from rtl.supertiles.buckets import depth_buckets
from rtl.supertiles.clip import SuperTileClip
from rtl.supertiles.colour import PairColour
from rtl.supertiles.pair_writer import PairWriter
from rtl.supertiles.reader import SuperTileReader
from rtl.supertiles.record_fetch import RecordFetch
from rtl.supertiles.row_join import RowJoin
from rtl.supertiles.stream_arrays import StreamArrays
from rtl.supertiles.stream_buffer import StreamBuffer
from rtl.supertiles.tile_test import SuperTileTest
from rtl.tile_lists.entry_writer import IntersectionWriter
from rtl.tile_lists.geometry_reader import GeometryReader
from rtl.tile_lists.header_maker import HeaderMaker
from rtl.tile_lists.list_reader import ListReader
from rtl.tile_lists.table_loader import TableLoader
from rtl.top.controller import FrameController
from rtl.top.machine import Machine
from rtl.vrc_array.array import VrcArray
from rtl.vrc_array.batch_array import BatchArray
from rtl.vrc_array.blend import Blend
from rtl.vrc_array.blocks import BlockSequencer
from rtl.vrc_array.collect import Collect
from rtl.vrc_array.expand import Expand
from rtl.vrc_array.pixel_core import PixelCore
from rtl.vrc_array.pixel_writer import PixelWriter
from rtl.vrc_array.row import VrcRow
from rtl.vrc_array.setup import SetupUnit
from rtl.vrc_array.splat_fetch import SplatFetch
from rtl.warp_unit.disparity import disparity_divider
from rtl.warp_unit.warp_unit import WarpUnit
from spec.command_line import choice
from spec.compact import with_compact_records
from spec.config import MOST_STREAMS, V3, AcceleratorConfig, NumberFormats
from spec.registers import WRITE_CLIENTS, read_clients
from spec.stages import EVERY_STAGE

TOP = "msv2_top"
"""Name of the whole machine."""


@dataclass(frozen=True)
class Unit:
    """A unit of the machine. Shared modules below it (`rtl.emit.add_shared`) are emitted once each, by their own names.

    Attributes:
        make: builds the component of a configuration.
        doc: what it does, in one line.
        serves: "machine" for what serves all stages (bus, registers, control), "arithmetic" for operators that units share, and
            nothing for the units that `spec.stages` lists with their stages.
    """

    make: Callable[[AcceleratorConfig], wiring.Component]
    doc: str
    serves: str = ""


def _operator(doc: str, make: Callable[[NumberFormats], wiring.Component]) -> Unit:
    """An operator on small floats, which depends on number formats only."""
    return Unit(lambda config: make(config.formats), doc, "arithmetic")


def _of_chunks(config: AcceleratorConfig) -> AcceleratorConfig:
    """The machine, or where it reads no chunks the same one that does, with V3's records."""
    return config if config.chunks else with_compact_records(config)


def _of_compact(config: AcceleratorConfig) -> AcceleratorConfig:
    """The machine, or where its records are wide the same one with V3's."""
    return config if config.compact else with_compact_records(config)


def _of_supertiles(config: AcceleratorConfig) -> AcceleratorConfig:
    """The machine; where its lists are by tile the same one with super-tiles, V3's records, one eye, no lockstep, and banks in
    registers."""
    return config if config.supertiles else with_compact_records(
        config, lists=V3.lists, stereo=False, lockstep=False, bank_memories=False)


def _of_streams(config: AcceleratorConfig) -> AcceleratorConfig:
    """The machine, or where it has one stream the same one with super-tiles and four, and with four cores at least in a row."""
    config = _of_supertiles(config)
    return config if config.streams > 1 else config.with_(
        streams=MOST_STREAMS, cores_x=max(4, config.cores_x), cores_y=max(4, config.cores_y))


UNITS: dict[str, Unit] = {
    TOP: Unit(Machine, "the whole machine: AXI4-Lite slave, AXI4 master, interrupt", "machine"),
    "pixel_core": Unit(PixelCore, "one pixel: alpha, transmittance, colour and depth sums"),
    "vrc_row": Unit(VrcRow, "a row of pixel cores"),
    "setup": Unit(SetupUnit, "coefficients of a splat's exponent at a tile's first pixel"),
    "expand": Unit(Expand, "an array entry into the ops of its tile's levels"),
    "block_sequencer": Unit(BlockSequencer, "the passes of an array that is smaller than a tile"),
    "blend": Unit(Blend, "two levels of a tile blended along its plane"),
    "collect": Unit(Collect, "finished rows of pixels out of the array"),
    "vrc_array": Unit(VrcArray, "the whole volume rendering array, with early stop of tiles"),
    "batch_array": Unit(lambda config: BatchArray(_of_supertiles(config)),
                        "the volume rendering array with its pixels' state between visits of tiles"),
    "float_add": _operator("a + b", lambda n: FloatAdd(a=n.work, b=n.work, result=n.work)),
    "float_mul": _operator("a * b", lambda n: FloatMul(a=n.work, b=n.work, result=n.work)),
    "float_divide": _operator("a / b", lambda n: FloatDivide(a=n.work, b=n.work, result=n.work)),
    "float_reciprocal": _operator("1 / a", lambda n: FloatReciprocal(a=n.view, result=n.view)),
    "float_rsqrt": _operator("1 / sqrt(a)", lambda n: FloatRsqrt(a=n.work, result=n.work)),
    "float_sqrt": _operator("sqrt(a)", lambda n: FloatSqrt(a=n.work, result=n.extent)),
    "float_to_fixed": _operator("a small float to fixed point", lambda n: FloatToFixed(a=n.view, result=n.mean2d)),
    "fixed_to_float": _operator("fixed point to a small float", lambda n: FixedToFloat(a=n.quaternion, result=n.work)),
    "chunk_header_reader": Unit(lambda config: ChunkHeaderReader(_of_chunks(config)),
                                "headers of chunks from memory to their test"),
    "chunk_reader": Unit(lambda config: ChunkReader(_of_chunks(config)),
                         "Gaussians of tested chunks from memory to projection"),
    "geometry_decode": Unit(lambda config: GeometryDecode(_of_compact(config)),
                            "compact geometry to the words of Gaussians"),
    "near_test": Unit(NearTest, "drops points in front of the near plane and faint ones"),
    "projection": Unit(Projection, "a Gaussian to a splat: mean, conic, depth, box of tiles"),
    "projection_unit": Unit(ProjectionUnit, "near test and projection together"),
    "saturation_counters": Unit(SaturationCounters, "counts values at the limits of their formats", "machine"),
    "tile_test": Unit(TileTest, "the tiles a splat touches, and the foveation filter"),
    "supertile_clip": Unit(lambda config: SuperTileClip(_of_supertiles(config)), "boxes of splats cut to super-tiles"),
    "supertile_test": Unit(lambda config: SuperTileTest(_of_supertiles(config)),
                           "the super-tiles a splat has intersections with, and the tiles of each"),
    "colour_unit": Unit(ColourUnit, "spherical harmonics to the colours of a splat's levels"),
    "pair_colour": Unit(lambda config: PairColour(_of_supertiles(config), sh_degree=config.sh_degree),
                        "spherical harmonics to the splat records of a pair's levels"),
    "level_bounds": Unit(LevelBounds, "octagons around the tiles that splats of each quality bound can touch"),
    "chunk_test": Unit(lambda config: ChunkTest(_of_chunks(config)), "drops chunks of which nothing can be seen"),
    "geometry_reader": Unit(GeometryReader, "Gaussians from memory to projection"),
    "table_loader": Unit(TableLoader, "levels of all tiles into the tile test's table"),
    "entry_writer": Unit(IntersectionWriter, "intersections into the pages of their tiles"),
    "list_reader": Unit(ListReader, "pages back to the sorter, one group of tiles after the other"),
    "header_maker": Unit(HeaderMaker, "tile headers for the array, from counts and the host's table"),
    "tile_merge_unit": Unit(TileMergeUnit, "intersections counted by tile, tiles merged into groups"),
    "chunk_sorter": Unit(ChunkSorter, "chunks of a group that fit the sort buffer"),
    "hierarchical_sorter": Unit(HierarchicalSorter, "groups of any size, spilled to memory as sorted runs"),
    "line_buffer": Unit(LineBuffer, "sorted intersections to the array as they become final"),
    "double_buffer": Unit(DoubleBuffer, "sorted groups to the array as a whole, the baseline"),
    "handover": Unit(handover, "the line buffer or the double buffer, whichever the machine has"),
    "splat_fetch": Unit(SplatFetch, "splat records of sorted intersections, through the splat cache"),
    "depth_buckets": Unit(lambda config: depth_buckets(_of_supertiles(config)), "the list of each pair, by its depth"),
    "pair_writer": Unit(lambda config: PairWriter(_of_supertiles(config)), "pairs into the pages of their lists"),
    "supertile_reader": Unit(lambda config: SuperTileReader(_of_supertiles(config)),
                             "super-tiles for the batch buffer, from counts and the host's table"),
    "record_fetch": Unit(lambda config: RecordFetch(_of_supertiles(config)),
                         "records of sorted pairs, by the headers of their chunks, to projection"),
    "batch_buffer": Unit(lambda config: BatchBuffer(_of_supertiles(config)),
                         "splat records of super-tiles in batches, dealt to their tiles"),
    "stream_buffer": Unit(lambda config: StreamBuffer(_of_streams(config)),
                          "splat records of super-tiles in batches, dealt to the quarters of their tiles in four streams"),
    "row_join": Unit(lambda config: RowJoin(_of_streams(config)), "rows of pixels of four arrays as those of one"),
    "stream_arrays": Unit(lambda config: StreamArrays(_of_streams(config)),
                          "a batch buffer of four streams with an array for each"),
    "pixel_writer": Unit(PixelWriter, "finished rows of pixels to the frame in memory"),
    "block_packer": Unit(BlockPacker, "blocks of pixels into beats of a packed frame"),
    "frame_packer": Unit(FramePacker, "finished rows of pixels to a packed frame in memory"),
    "frame_reader": Unit(FrameReader, "table and blocks of a packed frame from memory, for a display"),
    "block_unpacker": Unit(BlockUnpacker, "beats of a packed frame back to pixels, for a display"),
    "warp_divider": Unit(disparity_divider, "the divider that makes disparity from depth"),
    "warp_unit": Unit(lambda config: WarpUnit(config.with_(stereo=True)),
                      "the source eye's pixels to the target eye's frame"),
    "axi_master": Unit(lambda config: AxiMaster(config, len(read_clients(config)), len(WRITE_CLIENTS)),
                       "read and write clients to one AXI4 master", "machine"),
    "register_file": Unit(RegisterFile, "the host's registers behind AXI4-Lite", "machine"),
    "frame_controller": Unit(FrameController, "the phases of a frame, and the way out of a failed one", "machine"),
}


def named(name: str) -> Unit:
    """The unit of that name; InputError with what is accepted, and the nearest name, where there is none."""
    return UNITS[choice("unit", name, UNITS)]


def stage_of(name: str) -> str:
    """The stage that a unit works in (`spec.stages`); of the others, "machine" or "arithmetic". InputError as `named`."""
    return named(name).serves or next(stage.name for stage in EVERY_STAGE if name in stage.units)


def emit(name: str, config: AcceleratorConfig) -> str:
    """Verilog of a unit as the module of its name, with all modules below it; InputError for an unknown name."""
    return to_verilog(named(name).make(config), name)
