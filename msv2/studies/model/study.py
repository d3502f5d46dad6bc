"""Compares the cycle model with the RTL: reports/model.json and reports/model.md.

    msv2 study run model                compares the frames that the RTL has rendered: reports/frames.json, machine.json
                                        and model_rtl.json
    msv2 study run model --rtl          first renders the frames of model_rtl.json through the RTL (an hour, but finished
                                        runs are kept), and one frame more to time RTL and model in turn
    msv2 study run model --rtl lpddr3   the same for the frames of one memory; those of the other stay as they are
    msv2 study run model --rtl v3       the same for the frames of one configuration, in rows and alone, on both memories
    msv2 study run model --rtl embedded,lpddr3    the same for the frames of one scene and one memory

Real scenes are looked for in MSV2_DATA. Frames whose scene is missing are left out and named.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence

from golden.host.run_options import IDEAL, LPDDR3, MEMORIES
from golden.scenes.captured import scene_argument
from golden.scenes.files import read_json
from golden.scenes.load import EMBEDDED
from msv2.studies.destination import newest
from msv2.studies.model.rows import BUILD, PHASES, machine, model_row, model_rows, request
from msv2.studies.page import table, write_page
from msv2.studies.record import write_report
from msv2.studies.rtl_frame import AWAY, COMMAND, INSIDE, kept_frame
from perf.model import FrameCycles, MemoryModel, simulate
from perf.trace import trace_request
from spec.command_line import choice, command_parser
from spec.config import MACHINES, V3
from spec.errors import InputError
from spec.paths import REPORTS

RTL_REPORTS = ("frames", "frames_v3", "machine", "model_rtl")
"""The reports that hold frames of the RTL."""

RTL_FRAMES = (
    "embedded --size 160x96 --config paper_small",
    "truck --size 96x64 --config paper_small --machine scene",
    "embedded --size 128x128 --config paper_small --stereo --gaze 64,64 --levels 4 --levels-from random",
    "embedded --size 320x180 --config paper_small --stereo --gaze 160,90 --levels 4 --levels-from random",
)
"""Frames of the ideal memory that the other reports do not have: two eyes, a smaller machine, and one without harmonics and
levels."""

_SUPER = f"--config {V3.name} --frames"
ROWS = (
    f"embedded --size 128x128 {_SUPER} 3 --turn 5",
    f"rock_sh3 --size 192x108 {_SUPER} 2 --turn 2",
)
"""Frames of a camera that turns, on the ideal memory. With super-tiles, lists of all but the first have the bounds of the frame
before."""

NEAR = {
    "embedded": "--camera auto --orbit 60,20,1.4", "truck": "--camera auto --orbit 120,35,1.1",
    "rock_sh3": "--camera auto --orbit 150,35,2.3"}
"""Cameras close to the object of a scene, where large splats cover many tiles."""

_FOVEATED = "--levels 4 --levels-from random"
LPDDR3_FRAMES = tuple(f"{line} --memory lpddr3" for line in (
    "embedded --size 96x64 --config tiny",
    f"embedded --size 128x96 --config tiny --gaze 64,48 {_FOVEATED}",
    f"embedded --size 96x64 --config tiny {NEAR['embedded']} --gaze 48,32 {_FOVEATED}",
    "truck --size 96x64 --config tiny",
    "embedded --size 96x64 --config paper",
    f"embedded --size 96x64 --config paper --gaze 48,32 {_FOVEATED} --pixels display",
    f"embedded --size 160x96 --config paper --gaze 80,48 {_FOVEATED}",
    f"embedded --size 128x80 --config paper {NEAR['embedded']} --pixels display",
    "truck --size 160x96 --config paper --pixels display",
    f"truck --size 96x64 --config paper --gaze 48,32 {_FOVEATED}",
    f"truck --size 128x80 --config paper {NEAR['truck']} --gaze 64,40 {_FOVEATED}",
    f"rock_sh3 --size 96x64 --config paper {NEAR['rock_sh3']}",
    "rock_sh3 --size 96x64 --config paper",
    f"garden_large --size 160x96 --config paper --gaze 80,48 {_FOVEATED} --pixels display",
    "garden_large --size 96x64 --config paper",
    f"rock_sh3 --size 128x80 --config paper --gaze 64,40 {_FOVEATED}",
    f"embedded --size 128x128 {_SUPER} 2",
    f"embedded --size 256x144 {_SUPER} 2 --gaze 128,72 {_FOVEATED} --pixels display",
    f"truck --size 256x144 {_SUPER} 2 --pixels display",
    f"rock_sh3 --size 192x108 {_SUPER} 2",
))
"""Small frames on four channels of LPDDR3: plain, foveated, and close to an object. The first ones are of a small machine,
whose simulator is built in a minute; the last ones are frames in a row of the machine with super-tiles."""

FRAMES = {IDEAL: (*RTL_FRAMES, *ROWS), LPDDR3: LPDDR3_FRAMES}
ALL = "all"

TIMED = "embedded --size 128x128 --config paper"
"""The frame with which RTL and model are timed, one after the other."""

LARGE = "garden_large --size 1920x1080 --gaze 960,540 --levels 4 --levels-from random --config paper --pixels display"
_LARGE_ROW = {"size": (1920, 1080), "gaze": (960, 540), "levels": 4}
"""A large frame for which the report states the model's time."""

