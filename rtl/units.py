"""The registry of units: every piece of the machine that can be emitted, simulated or synthesised by its name.

A unit's name is also the name of its Verilog module. `rtl.units.emit("tile_merge_unit", TINY)` gives its Verilog.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches

from amaranth.lib import wiring

from rtl.axi.master import AxiMaster
from rtl.axi.registers import RegisterFile
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
from rtl.sort_tmu.chunk_sorter import ChunkSorter
from rtl.sort_tmu.handover import DoubleBuffer, LineBuffer, handover
from rtl.sort_tmu.hierarchical_sorter import HierarchicalSorter
from rtl.sort_tmu.tile_merge import TileMergeUnit
from rtl.tile_lists.entry_writer import EntryWriter
from rtl.tile_lists.geometry_reader import GeometryReader
from rtl.tile_lists.header_maker import HeaderMaker
from rtl.tile_lists.list_reader import ListReader
from rtl.tile_lists.table_loader import TableLoader
from rtl.top.controller import FrameController
from rtl.top.machine import Machine
from rtl.vrc_array.array import VrcArray
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
from spec.config import AcceleratorConfig, NumberFormats
from spec.errors import InputError
from spec.registers import READ_CLIENTS, WRITE_CLIENTS

TOP = "msv2_top"
"""Name of the whole machine."""


@dataclass(frozen=True)
class Unit:
    """A unit of the machine. Shared modules below it (`rtl.emit.add_shared`) are emitted once each, by their own names.

    Attributes:
        make: builds the component of a configuration.
        stage: the stage of the machine that the unit works in; "machine" for what serves all of them (bus, registers, control)
            and "arithmetic" for the operators that other units share.
        doc: what it does, in one line.
        golden: the module of the golden renderer that computes the same, or an empty string where none does.
    """

    make: Callable[[AcceleratorConfig], wiring.Component]
    stage: str
    doc: str
    golden: str = ""


def _operator(doc: str, make: Callable[[NumberFormats], wiring.Component]) -> Unit:
    """An operator on small floats, which depends on number formats only."""
    return Unit(lambda config: make(config.formats), "arithmetic", doc, "golden.host.rounding")


_REF = "golden.msv2_ref"

UNITS: dict[str, Unit] = {
    TOP: Unit(Machine, "machine", "the whole machine: AXI4-Lite slave, AXI4 master, interrupt", f"{_REF}.pipeline"),
    "pixel_core": Unit(PixelCore, "array", "one pixel: alpha, transmittance, colour and depth sums", f"{_REF}.array_kernel"),
    "vrc_row": Unit(VrcRow, "array", "a row of pixel cores", f"{_REF}.array_kernel"),
    "setup": Unit(SetupUnit, "array", "coefficients of a splat's exponent at a tile's first pixel", f"{_REF}.array_kernel"),
    "expand": Unit(Expand, "array", "an array entry into the ops of its tile's levels", f"{_REF}.array_kernel"),
    "block_sequencer": Unit(BlockSequencer, "array", "the passes of an array that is smaller than a tile",
                            f"{_REF}.array_kernel"),
    "blend": Unit(Blend, "array", "two levels of a tile blended along its plane", f"{_REF}.array_kernel"),
    "collect": Unit(Collect, "array", "finished rows of pixels out of the array", f"{_REF}.array_kernel"),
    "vrc_array": Unit(VrcArray, "array", "the whole volume rendering array, with early stop of tiles", f"{_REF}.array"),
    "float_add": _operator("a + b", lambda n: FloatAdd(a=n.work, b=n.work, result=n.work)),
    "float_mul": _operator("a * b", lambda n: FloatMul(a=n.work, b=n.work, result=n.work)),
    "float_divide": _operator("a / b", lambda n: FloatDivide(a=n.work, b=n.work, result=n.work)),
    "float_reciprocal": _operator("1 / a", lambda n: FloatReciprocal(a=n.view, result=n.view)),
    "float_rsqrt": _operator("1 / sqrt(a)", lambda n: FloatRsqrt(a=n.work, result=n.work)),
    "float_sqrt": _operator("sqrt(a)", lambda n: FloatSqrt(a=n.work, result=n.extent)),
    "float_to_fixed": _operator("a small float to fixed point", lambda n: FloatToFixed(a=n.view, result=n.mean2d)),
    "fixed_to_float": _operator("fixed point to a small float", lambda n: FixedToFloat(a=n.quaternion, result=n.work)),
    "near_test": Unit(NearTest, "projection", "drops points in front of the near plane and faint ones", f"{_REF}.projection"),
    "projection": Unit(Projection, "projection", "a Gaussian to a splat: mean, conic, depth, box of tiles",
                       f"{_REF}.projection"),
    "projection_unit": Unit(ProjectionUnit, "projection", "near test and projection together", f"{_REF}.projection"),
    "saturation_counters": Unit(SaturationCounters, "projection", "counts values at the limits of their formats",
                                f"{_REF}.saturations"),
    "tile_test": Unit(TileTest, "tile_test", "the tiles a splat touches, and the foveation filter", f"{_REF}.tile_test"),
    "colour_unit": Unit(ColourUnit, "colour", "spherical harmonics to the colours of a splat's levels", f"{_REF}.colour"),
    "geometry_reader": Unit(GeometryReader, "projection", "Gaussians from memory to projection", f"{_REF}.pipeline"),
    "table_loader": Unit(TableLoader, "tile_test", "levels of all tiles into the tile test's table", f"{_REF}.pipeline"),
    "entry_writer": Unit(EntryWriter, "tile_lists", "intersections into the pages of their tiles", f"{_REF}.tile_lists"),
    "list_reader": Unit(ListReader, "tile_lists", "pages back to the sorter, one group of tiles after the other",
                        f"{_REF}.tile_lists"),
    "header_maker": Unit(HeaderMaker, "tile_lists", "tile headers for the array, from counts and the host's table",
                         f"{_REF}.tile_lists"),
    "tile_merge_unit": Unit(TileMergeUnit, "tile_merge", "intersections counted by tile, tiles merged into groups",
                            f"{_REF}.tile_merge"),
    "chunk_sorter": Unit(ChunkSorter, "sort", "chunks of a group that fit the sort buffer", f"{_REF}.sort"),
    "hierarchical_sorter": Unit(HierarchicalSorter, "sort", "groups of any size, spilled to memory as sorted runs",
                                f"{_REF}.sort"),
    "line_buffer": Unit(LineBuffer, "handover", "sorted intersections to the array as they become final"),
    "double_buffer": Unit(DoubleBuffer, "handover", "sorted groups to the array as a whole, the baseline"),
    "handover": Unit(handover, "handover", "the line buffer or the double buffer, whichever the machine has"),
    "splat_fetch": Unit(SplatFetch, "fetch", "splat records of sorted intersections, through the splat cache",
                        f"{_REF}.fetch"),
    "pixel_writer": Unit(PixelWriter, "pixel_write", "finished rows of pixels to the frame in memory", f"{_REF}.frame_memory"),
    "warp_divider": Unit(disparity_divider, "warp", "the divider that makes disparity from depth", f"{_REF}.warp"),
    "warp_unit": Unit(lambda config: WarpUnit(config.with_(stereo=True)), "warp",
                      "the source eye's pixels to the target eye's frame", f"{_REF}.warp"),
    "axi_master": Unit(lambda config: AxiMaster(config, len(READ_CLIENTS), len(WRITE_CLIENTS)), "machine",
                       "read and write clients to one AXI4 master"),
    "register_file": Unit(RegisterFile, "machine", "the host's registers behind AXI4-Lite"),
    "frame_controller": Unit(FrameController, "machine", "the phases of a frame, and the way out of a failed one"),
}


def named(name: str) -> Unit:
    """The unit of that name; InputError with what is accepted, and the nearest name, where there is none."""
    if name in UNITS:
        return UNITS[name]
    near = get_close_matches(name, UNITS, 1)
    raise InputError(f"unit {name!r} is not known{f' (did you mean {near[0]!r}?)' if near else ''}: {', '.join(UNITS)} are")


def emit(name: str, config: AcceleratorConfig) -> str:
    """Verilog of a unit as the module of its name, with all modules below it; InputError for an unknown name."""
    return to_verilog(named(name).make(config), name)
