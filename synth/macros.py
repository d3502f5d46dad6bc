"""Area of the memories that are no logic: macros of a table of sizes, put together, or flip-flops where those are smaller.

The table is fakeram7's (liberty files of SRAM macros for ASAP7, areas as a generator of macros would give them; `fakeram7/`
below MSV2_PDK). A memory's words and width are made of macros side by side and one upon the other, what is too much is waste;
narrow and long memories are folded: several words lie in a row, written by the macro's mask and read through a multiplexer.
Where there is no table, its density stands for it: it is the same for all sizes.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from math import inf
from pathlib import Path

from synth.liberty import PDK_VARIABLE
from synth.memories import Macro

FOLDER, FAMILY = "fakeram7", "fakeram7_dp"
"""Macros of two ports: one reads while the other writes."""

PORTS = 2
"""Of a macro."""

DENSITY_UM2 = 0.0601
"""Area a bit of all these macros (0.0594 to 0.0644), for where the liberty files are not there."""

_SIZES = ((64, 32), (128, 32), (256, 32), (256, 64), (512, 32), (512, 64), (512, 128), (1024, 32), (1024, 64), (4096, 64),
          (8192, 64))
"""Words and width of the macros in the table."""

_FOLDS, _LONGEST_ROW = (1, 2, 4, 8, 16, 32), 512
_WORDS, _WIDTH = 64, 32  # every size is a multiple of these

FLOP_UM2, MUX_UM2, WORD_UM2 = 0.292, 0.13, 0.6
"""ASAP7, strict cells: a flip-flop; a 2:1 multiplexer; a word's clock gate and its place in the decoder. An array of
flip-flops is words x width of the first, (words - 1) x width of the second a read port, words of the third."""


@dataclass(frozen=True)
class Made:
    """What a memory is made of.

    Attributes:
        kind: "macros" or "flip-flops".
        macros: how many of which macro; none of flip-flops.
        area_um2: at ASAP7's node, multiplexers behind macros included.
        source: how the area was found.
    """

    kind: str
    macros: dict[str, int]
    area_um2: float
    source: str


def macro_areas() -> tuple[dict[tuple[int, int], float], str]:
    """Area by words and width, um^2, and where it is from."""
    folder = Path(os.environ.get(PDK_VARIABLE, "/nowhere")) / FOLDER
    found = {}
    for words, width in _SIZES:
        path = folder / f"{FAMILY}_{words}x{width}.lib"
        if path.is_file():
            found[words, width] = float(re.search(r"\barea\s*:\s*([\d.]+)", path.read_text())[1])
    if found:
        return found, "liberty files of fakeram7 (dp), ASAP7"
    return ({size: size[0] * size[1] * DENSITY_UM2 for size in _SIZES},
            f"{DENSITY_UM2} um^2 a bit, the density of fakeram7 (dp), in its sizes")


def make(memory: Macro) -> Made:
    """The smallest way to make a memory of any number of read ports, and of one write port or as many as a macro has ports."""
    if memory.writes > 1 and memory.reads + memory.writes > PORTS:
        raise ValueError(f"a memory must have one write port or {PORTS} ports in all, not {memory!r}")
    areas, source = macro_areas()
    copies = memory.reads if memory.writes == 1 else 1
    area, macros = min(
        (_folded(memory, fold, tuple(sorted(areas.items()))) for fold in _FOLDS
         if fold == 1 or (fold < memory.words and fold * memory.width <= _LONGEST_ROW)),
        key=lambda found: found[0])
    flops = memory.bits * FLOP_UM2 + memory.reads * (memory.words - 1) * memory.width * MUX_UM2 + memory.words * WORD_UM2
    if flops <= copies * area:
        return Made("flip-flops", {}, flops, f"{FLOP_UM2} um^2 a bit, {MUX_UM2} a multiplexer of a bit, {WORD_UM2} a word")
    return Made("macros", {name: copies * count for name, count in macros.items()}, copies * area,
                f"{source}; {MUX_UM2} um^2 for each multiplexer of a bit behind them")


def _folded(memory: Macro, fold: int, areas: tuple) -> tuple[float, Counter[str]]:
    """`fold` words in a row."""
    words, width = -(-memory.words // fold), memory.width * fold
    columns = -(-width // _WIDTH)
    best: list[tuple[float, Counter[str]]] = [(0.0, Counter())]
    for count in range(1, columns + 1):
        options = []
        for wide in sorted({size[1] for size, _ in areas}):
            if wide // _WIDTH <= count:
                area, macros = _stacked(-(-words // _WORDS), wide, areas)
                before = best[count - wide // _WIDTH]
                options.append((before[0] + area, before[1] + Counter(dict(macros))))
        best.append(min(options, key=lambda option: option[0]))
    area, macros = best[columns]
    return area + (fold - 1) * memory.width * MUX_UM2, macros


@lru_cache
def _stacked(rows: int, width: int, areas: tuple) -> tuple[float, tuple[tuple[str, int], ...]]:
    """Macros of one width, one upon the other, for `rows` times _WORDS words; a multiplexer behind each but one."""
    best: list[tuple[float, Counter[str]]] = [(-width * MUX_UM2, Counter())]
    for count in range(1, rows + 1):
        options = [(inf, Counter())]
        for (words, wide), area in areas:
            if wide == width:
                before = best[max(0, count - words // _WORDS)]
                options.append((before[0] + area + width * MUX_UM2, before[1] + Counter({f"{FAMILY}_{words}x{wide}": 1})))
        best.append(min(options, key=lambda option: option[0]))
    area, macros = best[rows]
    return area, tuple(sorted(macros.items()))
