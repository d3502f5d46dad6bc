"""Area of the memories that are not logic: SRAM macros of a table of sizes, or flip-flops if those are smaller.

The table is that of fakeram7: liberty files of SRAM macros for ASAP7 in `fakeram7/` below MSV2_PDK, with areas as a macro
generator would give them. A memory is built of macros side by side for its width and stacked for its words; excess capacity is
wasted.
A long and narrow memory is folded: a row of the macro holds several words, which are written with the macro's mask and read
through a multiplexer. If the files are missing, the table's area per bit is used, which is nearly the same for all sizes.
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
"""Family of macros with two ports, one of which reads while the other writes."""

PORTS = 2
"""Number of ports of a macro."""

DENSITY_UM2 = 0.0601
"""Area per bit of these macros in um^2 (0.0594 to 0.0644), used if the liberty files are missing."""

_SIZES = ((64, 32), (128, 32), (256, 32), (256, 64), (512, 32), (512, 64), (512, 128), (1024, 32), (1024, 64), (4096, 64),
          (8192, 64))
"""Words and width in bits of the macros in the table."""

_FOLDS, _LONGEST_ROW = (1, 2, 4, 8, 16, 32), 512
_WORDS, _WIDTH = 64, 32  # every size is a multiple of these

FLOP_UM2, MUX_UM2, WORD_UM2 = 0.292, 0.13, 0.6
"""Areas in um^2 of ASAP7 with the strict cell list: a flip-flop; a 2:1 multiplexer; a word's clock gate and share of the
decoder. An array of flip-flops takes words x width of the first, (words - 1) x width of the second for each read port, and one
of the third for each word."""


@dataclass(frozen=True)
class Made:
    """What a memory is built of.

    Attributes:
        kind: "macros" or "flip-flops".
        macros: number of macros by name; empty for flip-flops.
        area_um2: area in ASAP7's node, including the multiplexers behind macros.
        source: how the area was found.
    """

    kind: str
    macros: dict[str, int]
    area_um2: float
    source: str


def macro_areas() -> tuple[dict[tuple[int, int], float], str]:
    """Area of each macro in um^2 by (words, width), and the source of these areas."""
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
    """The smallest way to build a memory.

    Any number of read ports is possible together with one write port, because copies can be made; otherwise the ports of one
    macro must do.

    Raises:
        ValueError: the memory has more than one write port and more ports than a macro.
    """
    if memory.writes > 1 and memory.reads + memory.writes > PORTS:
        raise ValueError(f"a memory must have one write port or {PORTS} ports in all, not {memory!r}")
    areas, source = macro_areas()
    copies = memory.reads if memory.writes == 1 else 1
    area, macros = min(
        (_folded(memory, fold, tuple(sorted(areas.items()))) for fold in _FOLDS
         if fold == 1 or (fold < memory.words and fold * memory.width <= _LONGEST_ROW)),
        key=lambda found: found[0])
    flops = flops_um2(memory)
    if flops <= copies * area:
        return Made("flip-flops", {}, flops, f"{FLOP_UM2} um^2 a bit, {MUX_UM2} a multiplexer of a bit, {WORD_UM2} a word")
    return Made("macros", {name: copies * count for name, count in macros.items()}, copies * area,
                f"{source}; {MUX_UM2} um^2 for each multiplexer of a bit behind them")


def flops_um2(memory: Macro) -> float:
    """Area of a memory that is an array of flip-flops, in um^2 of ASAP7."""
    return memory.bits * FLOP_UM2 + memory.reads * (memory.words - 1) * memory.width * MUX_UM2 + memory.words * WORD_UM2


def _folded(memory: Macro, fold: int, areas: tuple) -> tuple[float, Counter[str]]:
    """Area and macros of a memory with `fold` words in each row."""
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
    """Area and macros of a stack of one width for `rows` times _WORDS words; all macros but one need a multiplexer."""
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
