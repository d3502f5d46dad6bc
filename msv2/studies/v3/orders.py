"""The orders of a model in memory (`golden.host.order`), compared by the cycles of an LPDDR3 memory."""

from __future__ import annotations

from golden.host.order import CANDIDATES
from golden.host.quantise import quantise_model
from golden.msv2_ref import pipeline
from golden.scenes.request import resolve
from msv2.studies.memory import memory_arguments
from msv2.studies.performance.frames import request
from msv2.studies.v3.frames import MEMORIES, Subject, chunks, chunks_read, total_bytes
from perf.model import MemoryModel, simulate
from perf.trace import FrameTrace, trace_of
from spec.config import PAPER, V3_RECORDS, AcceleratorConfig


def order_rows(subject: Subject) -> list[dict[str, object]]:
    """The numbers of a frame with the model in every order, on `paper` and, in orders that chunks can be cut from, on
    `v3_records`.

    Raises:
        InputError: the scene is missing.
    """
    asked = resolve(request(subject.scene, subject.size))
    rows = []
    for name, order in CANDIDATES.items():
        for config in (PAPER, V3_RECORDS) if order is not None else (PAPER,):
            words = quantise_model(config, asked.model, order=order)
            trace = trace_of(pipeline.render(
                words, asked.camera, config=config, foveation=asked.foveation, background=asked.background))
            rows += [_row(subject, name, config, memory, trace) for memory in MEMORIES]
    return rows


def _row(
    subject: Subject, name: str, config: AcceleratorConfig, memory: str, trace: FrameTrace,
) -> dict[str, object]:
    """The numbers of a frame with the model in an order."""
    frame = simulate(trace, config, memory=MemoryModel(**memory_arguments(memory)), display=True)
    return {"frame": subject.name, "order": name, "machine": config.name, "memory": memory, "cycles": frame.total,
            "total_bytes": total_bytes(frame), "activates": frame.activates, "chunks": chunks(trace),
            "chunks_read": chunks_read(trace)}
