"""Compares the cycle model with the RTL: reports/model.json and reports/model.md.

    msv2 study run model         compares the frames that the RTL has rendered: reports/frames.json, machine.json and
                                         model_rtl.json
    msv2 study run model --rtl   first renders the frames of model_rtl.json through the RTL (half an hour, but finished
                                         runs are kept), and one frame more to time RTL and model in turn

Real scenes are looked for in MSV2_DATA. Frames whose scene is missing are left out and named.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence

from golden.scenes.captured import scene_argument
from golden.scenes.level_source import RANDOM
from golden.scenes.load import EMBEDDED
from golden.scenes.request import parse_request
from msv2.studies.destination import newest
from msv2.studies.page import table, write_page
from msv2.studies.record import write_report
from msv2.studies.rtl_frame import COMMAND, kept_frame
from perf.model import FrameCycles, MemoryModel, simulate
from perf.trace import FrameTrace, trace_request
from spec.command_line import command_parser
from spec.config import CONFIGS, AcceleratorConfig
from spec.effects import EffectPlan
from spec.errors import InputError
from spec.paths import REPORTS, ROOT

BUILD = ROOT / "build" / "perf"
RTL_REPORTS = ("frames", "machine", "model_rtl")
"""The reports that hold frames of the RTL."""

RTL_FRAMES = (
    "embedded --size 160x96 --config default",
    "truck --size 96x64 --config default --machine scene",
    "embedded --size 128x128 --config default --stereo --gaze 64,64 --levels 4 --levels-from random",
    "embedded --size 320x180 --config default --stereo --gaze 160,90 --levels 4 --levels-from random",
)
"""Frames that the other reports do not have: two eyes, a smaller machine, and one without harmonics and levels."""

TIMED = "embedded --size 128x128 --config paper"
"""The frame with which RTL and model are timed, one after the other."""

LARGE = "garden_large --size 1920x1080 --gaze 960,540 --levels 4 --levels-from random --config paper --pixels display"
_LARGE_ROW = {"size": (1920, 1080), "gaze": (960, 540), "levels": 4}
"""A large frame for which the report states the model's time."""

TIMED_SECONDS = 10.0

PHASES = ("table", "geometry", "render")
TOTAL_GOAL, STAGE_GOAL, SPEED_GOAL = 0.02, 0.05, 500

_KEPT = (
    "scene", "size", "gaze", "levels", "config", "machine", "effects", "pixels", "merge", "pipeline", "bit_exact",
    "counter_errors", "entries", "ops", "skipped", "table_cycles", "geometry_cycles", "render_cycles", "frame_cycles",
    "source_cycles", "target_cycles", "stage_cycles", "events", "dram_bytes", "latency", "bytes_per_cycle", "wall_s", "cpu_s",
    "cycles_per_s")


def request(row: Mapping[str, object], scene: str) -> argparse.Namespace:
    """The parsed arguments of a report's frame."""
    argv = [scene, "--size", "x".join(map(str, row["size"]))]
    argv += ["--gaze", ",".join(map(str, row["gaze"]))] if row.get("gaze") else []
    argv += ["--levels", str(row["levels"]), "--levels-from", RANDOM] if row["levels"] > 1 else []
    argv += ["--stereo"] if "target_cycles" in row else []
    return parse_request(*argv)


def machine(row: Mapping[str, object]) -> AcceleratorConfig:
    """The machine of a report's frame: that of its whole configuration, or only what the frame needs (tb.frame --machine)."""
    config = CONFIGS[row["config"]]
    config = config.with_(stereo=True) if "target_cycles" in row else config
    if row.get("machine") != "scene":
        return config
    said = row["effects"]
    active = frozenset(name for name, effect in said["effects"].items() if effect["state"] != "absent")
    return EffectPlan(said["wanted"], active, frozenset(), {}, said["sh_degree"]).machine(config)


def model_row(row: Mapping[str, object], scene: str) -> tuple[FrameTrace, FrameCycles]:
    """The trace of a report's frame, and its numbers from the model."""
    config = machine(row)
    trace = trace_request(request(row, scene), config, cache=BUILD / "traces")
    memory = MemoryModel(latency=row["latency"], bytes_per_cycle=row["bytes_per_cycle"])
    return trace, simulate(
        trace, config, memory=memory, merge=row["merge"], pipeline=row["pipeline"], display=row["pixels"] == "display")


