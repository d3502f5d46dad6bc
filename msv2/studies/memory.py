"""The memories of a report, in the order of its tables: LPDDR3, which the paper has, then ideal ones as bounds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from spec.memory import DRAM_BYTES_PER_CYCLE

LPDDR3, IDEAL, UNLIMITED = "lpddr3", "ideal", "unlimited"
"""Four channels of LPDDR3-1600; the memory of the RTL's bench at the same bandwidth, without rows, refresh or turns of the bus;
and the bench's memory with a beat read and a beat written in every cycle."""

IDEAL_CYCLES = "ideal_cycles"
"""The name under which reports have a frame's cycles with the ideal memory beside `cycles`, those with LPDDR3."""

MEMORY_NAMES = {LPDDR3: "4 x LPDDR3-1600", IDEAL: f"ideal, {DRAM_BYTES_PER_CYCLE:g} B a cycle"}
"""The names in tables of the memories that have the paper's bandwidth, LPDDR3 first."""

ALL_NAMES = {**MEMORY_NAMES, UNLIMITED: "unlimited"}
"""The names in tables of all memories."""


def memory_arguments(memory: str) -> dict[str, object]:
    """The arguments of `perf.model.MemoryModel` for a memory. Raises KeyError for one that is not in ALL_NAMES."""
    arguments: dict[str, dict[str, object]] = {
        LPDDR3: {"kind": "lpddr3"}, IDEAL: {"kind": "ideal"}, UNLIMITED: {"kind": "ideal", "bytes_per_cycle": None}}
    return arguments[memory]


def cycles_heads(rows: Iterable[Mapping[str, object]]) -> list[str]:
    """The heads of the columns of `cycles_cells`, for rows of a report. Reports from before LPDDR3 was the headline memory have
    the ideal memory's cycles alone."""
    both = any(IDEAL_CYCLES in row for row in rows)
    return [f"cycles, {MEMORY_NAMES[memory]}" for memory in (MEMORY_NAMES if both else (IDEAL,))]


def cycles_cells(row: Mapping[str, float]) -> list[str]:
    """The cycles of a row: with LPDDR3, then with the ideal memory as a bound."""
    return [f"{row[name]:,.0f}" for name in ("cycles", IDEAL_CYCLES) if name in row]
