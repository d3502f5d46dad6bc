"""LightGaussian's way (Fan et al. 2023): one prune by importance, recovery, then harmonics of a lower degree, distilled.

Nothing is gated: the share that is removed is fixed. It is what published speed-ups of one-shot pruning stand for, in contrast
to the criterion `importance`, which takes LightGaussian's score into our loop.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from golden.diff.gaussians import Gaussians
from golden.diff.render import render
from golden.scenes.model import SH_REST_COUNT
from golden.scenes.pictures import to_bytes
from golden.training.efficiency import Scores, without_lowest
from golden.training.poses import with_poses
from golden.training.representable import Bounds
from golden.training.retrain import Retraining
from golden.training.stage import Stage
from spec.constants import ALPHA_MAX_L1

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene


@dataclass(frozen=True)
class OneShotOptions:
    """Options of one-shot pruning.

    Attributes:
        iterations: number of training iterations in all.
        removed: share of the points that is removed; LightGaussian removes 66 %.
        recovery: share of the iterations that train on photographs before the harmonics are cut.
        sh_degree: degree of the harmonics that are left; LightGaussian goes from 3 to 2.
        poses: largest number of views between the training views that are distilled beside them.
    """

    iterations: int = 3000
    removed: float = 0.66
    recovery: float = 0.5
    sh_degree: int = 2
    poses: int = 64

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ValueError(f"iterations must be at least 1, not {self.iterations!r}")
        for name in ("removed", "recovery"):
            if not 0 < getattr(self, name) < 1:
                raise ValueError(f"{name} must lie in 0..1, not {getattr(self, name)!r}")
        if self.sh_degree not in SH_REST_COUNT:
            raise ValueError(f"sh_degree must be one of {tuple(SH_REST_COUNT)}, not {self.sh_degree!r}")


class OneShotStage(Stage):
    """Prunes a dense model once, lets it recover on the photographs, and distils it to harmonics of a lower degree.

    Distillation trains the pruned model on renders of the dense one, of the training views and of poses between them. All
    parameters are trained in both parts, with the photometric loss.

    Args:
        scene: training views train and score; no other view is read.
        dense: the model to prune, which also teaches.
        options: see `OneShotOptions`.
        seed: seed of the order of views.
        name: the stage's name in the chain.
    """

    def __init__(
        self, scene: TrainingScene, dense: Gaussians, options: OneShotOptions | None = None, *, seed: int = 0,
        name: str = "prune",
    ) -> None:
        self.name, self.options, self._seed = name, options or OneShotOptions(), seed
        self.total, self.done = self.options.iterations, 0
        self._recovery = min(round(self.options.recovery * self.total), self.total - 1)
        self._scene, self._dense, self._bounds = scene, dense.detached(), Bounds(scene)
        self._training: Retraining | None = None

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians in training."""
        return self._dense if self._training is None else self._training.gaussians

    def step(self) -> dict[str, float]:
        """Takes one iteration, after the prune or the cut if it is due."""
        if self._training is None:
            self._training = self._trained_on_photographs(self._pruned())
        if self.done == self._recovery:
            self._training = self._distilled(_cut(self._training.average, self.options.sh_degree))
        loss = self._training.step(self.done, 0.0)
        self.done += 1
        record = {"loss": loss, "points": len(self.gaussians), "view": self._training.view}
        if self.finished:
            record["narrowed"] = self._training.narrow(self._bounds)
        return record

    def result(self) -> Gaussians:
        """The running average of the parameters."""
        return self._dense if self._training is None else self._training.average

    def state(self) -> dict[str, object]:
        """See `Stage`."""
        return {"done": self.done, "training": None if self._training is None else self._training.state()}

    def load(self, state: dict[str, object]) -> None:
        """See `Stage`."""
        self.done = state["done"]
        if state["training"] is None:
            return
        if self.done <= self._recovery:
            self._training = self._trained_on_photographs(self._dense)
        else:
            self._training = self._distilled(_cut(self._dense, self.options.sh_degree))
        self._training.load(state["training"])

    def _pruned(self) -> Gaussians:
        """The dense model without the points of the lowest importance."""
        cameras = [self._scene.cameras[view] for view in self._scene.train]
        scores = Scores("importance", cameras, seed=self._seed).measure(self._dense)
        return self._dense.select(without_lowest(scores, round(self.options.removed * len(self._dense))))

    def _trained_on_photographs(self, gaussians: Gaussians) -> Retraining:
        return Retraining(self._scene, gaussians, self._seed, self.name)

    def _distilled(self, gaussians: Gaussians) -> Retraining:
        return Retraining(taught(self._scene, self._dense, self.options.poses), gaussians, self._seed, f"{self.name} distilled")


def taught(scene: TrainingScene, teacher: Gaussians, poses: int) -> TrainingScene:
    """The scene with the teacher's renders, at 8 bits a channel, in place of the training photographs, and with up to `poses`
    interpolated poses as further training views. Masks do not apply to renders."""
    images = scene.images.copy()
    with torch.no_grad():
        for view in scene.train:
            images[view] = to_bytes(render(teacher, scene.cameras[view], alpha_max=ALPHA_MAX_L1).image.cpu().numpy())
    masks = None if scene.masks is None else np.ones_like(scene.masks)
    posed, further = with_poses(replace(scene, images=images, masks=masks), teacher, poses)
    return replace(posed, train=(*scene.train, *further))


def _cut(gaussians: Gaussians, degree: int) -> Gaussians:
    """The Gaussians with harmonics of at most this degree."""
    return replace(gaussians, sh_rest=gaussians.sh_rest[:, : SH_REST_COUNT[degree]].contiguous())
