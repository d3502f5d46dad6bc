"""Baselines of pruning: the field's criteria in the same loop, and pruning once to a given number of points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from golden.diff.gaussians import Gaussians
from golden.training.efficiency import Scores, without_lowest
from golden.training.pruning import PruneOptions, PruneStage
from golden.training.retrain import Retraining
from golden.training.stage import Stage

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

BASELINES = ("count", "importance", "random")
"""Those of efficiency.CRITERIA that do not consider what a point costs."""


def baseline_stage(
    criterion: str, scene: TrainingScene, dense: Gaussians, variant: str = "H", options: PruneOptions | None = None, *,
    seed: int = 0, rates: Mapping[str, float] | None = None,
) -> PruneStage:
    """The loop of `PruneStage`, with its gates and its budget, but with a baseline's criterion and without scale decay.

    So models are compared at equal PSNR and differ only in how their points were chosen.

    Args:
        criterion: one of BASELINES.
        scene, dense, variant, options, seed, rates: see `PruneStage`.

    Raises:
        ValueError: the criterion is none of these.
    """
    if criterion not in BASELINES:
        raise ValueError(f"criterion must be one of {BASELINES}, not {criterion!r}")
    options = replace(options or PruneOptions(), criterion=criterion, scale_decay=False)
    return PruneStage(scene, dense, variant, options, seed=seed, rates=rates, name=f"prune-{criterion}")


class OneShotStage(Stage):
    """Prunes once to a number of points and then retrains: pruning without a gate, as LightGaussian does it.

    Args:
        scene: training views score and train.
        dense: the model to prune.
        criterion: one of efficiency.CRITERIA.
        points: number of points to keep, 1 to len(dense).
        iterations: number of retraining iterations with the loss 0.8 L1 + 0.2 (1 - SSIM).
        seed: seed of random choices and of the order of views.
        rates: Adam's rates by field; None for `retraining_rates`.
    """

    def __init__(
        self, scene: TrainingScene, dense: Gaussians, criterion: str, points: int, iterations: int, *, seed: int = 0,
        rates: Mapping[str, float] | None = None,
    ) -> None:
        if not 1 <= points <= len(dense):
            raise ValueError(f"points must lie in 1..{len(dense)}, the dense model's, not {points!r}")
        if iterations < 1:
            raise ValueError(f"iterations must be at least 1, not {iterations!r}")
        self.name, self.total, self.done = f"once-{criterion}-{points}", iterations, 0
        self._points = points
        self._scores = Scores(criterion, [scene.cameras[view] for view in scene.train], seed=seed)
        self._training = Retraining(scene, dense, seed, self.name, rates)

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians in training."""
        return self._training.gaussians

    def step(self) -> dict[str, float]:
        """Takes one iteration of retraining; the prune comes before the first."""
        excess = len(self.gaussians) - self._points
        if excess > 0:
            self._training.select(without_lowest(self._scores.measure(self.gaussians), excess))
        loss = self._training.step(self.done, 0.0)
        self.done += 1
        return {"loss": loss, "points": len(self.gaussians)}

    def result(self) -> Gaussians:
        """The model as it is now."""
        return self.gaussians.detached()

    def state(self) -> dict[str, object]:
        """See `Stage`."""
        return {"done": self.done, "training": self._training.state()}

    def load(self, state: dict[str, object]) -> None:
        """See `Stage`."""
        self.done = state["done"]
        self._training.load(state["training"])
