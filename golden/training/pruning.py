"""Perception-guided pruning: monitor quality, prune while it holds, retrain with scale decay while it does not.

Paper section 3.4. The dense model's quality on the validation views sets the gate; no view of the test set is ever read.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from golden.diff.gaussians import Gaussians
from golden.training.efficiency import CRITERIA, Scores, widened, without_lowest
from golden.training.evaluate import Gate, Quality, evaluate
from golden.training.representable import Bounds
from golden.training.retrain import Retraining
from golden.training.scale_decay import GAMMA_FIRST, next_gamma
from golden.training.stage import Stage

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

QUALITY_LOSS = {"H": 0.01, "M": 0.02, "L": 0.03}
"""Share of the dense model's PSNR and SSIM that each variant may lose."""


RECOVERY = 3
"""Intervals from a failed gate to the next look: healing takes that long, and gamma should not be gone by then."""


@dataclass(frozen=True)
class PruneOptions:
    """How the loop goes.

    Attributes:
        iterations: of retraining, in all.
        interval: iterations of retraining after a prune until the gate is looked at.
        recovery: iterations from a failed gate to the next look; None for RECOVERY times `interval`.
        patience: failed looks in a row after which a prune is undone and a smaller one tried; sooner where going on as since
            the second of them would not do.
        fraction: of the points, removed at each passed gate; halved where a prune is undone, doubled up to this where the gate
            passes at the first look after a prune.
        parts: that a prune is made in, with the scores measured anew before each.
        criterion: one of CRITERIA, or None: nothing is pruned, scale decay alone is controlled.
        scale_decay: whether gamma is ever above 0.
        gamma_first: gamma after the first passed gate, and the least that is not 0.
        opacity_min: Gaussians below it go first, whatever their score.
        opacity_clamp: opacities are clamped to it after a prune, None leaves them. 0.1, as the predecessor has it, costs more
            than a few hundred iterations bring back: 13 dB at once on the embedded scene, 2 dB after 100 iterations.
        margin: share of a frame's size by which it is widened on every side where points are scored.
        scored: poses that points are scored at anew before each part of a prune, in turn, while the others' last scores stand.
        validated: views that the gate looks at, at most, evenly spread over the validation views.
    """

    iterations: int = 3000
    interval: int = 20
    recovery: int | None = None
    patience: int = 10
    fraction: float = 0.10
    parts: int = 5
    criterion: str | None = "ce"
    scale_decay: bool = True
    gamma_first: float = GAMMA_FIRST
    opacity_min: float = 0.005
    opacity_clamp: float | None = None
    margin: float = 0.1
    scored: int = 8
    validated: int = 8

    def __post_init__(self) -> None:
        for name in ("iterations", "interval", "recovery", "patience", "parts", "scored", "validated"):
            if getattr(self, name) is not None and getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, not {getattr(self, name)!r}")
        if self.margin < 0 or self.gamma_first <= 0:
            raise ValueError(f"margin must be at least 0 and gamma_first above 0, not {self.margin!r} and {self.gamma_first!r}")
        if not 0 < self.fraction < 1:
            raise ValueError(f"fraction must lie in 0..1, not {self.fraction!r}")
        if self.criterion is not None and self.criterion not in CRITERIA:
            raise ValueError(f"criterion must be None or one of {CRITERIA}, not {self.criterion!r}")


@dataclass(frozen=True)
class Check:
    """One look at the gate.

    Attributes:
        iteration: of retraining, before it.
        points: Gaussians, before the prune that follows a pass.
        entries: (splat, tile) pairs per frame of the validation views.
        psnr, ssim: on the validation views.
        gamma: weight of scale decay that led here.
        slack: by how much the gate let it through, see `Gate.slack`; below 0 it did not.
    """

    iteration: int
    points: int
    entries: float
    psnr: float
    ssim: float
    gamma: float
    slack: float

    @property
    def passed(self) -> bool:
        """Whether the gate let it through."""
        return self.slack >= 0


