"""What can be synthesised: units by name, with the hints their carry chains need."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from amaranth.lib import wiring

from rtl.axi.master import AxiMaster
from rtl.axi.registers import RegisterFile
from rtl.culling.colour import ColourUnit
from rtl.culling.near import NearTest
from rtl.culling.projection import Projection
from rtl.culling.projection_unit import ProjectionUnit
from rtl.culling.tile_test import TileTest
from rtl.float.add import FloatAdd
from rtl.float.convert import FixedToFloat, FloatToFixed
from rtl.float.divide import FloatDivide, FloatReciprocal
from rtl.float.multiply import FloatMul
from rtl.float.roots import FloatRsqrt, FloatSqrt
from rtl.sort_tmu.chunk_sorter import ChunkSorter
from rtl.sort_tmu.handover import DoubleBuffer, LineBuffer
from rtl.sort_tmu.hierarchical_sorter import HierarchicalSorter
from rtl.sort_tmu.tile_merge import TileMergeUnit
from rtl.tile_lists.entry_writer import EntryWriter
from rtl.tile_lists.geometry_reader import GeometryReader
from rtl.tile_lists.header_maker import HeaderMaker
from rtl.tile_lists.list_reader import ListReader
from rtl.tile_lists.table_loader import TableLoader
from rtl.top.controller import FrameController
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
from spec.config import DEFAULT, PAPER, AcceleratorConfig, NumberFormats
from spec.registers import READ_CLIENTS, WRITE_CLIENTS


@dataclass(frozen=True)
class Unit:
    """A unit of the machine. Shared modules below it (`rtl.emit.add_shared`) are synthesised apart, as the unit of their name.

    Attributes:
        make: the component of a configuration.
        config: the configuration it is reported for.
        variants: further configurations reported beside it, by name.
        blocks: incremented blocks at the top of a sum's carry chain, lowest first, by the name of the sum (`synth.heap`).
            Found by lengthening the chain of the worst path until 1,000 ps were met; a name that no sum bears is ignored.
            None: they are chosen, from the slack (`synth.report`).
    """

    make: Callable[[AcceleratorConfig], wiring.Component]
    config: AcceleratorConfig = PAPER
    variants: Mapping[str, AcceleratorConfig] = field(default_factory=dict)
    blocks: Mapping[str, Sequence[int]] | None = None


def _numbers(make: Callable[[NumberFormats], wiring.Component]) -> Unit:
    """A unit that depends on number formats only."""
    return Unit(lambda config: make(config.formats))


def culling_variants() -> dict[str, AcceleratorConfig]:
    """PAPER's units and those of machines with fewer of them."""
    return {f"culling_units={units}": PAPER.with_(culling_units=units) for units in (4, 2, 1)}


UNITS: dict[str, Unit] = {
    "pixel_core": Unit(
        make=PixelCore,
        config=DEFAULT,
        variants={
            "levels=1": DEFAULT.with_(levels=1),
            "depth=False": DEFAULT.with_(depth=False),
            "levels=1, depth=False": DEFAULT.with_(levels=1, depth=False),
        },
        blocks={"after": (4, 4, 5), "less": (4,), "total0": (5,), "total1": (5,), "total2": (5,), "total3": (6, 5),
                "exponent_below": (6,)},
    ),
    "vrc_row": Unit(make=VrcRow, config=DEFAULT, blocks={}),
    "setup": Unit(SetupUnit),
    "expand": Unit(Expand),
    "block_sequencer": Unit(BlockSequencer),
    "blend": Unit(Blend),
    "collect": Unit(Collect),
    "vrc_array": Unit(VrcArray),
    "float_add": _numbers(lambda n: FloatAdd(a=n.work, b=n.work, result=n.work)),
    "float_mul": _numbers(lambda n: FloatMul(a=n.work, b=n.work, result=n.work)),
    "float_divide": _numbers(lambda n: FloatDivide(a=n.work, b=n.work, result=n.work)),
    "float_reciprocal": _numbers(lambda n: FloatReciprocal(a=n.view, result=n.view)),
    "float_rsqrt": _numbers(lambda n: FloatRsqrt(a=n.work, result=n.work)),
    "float_sqrt": _numbers(lambda n: FloatSqrt(a=n.work, result=n.extent)),
    "float_to_fixed": _numbers(lambda n: FloatToFixed(a=n.view, result=n.mean2d)),
    "fixed_to_float": _numbers(lambda n: FixedToFloat(a=n.quaternion, result=n.work)),
    "near_test": Unit(NearTest),
    "projection": Unit(Projection),
    "projection_unit": Unit(ProjectionUnit, variants=culling_variants()),
    "tile_test": Unit(TileTest),
    "colour_unit": Unit(ColourUnit, variants=culling_variants()),
    "geometry_reader": Unit(GeometryReader),
    "table_loader": Unit(TableLoader),
    "entry_writer": Unit(EntryWriter),
    "list_reader": Unit(ListReader),
    "header_maker": Unit(HeaderMaker),
    "tile_merge_unit": Unit(TileMergeUnit),
    "chunk_sorter": Unit(ChunkSorter),
    "hierarchical_sorter": Unit(HierarchicalSorter),
    "line_buffer": Unit(LineBuffer),
    "double_buffer": Unit(DoubleBuffer),
    "splat_fetch": Unit(SplatFetch),
    "pixel_writer": Unit(PixelWriter),
    "warp_divider": Unit(disparity_divider),
    "warp_unit": Unit(lambda config: WarpUnit(config.with_(stereo=True)), variants={
        f"warp_lanes={lanes}": PAPER.with_(warp_lanes=lanes) for lanes in (2, 1)}),
    "axi_master": Unit(lambda config: AxiMaster(config, len(READ_CLIENTS), len(WRITE_CLIENTS))),
    "register_file": Unit(RegisterFile),
    "frame_controller": Unit(FrameController),
}
