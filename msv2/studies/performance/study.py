"""`msv2 study run performance`: compares machines on the same frames, and with the paper: performance.{json,md} and
performance_*.png.

Areas come from reports/area.json (`make report-area`), and energies of operations from reports/energy_per_operation.json
(`msv2 study run energy_per_operation`).

examples:
  msv2 study run performance                            the embedded scene, and those of MSV2_DATA and build/train
  msv2 study run performance embedded --size 320x180    one scene
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from golden.scenes.load import EMBEDDED
from golden.scenes.request import make_folder, parse_size
from msv2.studies.memory import ALL_NAMES, memory_arguments
from msv2.studies.page import write_page
from msv2.studies.performance import area, gpu, summary
from msv2.studies.performance.frames import LEVELS, Compared, compared, default_frames, scene_file, scenes_here
from msv2.studies.performance.fullhd import full_hd
from msv2.studies.performance.machines import (
    BASE,
    BOTH,
    CLOCK_HZ,
    MACHINES,
    MEMORIES,
    PEAK,
    SUPER,
    WHOLE,
    Run,
    rows,
    run_all,
)
from msv2.studies.performance.page import page
from msv2.studies.performance.pictures import draw
from msv2.studies.performance.steps import STEPS, over_gscore, run_steps, step_areas
from msv2.studies.performance.steps import summary as step_summary
from msv2.studies.performance.sweeps import at_equal_area, bandwidth_rows, iso_area, sweeps
from msv2.studies.performance.tiles import tile_granular
from msv2.studies.progress import Progress
from msv2.studies.record import command, commit, write_report
from perf.model import FrameCycles, MemoryModel, simulate
from perf.perfetto import trace_events
from spec.command_line import command_parser
from spec.config import PAPER, PAPER_BASE, V3
from spec.extras import how_to_get
from spec.paths import REPORTS, ROOT

SWEPT = ("embedded", "truck", "garden_large")
"""Scenes whose first frame is used in the sweeps and in the comparison over area."""


FULL_HD = "Full HD"
"""The step that measures Full HD frames."""


def is_swept(scene: str, camera: str, scenes: Sequence[str]) -> bool:
    """Whether a frame is used in the sweeps; `scenes` are those that the command line names."""
    return camera == "orbit" and (Path(scene).stem in SWEPT or bool(scenes))


def steps_of(todo: Sequence[tuple[str, str]], scenes: Sequence[str], hd: bool) -> list[str]:
    """The names of the steps of `measure`, in order."""
    frames = [f"{scene}, {camera}: {what}" for scene, camera in todo for what in ("traces", "machines")]
    return [*frames, *(f"{scene}: sweeps" for scene, camera in todo if is_swept(scene, camera, scenes)), *([FULL_HD] * hd)]


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 study run performance", __doc__)
    parser.add_argument("scene", nargs="*", metavar="SCENE",
                        help="'embedded', a model file, a scene of MSV2_DATA or build/train")
    parser.add_argument("--size", default="640x360", metavar="WxH", help="size of the frames (default: 640x360)")
    parser.add_argument("--full-hd", default=None, choices=("0", "1"),
                        help="also measure Full HD frames (default: if no SCENE is named)")
    parser.add_argument("--out", type=Path, default=REPORTS, metavar="DIR",
                        help="output folder (default: build/reports; --keep: reports)")
    return parser.parse_args(argv)


def model_error(path: Path = REPORTS / "model.json") -> dict[str, object] | None:
    """The error of the cycle model's total against the RTL, from the validation report; None where it is missing."""
    if not path.is_file():
        return None
    found = json.loads(path.read_text())["summary"]
    return {"total": found["model_error_total"], "mean": found["mean_error_total"], "frames": found["frames"]}


def frame_rows(frame: Compared, runs: list[Run]) -> dict[str, object]:
    """The numbers of a frame."""
    counts = frame.frame.eyes[0].counts
    quartiles = np.percentile(counts, (0, 25, 50, 75, 100))
    base = {r.memory: r for r in runs if r.machine == BASE.name}
    return {
        "name": frame.name, "scene": frame.scene, "trained": frame.trained, "subject": {**frame.subject, "scene": frame.scene},
        "points": frame.frame.points, "entries": frame.frame.entries, "runs": rows(runs),
        "target_rendered": float(frame.warped.eyes[1].rendered.mean()),
        "memory_share": {memory: r.dram_bytes / (PEAK[memory] * r.cycles) for memory, r in base.items() if PEAK[memory]},
        "tile_granular": tile_granular(frame.frame.eyes[0]),
        "tiles": dict(zip(("least", "quarter", "median", "three_quarters", "most"), quartiles.tolist(), strict=True))
        | {"mean": float(counts.mean()), "across": frame.frame.tiles_x, "counts": counts.tolist()}}


def timelines(frame: Compared) -> dict[str, FrameCycles]:
    """A frame's cycles on the base machine, with merging, and on the full machine, with LPDDR3."""
    shown, memory = [m for m in MACHINES if m.merge or m is BASE], MemoryModel(**memory_arguments(MEMORIES[0]))
    return {m.name: simulate(frame.frame, m.config, memory=memory, merge=m.merge, display=True) for m in shown}


