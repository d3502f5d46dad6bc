"""Frames of `v3` that give something up, with their losses and cycles.

Harmonics are given up by the SH degree of the frame, and points by leaving out those that contribute least for their work. Both
are the host's doing: a machine takes any model. Where harmonics go, the base colours may become what the model's own pictures
show of each point on average.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from golden.metrics.image import psnr_vs
from golden.msv2_ref import pipeline
from golden.scenes.camera import Camera
from golden.scenes.level_blend import LOOK, draw
from golden.scenes.level_fit import cameras
from golden.scenes.level_views import REACH, Shapes, look
from golden.scenes.load import EMBEDDED
from golden.scenes.model import GaussianModel
from golden.scenes.request import resolve
from msv2.studies.memory import IDEAL, IDEAL_CYCLES, LPDDR3, memory_arguments
from msv2.studies.performance.frames import SECOND_VIEW, STEP_CACHE, request
from msv2.studies.performance.steps import WHOLE
from msv2.studies.tradeoff.choose import ASSUMED_PSNR_DB, uncorrelated_psnr
from msv2.studies.tradeoff.scene import SceneRequest, first_level
from msv2.studies.tradeoff.scene import load as load_tradeoff
from perf.frames import simulate, trace_of
from perf.model import MemoryModel
from perf.supertiles import simulate_supertiles
from perf.supertiles_trace import trace_request
from spec.config import PRESETS, V3, V3_STREAMS, V3_STREAMS_PACKED, AcceleratorConfig
from spec.constants import ALPHA_MAX_L1, ALPHA_MIN, MAX_SH_DEGREE, SH_C0

SIZES = {EMBEDDED: "192x108", "rock_sh3": "320x180"}
"""The scenes of SH degree 3 that need no training, with the size of their frames: views without a gaze."""

VIEWS = 2

FOVEATED = "640x360"
"""The size of the frames of four levels whose cycles alone are measured."""


@dataclass(frozen=True)
class Choice:
    """What a frame gives up.

    Attributes:
        name: in the report.
        config: the machine.
        degree: the highest SH degree of the model.
        averaged: whether base colours are averages of what pictures show.
        kept: the share of the pictures' intersections whose points stay.
    """

    name: str
    config: AcceleratorConfig = V3
    degree: int = MAX_SH_DEGREE
    averaged: bool = False
    kept: float = 1.0


EXACT = Choice("exact")

CHOICES = (
    EXACT, *(Choice(f"preset {name}", config.with_(name=V3.name), config.sh_degree) for name, config in PRESETS.items()),
    *(Choice(f"degree {degree}", degree=degree) for degree in (2, 1, 0)), Choice("degree 0, averaged", degree=0, averaged=True),
    *(Choice(f"{100 * kept:g} % of the work", kept=kept) for kept in (0.95, 0.9, 0.8)),
    *(Choice(f"degree 0, averaged, {100 * kept:g} % of the work", degree=0, averaged=True, kept=kept) for kept in (0.9, 0.8)),
    *(Choice(f"support radius {sigma:g}", V3.with_(support_sigma=sigma)) for sigma in (2.5, 2.0)),
    Choice("support radius 2.5, degree 0, averaged", V3.with_(support_sigma=2.5), 0, averaged=True))
"""All choices, the exact one first."""


@dataclass(frozen=True)
class Shown:
    """What a model's own pictures show of its points.

    Attributes:
        weight: (N,) the sum of T alpha over all pixels.
        work: (N,) the intersections.
        colour: (N, 3) the mean of the colours, weighted by T alpha; NaN where `weight` is 0.
    """

    weight: np.ndarray
    work: np.ndarray
    colour: np.ndarray


def shown(model: GaussianModel) -> Shown:
    """What the pictures show to which levels would be fitted (`golden.scenes.level_fit`)."""
    shapes, count = Shapes.of(model), len(model)
    log2_opacity = np.log2(np.maximum(model.opacity[:, 0], 1e-12)).astype(np.float32)
    weight, work, colour = np.zeros(count), np.zeros(count, np.int64), np.zeros((count, 3))
    for camera in cameras(model):
        view = look(model, shapes, camera)
        seen = np.empty((len(view.index), LOOK), np.float32)
        seen[:, 0] = log2_opacity[view.index]
        seen[:, 1] = np.minimum(REACH, seen[:, 0] - np.float32(np.log2(ALPHA_MIN)))
        seen[:, 2:] = np.maximum(view.rest + np.float32(SH_C0) * model.sh_dc[view.index, 0].astype(np.float32), 0)
        image, part = np.empty((camera.height, camera.width, 4), np.float32), np.zeros(len(view.index), np.float32)
        draw(view.geometry, seen, view.start, view.splat, camera.width, camera.height, np.float32(ALPHA_MAX_L1), image, part)
        weight[view.index] += part
        work += view.tiles_met(count)
        colour[view.index] += part[:, None] * seen[:, 2:]
    with np.errstate(invalid="ignore", divide="ignore"):
        return Shown(weight, work, colour / weight[:, None])


def reduced(model: GaussianModel, choice: Choice, seen: Shown) -> GaussianModel:
    """A model of one level with what a choice leaves of it. Points that no picture shows stay as they are."""
    out = model.with_sh_degree(min(choice.degree, model.sh_degree))
    if choice.averaged:
        base, there = out.sh_dc.copy(), seen.weight > 0
        base[there, 0] = (seen.colour[there] - 0.5) / SH_C0
        out = replace(out, sh_dc=base)
    if choice.kept == 1:
        return out
    order = np.argsort(-seen.weight / np.maximum(seen.work, 1), kind="stable")
    order = order[seen.work[order] > 0]
    stays = seen.work == 0
    stays[order[np.cumsum(seen.work[order]) <= choice.kept * seen.work.sum()]] = True
    return out.select(np.flatnonzero(stays))


@dataclass(frozen=True)
class Subject:
    """A scene with its cameras.

    Attributes:
        scene: its name.
        model: its model of one level.
        cameras: the cameras.
        photographs: an image for each camera; None without.
    """

    scene: str
    model: GaussianModel
    cameras: tuple[Camera, ...]
    photographs: tuple[np.ndarray, ...] | None

    @cached_property
    def seen(self) -> Shown:
        return shown(self.model)


def load(scene: str, size: str) -> Subject:
    """A scene of SIZES or another one.

    Raises:
        InputError: the scene is missing.
    """
    if scene == EMBEDDED:
        found = load_tradeoff(SceneRequest(scene, size, VIEWS))
        return Subject(scene, first_level(found.leveled[""]), found.cameras, found.photographs)
    asked = [resolve(request(scene, size, camera)) for camera in ("orbit", SECOND_VIEW)]
    return Subject(scene, first_level(asked[0].model), tuple(a.camera for a in asked), None)


def rows(subject: Subject, choices: tuple[Choice, ...] = CHOICES) -> Iterator[dict[str, object]]:
    """The numbers of every choice, means over the views: `psnr_db` against the exact frame (None where it is equal), `loss_db`
    as `msv2.studies.tradeoff` defines it but from the exact frame on, `cycles`, IDEAL_CYCLES, and `points`, the share that
    stays."""
    exact: list[np.ndarray] = []
    model_db = ASSUMED_PSNR_DB
    for choice in choices:
        model = reduced(subject.model, choice, subject.seen)
        frames = [pipeline.render(model, camera, config=choice.config) for camera in subject.cameras]
        images = [frame.image for frame in frames]
        exact = exact or images
        off = float(np.mean([min(psnr_vs(image, other), 200.0) for image, other in zip(images, exact, strict=True)]))
        photo = None
        if subject.photographs:
            photo = float(np.mean([psnr_vs(np.clip(image, 0, 1), truth)
                                   for image, truth in zip(images, subject.photographs, strict=True)]))
            model_db = photo if choice == choices[0] else model_db
        told = model_db - uncorrelated_psnr(off, model_db)
        traces = [trace_of(frame) for frame in frames]
        cycles = {memory: float(np.mean([simulate(trace, choice.config, memory=MemoryModel(**memory_arguments(memory))).total
                                         for trace in traces])) for memory in (LPDDR3, IDEAL)}
        yield {"scene": subject.scene, "choice": choice.name, "degree": min(choice.degree, subject.model.sh_degree),
               "points": len(model) / len(subject.model), "psnr_db": None if off == 200.0 else off, "psnr_photo_db": photo,
               "loss_db": told if photo is None else max(told, model_db - photo), "cycles": cycles[LPDDR3],
               IDEAL_CYCLES: cycles[IDEAL]}


def foveated_rows(scene: str, size: str = FOVEATED) -> list[dict[str, object]]:
    """Cycles of a frame of four levels by SH degree, on V3 and with everything that is built for one eye. A degree changes no
    trace: colours stop no pixel.

    Raises:
        InputError: the scene is missing.
    """
    out = []
    for name, traced, config in ((V3.name, V3, V3), (WHOLE, V3_STREAMS, V3_STREAMS_PACKED)):
        trace = trace_request(request(scene, size), traced, cache=STEP_CACHE)
        for degree in range(trace.sh_degree, -1, -1):
            cycles = {memory: simulate_supertiles(
                replace(trace, sh_degree=degree), config, memory=MemoryModel(**memory_arguments(memory)), display=True,
                packed=config.packed).total for memory in (LPDDR3, IDEAL)}
            out.append({"scene": scene, "machine": name, "degree": degree, "cycles": cycles[LPDDR3],
                        IDEAL_CYCLES: cycles[IDEAL]})
    return out
