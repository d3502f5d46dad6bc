"""The sources of the cycles in a report, and their names in tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

ESTIMATE, MODEL, LPDDR3_MODEL, RTL = "golden", "model", "model, lpddr3", "rtl"
"""The sources of cycles: the estimate that version 0.1 made from golden frames, which reports of that version hold; the cycle
model in `perf` with the ideal memory, and with LPDDR3; the simulated RTL, with the ideal memory."""

CYCLES = {ESTIMATE: "cycles by the golden estimate of version 0.1", MODEL: "cycles by the model, ideal memory",
          LPDDR3_MODEL: "cycles by the model, LPDDR3", RTL: "RTL cycles"}
"""The name of each source in tables."""

EXPLAINED = {
    ESTIMATE: "*Cycles by the golden estimate of version 0.1* are kept from that version: each phase takes as long as its "
              "busiest part at one item a cycle, or as its traffic takes a memory of 25.6 bytes a cycle.",
    MODEL: "*Cycles by the model, ideal memory*: the cycle model (`perf/`) simulates the golden renderer's frame, with a "
           "memory that moves 25.6 bytes in every cycle, which is a bound for LPDDR3.",
    LPDDR3_MODEL: "*Cycles by the model, LPDDR3*: the cycle model (`perf/`) simulates the golden renderer's frame, with four "
                  "channels of LPDDR3-1600."}
"""Explanations of the sources, for pages."""


def cycles_by(record: Mapping[str, Any]) -> str:
    """The source of a record's cycles. Records from version 0.1 do not name it."""
    return record.get("cycles_by", ESTIMATE)


def explained(records: Iterable[Mapping[str, Any]]) -> str:
    """The sentences of EXPLAINED for all sources that occur in the records."""
    found = set(map(cycles_by, records))
    return " ".join(text for name, text in EXPLAINED.items() if name in found)


def cycles_of(record: Mapping[str, Any]) -> str:
    """The name that tables give to a record's cycles."""
    return CYCLES[cycles_by(record)]