TIMED_SECONDS = 10.0

COMMANDS = ("activates", "refreshes")
TOTAL_GOAL, STAGE_GOAL, SPEED_GOAL = 0.02, 0.05, 500

_KEPT = (
    "scene", "size", "gaze", "levels", "config", "machine", "effects", "pixels", "merge", "pipeline", "bit_exact",
    "counter_errors", "entries", "ops", "skipped", "table_cycles", "geometry_cycles", "render_cycles", "frame_cycles",
    "idle_cycles", "source_cycles", "target_cycles", "stage_cycles", "events", "dram_bytes", "memory", "activates", "refreshes",
    "latency", "bytes_per_cycle", "lists", "number", "turn", "wall_s", "cpu_s", "cycles_per_s")


def compared(row: Mapping[str, object], frame: FrameCycles) -> dict[str, object]:
    """The report's row of a frame: the cycles of RTL and model and the relative error, by phase, by stage and in total.

    A stage's number is that of the cycles in which something was offered at its input, whether it moved or not. Both totals are
    without the clearing that follows a reset.
    """
    rtl = {name: int(row[f"{name}_cycles"]) for name in PHASES}
    model = {name: frame.phases[name] for name in PHASES}
    totals, stages = (sum(model.values()), sum(rtl.values())), {}
    misses = "header_misses" if "header_misses" in row["events"] else "fetch_misses"
    for name, stage in frame.stages.items():
        watched = row["stage_cycles"][name]
        there, ours = watched["busy"] + watched["blocked"], stage.busy + stage.blocked
        stages[name] = {"rtl": there, "model": ours, "error": _error(ours, there), "busy_equal": stage.busy == watched["busy"],
                        "share_of_frame": abs(ours - there) / max(1, sum(rtl.values()))}
    return {
        **{name: row[name] for name in ("scene", "size", "gaze", "levels", "config", "pixels", "merge", "pipeline", "latency",
                                        "bytes_per_cycle", "entries")},
        "machine": row.get("machine", "full"), "eyes": len(frame.eyes), "memory": row.get("memory", IDEAL),
        "camera_options": row.get("camera_options", []), **{name: row[name] for name in ("number", "lists") if name in row},
        "commands": {name: {"rtl": row[name], "model": getattr(frame, name)} for name in COMMANDS if name in row},
        "phases": {name: {"rtl": rtl[name], "model": model[name], "error": _error(model[name], rtl[name])} for name in PHASES},
        "total": {"rtl": totals[1], "model": totals[0], "error": _error(*totals)},
        "stages": stages,
        "beats_equal": frame.dram_bytes["reads"] == row["dram_bytes"]["reads"] and all(
            frame.writes.get(name, 0) == count for name, count in row["dram_bytes"]["writes"].items()),
        "misses_equal": frame.fetch_misses == row["events"][misses], "skipped": [row["skipped"], frame.skipped],
        "model_seconds": frame.seconds, "rtl_cycles_per_s": row["cycles_per_s"],
    }


