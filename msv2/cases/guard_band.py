"""Case 74: a giant far beside the camera and just past the near plane, whose projected mean `mean2d` cannot hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from golden.host.quantise import quantise_model
from golden.metrics.image import psnr_vs
from golden.msv2_ref.pipeline import render
from golden.msv2_ref.saturations import frame_saturations
from golden.scenes.model import GaussianModel
from msv2.cases.case import GOLDEN, Renderer, Shot, Shots, close, require, scene_case
from msv2.cases.case import Gradients as Wanted
from msv2.cases.check import see_golden, see_oracle
from msv2.cases.chunks import InChunks
from msv2.cases.eyes import TwoEyes
from msv2.cases.makers import splats, view
from msv2.cases.projection import closed_form
from msv2.cases.supertiles import SUPER_MACHINE, InSuperTiles

DEPTH = 0.25
"""The giants' depth: a little more than that of the near plane, 0.2."""

SCENE = 24
"""Splats in view."""

BUDGETS_DB = {"wide": 60.0, "compact": 58.0}
"""The least PSNR against the oracle, by the format of records."""


def giant(x: float, y: float, sigma: float) -> GaussianModel:
    """A white ball of opacity 0.8, seen at this pixel from the frame's centre, with a standard deviation of about `sigma`
    pixels."""
    per_pixel = DEPTH / 50
    return splats((x * per_pixel, y * per_pixel, DEPTH), scale=sigma * per_pixel / 1.3, opacity=0.8)


def scene() -> GaussianModel:
    """Coloured splats of many sizes that fill the frame."""
    rng = np.random.default_rng(74)
    z = rng.uniform(1, 4, SCENE)
    means = np.column_stack([rng.uniform(-0.6, 0.6, SCENE) * z, rng.uniform(-0.45, 0.45, SCENE) * z, z])
    return splats(*means, scale=rng.uniform(0.1, 0.6, (SCENE, 3)), opacity=rng.uniform(0.4, 0.95, SCENE),
                  colour=rng.uniform(0.05, 0.95, (SCENE, 3)), quat=rng.normal(size=(SCENE, 4)))


def with_giant(*at: float) -> GaussianModel:
    """The scene behind a giant, which is its first Gaussian."""
    both = giant(*at), scene()
    fields = ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound")
    return replace(both[0], **{name: np.concatenate([getattr(model, name) for model in both]) for name in fields})


AWAY = {"right": (40000, 0), "left": (-40000, 0), "below": (0, 40000), "above": (0, -40000)}
"""Giants that do not reach the frame, but would if their mean were moved to the end of its range."""

REACHING = {"reaching from the right": (20000, 0), "reaching from above": (0, -20000)}
"""Giants that would reach the frame from where they are."""


def _shots(renderer: Renderer) -> Shots:
    models = {"alone": scene(), **{name: with_giant(*at, 9500) for name, at in AWAY.items()},
              **{name: with_giant(*at, 12000) for name, at in REACHING.items()}}
    inside = {f"inside, {name}": giant(0.4 * x, 0.4 * y, 12000) for name, (x, y) in AWAY.items()}
    return {name: Shot(model, view()) for name, model in {**models, **inside}.items()}


def _supertiles() -> Mapping[str, InSuperTiles]:
    return {name: InSuperTiles(with_giant(*at, 9500), view(), (23, 21), (2, 2)) for name, at in AWAY.items()}


def _chunks() -> Mapping[str, InChunks]:
    return {"right, in chunks": InChunks(with_giant(*AWAY["right"], 9500), 1, 1, SCENE)}


def _eyes() -> Mapping[str, TwoEyes]:
    """The giant lies beyond the guard band for the eye on one side, and within it for the other."""
    end = 16384 - 32  # the target eye sees the giant 100 pixels farther to the left, or to the right
    return {"left": TwoEyes(with_giant(end + 50, 0, 12000), view(), 0.5, source_eye="left"),
            "right": TwoEyes(with_giant(end - 50, 0, 12000), view(), 0.5, source_eye="right")}


def _other_machines() -> None:
    """Raises CaseFailure where a frame of either format of records is too far from the oracle's, where the giant is not counted
    once, or where a frame in chunks, in super-tiles or of two eyes is not as it must be."""
    for name, shot in _shots(GOLDEN).items():
        if name.startswith("inside"):
            continue
        exact = see_oracle(shot).image
        compact = render(quantise_model(SUPER_MACHINE, shot.model), shot.camera, config=SUPER_MACHINE)
        for frame in (see_golden(shot).frame, compact):
            db, least = psnr_vs(frame.image, exact), BUDGETS_DB[frame.config.records]
            require(db >= least, f"{name}: {frame.config.records} records must reach {least} dB, not {db:.1f} dB")
            wanted, got = int(name in {**AWAY, **REACHING}), frame_saturations(frame)["saturated_means"]
            require(got == wanted, f"{name}: saturated_means must be {wanted}, not {got}")
    for name, part in {**_chunks(), **_supertiles()}.items():
        part.check(name)
    for eyes in _eyes().values():
        frame = eyes.frame
        found = [frame_saturations(each)["saturated_means"] for each in (frame.source, frame.target)]
        require(sorted(found) == [0, 1], f"the giant must be beyond the guard band of one eye, not of {sum(found)}")


@scene_case(
    74, "veil-beyond-the-range", "giants at depth 0.25 whose means lie 20,000 and 40,000 pixels beside a scene's frame",
    "culled as outside and counted as saturated; the scene looks as if they were not there; at 16,000 pixels: closed form",
    shots=_shots, checks={"golden": _other_machines}, eyes=_eyes, chunks=_chunks, supertiles=_supertiles,
    gradients=(Wanted("right", zero=(0,), lit=(1,)), Wanted("reaching from above", zero=(0,), lit=(1,))))
def VEIL_BEYOND_THE_RANGE(album, renderer, shots):
    for name in (*AWAY, *REACHING):
        album[name].counts(near=0, faint=0, drawn=SCENE)
        close(f"{name}: image", album[name].image, album["alone"].image, 2 * renderer.error)
    for name in AWAY:
        closed_form(album[f"inside, {name}"], shots[f"inside, {name}"], renderer, 0.8, what=f"inside, {name}: ")


CASES = (VEIL_BEYOND_THE_RANGE,)
