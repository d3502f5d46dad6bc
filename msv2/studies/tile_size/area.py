"""Area of the parts of the machine that depend on the size of a tile: the array, and the memories with a word for each tile."""

from __future__ import annotations

from msv2.studies.area.estimate import estimate_area
from msv2.studies.tile_size.measure import Array
from spec.config import PAPER, AcceleratorConfig
from spec.constants import TILE
from synth.machine import ARRAY
from synth.macros import make
from synth.memories import Macro
from synth.scaling import TO_16NM

_FACTOR = TO_16NM["asap7"].area

TILE_WORDS = (24, 24, 23)
"""Bits of the words that the machine holds for each tile: its count, and where its list's last page begins and ends."""


def array_mm2(array: Array) -> float:
    """Logic of the array's cores, rows and setup, at 16 nm.

    An array that a configuration can have is estimated like any machine. Another one has as many cores as it has, and a core
    holds the sums of as many pixels as it renders.
    """
    if array.expressible:
        return estimate_area(PAPER.with_(cores_x=array.cores, cores_y=array.cores)).groups[ARRAY].logic_um2 / 1e6
    # A core of a tile of 32 on an array of 16 holds as much as one of a tile of 16 on an array of 8
    same = PAPER.with_(cores_x=TILE // int(array.blocks**0.5), cores_y=TILE // int(array.blocks**0.5))
    one = estimate_area(same).groups[ARRAY].logic_um2 / (same.cores_x * same.cores_y)
    return one * array.cores**2 / 1e6


def tile_memory_mm2(tile: int, config: AcceleratorConfig = PAPER) -> float:
    """The memories with a word for each tile of the largest frame, at 16 nm."""
    words = (-(-config.row_width // tile)) ** 2
    return sum(make(Macro(words, width, 1, 1)).area_um2 for width in TILE_WORDS) * _FACTOR / 1e6


def output_mm2(array: Array, config: AcceleratorConfig = PAPER) -> float:
    """The buffer behind the array, which holds two drains of its rows, as flip-flops and multiplexers or macros."""
    bits = 3 * config.formats.accumulator.width + config.formats.depth_accumulator.width + config.formats.transmittance.width
    return make(Macro(2 * array.cores, array.cores * bits, 1, 1)).area_um2 * _FACTOR / 1e6


def basis(array: Array) -> str:
    """Where the area of the array comes from."""
    if array.expressible:
        return estimate_area(PAPER.with_(cores_x=array.cores, cores_y=array.cores)).basis
    return "modelled"
