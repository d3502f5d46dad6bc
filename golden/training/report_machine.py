"""A trained model on the machine: the intersections of its frames, and what quantisation costs against the photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from golden.diff.gaussians import Gaussians, to_model
from golden.host.quantise import quantise_model
from golden.metrics.image import psnr_vs
from golden.msv2_ref import pipeline
from golden.oracle.render import render as render_oracle
from golden.scenes.model import GaussianModel
from golden.training.foveated import FoveatedModel
from golden.training.level_quality import Levels, centre_foveation, frame_cost
from golden.training.scene import TrainingScene
from spec.config import PAPER

VIEWS = 8
"""Largest number of views that the integer renderer renders, evenly spread over the test views."""


@dataclass(frozen=True)
class MachineNumbers:
    """Means over views of the integer renderer's frames; the gaze, if there is one, is in the centre.

    Attributes:
        views: indices of the views.
        entries: number of intersections in a frame: `dense`, `l1` (whole frame at level 1) and, with several levels,
            `foveated`.
        psnr_float, psnr_quantised: dB against the photographs for whole frames at level 1, by the float64 oracle and by the
            integer renderer.
        foveated_psnr_float, foveated_psnr_quantised: the same for foveated frames; None with one level or separate models.
    """

    views: tuple[int, ...]
    entries: dict[str, float]
    psnr_float: float
    psnr_quantised: float
    foveated_psnr_float: float | None
    foveated_psnr_quantised: float | None

    @property
    def loss_db(self) -> float:
        """What quantisation costs whole frames at level 1, in dB; below 0 if it happens to help."""
        return self.psnr_float - self.psnr_quantised


def model_files(levels: Levels, scene: TrainingScene) -> dict[str, GaussianModel]:
    """The models to save, by file name. Nested levels are one model; separate models are one each, and L1 is also
    `model.ply`."""
    if isinstance(levels, FoveatedModel):
        return {"model.ply": levels.to_model(up=scene.up, name=scene.name)}
    each = [to_model(levels.level(level), up=scene.up, name=f"{scene.name}-l{level + 1}") for level in range(levels.levels)]
    return {"model.ply": each[0]} | {f"model_l{level}.ply": model for level, model in enumerate(each, 1)}


def machine_numbers(levels: Levels, dense: Gaussians, scene: TrainingScene) -> MachineNumbers | None:
    """Measures a trained model on the integer renderer; returns None if frames are wider than the machine's rows."""
    if scene.size[0] > PAPER.row_width:
        return None
    views = _spread(scene.judged, VIEWS)
    model = model_files(levels, scene)["model.ply"]
    words, dense_words = (quantise_model(PAPER, each) for each in (model, to_model(dense, up=scene.up, name="dense")))
    rows: dict[str, list[float]] = {}

    def note(name: str, value: float) -> None:
        rows.setdefault(name, []).append(float(value))

    def psnr(view: int, image: np.ndarray) -> float:
        shown = image if scene.masks is None else scene.unmasked(view, torch.from_numpy(image).to(torch.float32)).numpy()
        return psnr_vs(shown, scene.photograph(view).numpy()) + 10 * np.log10(scene.shown_share(view))

    for view in views:
        camera = scene.cameras[view]
        whole = pipeline.render(words, camera, config=PAPER)
        note("dense", len(pipeline.render(dense_words, camera, config=PAPER).entries.splat))
        note("l1", len(whole.entries.splat))
        note("quantised", psnr(view, whole.image))
        note("float", psnr(view, render_oracle(model, camera).image))
        if levels.levels == 1:
            continue
        note("foveated", frame_cost(levels, camera).entries)
        if isinstance(levels, FoveatedModel):
            foveation = centre_foveation(camera, levels.levels)
            note("foveated_quantised", psnr(
                view, pipeline.render(words, camera, config=PAPER, foveation=foveation).image))
            note("foveated_float", psnr(view, render_oracle(model, camera, foveation=foveation).image))
    mean = {name: float(np.mean(values)) for name, values in rows.items()}
    return MachineNumbers(
        views, {name: mean[name] for name in ("dense", "l1", "foveated") if name in mean}, mean["float"], mean["quantised"],
        mean.get("foveated_float"), mean.get("foveated_quantised"))


def _spread(views: Sequence[int], count: int) -> tuple[int, ...]:
    """At most `count` of the views, evenly spread."""
    if len(views) <= count:
        return tuple(views)
    return tuple(views[round(i * (len(views) - 1) / (count - 1))] for i in range(count))