def compared(row: Mapping[str, object], frame: FrameCycles) -> dict[str, object]:
    """The report's row of a frame: the cycles of RTL and model and the relative error, by phase, by stage and in total.

    A stage's number is that of the cycles in which something was offered at its input, whether it moved or not. Both totals are
    without the clearing that follows a reset.
    """
    rtl = {name: int(row[f"{name}_cycles"]) for name in PHASES}
    model = {name: frame.phases[name] for name in PHASES}
    totals, stages = (sum(model.values()), sum(rtl.values())), {}
    for name, stage in frame.stages.items():
        watched = row["stage_cycles"][name]
        there, ours = watched["busy"] + watched["blocked"], stage.busy + stage.blocked
        stages[name] = {"rtl": there, "model": ours, "error": _error(ours, there), "busy_equal": stage.busy == watched["busy"],
                        "share_of_frame": abs(ours - there) / max(1, sum(rtl.values()))}
    return {
        **{name: row[name] for name in ("scene", "size", "gaze", "levels", "config", "pixels", "merge", "pipeline", "latency",
                                        "bytes_per_cycle", "entries")},
        "machine": row.get("machine", "full"), "eyes": len(frame.eyes),
        "phases": {name: {"rtl": rtl[name], "model": model[name], "error": _error(model[name], rtl[name])} for name in PHASES},
        "total": {"rtl": totals[1], "model": totals[0], "error": _error(*totals)},
        "stages": stages,
        "beats_equal": frame.dram_bytes["reads"] == row["dram_bytes"]["reads"] and all(
            frame.writes.get(name, 0) == count for name, count in row["dram_bytes"]["writes"].items()),
        "misses_equal": frame.fetch_misses == row["events"]["fetch_misses"], "skipped": [row["skipped"], frame.skipped],
        "model_seconds": frame.seconds, "rtl_cycles_per_s": row["cycles_per_s"],
    }


def _error(model: int, rtl: int) -> float:
    return (model - rtl) / rtl if rtl else float(model != 0)


def rtl_row(line: str, *, again: bool = False) -> dict[str, object] | None:
    """A frame through the RTL. A finished run is used unless `again`; None where the scene is missing.

    Raises:
        InputError: the simulation fails, or a bit or a counter differs from the golden renderer's.
    """
    name, *options = line.split()
    scene = scene_argument(name)
    if scene is None:
        return None
    row = kept_frame(BUILD / "rtl", scene, ["--machine", "full", *options], again=again)
    return {**{key: row[key] for key in _KEPT if key in row}, "scene": name}


def render_rtl() -> None:
    """Renders the frames of reports/model_rtl.json and measures the speed of RTL and model."""
    rows, speed = [], side_by_side()
    for line in RTL_FRAMES:
        row = rtl_row(line)
        print(f"{line}: {'no such scene in MSV2_DATA' if row is None else row['frame_cycles']}", flush=True)
        rows += [row] if row else []
        scenes = filter(None, (scene_argument(row["scene"]) for row in rows))
        write_report(REPORTS / "model_rtl.json", {"rows": rows, "speed": speed}, [__name__, COMMAND],
                     {"frames": RTL_FRAMES, "timed": TIMED}, scenes)


def side_by_side() -> dict[str, object]:
    """The speeds of the RTL's simulator and of the model, in cycles of a frame per second of processor time. They run one after
    the other on the same machine, on one processor each. The model is repeated for some seconds.
    """
    row = rtl_row(TIMED, again=True)
    trace, frame = model_row(row, EMBEDDED)  # also compiles or loads the kernels
    runs, begin = 0, time.process_time()
    while time.process_time() - begin < TIMED_SECONDS:
        frame = simulate(trace, CONFIGS[row["config"]], display=False)
        runs += 1
    seconds = (time.process_time() - begin) / runs
    model, rtl = frame.total / seconds, row["cycles_per_s"] * row["wall_s"] / row["cpu_s"]
    return {"frame": TIMED, "rtl_cycles_per_s": round(rtl), "model_cycles_per_s": round(model),
            "speedup": round(model / rtl, 1), "model_seconds": seconds, "model_runs": runs, "large": large_frame()}


def large_frame() -> dict[str, object] | None:
    """Processor seconds of the model for a large foveated frame, without tracing; None where its scene is missing."""
    name, *_ = LARGE.split()
    scene = scene_argument(name)
    if scene is None:
        return None
    trace = trace_request(request(_LARGE_ROW, scene), CONFIGS["paper"], cache=BUILD / "traces")
    begin = time.process_time()
    frame = simulate(trace, CONFIGS["paper"], display=True)
    return {"frame": LARGE, "cycles": frame.total, "model_seconds": time.process_time() - begin}


def frames() -> tuple[list[dict], list[str]]:
    """The rows of RTL frames that can be modelled here, and the missing scenes."""
    rows, missing = [], []
    for name in RTL_REPORTS:
        path = newest(REPORTS / f"{name}.json")
        rows += [dict(row, report=name) for row in json.loads(path.read_text())["rows"]] if path.is_file() else []
    rows = [row for row in rows if row.get("bit_exact") and row["entries"]]
    missing = sorted({row["scene"] for row in rows if scene_argument(row["scene"]) is None})
    return [row for row in rows if row["scene"] not in missing], missing


