"""What gave the cycles in a report, and how tables call them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

ESTIMATE, MODEL, RTL = "golden", "model", "rtl"
"""The estimate that version 0.1 made from golden frames, which reports kept from it hold; the cycle model of `perf`; the
simulated RTL."""

CYCLES = {ESTIMATE: "cycles by the golden estimate of version 0.1", MODEL: "cycles by the model", RTL: "RTL cycles"}
"""How tables call them."""

EXPLAINED = {
    ESTIMATE: "*Cycles by the golden estimate of version 0.1* are kept from that version: each phase takes as long as its "
              "busiest part at one item a cycle, or as its traffic takes a memory of 25.6 bytes a cycle.",
    MODEL: "*Cycles by the model*: the cycle model (`perf/`) simulates the golden renderer's frame."}
"""What each of them is, for pages."""


def cycles_by(record: Mapping[str, Any]) -> str:
    """What gave the cycles of a record: those kept from version 0.1 do not say it."""
    return record.get("cycles_by", ESTIMATE)


def explained(records: Iterable[Mapping[str, Any]]) -> str:
    """The sentences of EXPLAINED for all that gave cycles in the records."""
    found = set(map(cycles_by, records))
    return " ".join(text for name, text in EXPLAINED.items() if name in found)


def cycles_of(record: Mapping[str, Any]) -> str:
    """How tables call the cycles of a record."""
    return CYCLES[cycles_by(record)]