def gate_views(scene: TrainingScene, options: PruneOptions) -> tuple[int, ...]:
    """The views that gates look at."""
    return scene.validation[:: -(-len(scene.validation) // options.validated)]


class PruneStage(Stage):
    """From a dense model to one of the same quality, less a variant's loss, with as few intersections as the budget allows.

    The dense model passes its own gate, so the first prune comes at once. After `interval` iterations the gate is looked at
    again, always with the running average of the parameters: a pass keeps the model if no passing one had fewer entries, prunes
    it and raises gamma; a failure lowers gamma and retrains for `recovery` iterations more. Where that does not lead back over
    the gate, the last model that passed comes back and a prune of half the size is tried. The result is the passing model with
    the fewest entries, at worst the dense one.

    Args:
        scene: training views are trained on and scored on, validation views gate.
        dense: the model to prune.
        variant: H, M or L.
        options: how.
        seed: of the order of training views.
        rates: Adam's, by field; None for `retraining_rates`.
        name: in a chain.

    Attributes:
        history: one row for each look at the gate, the dense model's first.
        gate: what must be reached; None before the first step.
    """

    def __init__(
        self, scene: TrainingScene, dense: Gaussians, variant: str = "H", options: PruneOptions | None = None, *, seed: int = 0,
        rates: Mapping[str, float] | None = None, name: str = "prune",
    ) -> None:
        if variant not in QUALITY_LOSS:
            raise ValueError(f"variant must be one of {tuple(QUALITY_LOSS)}, not {variant!r}")
        self.name, self.variant, self.options = name, variant, options or PruneOptions()
        self.total, self.done = self.options.iterations, 0
        self.gamma, self.gate, self.history = 0.0, None, []
        self._look = self.options.interval
        self._scene = scene
        self._validation = gate_views(scene, self.options)
        self._bounds, dense = Bounds(scene), dense.detached()
        self._bounds.apply(dense)
        self._training = Retraining(scene, dense, seed, name, rates)
        self._scores = None
        if self.options.criterion is not None:
            # Poses of validation views too: what only they see could otherwise be neither kept nor retrained.
            cameras = [widened(scene.cameras[view], self.options.margin) for view in (*scene.train, *scene.validation)]
            self._scores = Scores(self.options.criterion, cameras, share=-(-len(cameras) // self.options.scored), seed=seed)
        self._best = dense
        self._fraction, self._failures = self.options.fraction, 0
        self._passed: dict[str, object] | None = None

    @property
    def gaussians(self) -> Gaussians:
        """What is trained."""
        return self._training.gaussians

    def step(self) -> dict[str, float]:
        """One iteration of retraining; where the gate was looked at, `psnr`, `ssim`, `entries` and `passed` too."""
        if self.gate is None:
            dense = self._quality()
            self.gate = Gate.of(dense, QUALITY_LOSS[self.variant])
            self._decide(dense)
        loss = self._training.step(self.done, self.gamma)
        self.done += 1
        record = {"loss": loss, "points": len(self.gaussians), "gamma": self.gamma, "view": self._training.view}
        if self.done >= self._look or self.finished:
            narrowed = self._training.narrow(self._bounds)
            check = self._decide(self._quality())
            record |= {"psnr": check.psnr, "ssim": check.ssim, "entries": check.entries, "passed": check.passed,
                       "narrowed": narrowed}
        return record

    def result(self) -> Gaussians:
        """The passing model with the fewest entries."""
        return self._best

    def state(self) -> dict[str, object]:
        """For `load`."""
        return {
            "done": self.done, "look": self._look, "gamma": self.gamma, "fraction": self._fraction, "failures": self._failures,
            "gate": None if self.gate is None else vars(self.gate).copy(),
            "history": [vars(check).copy() for check in self.history], "best": self._best.tensors(),
            "current": self._snapshot(), "passed": None if self._passed is None else copy.deepcopy(self._passed),
        }

    def load(self, state: dict[str, object]) -> None:
        """Back to where `state` was taken."""
        self.done, self._look, self.gamma = state["done"], state["look"], state["gamma"]
        self._fraction, self._failures = state["fraction"], state["failures"]
        self.gate = None if state["gate"] is None else Gate(**state["gate"])
        self.history = [Check(**check) for check in state["history"]]
        self._best = Gaussians(**state["best"]).detached()
        self._passed = copy.deepcopy(state["passed"])
        self._restore(state["current"])

    def _snapshot(self) -> dict[str, object]:
        return {"training": self._training.state(), "scores": None if self._scores is None else self._scores.state()}

    def _restore(self, snapshot: dict[str, object]) -> None:
        self._training.load(snapshot["training"])
        if self._scores is not None:
            self._scores.load(snapshot["scores"])

    def _quality(self) -> Quality:
        return evaluate(self._training.average, self._scene, self._validation)

    def _decide(self, quality: Quality) -> Check:
        """The gate: keeps the model, prunes it and changes gamma as it says."""
        check = Check(
            self.done, quality.points, quality.entries, quality.psnr, quality.ssim, self.gamma, self.gate.slack(quality))
        fewest = min((row.entries for row in self.history if row.passed), default=None)
        self.history.append(check)
        if check.passed and (fewest is None or check.entries < fewest):
            self._best = self._training.average
        if self.finished:
            return check
        options = self.options
        if options.scale_decay:
            self.gamma = next_gamma(self.gamma, check.passed, options.gamma_first)
        pruned = self._go_on() if check.passed else self._wait()
        self._look = self.done + (options.interval if pruned else options.recovery or RECOVERY * options.interval)
        return check

    def _go_on(self) -> bool:
        """After a pass: prune the model, the more the easier the last prune was."""
        if self._scores is None:
            return True
        if self._failures == 0:
            self._fraction = min(2 * self._fraction, self.options.fraction)
        self._training.settle()
        self._failures, self._passed = 0, self._snapshot()
        self._prune()
        return True

    def _wait(self) -> bool:
        """After a failure: whether the prune was undone and a smaller one took its place."""
        self._failures += 1
        if self._passed is None or not self._hopeless():
            return False
        self._restore(self._passed)
        self._fraction, self._failures = self._fraction / 2, 0
        self._prune()
        return True

    def _hopeless(self) -> bool:
        """Whether the gate has failed too often since the last prune, or will by what the last retraining gained."""
        left = self.options.patience - self._failures
        if left <= 0:
            return True
        if self._failures < 4:  # the first look comes soon after the prune, the second after the quickest recovery
            return False
        since, now = self.history[1 - self._failures].slack, self.history[-1].slack
        return now + (now - since) / (self._failures - 2) * left < 0

    def _prune(self) -> None:
        """Drop what is almost transparent, then the lowest `fraction` in parts, scores measured before each."""
        options = self.options
        self._keep(self.gaussians.amplified_opacity.detach() >= options.opacity_min)
        part = max(1, round(self._fraction / options.parts * len(self.gaussians)))
        for _ in range(options.parts):
            self._keep(without_lowest(self._scores.measure(self.gaussians), part))
        if options.opacity_clamp is not None:
            self._training.clamp_opacity(options.opacity_clamp)

    def _keep(self, keep: torch.Tensor) -> None:
        self._training.select(keep)
        self._scores.select(keep)