def _error(model: int, rtl: int) -> float:
    return (model - rtl) / rtl if rtl else float(model != 0)


def rtl_rows(line: str, *, again: bool = False) -> list[dict[str, object]]:
    """A frame through the RTL, or the frames of a row. A finished run is used unless `again`; none where the scene is missing.

    Raises:
        InputError: the simulation fails, or a bit or a counter differs from the golden renderer's.
    """
    name, *options = line.split()
    scene = scene_argument(name)
    if scene is None:
        return []
    found = kept_frame(BUILD / "rtl", scene, ["--machine", "full", *options], again=again)
    camera = {"camera_options": camera_options(options)} if "--camera" in options else {}
    each = [found | numbers | {"number": n} for n, numbers in enumerate(found["frames"])] if "frames" in found else [found]
    return [{**{key: row[key] for key in _KEPT if key in row}, "scene": name, **camera} for row in each]


def camera_options(options: Sequence[str]) -> list[str]:
    """Those of a frame's options that choose its camera."""
    found = (options[i : i + 2] for i, option in enumerate(options) if option in ("--camera", "--up", "--orbit"))
    return [word for pair in found for word in pair]


def lines_of(kinds: Sequence[str], config: str | None = None, scene: str | None = None) -> list[str]:
    """The frames to render on these kinds of memory; with `config` or `scene`, those of this configuration or scene alone."""
    lines = [line for kind in kinds for line in FRAMES[kind]]
    return [line for line in lines if (config is None or f"--config {config} " in f"{line} ")
            and (scene is None or line.split()[0] == scene)]


def render_rtl(kinds: Sequence[str], config: str | None = None, scene: str | None = None) -> None:
    """Renders the frames of reports/model_rtl.json on these kinds of memory and, with `config` or `scene`, of this one alone;
    other rows stay as they are. With all frames of the ideal memory, the speed of RTL and model is measured too."""
    path, lines, part = REPORTS / "model_rtl.json", lines_of(kinds, config, scene), config or scene
    old = read_json(path) if path.is_file() and (part or set(kinds) != set(MEMORIES)) else None
    rows = [row for row in (old or {"rows": []})["rows"]
            if row.get("memory", IDEAL) not in kinds
            or (config and machine(row | {"machine": "full"}).name != config)
            or (scene and row["scene"] != scene)]
    speed = side_by_side() if IDEAL in kinds and not part else old and old["speed"]
    for line in lines:
        found = rtl_rows(line)
        print(f"{line}: {', '.join(str(row['frame_cycles']) for row in found) or 'no such scene in MSV2_DATA'}", flush=True)
        rows += found
        rows.sort(key=lambda row: MEMORIES.index(row.get("memory", IDEAL)))
        scenes = filter(None, (scene_argument(row["scene"]) for row in rows))
        write_report(path, {"rows": rows, "speed": speed}, [__name__, COMMAND], {"frames": lines, "timed": TIMED}, scenes,
                     earlier=old)


def side_by_side() -> dict[str, object]:
    """The speeds of the RTL's simulator and of the model, in cycles of a frame per second of processor time. They run one after
    the other on the same machine, on one processor each. The model is repeated for some seconds.
    """
    (row,) = rtl_rows(TIMED, again=True)
    trace, frame = model_row(row, EMBEDDED)  # also compiles or loads the kernels
    runs, begin = 0, time.process_time()
    while time.process_time() - begin < TIMED_SECONDS:
        frame = simulate(trace, MACHINES[row["config"]], memory=MemoryModel(IDEAL), display=False)
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
    trace = trace_request(request(_LARGE_ROW, scene), MACHINES["paper"], cache=BUILD / "traces")
    begin = time.process_time()
    frame = simulate(trace, MACHINES["paper"], memory=MemoryModel(IDEAL), display=True)
    return {"frame": LARGE, "cycles": frame.total, "model_seconds": time.process_time() - begin}