def summary(rows: Sequence[Mapping[str, object]]) -> dict[str, object]:
    """The worst and the mean errors over all frames."""
    totals = [abs(row["total"]["error"]) for row in rows]
    worst = {name: max(abs(row["phases"][name]["error"]) for row in rows) for name in PHASES}
    stages = {}
    for row in rows:
        for name, stage in row["stages"].items():
            stages.setdefault(name, []).append(abs(stage["error"]))
    return {
        "frames": len(rows), "model_error_total": max(totals), "mean_error_total": sum(totals) / len(totals), "phases": worst,
        "stages": {
            name: {"worst": max(e), "mean": sum(e) / len(e), "within_5_percent": sum(x <= STAGE_GOAL for x in e) / len(e)}
            for name, e in stages.items()},
        "beats_equal": all(row["beats_equal"] for row in rows),
    }


def _name(row: Mapping[str, object]) -> str:
    parts = [str(row["scene"]), "x".join(map(str, row["size"])), f"{row['levels']} levels" if row["levels"] > 1 else "",
             row["config"], "of its effects alone" if row["machine"] == "scene" else "",
             "two eyes" if row["eyes"] > 1 else "", row["pixels"],
             "" if row["merge"] else "no merging", "" if row["pipeline"] else "double buffers",
             f"{row['bytes_per_cycle']:g} B/cycle" if row["bytes_per_cycle"] else "unlimited"]
    return ", ".join(part for part in parts if part)


def markdown(report: Mapping[str, object]) -> str:
    """The report as Markdown tables."""
    s, speed = report["summary"], report["speed"]
    lines = ["# Model against RTL", "", "Made by `msv2 study run model`; docs/performance_model.md explains it.", "",
             f"{s['frames']} frames. Total cycles: worst error {s['model_error_total']:.2%}, mean {s['mean_error_total']:.2%} "
             f"(goal {TOTAL_GOAL:.0%} on every frame). Beats by client "
             f"{'are those of the RTL in every frame' if s['beats_equal'] else 'differ in some frame'}.", ""]
    if speed:
        lines += [f"Speed, `{speed['frame']}`, one behind the other, in seconds of a processor: RTL "
                  f"{speed['rtl_cycles_per_s']:,} cycles/s, model {speed['model_cycles_per_s']:,} cycles/s: "
                  f"{speed['speedup']:,.0f} times (goal {SPEED_GOAL}).", ""]
        if speed.get("large"):
            lines += [f"`{speed['large']['frame']}`: {speed['large']['cycles']:,} cycles in "
                      f"{speed['large']['model_seconds']:.2f} s of a processor.", ""]
    cells = []
    for row in report["rows"]:
        errors = [row["total"], *(row["phases"][name] for name in PHASES)]
        cells.append([_name(row), f"{row['total']['rtl']:,}", f"{row['total']['model']:,}",
                      *(f"{e['error']:+.2%}" for e in errors)])
    stages = [[name, f"{e['worst']:.2%}", f"{e['mean']:.2%}", f"{e['within_5_percent']:.0%}"]
              for name, e in s["stages"].items()]
    lines += [table(["frame", "RTL cycles", "model", "total", "table", "geometry", "render"], cells, left=1), "",
              "Cycles in which something was offered at a stage's input, moved or not:", "",
              table(["stage", "worst error", "mean", "frames within 5 %"], stages, left=1)]
    if report["missing"]:
        lines += ["", f"Not compared, for lack of the scene: {', '.join(report['missing'])}."]
    return "\n".join(lines) + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns 1 where a frame's total misses the goal."""
    parser = command_parser("msv2 study run model", __doc__)
    parser.add_argument("--rtl", action="store_true", help="render the frames of reports/model_rtl.json through the RTL first")
    args = parser.parse_args(argv)
    if args.rtl:
        render_rtl()
    found, missing = frames()
    rows = []
    for row in found:
        trace, frame = model_row(row, scene_argument(row["scene"]))
        if trace.entries != row["entries"]:
            raise InputError(f"{row['report']}.json: {row['scene']} has {row['entries']} entries in the RTL, {trace.entries} "
                             "here: the report is of other sources or another camera")
        rows.append(compared(row, frame))
        print(f"{_name(rows[-1])}: {rows[-1]['total']['error']:+.2%}", flush=True)
    speed_file = newest(REPORTS / "model_rtl.json")
    speed = json.loads(speed_file.read_text())["speed"] if speed_file.is_file() else None
    report = {"summary": summary(rows), "speed": speed, "rows": rows, "missing": missing}
    scenes = filter(None, (scene_argument(name) for name in sorted({row["scene"] for row in found})))
    write_report(REPORTS / "model.json", report, [__name__], {"arguments": args},
                 [*(newest(REPORTS / f"{name}.json") for name in RTL_REPORTS), *scenes])
    write_page(REPORTS / "model.md", markdown(report))
    worst = report["summary"]["model_error_total"]
    print(f"{len(rows)} frames, worst error {worst:.2%}")
    return 0 if worst <= TOTAL_GOAL else 1
