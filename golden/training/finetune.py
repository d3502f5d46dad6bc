"""Fine-tuning of level 1 on what a viewer sees: HVSQ at the fovea's pooling (paper section 3.4, last step of L1)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from golden.diff.gaussians import Gaussians
from golden.diff.render import render
from golden.metrics.level_pooling import LevelPooling
from golden.metrics.ssim import Ssim
from golden.training.average import Average
from golden.training.evaluate import Gate, Quality, evaluate
from golden.training.losses import photometric
from golden.training.optimiser import Optimiser
from golden.training.representable import Bounds
from golden.training.retrain import SSIM_BUDGET, SSIM_BYTES, retraining_rates
from golden.training.stage import Stage
from golden.training.views import PerView, view_at, views_within
from spec.constants import ALPHA_MAX_L1

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

HVSQ_BYTES = 216
"""Largest number of bytes that an `Hvsq` keeps for a pixel."""

HVSQ_BUDGET = 2**30
"""Bytes for the views' `Hvsq` objects; those of further views are made again at each use."""


class FineTuneStage(Stage):
    """Trains all parameters on HVSQ at pooling 1 and, with the same weight, on the loss of pruning; keeps the result only if it
    helps.

    Trained on HVSQ alone, PSNR and HVSQ improve but SSIM falls below the gate, which the pruned model just passes.

    Every `interval` iterations, HVSQ, PSNR and SSIM of the running average of the parameters are measured on the validation
    views. The result is the model with the lowest HVSQ among those that pass the gate. The model that came in counts whether or
    not it passes.

    Args:
        scene: training views train, and validation views judge.
        gaussians: level 1.
        gate: the gate of pruning, or None: HVSQ alone decides.
        iterations: number of iterations.
        interval: iterations between two measurements.
        seed: seed of the order of training views.
        rates: Adam's rates by field; None for `retraining_rates`.
        name: the stage's name in the chain.
        pooling: HVSQ's pooling; that of level 1 is used.

    Attributes:
        before, after: quality of the model that came in and of the result on the validation views, including HVSQ at pooling 1.
    """

    def __init__(
        self, scene: TrainingScene, gaussians: Gaussians, gate: Gate | None = None, *, iterations: int = 500,
        interval: int = 100, seed: int = 0, rates: Mapping[str, float] | None = None, name: str = "finetune",
        pooling: LevelPooling | None = None,
    ) -> None:
        if iterations < 1 or interval < 1:
            raise ValueError(f"iterations and interval must be at least 1, not {iterations!r} and {interval!r}")
        self.name, self.total, self.done = name, iterations, 0
        self.before: Quality | None = None
        self.after: Quality | None = None
        self._scene, self._gate, self._interval, self._seed = scene, gate, interval, seed
        self._bounds, gaussians = Bounds(scene), gaussians.detached()
        self._bounds.apply(gaussians)
        self._optimiser = Optimiser(gaussians, retraining_rates(scene) if rates is None else rates)
        self._average, self._best = Average(gaussians), gaussians
        camera = scene.cameras[scene.train[0]]
        self.pooling = pooling or LevelPooling()
        self._hvsq = PerView(
            lambda view: self.pooling.hvsq(scene.photograph(view).to(gaussians.device), 0),
            views_within(camera.width * camera.height, HVSQ_BYTES, HVSQ_BUDGET))
        self._ssim = PerView(
            lambda view: Ssim(scene.photograph(view).to(gaussians.device)),
            views_within(camera.width * camera.height, SSIM_BYTES, SSIM_BUDGET))

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians in training."""
        return self._optimiser.gaussians

    def step(self) -> dict[str, float]:
        """Takes one iteration; if validation views were measured, the record has `psnr`, `ssim` and `hvsq` too."""
        if self.before is None:
            self.before = self.after = self._quality(self._best)
        view = view_at(self._scene.train, self._seed, self.name, self.done)
        rendering = render(self.gaussians, self._scene.cameras[view], alpha_max=ALPHA_MAX_L1)
        image = self._scene.unmasked(view, rendering.image)
        hvsq, photograph = self._hvsq(view).absolute(image), self._scene.photograph(view).to(self.gaussians.device)
        others = photometric(image, self._ssim(view), photograph)
        loss = hvsq + (hvsq.detach() / others.detach().clamp(min=1e-12)) * others
        loss.backward()
        self._optimiser.step()
        self._average.take(self.gaussians)
        self.done += 1
        record = {"loss": float(hvsq.detach()), "points": len(self.gaussians), "view": view}
        if self.done % self._interval == 0 or self.finished:
            narrowed = self._bounds.apply(self._average.gaussians)
            quality = self._quality(self._average.gaussians)
            record |= {"psnr": quality.psnr, "ssim": quality.ssim, "hvsq": quality.hvsq[0], "narrowed": narrowed}
            passes = self._gate is None or self._gate.passes(quality)
            if passes and math.isfinite(quality.hvsq[0]) and quality.hvsq[0] < self.after.hvsq[0]:
                self.after, self._best = quality, self._average.gaussians.detached()
        return record

    def result(self) -> Gaussians:
        """The model with the lowest validation HVSQ that passes the gate."""
        return self._best

    def state(self) -> dict[str, object]:
        """See `Stage`."""
        return {
            "done": self.done, "before": _plain(self.before), "after": _plain(self.after), "best": self._best.tensors(),
            "training": self._optimiser.state(), "average": self._average.state(),
        }

    def load(self, state: dict[str, object]) -> None:
        """See `Stage`."""
        self.done = state["done"]
        self.before, self.after = (None if state[key] is None else Quality(**state[key]) for key in ("before", "after"))
        self._best = Gaussians(**state["best"]).detached()
        self._optimiser.load(state["training"])
        self._average.load(state["average"], self.gaussians.device)

    def _quality(self, gaussians: Gaussians) -> Quality:
        return evaluate(gaussians, self._scene, self._scene.validation,
                        hvsq=[lambda photograph: self.pooling.hvsq(photograph, 0)])


def _plain(quality: Quality | None) -> dict[str, object] | None:
    return None if quality is None else vars(quality).copy()
