"""A pose through the machine by `python -m tb.frame`, a process a frame: both eyes, one warped, and each eye rendered alone."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from golden.scenes.camera import Camera
from golden.scenes.camera_file import save_camera
from golden.scenes.files import read_json
from golden.scenes.model import GaussianModel
from golden.scenes.request import make_folder
from golden.scenes.save import save_model
from golden.scenes.stereo import stereo_pair
from msv2.studies.threshold.kept import RTL_SOURCES, fingerprint, kept
from spec.constants import IPD_METRES
from spec.errors import InputError
from spec.paths import ROOT

Gazes = tuple[tuple[float, float], tuple[float, float]]

KEPT = ("bit_exact", "cycles", "table_cycles", "geometry_cycles", "render_cycles", "bound_cycles", "bounds", "entries",
        "stereo_overhead", "source_cycles", "target_cycles", "source_entries", "target_entries", "dram_bytes")
"""Of frame.json."""


def rtl_pose(
    model: GaussianModel, camera: Camera, gazes: Gazes, threshold_deg: float, folder: Path, *, units_per_metre: float,
    ipd_metres: float = IPD_METRES, alone: bool = False, step: Callable[[str], None] = lambda what: None,
) -> dict[str, object]:
    """Cycles of a pose by the RTL of the paper's machine: `stereo`, and, if asked for, `source` and `target`: each eye alone.

    Args:
        model: with its levels.
        camera: of the source eye.
        gazes: of source and target.
        threshold_deg: of the stereo frame.
        folder: for models, cameras and what was measured before.
        units_per_metre, ipd_metres: of the pair.
        alone: each eye rendered alone as well, by the machine without stereo.
        step: told what is simulated next.

    Raises:
        InputError: a simulation fails, or a bit differs.
    """
    pair = stereo_pair(camera, ipd_metres=ipd_metres, units_per_metre=units_per_metre)
    two = ["--stereo", "--ecc-thresh", str(threshold_deg), "--units-per-metre", str(units_per_metre), "--ipd", str(ipd_metres),
           "--gaze-right", _point(gazes[1])]
    frames = {"stereo": (pair.source, gazes[0], two)}
    if alone:
        frames |= {"source": (pair.source, gazes[0], ["--pixels", "display"]),
                   "target": (pair.target, gazes[1], ["--pixels", "display"])}
    rows = {}
    for name, (view, gaze, options) in frames.items():
        step(name)
        view = replace(view, name=name)  # where it comes from changes nothing
        key = fingerprint(RTL_SOURCES, model, view, gaze, options)
        rows[name] = kept(folder, key, lambda view=view, gaze=gaze, options=options, key=key: _simulate(
            model, view, gaze, options, make_folder(folder / key)))
    return rows


def _point(xy: tuple[float, float]) -> str:
    return ",".join(map(repr, map(float, xy)))


def _simulate(
    model: GaussianModel, camera: Camera, gaze: tuple[float, float], options: list[str], folder: Path,
) -> dict[str, object]:
    save_model(model, folder / "model.ply")
    save_camera(camera, folder / "camera.json")
    command = [sys.executable, "-m", "tb.frame", str((folder / "model.ply").resolve()), "--machine", "full", "--camera",
               str((folder / "camera.json").resolve()), "--size", f"{camera.width}x{camera.height}", "--gaze", _point(gaze),
               "--levels", str(model.levels), "--config", "paper", "--out", str(folder.resolve()), *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode or not (folder / "frame.json").exists():
        last = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
        raise InputError(f"{' '.join(command)}: exit status {done.returncode}: {last}")
    numbers = read_json(folder / "frame.json")
    for written in ("model.ply", "sim"):  # large, and made anew if ever needed
        path = folder / written
        if path.is_file():
            path.unlink()
    return {name: numbers[name] for name in KEPT if name in numbers}
