"""`msv2 study run frames_eyes`: joint frames of both eyes through the RTL, each beside the cycle model.

On `v3_eyes` and, with four arrays and packed frames, on `v3_eyes_streams`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

from golden.host.run_options import IDEAL, LPDDR3
from golden.msv2_ref.buckets import no_bounds
from golden.msv2_ref.joint import render_joint
from golden.scenes.camera_options import ORBIT
from golden.scenes.captured import scene_argument
from golden.scenes.files import read_json
from golden.scenes.load import TRAINED
from golden.scenes.request import parse_request, resolve
from golden.scenes.stereo import scene_scale, stereo_pair
from msv2.studies.destination import newest
from msv2.studies.record import write_report
from msv2.studies.results.frames import FRAME_KEYS, Frame, frame_row
from msv2.studies.rtl_frame import COMMAND
from msv2.studies.scenes import EXACT, View, available, places
from perf.joint_trace import joint_trace
from perf.model import MemoryModel
from perf.phases import LastingMemory
from perf.supertiles import clear_cycles, simulate_supertiles
from spec.config import MACHINES, V3_EYES, V3_EYES_STREAMS, AcceleratorConfig
from spec.paths import REPORTS

KEYS = (*FRAME_KEYS, "memory", "idle_cycles", "configuration")
"""The fields of frame.json that the report keeps, of which `configuration` becomes `streams` and `packs`."""

PHASES = ("table", "geometry", "render")


def _two(view: View, config: AcceleratorConfig, pixels: str, *options: str) -> Frame:
    return (view, "--config", config.name, "--pixels", pixels, "--stereo", *options)


_TRAINED = (View(TRAINED, "128x128"), V3_EYES_STREAMS, "packed", "--gaze", "64,64", "--levels", "4")

WANTED: tuple[Frame, ...] = (
    *(_two(of, V3_EYES, "display") for view in EXACT for of in (replace(view, gaze=None), view)),
    *(_two(view, V3_EYES_STREAMS, "packed") for view in EXACT), _two(*_TRAINED),
    _two(EXACT[0], V3_EYES_STREAMS, "packed", "--memory", LPDDR3), _two(*_TRAINED, "--memory", LPDDR3))
"""The frames: views and the other options of `python -m tb.frame`."""

VIEWS = (*EXACT, _TRAINED[0])


def measure_frames_eyes(scene: str | None = None, machines: Collection[str] = ()) -> None:
    """Writes reports/frames_eyes.json; with `scene` or `machines` only the frames of these are simulated, and the other rows
    stay."""
    path = REPORTS / "frames_eyes.json"
    old = read_json(newest(path)) if (scene or machines) and newest(path).is_file() else None
    kept = {_key(row): row for row in old["rows"]} if old else {}
    here = {view for view, _ in available(dict.fromkeys(view for view, *_ in WANTED))}
    rows: list[dict[str, Any]] = []
    for frame in (frame for frame in WANTED if frame[0] in here):
        if scene in (None, frame[0].scene) and (not machines or frame[2] in machines):
            row = frame_row(*frame, keys=KEYS)
            made = row.pop("configuration")
            rows.append(with_model(frame, {
                **row, "config": frame[2], "streams": made["streams"], "packs": made["packed"]}))
        else:
            rows += [row if "model" in row else with_model(frame, row) for row in [kept.get(_asked(frame))] if row]
    write_report(path, {"rows": rows, "summary": summary(rows)}, [__name__, COMMAND],
                 {"config": V3_EYES, "streams": V3_EYES_STREAMS}, places(VIEWS), earlier=old)


def _asked(frame: Frame) -> tuple[object, ...]:
    """What `_key` gives for the row of a frame."""
    args = _parsed(frame)
    return (frame[0].scene, args.size, bool(args.gaze), frame[2], _option(frame, "--pixels"),
            _option(frame, "--memory") or IDEAL)


def _key(row: Mapping[str, Any]) -> tuple[object, ...]:
    """What tells the rows of the report apart."""
    return (row["scene"], "x".join(map(str, row["size"])), bool(row["gaze"]), row["config"], row["pixels"],
            row.get("memory", IDEAL))


def _option(frame: Frame, name: str) -> str | None:
    """The value of an option of a frame."""
    return frame[frame.index(name) + 1] if name in frame else None


def _parsed(frame: Frame) -> Any:
    """The parsed arguments of a frame, except those of the run."""
    view, *options = frame
    run = ("--config", "--pixels", "--memory")
    kept = [word for n, word in enumerate(options) if word not in ("--stereo", *run) and not (n and options[n - 1] in run)]
    return parse_request(scene_argument(view.scene), "--camera", ORBIT, *view.arguments, *kept)


def with_model(frame: Frame, row: Mapping[str, Any]) -> dict[str, Any]:
    """A frame's row with the cycles of the model, and its error in the total."""
    config = MACHINES[frame[2]]
    asked = resolve(_parsed(frame))
    how = {"config": config, "foveation": asked.foveation, "background": asked.background}
    pair = stereo_pair(asked.camera, units_per_metre=scene_scale(asked.model.name, None)[0])
    trace = joint_trace(render_joint(asked.model, pair, **how))
    memory = MemoryModel(LPDDR3) if row.get("memory") == LPDDR3 else MemoryModel(IDEAL, row["latency"], row["bytes_per_cycle"])
    clear = row["frame_cycles"] - sum(row[f"{name}_cycles"] for name in PHASES)
    idle = row.get("idle_cycles", 0) + max(0, clear - clear_cycles(trace, config))  # units clear memories after a reset
    found = simulate_supertiles(trace, config, memory=LastingMemory(memory, idle), display=row["pixels"] == "display",
                                packed=row["pixels"] == "packed", bounds=no_bounds(trace.supertiles))
    cycles = {name: found.phases[name] for name in PHASES}
    same = sum(cycles.values()) / sum(row[f"{name}_cycles"] for name in PHASES)
    return {**row, "model": {**{f"{name}_cycles": n for name, n in cycles.items()}, "error": round(same - 1, 6)}}


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, object]:
    """What the rows say together: how many are equal to golden, and the largest error of the model in a frame's cycles."""
    return {"frames": len(rows), "bit_exact": sum(row["bit_exact"] and not row["counter_errors"] for row in rows),
            "model_error_total": max(abs(row["model"]["error"]) for row in rows)}