def measure(scenes: Sequence[str], size: str, hd: bool, folder: Path) -> tuple[dict[str, object], dict[str, FrameCycles]]:
    """The report's numbers, and the timelines for the picture of the handover."""
    here, missing = scenes_here()
    found, areas, swept = [], area.load_area(), []
    known: dict[str, float] = area.known_mm2(areas)
    equal: dict[str, list[dict[str, object]]] = {"equal_area": [], "equal_area_supertiles": []}
    step_mm2, by_step = step_areas(), {}
    todo = list(default_frames(list(scenes) or here))
    progress = Progress(f"performance_{size}", steps_of(todo, scenes, hd))
    for scene, camera in todo:
        with progress.step(f"{scene}, {camera}: traces"):
            frame = compared(scene, size, camera)
        with progress.step(f"{scene}, {camera}: machines"):
            runs = [*run_all(frame)[0], *run_steps(frame)]
        found.append(frame_rows(frame, runs))
        for key, name, config in (("equal_area", BOTH.name, PAPER), ("equal_area_supertiles", SUPER, V3)):
            equal[key] += at_equal_area(frame, [r for r in runs if r.machine == name], known.get(config.name))
        for name, compared_rows in over_gscore(frame, runs, step_mm2).items():
            by_step.setdefault(name, []).extend(compared_rows)
        if is_swept(scene, camera, scenes):
            swept.append(frame)
        print(f"{frame.name}: {', '.join(f'{r.machine} {r.cycles:,.0f}' for r in runs[:len(MACHINES)])} cycles", flush=True)
    equal["equal_area_whole"] = by_step[WHOLE]
    over: dict[str, list[dict[str, object]]] = {"iso_area": [], "bandwidth": [], "sweeps": []}
    for frame in swept:
        with progress.step(f"{frame.scene}: sweeps"):
            over["iso_area"] += iso_area(frame, areas)
            over["bandwidth"] += bandwidth_rows(frame)
            over["sweeps"] += sweeps(frame)
    large = []
    if hd:
        with progress.step(FULL_HD):
            large = list(full_hd(1 / areas["delay_to_16nm"] if areas else None))
    shown = timelines(swept[0])
    for name, cycles in shown.items():
        (folder / f"perfetto_{name}.json").write_text(json.dumps(trace_events(cycles)))
    means = summary.means(found)
    build = area.build_of(areas) if areas else None
    return {
        "size": size, "levels": LEVELS, "config": PAPER.name, "clock_hz": CLOCK_HZ, "missing": [] if scenes else missing,
        "trained": sorted({f["scene"] for f in found if f["trained"]}), "model_error": model_error(),
        "frames": found, "means": means, "beside_paper": summary.beside_paper(found, means, **equal),
        "goals": summary.goals(found, means, **equal), "steps": step_summary(found, by_step, step_mm2), **equal, **over,
        "area_source": build and f"reports/area.json, `{PAPER.name}`: build `{build[0]}` of commit {build[1].get('commit')}",
        "timeline": {"frame": swept[0].name, "memory": MEMORIES[0], "folder": str(folder.relative_to(ROOT)),
                     "machines": [{"machine": name, "groups": f.groups, "render": f.phases["render"]}
                                  for name, f in shown.items()]},
        "full_hd": large, "chip_129": summary.CHIP_129,
        "scaled_clock": 1 / areas["delay_to_16nm"] if areas else None,
        "reached_ghz": areas["builds"]["1ghz"].get("clock_ghz_zero_slack") if areas else None, "gpu_published": gpu.PUBLISHED,
        "gpu_model": f"{gpu.CORES} cores at {gpu.CLOCK_HZ / 1e9:g} GHz, {gpu.BYTES_PER_S / 1e9:g} GB/s, {gpu.PAIR_FLOPS} "
                     f"operations a pixel and splat, {gpu.POINT_FLOPS} a point; kernels in turn, each at its bound. Its memory "
                     f"is {gpu.BYTES_PER_S / (PEAK[MEMORIES[0]] * CLOCK_HZ):.2f} times as fast as ours",
    }, shown


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    args = _arguments(argv)
    parse_size(args.size)
    hd = args.full_hd == "1" or (args.full_hd is None and not args.scene)
    out, traces = make_folder(args.out), make_folder(ROOT / "build" / "report")
    content, shown = measure(args.scene, args.size, hd, traces)
    content = {"commit": commit(), "command": command(__name__), **content}
    inputs = [REPORTS / f"{name}.json" for name in ("area", "culling_area", "synthesis", "energy_per_operation", "model")]
    scenes = [scene_file(scene) for scene in (args.scene or scenes_here()[0]) if scene != EMBEDDED]
    machines = {config.name: config for config in (PAPER, PAPER_BASE, *(step.config for step in STEPS))}
    write_report(out / "performance.json", content, [__name__], {"arguments": args, "machines": machines},
                 [*inputs, *filter(None, scenes)])
    pictures = draw(content, shown, out)
    write_page(out / "performance.md", page(content, pictures))
    for row in content["beside_paper"]:
        ours = ", ".join(f"{value:.3f} with {ALL_NAMES[memory]}" for memory, value in row["ours"].items())
        print(f"{row['what']}: paper {row['paper']:.2f}, ours {ours}")
    print(f"wrote {out / 'performance.json'}, performance.md, "
          + (f"{len(pictures)} pictures" if pictures else f"no pictures without matplotlib; {how_to_get('matplotlib')}"))
    return 0
