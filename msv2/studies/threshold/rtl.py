"""Simulates a pose on the machine: both eyes with one of them warped, and each eye rendered alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from golden.scenes.stereo import stereo_pair
from msv2.studies import rtl_frame
from spec.constants import IPD_METRES

Gazes = tuple[tuple[float, float], tuple[float, float]]

KEPT = ("bit_exact", "cycles", "table_cycles", "geometry_cycles", "render_cycles", "bound_cycles", "bounds", "entries",
        "stereo_overhead", "source_cycles", "target_cycles", "source_entries", "target_entries", "dram_bytes")
"""The fields of frame.json that are kept."""


def rtl_pose(
    model: GaussianModel, camera: Camera, gazes: Gazes, threshold_deg: float, folder: Path, *, units_per_metre: float,
    ipd_metres: float = IPD_METRES, alone: bool = False, step: Callable[[str], None] = lambda what: None,
) -> dict[str, object]:
    """Cycles of a pose from the RTL of the paper's machine: `stereo` and, if requested, `source` and `target`, each eye alone.

    Args:
        model: the model with its levels.
        camera: the source eye's camera.
        gazes: the gazes of source and target eye.
        threshold_deg: the threshold of the frame of two eyes.
        folder: the folder for models, cameras and earlier measurements.
        units_per_metre, ipd_metres: the scale of the scene, and the distance between the eyes.
        alone: whether to render each eye alone as well, on the machine without stereo.
        step: is called with the name of what is simulated next.

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
    for name, (seen, gaze, more) in frames.items():
        step(name)
        options = ["--machine", "full", "--gaze", _point(gaze), "--levels", str(model.levels), "--config", "paper", *more]
        found = rtl_frame.model_frame(folder, model, replace(seen, name=name), options)  # the key must not contain other names
        rows[name] = {key: found[key] for key in KEPT if key in found}
    return rows


def _point(xy: tuple[float, float]) -> str:
    return ",".join(map(repr, map(float, xy)))
