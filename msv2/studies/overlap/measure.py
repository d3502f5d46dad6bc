"""Frames in a row, with phases in turn and overlapped, by the cycle model."""

from __future__ import annotations

from msv2.studies.memory import memory_arguments
from msv2.studies.two_eyes.measure import ONE, TWO, traces
from msv2.studies.v3.frames import Subject, traced
from perf.model import MemoryModel, simulate
from perf.overlap import simulate_overlap
from perf.supertiles import simulate_supertiles
from spec.config import PAPER, V3, V3_EYES, V3_EYES_LARGE, V3_EYES_STREAMS, V3_STREAMS_PACKED, AcceleratorConfig

MACHINES: dict[str, tuple[AcceleratorConfig, tuple[str, ...]]] = {
    V3.name: (V3, (ONE,)), V3_STREAMS_PACKED.name: (V3_STREAMS_PACKED, (ONE,)),
    **{config.name: (config, (ONE, TWO)) for config in (V3_EYES, V3_EYES_STREAMS, V3_EYES_LARGE)}}
"""The machines by name, with the kinds of frames that are measured on them."""

TURNS = (1.0, 4.0)
"""Degrees by which the camera turns between the frame that leaves the bounds and the one that uses them: as those frames lie
two apart, twice as many as with phases in turn."""


def rows(subject: Subject, memory: str) -> list[dict[str, object]]:
    """The numbers of a frame with a memory on each machine, JSON-ready."""
    model, out = MemoryModel(**memory_arguments(memory)), []
    for machine, (config, kinds) in MACHINES.items():
        for kind, trace in zip((ONE, TWO), traces(subject, config), strict=True):
            if kind not in kinds:
                continue
            turns = simulate_supertiles(trace, config, memory=model, display=True, packed=config.packed)
            both = simulate_overlap(trace, config, memory=model, display=True, packed=config.packed)
            out.append({
                "frame": subject.name, "scene": subject.scene, "size": subject.size, "machine": machine, "kind": kind,
                "memory": memory, "in_turn": turns.total, "phases": turns.phases, "overlapped": both.period,
                "first": both.first, "second": both.second, "bytes": both.bytes,
                "activates": {"in_turn": turns.activates, "overlapped": both.activates}, "utilisation": both.utilisation})
    return out


def paper_row(subject: Subject, memory: str) -> dict[str, object]:
    """The cycles of the frame of one eye on `paper`, whose phases take turns."""
    found = simulate(traced(subject, PAPER), PAPER, memory=MemoryModel(**memory_arguments(memory)), display=True)
    return {"frame": subject.name, "memory": memory, "cycles": found.total}
