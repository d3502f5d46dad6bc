"""FovVideoVDP's scores of a finished run's frames and levels."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import torch

from golden.diff.gaussians import Gaussians
from golden.diff.render import render, render_foveated
from golden.metrics.fovvideo import FovVideoVdp
from golden.metrics.hvsq import FULL_WIDTH
from golden.scenes.camera import Camera
from golden.scenes.files import read_json
from golden.scenes.request import parse_size
from golden.training.baselines import smfr
from golden.training.embedded_photographs import EMBEDDED_VIEWS
from golden.training.finished_runs import FinishedRun
from golden.training.foveated import level_alpha_max
from golden.training.level_quality import Levels, centre_foveation
from golden.training.recipe import levels_of
from golden.training.run import chosen_scene
from golden.training.scene import TrainingScene
from spec.constants import ALPHA_MAX_L1, DISPLAY_FOV_DEG, REGION_START_DEG
from spec.errors import InputError

NAMED = ("scene", "size", "variant", "baseline", "seed")
"""What tells rows apart."""


def distance_px(width: int = FULL_WIDTH, fov_deg: float = DISPLAY_FOV_DEG) -> float:
    """Distance of the eye from a display that is so many pixels wide and spans an angle, in pixels."""
    return width / (2 * math.tan(math.radians(fov_deg) / 2))


def part_of_display(width: int) -> float:
    """The angle in degrees that so many pixels span in the middle of the paper's display."""
    return 2 * math.degrees(math.atan(width / 2 / distance_px()))


def gaze_beside(camera: Camera, eccentricity_deg: float) -> tuple[float, float]:
    """Where someone looks who sees the frame's centre at an eccentricity, in pixels of the frame, left of the centre."""
    away = distance_px() * math.tan(math.radians(eccentricity_deg))
    return camera.width / 2 - away, camera.height / 2


def measure(dense: Gaussians, levels: Levels, scene: TrainingScene) -> dict[str, Any]:
    """The means over the judged test views, in JOD against the photographs.

    `frames` has whole frames that span the display, with the gaze in the centre: the dense model, L1 everywhere, the foveated
    frame, and that of random subsets of L1 with the same points in each level (SMFR), which are not trained. `levels` has each
    level's whole frame and L1's, as a part of the paper's display that is seen at the eccentricity where the level's region
    begins.
    """
    camera = scene.cameras[scene.judged[0]]
    size, foveation = (camera.width, camera.height), centre_foveation(camera, levels.levels)
    whole, part = FovVideoVdp(size), FovVideoVdp(size, part_of_display(camera.width))
    own = [levels.level(index) for index in range(levels.levels)]
    random = smfr(own[0], levels.counts)
    drawn = [random.level(index) for index in range(levels.levels)]
    frames, alone = [], []
    for view in scene.judged:
        at, photograph = scene.cameras[view], scene.photograph(view)

        def shown(image: torch.Tensor, view: int = view) -> torch.Tensor:
            return scene.unmasked(view, image.clamp(0.0, 1.0))

        with torch.no_grad():
            first = shown(render(own[0], at, alpha_max=ALPHA_MAX_L1).image)
            pictures = {
                "dense": shown(render(dense, at, alpha_max=ALPHA_MAX_L1).image), "l1": first,
                "foveated": shown(render_foveated(own, at, foveation)), "smfr": shown(render_foveated(drawn, at, foveation))}
            each = [first, *(shown(render(level, at, alpha_max=level_alpha_max(index)).image)
                             for index, level in enumerate(own[1:], 1))]
        frames.append([whole(picture, photograph, foveation.gaze_xy) for picture in pictures.values()])
        alone.append([[part(picture, photograph, gaze_beside(at, start)) for picture in (level, first)]
                      for level, start in zip(each, REGION_START_DEG, strict=False)])
    return {"views": len(scene.judged), "frames": dict(zip(pictures, np.mean(frames, axis=0).tolist(), strict=True)),
            "levels": [{"start_deg": start, "jod": jod, "l1_jod": first} for start, (jod, first) in zip(
                REGION_START_DEG, np.mean(alone, axis=0).tolist(), strict=False)]}


def row_of(folder: Path) -> dict[str, Any]:
    """The row of a finished run.

    Raises:
        InputError: the folder holds no finished run with its checkpoint, or a run without levels.
    """
    options = read_json(folder / "report.json")["options"]
    last = FinishedRun(folder, options).last()
    if last is None:
        raise InputError(f"{folder}: the last checkpoint of a finished run is needed; train it anew")
    levels = levels_of(last.results)
    if levels.levels == 1:
        raise InputError(f"{folder}: a run with levels is needed, not one of baseline {options['baseline']!r}")
    dense = last.results["dense"] if options["from"] else None
    scene, _ = chosen_scene(options["scene"], parse_size(options["size"]), dense, options.get("views") or EMBEDDED_VIEWS)
    named = {"scene": scene.name, **{name: options[name] for name in NAMED[1:]}}
    return named | measure(last.results["dense"], levels, scene)
