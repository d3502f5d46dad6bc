"""Area and access time of memories under a table whose small macros cost more a bit than its large ones.

The table of `synth.macros` has nearly one price a bit at all sizes, which no memory compiler has: decoders, sense amplifiers
and drivers of a small macro serve few bits. This module takes the shape of the cost from fakeram45 (liberty files with areas
and access times as CACTI gives them, Nangate45's node, in `fakeram45/` below MSV2_PDK), in two ways:

    ANCHORED  areas of fakeram45 relative to its densest macro, times the price a bit of `synth.macros`: only the shape is new
    SCALED    areas of fakeram45 as they are, scaled from 45 nm, times what a second port costs in fakeram7

Its macros have one port; that of `synth.macros` has two, as the machine's memories need.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from functools import cache
from math import ceil
from pathlib import Path

from spec.errors import InputError
from synth.liberty import PDK_VARIABLE
from synth.macros import DENSITY_UM2, MUX_UM2, flops_um2
from synth.memories import Macro
from synth.scaling import TO_16NM

FOLDER = "fakeram45"

SECOND_PORT = 1.41
"""Area of fakeram7's macros with two ports over those with one: 1.40 to 1.42 at all sizes, by the liberty files (a test
measures it again where they are)."""

ANCHORED, SCALED = "anchored", "scaled"
"""The two ways to turn fakeram45's areas into those of a node."""

_FOLDS, _LONGEST_ROW = (1, 2, 4, 8, 16, 32), 512


@dataclass(frozen=True)
class SizedMacro:
    """A macro of the table: its shape, area in um^2 of 45 nm with one port, and access time in ps at 45 nm."""

    words: int
    width: int
    um2: float
    access_ps: float

    @property
    def um2_a_bit(self) -> float:
        """Area of a bit."""
        return self.um2 / (self.words * self.width)


@dataclass(frozen=True)
class Sized:
    """A memory under the table.

    Attributes:
        kind: what it is built of: the macro's shape, or "flip-flops".
        macros: number of macros.
        um2: area at 16 nm.
        access_ps: access time of the macro in ps, scaled to ASAP7's node by the factors of `synth.scaling`; 0 for flip-flops.
    """

    kind: str
    macros: int
    um2: float
    access_ps: float


@cache
def table(folder: str | None = None) -> tuple[SizedMacro, ...]:
    """The macros of fakeram45, by words and width.

    Raises:
        InputError: the folder has no such files, or MSV2_PDK names none.
    """
    folder = folder or os.environ.get(PDK_VARIABLE)
    found = []
    for path in sorted(Path(folder or "/nowhere", FOLDER).glob("fakeram45_*x*.lib")):
        text = path.read_text()
        words, width = map(int, re.fullmatch(r"fakeram45_(\d+)x(\d+)", path.stem).groups())
        access = max(float(value) for value in re.findall(r'cell_(?:rise|fall)\(scalar\)\s*\{\s*values \("([\d.]+)"', text))
        found.append(SizedMacro(words, width, float(re.search(r"\barea\s*:\s*([\d.]+)", text)[1]), 1e3 * access))
    if not found:
        raise InputError(f"{PDK_VARIABLE} must name a folder with liberty files in {FOLDER}/, not {folder!r}")
    return tuple(sorted(found, key=lambda macro: (macro.words, macro.width)))


def make_sized(memory: Macro, way: str, macros: tuple[SizedMacro, ...]) -> Sized:
    """The smallest way to build a memory: of equal macros beside and above each other, folded or not, or of flip-flops.

    Args:
        memory: its shape; each of several read ports beside one write port is a copy.
        way: ANCHORED or SCALED.
        macros: the table.
    """
    copies = memory.reads if memory.writes == 1 else 1
    options = [_of(memory, macro, fold, copies, um2_16nm(macro, way, macros)) for macro in macros for fold in _FOLDS
               if fold == 1 or (fold < memory.words and fold * memory.width <= _LONGEST_ROW)]
    options.append(Sized("flip-flops", 0, flops_um2(memory) * TO_16NM["asap7"].area, 0.0))
    return min(options, key=lambda sized: sized.um2)


def um2_16nm(macro: SizedMacro, way: str, macros: tuple[SizedMacro, ...]) -> float:
    """Area of a macro with two ports at 16 nm."""
    if way == SCALED:
        return macro.um2 * SECOND_PORT * TO_16NM["nangate45"].area
    densest = min(other.um2_a_bit for other in macros)
    return macro.um2 / densest * DENSITY_UM2 * TO_16NM["asap7"].area


def _of(memory: Macro, macro: SizedMacro, fold: int, copies: int, um2: float) -> Sized:
    across, down = ceil(memory.width * fold / macro.width), ceil(ceil(memory.words / fold) / macro.words)
    choices = (fold - 1) * memory.width + (down - 1) * memory.width * fold  # 2:1 multiplexers behind the macros
    count = copies * across * down
    area = count * um2 + copies * choices * MUX_UM2 * TO_16NM["asap7"].area
    return Sized(f"{macro.words}x{macro.width}", count, area, macro.access_ps * _TO_7NM)


_TO_7NM = TO_16NM["nangate45"].delay / TO_16NM["asap7"].delay
"""Factor from a delay at 45 nm to one at 7 nm."""
