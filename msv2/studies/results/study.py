"""Runs the measurements for the generated tables, stores the numbers in reports/, and writes the tables of README.md and docs/.

    msv2 study run results                      everything except training; it takes hours if nothing is cached, and reads
                                                scenes from MSV2_DATA and liberty files from MSV2_PDK
    msv2 study run results --keep               the same into reports/, and the tables of README.md and docs/ from there
    msv2 study run results --only frames        one part: accuracy, frames, frames_v3, frames_streams, frames_eyes,
                                                machine, sorting, order, latencies, synthesis, culling_area, colour, bench
    msv2 study run results --only frames_eyes --machine v3_eyes      the rows of one machine; the other rows stay
    msv2 study run results --only training      the tables of training, of the embedded scene and of posed/fern in MSV2_DATA;
                                                it takes hours, but finished runs in build/train are not trained again
    msv2 study run results --only synthesis --unit splat_fetch    the row of one unit; the other rows stay
    msv2 study run results --only tables        only writes the tables again, from reports/
    msv2 study run results --check              the exit status is 1 if a page differs from the reports
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.camera_file import save_camera
from golden.scenes.captured import scene_argument
from golden.scenes.files import read_json
from golden.scenes.load import EMBEDDED, load_scene
from golden.scenes.orbit import orbit_camera
from golden.scenes.request import make_folder
from msv2.studies import record
from msv2.studies.catalogue import BY_NAME
from msv2.studies.destination import KEEP, keeping, tell
from msv2.studies.record import liberties, write_report
from msv2.studies.results.frames import frame_rows, write_frames
from msv2.studies.results.joint_frames import VIEWS as JOINT_VIEWS
from msv2.studies.results.joint_frames import WANTED, measure_frames_eyes
from msv2.studies.results.tables import PAGES, fill
from msv2.studies.rtl_frame import AWAY, INSIDE
from msv2.studies.rtl_frame import COMMAND as FRAME_COMMAND
from msv2.studies.scenes import BENCH, EXACT, EXACT_LARGE, ORDER, SPEED, TRAINING, View, available, places
from spec.config import PAPER, V3, V3_STREAMS
from spec.errors import InputError
from spec.paths import REPORTS, ROOT

BANDWIDTHS = ("25.6", "unlimited")
"""Bandwidths in bytes per cycle: that of the paper's memory, and unlimited for a beat read and a beat written in every
cycle."""

SYNTHESISED = (
    "near_test", "projection", "tile_test", "colour_unit", "entry_writer", "tile_merge_unit", "list_reader", "chunk_sorter",
    "splat_fetch", "setup", "expand", "pixel_core", "vrc_row", "blend", "pixel_writer", "frame_packer", "warp_unit",
    "axi_master", "register_file", "float_add", "float_mul", "float_divide", "float_reciprocal", "float_rsqrt", "float_sqrt",
    "fixed_to_float", "float_to_fixed", "chunk_header_reader", "chunk_reader", "geometry_decode", "level_bounds", "chunk_test",
    "supertile_clip", "supertile_test", "depth_buckets", "pair_writer", "supertile_reader", "record_fetch", "pair_colour",
    "batch_buffer", "stream_buffer", "row_join")
"""The units of the area table. `batch_array` is not among them: reports/area.md has its parts."""

SYNTHESIS_KEYS = ("area_um2", "area_per_core_um2", "cells", "clock_ps", "slack_ps", "zero_slack_ps", "derated_ps",
                  "memory_bits")


def run(*command: str) -> None:
    """Runs one of the project's commands and shows its output. Raises InputError where it fails."""
    print(f"$ {' '.join(command)}", flush=True)
    if subprocess.run([sys.executable, *command], cwd=ROOT).returncode:
        raise InputError(f"{' '.join(command)} failed")


def measure_frames(scene: str | None = None) -> None:
    """Writes reports/frames.json: frames of every kind on the machine, with every bit compared; with `scene` those of one scene
    alone, here and below: the other rows stay."""
    wanted = [(of, merge, pipeline) for view in EXACT for of in (replace(view, gaze=None), view)
              for merge in "10" for pipeline in "10"]
    wanted += [(of, "1", "1") for view in EXACT_LARGE for of in (replace(view, gaze=None), view)]
    write_frames("frames", [(view, "--config", "paper", "--merge", merge, "--pipeline", pipeline)
                            for view, merge, pipeline in wanted], {"config": PAPER}, (*EXACT, *EXACT_LARGE), scene,
                 modules=[__name__])


