"""Which bits of a unit change in both directions, by Verilator's counts."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping

from msv2.cases.counts import Point

Toggles = Mapping[tuple[str, str, int], bool]
"""Of every bit, by module, signal and number, whether it has changed in both directions."""


def toggles(points: Iterable[Point]) -> Toggles:
    """The bits of the counts. Only signals with names count, each once: not intermediate values, and not the fields of a record
    beside the record."""
    ways: dict[tuple[str, str, int], set[str]] = defaultdict(set)
    for point in points:
        if point.kind == "toggle":
            name, _, way = point.what.rpartition(":")
            signal, bit = re.fullmatch(r"(.*?)(?:\[(\d+)\])?", name).groups()
            if not re.search(r"\$\d|\.", signal):
                ways[point.module, signal, int(bit or 0)] |= {way} if point.count else set()
    return {key: len(found) == 2 for key, found in sorted(ways.items())}


def holes(found: Toggles) -> list[str]:
    """The bits that have not changed in both directions, as "module: signal[7:4, 0]"."""
    still: dict[tuple[str, str], list[int]] = defaultdict(list)
    for (module, name, bit), both in found.items():
        if not both:
            still[module, name].append(bit)
    return [f"{module}: {name}[{_ranges(bits)}]" for (module, name), bits in still.items()]


def _ranges(bits: list[int]) -> str:
    """Numbers of bits, the highest first, neighbours as a range."""
    parts: list[list[int]] = []
    for bit in sorted(bits, reverse=True):
        if parts and parts[-1][-1] == bit + 1:
            parts[-1].append(bit)
        else:
            parts.append([bit])
    return ", ".join(str(part[0]) if len(part) == 1 else f"{part[0]}:{part[-1]}" for part in parts)
