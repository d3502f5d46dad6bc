"""A frame's timeline as trace events, which ui.perfetto.dev and chrome://tracing can display."""

from __future__ import annotations

from perf.model import FrameCycles


def trace_events(frame: FrameCycles) -> dict[str, object]:
    """The trace, with a row per stage and a slice per group. One microsecond stands for one cycle."""
    stages = list(dict.fromkeys(stage for stage, *_ in frame.timeline))
    events: list[dict[str, object]] = [
        {"name": "thread_name", "ph": "M", "pid": 0, "tid": tid, "args": {"name": stage}} for tid, stage in enumerate(stages)]
    for stage, eye, group, first, last in frame.timeline:
        name = stage if group < 0 else f"group {group}"
        events.append({"name": name, "ph": "X", "pid": 0, "tid": stages.index(stage), "ts": first, "dur": last - first + 1,
                       "args": {"eye": eye, "cycles": last - first + 1}})
    return {"traceEvents": events, "displayTimeUnit": "ns"}