def measure_frames_v3(scene: str | None = None) -> None:
    """Writes reports/frames_v3.json: the frames of reports/frames.json that have the pipeline on, and one with a camera inside
    the model, on the machine `v3`."""
    views = [of for view in (*EXACT, *EXACT_LARGE) for of in (replace(view, gaze=None), view)]
    wanted = [(of, "--config", "v3", *more) for more in ((), ("--merge", "0")) for of in views
              if not more or of.scene not in {view.scene for view in EXACT_LARGE}]
    model = load_scene(EMBEDDED).model
    camera = orbit_camera(model, 0, 1, 128, 128)
    inside = _camera(INSIDE, replace(camera, translation=-camera.rotation @ np.median(model.means, axis=0)))
    wanted += [(of, "--config", "v3", "--camera", inside) for of in (replace(EXACT[0], gaze=None), EXACT[0])]
    write_frames("frames_v3", wanted, {"config": V3}, (*EXACT, *EXACT_LARGE), scene, modules=[__name__])


def measure_frames_streams(scene: str | None = None) -> None:
    """Writes reports/frames_streams.json: frames on `v3` with four arrays, packed."""
    machine = V3_STREAMS.with_(packed=True)
    wanted = [(of, "--config", V3_STREAMS.name, "--set", "packed=1", "--pixels", "packed")
              for view in EXACT for of in (replace(view, gaze=None), view)]
    write_frames("frames_streams", wanted, {"config": machine}, EXACT, scene, modules=[__name__])


def measure_machine() -> None:
    """Writes reports/machine.json: cycles of the paper's machine, also for a camera that sees nothing, so that all points are
    culled."""
    wanted = [(view, "--config", "paper", "--pixels", "display", "--merge", switch, "--pipeline", switch,
               "--bandwidth", bandwidth)
              for view in SPEED for bandwidth in BANDWIDTHS for switch in "10"]
    camera = orbit_camera(load_scene(EMBEDDED).model, 0, 1, 128, 128)
    away = _camera(AWAY, replace(camera, translation=camera.translation - [0, 0, 1e3]))  # in front, and looking away
    wanted += [(View("rock_sh3", "640x360"), "--config", "paper", "--pixels", "display", "--bandwidth", bandwidth)
               for bandwidth in BANDWIDTHS]
    wanted += [(View(EMBEDDED, "128x128"), "--config", "paper", "--camera", away, "--bandwidth", bandwidth)
               for bandwidth in BANDWIDTHS]
    write_report(REPORTS / "machine.json", {"rows": frame_rows(wanted)}, [__name__, FRAME_COMMAND], {"config": PAPER},
                 places(SPEED))


def _camera(name: str, camera: Camera) -> str:
    """The path of a file that holds the camera under that name."""
    path = make_folder(ROOT / "build" / "results") / f"{name}.json"
    save_camera(replace(camera, name=name), path)
    return str(path)


def measure_order() -> None:
    """Writes reports/order.json: the inversions in the machine's order, for every scene."""
    rows, out = [], ROOT / "build" / "results" / "order"
    for view, path in available(ORDER):
        run("-m", "msv2.cases.inversions", path, *view.arguments, "--out", str(out))
        rows.append({**json.loads((out / "order.json").read_text()), "scene": view.scene})
    write_report(REPORTS / "order.json", {"rows": rows}, [__name__, "msv2.cases.inversions"], {}, places(ORDER))


def measure_synthesis(units: Sequence[str] = SYNTHESISED) -> None:
    """Writes reports/synthesis.json: area and slack of SYNTHESISED in ASAP7. Only `units` are measured; skipped without
    MSV2_PDK.

    Raises:
        InputError: a unit is neither measured nor in the report already.
    """
    if "MSV2_PDK" not in os.environ:
        print("skipped: synthesis (MSV2_PDK names no liberty folder)")
        return
    report, out = REPORTS / "synthesis.json", ROOT / "build" / "results" / "synth"
    old = read_json(report) if report.exists() else {"rows": []}
    rows = {row["unit"]: row for row in old["rows"]}
    missing = set(SYNTHESISED) - set(rows) - set(units)
    if missing:
        raise InputError(f"no area is known of {', '.join(sorted(missing))}: run the whole part")
    for unit in units:
        rows[unit] = synthesised(unit, out)
    write_report(report, {"rows": [rows[unit] for unit in SYNTHESISED]}, [__name__, "synth.__main__"], {"units": list(units)},
                 liberties(), None if set(SYNTHESISED) <= set(units) else old)


