"""Frames through the RTL for the reports: the numbers that reports keep of each, and reports of which some rows stay."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from golden.scenes.captured import scene_argument
from golden.scenes.files import read_json
from msv2.studies.destination import newest
from msv2.studies.record import write_report
from msv2.studies.rtl_frame import COMMAND, kept_frame
from msv2.studies.scenes import View, available, places
from spec.config import AcceleratorConfig
from spec.paths import REPORTS, ROOT

FRAME_KEYS = (
    "camera", "size", "gaze", "levels", "config", "pixels", "merge", "pipeline", "bit_exact", "mismatches", "counter_errors",
    "pixels_checked", "tiles", "entries", "groups", "ops", "skipped", "table_cycles", "geometry_cycles", "render_cycles",
    "frame_cycles", "overlapped_cycles", "bound_cycles", "bounds", "utilisation", "stage_cycles", "events", "dram_bytes",
    "latency", "bytes_per_cycle", "cycles_per_s")
"""The fields of frame.json that the reports keep."""

Frame = tuple  # a View, and the other options of `python -m tb.frame`


def frame_rows(wanted: Sequence[Frame], keys: Sequence[str] = FRAME_KEYS) -> list[dict[str, object]]:
    """The `frame_row` of every wanted frame, given as a view and options, if its scene is present. Several run in parallel."""
    here = {view for view, _ in available(dict.fromkeys(view for view, *_ in wanted))}
    with ThreadPoolExecutor(max(1, (os.cpu_count() or 1) // 2)) as pool:
        return list(pool.map(lambda frame: frame_row(*frame, keys=keys), [frame for frame in wanted if frame[0] in here]))


def frame_row(view: View, *options: str, keys: Sequence[str] = FRAME_KEYS) -> dict[str, object]:
    """The kept numbers of one frame on the machine, and its simulated cycles in a second of processor time. A frame is not
    simulated again if its sources have not changed."""
    row = kept_frame(ROOT / "build" / "results", scene_argument(view.scene), ["--machine", "full", *view.arguments, *options])
    return {"scene": view.scene, **{key: row[key] for key in keys}, "cycles_per_cpu_s": round(row["cycles"] / row["cpu_s"])}


def write_frames(
    name: str, wanted: Sequence[Frame], machines: Mapping[str, AcceleratorConfig], views: Sequence[View], scene: str | None,
    *, modules: Sequence[str], rows_of: Callable[[Sequence[Frame]], list[dict[str, object]]] = frame_rows,
) -> None:
    """Writes a report of frames in the order of `wanted`; with `scene`, new rows of this scene among the old ones of others.

    Args:
        name: the report's name.
        wanted, machines: the frames, and their machines by name.
        views: the scenes in the order of the report's rows.
        scene: see above. modules: the modules that make the numbers, besides those of the RTL.
        rows_of: the rows of frames.
    """
    path = REPORTS / f"{name}.json"
    rows = rows_of([frame for frame in wanted if scene in (None, frame[0].scene)])
    old = read_json(newest(path)) if scene and newest(path).is_file() else None
    if old:
        rows += [row for row in old["rows"] if row["scene"] != scene]
        rows.sort(key=lambda row: [view.scene for view in views].index(row["scene"]))
    write_report(path, {"rows": rows}, [*modules, COMMAND], machines, places(views), earlier=old)
