"""Which bits of a unit change in both directions while its quick suite is played, counted by Verilator."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path

from msv2.cases.mutants.targets import Target
from tb.common import exact
from tb.common.player import play
from tb.common.runner import TOGGLES

_MANGLED = re.compile(r"__0([0-9A-Fa-f]{2})")
_BENCH = "tb"
"""The module around the unit in every testbench."""

Toggles = Mapping[tuple[str, str, int], bool]
"""Of every bit, by module, signal and number, whether it has changed in both directions."""


def toggles_of(target: Target, folder: Path) -> Toggles:
    """Plays a unit's quick suite and returns what has changed in it, but for units inside that have a target of their own.

    Raises:
        RuntimeError: the suite fails.
    """
    with exact.played_by(partial(play, toggles=True)):
        outcome = target.suite.run_plan(target.config, target.plan(), folder)
    if outcome.failures:
        raise RuntimeError(f"{target.name}: {next(iter(outcome.failures.items()))}")
    with open(folder / TOGGLES, errors="replace") as lines:
        found = merged(lines)
    return {key: both for key, both in found.items() if not any(f".{name}" in f".{key[0]}." for name in target.apart)}


def merged(lines: Iterable[str]) -> Toggles:
    """The bits of Verilator's counts. Only signals with names count, each once: not intermediate values, not the fields of a
    record beside the record, and not the testbench."""
    ways: dict[tuple[str, str, int], set[str]] = defaultdict(set)
    for module, name, bit, way, count in _points(lines):
        if module != _BENCH and not re.search(r"\$\d|\.", name):
            ways[module, name, bit] |= {way} if count else set()
    return {key: len(found) == 2 for key, found in sorted(ways.items())}


def _points(lines: Iterable[str]) -> Iterator[tuple[str, str, int, str, int]]:
    """Module, signal, bit, direction and count of each point."""
    for line in lines:
        if not line.startswith("C '"):
            continue
        words, _, count = line[3:].rpartition("'")
        fields = dict(part.split("\2", 1) for part in words.split("\1") if "\2" in part)
        if fields.get("t") != "toggle":
            continue
        name, _, way = fields["o"].rpartition(":")
        signal, bit = re.fullmatch(r"(.*?)(?:\[(\d+)\])?", name).groups()
        yield fields["page"].removeprefix("v_toggle/"), _plain(signal), int(bit or 0), way, int(count)


def _plain(name: str) -> str:
    """A signal's name in Verilog from that in the simulator."""
    return _MANGLED.sub(lambda code: chr(int(code[1], 16)), name.replace("___05F", "__"))


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