def synthesised(unit: str, out: Path) -> dict[str, object]:
    """The kept numbers of a unit's synthesis; other results stay in `out`."""
    run("-m", "synth", "--unit", unit, "--tech", "asap7", "--clock-ps", "1000", "--out", str(out))
    report = json.loads((out / f"{unit}-asap7.json").read_text())
    variants = {name: _numbers(variant) for name, variant in report["variants"].items()}
    named = {key: report[key] for key in ("unit", "config", "node", "cell_list", "yosys", "sta")}
    return {**named, **_numbers(report), "variants": variants}


def _numbers(report: dict) -> dict:
    return {key: report[key] for key in SYNTHESIS_KEYS if key in report}


def measure_bench() -> None:
    """Writes reports/bench.json for the embedded scene, and for the truck if it is present."""
    scenes = [path for _, path in available(BENCH)]
    run("-m", "msv2.studies", "speed", *scenes, "--size", BENCH[0].size, "--repeat", "9", *_kept())


def measure_training() -> None:
    """Writes reports/training.json, .md and .png: the tables of training for the embedded scene and for captured
    photographs."""
    scenes = filter(None, map(scene_argument, TRAINING))
    run("-m", "msv2.studies", "training", *scenes, *_kept(), "--name", "training")


def _kept() -> list[str]:
    """The option that this run passes on to the studies that it starts."""
    return [KEEP] * keeping()


PARTS = {
    "accuracy": lambda: run("-m", "msv2.studies", "accuracy", *_kept()),
    "frames": measure_frames, "frames_v3": measure_frames_v3,
    "frames_streams": measure_frames_streams, "frames_eyes": measure_frames_eyes, "machine": measure_machine,
    "sorting": lambda: run("-m", "msv2.studies", "sorting", *_kept()), "order": measure_order,
    "latencies": lambda: run("-m", "msv2.studies", "latencies", *_kept()),
    "synthesis": measure_synthesis, "culling_area": lambda: run("-m", "msv2.studies", "culling_area", *_kept()),
    "colour": lambda: run("-m", "msv2.studies", "colour", *_kept()), "bench": measure_bench, "tables": lambda: None,
}
"""The parts of everything, in this order."""

OF_SCENES = {"frames": measure_frames, "frames_v3": measure_frames_v3, "frames_streams": measure_frames_streams,
             "frames_eyes": measure_frames_eyes}
"""The parts that can be measured for one scene alone."""

ON_REQUEST = {"training": measure_training}
"""The parts that take hours, which run on request only."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=[*PARTS, *ON_REQUEST], help="one part instead of all")
    parser.add_argument("--unit", choices=SYNTHESISED, action="append",
                        help="with --only synthesis, update only this row; may be given several times")
    parser.add_argument("--scene", choices=sorted({view.scene for view in (*EXACT, *EXACT_LARGE, *JOINT_VIEWS)}),
                        help="with --only frames, frames_v3, frames_streams or frames_eyes, update only the rows of this scene")
    parser.add_argument("--machine", choices=sorted({frame[2] for frame in WANTED}), action="append",
                        help="with --only frames_eyes, update only the rows of this machine; may be given several times")
    parser.add_argument("--check", action="store_true", help="change nothing; exit 1 where a page is stale")
    args = parser.parse_args(argv)
    if args.unit and args.only != "synthesis":
        raise InputError(f"--unit {args.unit[0]} is of --only synthesis, not of {args.only or 'everything'}")
    if args.scene and args.only not in OF_SCENES:
        raise InputError(f"--scene {args.scene} is of --only {', '.join(OF_SCENES)}, not of {args.only or 'everything'}")
    if args.machine and args.only != "frames_eyes":
        raise InputError(f"--machine {args.machine[0]} is of --only frames_eyes, not of {args.only or 'everything'}")
    if args.machine and not args.check:
        measure_frames_eyes(args.scene, args.machine)
    elif args.scene and not args.check:
        OF_SCENES[args.only](args.scene)
    elif args.unit and not args.check:
        measure_synthesis(args.unit)
    elif not args.check:
        REPORTS.mkdir(exist_ok=True)
        for name in [args.only] if args.only else PARTS:
            if name in BY_NAME:  # a study of its own, and so named in its report
                record.begin(name, _kept())
            else:
                record.begin("results", ["--only", name, *_kept()])
            (PARTS | ON_REQUEST)[name]()
    if args.only == "tables":  # to write them is all that was asked for
        tell(keep=True, named=False)
    if not (args.check or keeping()):
        print(f"the tables of README.md and docs/ are as they were; {KEEP} fills them from reports/")
        return 0
    return max(fill(path, REPORTS, check=args.check) for path in PAGES)
