"""What compact records and the new order cost against photographs: golden frames of trained models, seen from test views."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from golden.host.quantise import GaussianWords, quantise_model
from golden.metrics.image import psnr
from golden.msv2_ref import pipeline
from golden.scenes.camera import Camera
from golden.scenes.files import read_json
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.request import parse_size
from msv2.studies.scenes import TRAINED_HERE
from msv2.studies.tradeoff.scene import SceneRequest, first_level, load, run_scene
from spec.config import PAPER, V3
from spec.constants import MAX_LEVELS
from spec.paths import ROOT

MOST_VIEWS = 10
"""Test views of a scene that are rendered, evenly spread."""

LIMITS = {MAX_LEVELS: 0.01, 1: 0.005}
"""The largest accepted loss in dB, by the number of levels of frame and model."""


def runs_here() -> tuple[dict[str, Path], list[str]]:
    """The finished training runs by scene, and the scenes that have none."""
    places = {scene: ROOT / "build" / "train" / scene for scene in TRAINED_HERE}
    found = {scene: place for scene, place in places.items() if run_scene(str(place)) is not None}
    return found, [scene for scene in places if scene not in found]


def photo_rows(scene: str, run: Path) -> list[dict[str, object]]:
    """The PSNR of `paper` and `v3` against a scene's photographs, with all levels and with one.

    The loss is the difference of the means over the views, in dB; it is negative where `v3` happens to be nearer.

    Raises:
        InputError: the run's data set is missing.
    """
    size = str(read_json(run / "report.json")["options"]["size"])
    count = _test_views(run, size)
    shots = load(SceneRequest(str(run), size, min(count, MOST_VIEWS)))
    assert shots.photographs is not None
    model = shots.leveled[""]
    rows = []
    for levels in (MAX_LEVELS, 1):
        leveled = model if levels > 1 else first_level(model)
        values = {config.name: _psnr(quantise_model(config, leveled), shots.cameras, shots.photographs, levels)
                  for config in (PAPER, V3)}
        paper, compact = (float(np.mean(values[config.name])) for config in (PAPER, V3))
        rows.append({"scene": scene, "size": size, "points": len(leveled), "sh_degree": leveled.sh_degree, "levels": levels,
                     "views": len(shots.cameras), "paper_db": paper, "v3_db": compact, "loss_db": paper - compact,
                     "worst_view_db": float(np.max(np.subtract(values[PAPER.name], values[V3.name]))),
                     "limit_db": LIMITS[levels]})
    return rows


def _test_views(run: Path, size: str) -> int:
    """The number of test views of the data set on which a run was trained."""
    from golden.training.scene import load_training_scene

    return len(load_training_scene(str(run_scene(str(run))), parse_size(size), points_needed=False).test)


def _psnr(
    words: GaussianWords, cameras: tuple[Camera, ...], photographs: tuple[np.ndarray, ...], levels: int,
) -> list[float]:
    """The PSNR in dB of each view's golden frame against its photograph; foveated frames have the gaze in the centre."""
    out = []
    for camera, photograph in zip(cameras, photographs, strict=True):
        centre = camera.width / 2, camera.height / 2
        foveation = foveation_map(Display(camera.width, camera.height), centre, levels) if levels > 1 else None
        image = pipeline.render(words, camera, config=words.config, foveation=foveation).image
        out.append(psnr(np.clip(image, 0.0, 1.0), photograph))
    return out