def frames() -> tuple[list[dict], list[str]]:
    """The rows of RTL frames that can be modelled here, and the missing scenes."""
    rows, missing = [], []
    for name in RTL_REPORTS:
        path = newest(REPORTS / f"{name}.json")
        rows += [dict(row, report=name) for row in json.loads(path.read_text())["rows"]] if path.is_file() else []
    rows = [row for row in rows if row.get("bit_exact") and row["entries"] and row.get("camera") not in (INSIDE, AWAY)]
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
    kinds = {kind: [abs(row["total"]["error"]) for row in rows if row["memory"] == kind] for kind in MEMORIES}
    return {
        "memories": {kind: {"frames": len(e), "worst": max(e), "mean": sum(e) / len(e)} for kind, e in kinds.items() if e},
        "frames": len(rows), "model_error_total": max(totals), "mean_error_total": sum(totals) / len(totals), "phases": worst,
        "stages": {
            name: {"worst": max(e), "mean": sum(e) / len(e), "within_5_percent": sum(x <= STAGE_GOAL for x in e) / len(e)}
            for name, e in stages.items()},
        "beats_equal": all(row["beats_equal"] for row in rows),
    }


NAMES = {IDEAL: "Ideal memory", LPDDR3: "Four channels of LPDDR3"}


def _name(row: Mapping[str, object]) -> str:
    parts = [str(row["scene"]), "x".join(map(str, row["size"])), f"{row['levels']} levels" if row["levels"] > 1 else "",
             row["config"], "of its effects alone" if row["machine"] == "scene" else "",
             "two eyes" if row["eyes"] > 1 else "", row["pixels"],
             "" if row["merge"] else "no merging", "" if row["pipeline"] else "double buffers",
             " ".join(row["camera_options"]).replace("--camera auto ", ""),
             f"frame {row['number'] + 1} in a row" if "number" in row else "",
             "LPDDR3" if row["memory"] == LPDDR3
             else f"{row['bytes_per_cycle']:g} B/cycle" if row["bytes_per_cycle"] else "unlimited"]
    return ", ".join(part for part in parts if part)


def markdown(report: Mapping[str, object]) -> str:
    """The report as Markdown tables."""
    s, speed = report["summary"], report["speed"]
    lines = ["# Model against RTL", "", "Made by `msv2 study run model`; docs/performance_model.md explains it.", "",
             f"{s['frames']} frames. Total cycles: worst error {s['model_error_total']:.2%}, mean {s['mean_error_total']:.2%} "
             f"(goal {TOTAL_GOAL:.0%} on every frame). Beats by client "
             f"{'are those of the RTL in every frame' if s['beats_equal'] else 'differ in some frame'}.", ""]
    lines += [f"{name}: {kind['frames']} frames, worst error {kind['worst']:.2%}, mean {kind['mean']:.2%}." for name, kind in (
        (NAMES[kind], found) for kind, found in s["memories"].items())]
    lines += [""]
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
    configs = tuple(name for name in MACHINES if lines_of(MEMORIES, name))
    scenes = tuple(dict.fromkeys(line.split()[0] for line in lines_of(MEMORIES)))
    accepted = (ALL, *MEMORIES, *configs, *scenes)
    parser.add_argument("--rtl", nargs="?", const=ALL, metavar="|".join(accepted), help="render the frames of "
                        "reports/model_rtl.json through the RTL first: all, or those of one memory, configuration or scene, "
                        "or of several of these together, as in embedded,lpddr3")
    args = parser.parse_args(argv)
    if args.rtl is not None:
        words = [choice("rtl", word, accepted) for word in args.rtl.split(",")]
        render_rtl([word for word in words if word in MEMORIES] or MEMORIES,
                   *(next((word for word in words if word in names), None) for names in (configs, scenes)))
    found, missing = frames()
    rows = []
    for row, trace, frame in model_rows(found, scene_argument):
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
