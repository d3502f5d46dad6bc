"""Perception-guided pruning: prune while quality holds, and retrain with scale decay while it does not (paper section 3.4).

The dense model's quality on the validation views sets the gate. Test views are never read.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from golden.diff.gaussians import Gaussians
from golden.training.efficiency import CRITERIA, Scores, widened, without_lowest
from golden.training.evaluate import KINDS, Gate, Quality, evaluate
from golden.training.representable import Bounds
from golden.training.retrain import Retraining
from golden.training.scale_decay import GAMMA_LIMIT, GAMMA_SHARE, next_gamma
from golden.training.stage import Stage

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

OURS = "removal_per_tile"
"""The criterion of our loop. From the dense model of the run without arguments, it cut intersections 2.55 times where the
paper's CE cut them 1.98 times, behind the same gate. The reason is that CE counts the pixels that a Gaussian dominates, and
does not ask what these would look like without it."""

QUALITY_LOSS = {"H": 0.01, "M": 0.02, "L": 0.03}
"""Share of the dense model's PSNR, and of its SSIM if the gate reads it, that each variant may lose."""

BALANCED = 8
"""Largest number of training views, evenly spread, from which the first gamma is determined."""

SLOWER = 3
"""How much longer a model takes to recover from a prune than from the one before, of the same share of its points. On bonsai at
200x133 a quarter of the points took 900 iterations at 54,000 points and 2,400 at 41,000."""

FEW = 4
"""Checks that a recovery should take. Where the last one took fewer, the next prune takes a larger share, by up to twice; where
it took more, a smaller one, down to half. Large prunes from which the model does not recover, and which are then undone, waste
more iterations than several smaller ones take."""

RECOVERY = 1
"""Intervals from a failed gate to the next check. A check costs a few iterations' time, and a model that has recovered should
not wait for it."""


@dataclass(frozen=True)
class PruneOptions:
    """Options of the pruning loop.

    Attributes:
        iterations: number of retraining iterations in all.
        interval: iterations of retraining between a prune and the next check of the gate.
        recovery: iterations from a failed gate to the next check; None for RECOVERY times `interval`.
        patience: number of failed checks in a row after which a prune is undone and a smaller one tried. It is undone earlier
            if progress shows that the gate will not be reached in time.
        fraction: largest share of the points that is removed each time the gate passes. Less is removed where, judging by the
            last recovery, the next one would take more iterations than are left. The share is halved when a prune is undone,
            and follows how many checks each recovery took, see FEW.
        parts: number of parts in which a prune is made; scores are measured again before each.
        criterion: one of CRITERIA, or None: nothing is pruned, and only scale decay is controlled.
        scale_decay: whether gamma is ever above 0.
        gamma_first: gamma after the first passed gate, and the smallest value after it; None: such that gamma WS is GAMMA_SHARE
            of the dense model's loss on training views.
        opacity_min: Gaussians with a lower opacity are removed first, whatever their score.
        opacity_clamp: opacities are clamped to it after a prune; None leaves them. The predecessor's 0.1 costs more than a few
            hundred iterations recover: 13 dB at once on the embedded scene, and still 2 dB after 100 iterations.
        margin: share of a frame's size by which it is widened on every side when points are scored.
        scored: number of poses that are scored again before each part of a prune, in turn; the other poses' last scores stand.
        validated: largest number of views that the gate reads, evenly spread over the validation views.
        gate: what the gate reads, one of `evaluate.KINDS`.
    """

    iterations: int = 3000
    interval: int = 20
    recovery: int | None = None
    patience: int = 40
    fraction: float = 0.25
    parts: int = 5
    criterion: str | None = OURS
    scale_decay: bool = True
    gamma_first: float | None = None
    opacity_min: float = 0.005
    opacity_clamp: float | None = None
    margin: float = 0.1
    scored: int = 8
    validated: int = 32
    gate: str = "psnr"

    def __post_init__(self) -> None:
        for name in ("iterations", "interval", "recovery", "patience", "parts", "scored", "validated"):
            if getattr(self, name) is not None and getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, not {getattr(self, name)!r}")
        if self.margin < 0 or (self.gamma_first is not None and self.gamma_first <= 0):
            raise ValueError(f"margin must be at least 0 and gamma_first above 0, not {self.margin!r} and {self.gamma_first!r}")
        if self.gate not in KINDS:
            raise ValueError(f"gate must be one of {KINDS}, not {self.gate!r}")
        if not 0 < self.fraction < 1:
            raise ValueError(f"fraction must lie in 0..1, not {self.fraction!r}")
        if self.criterion is not None and self.criterion not in CRITERIA:
            raise ValueError(f"criterion must be None or one of {CRITERIA}, not {self.criterion!r}")


@dataclass(frozen=True)
class Check:
    """One check of the gate.

    Attributes:
        iteration: number of retraining iterations before it.
        points: number of Gaussians, before the prune that follows a pass.
        entries: mean number of intersections in a frame of the validation views.
        psnr, ssim: means on the validation views; ssim is None if the gate does not read it.
        gamma: weight of scale decay in the training before it.
        slack: by how much the gate passed, see `Gate.slack`; below 0 it failed.
    """

    iteration: int
    points: int
    entries: float
    psnr: float
    ssim: float | None
    gamma: float
    slack: float

    @property
    def passed(self) -> bool:
        """Whether the gate passed."""
        return self.slack >= 0


def gate_views(scene: TrainingScene, options: PruneOptions) -> tuple[int, ...]:
    """The views that the gate reads."""
    return scene.validation[:: -(-len(scene.validation) // options.validated)]


class PruneStage(Stage):
    """Prunes a dense model to one of the same quality, less a variant's loss, with as few intersections as the budget allows.

    The dense model passes its own gate, so the first prune comes at once. After `interval` iterations the gate is checked
    again, always with the running average of the parameters. When it passes, the model becomes the result if no passing one had
    fewer intersections; it is then pruned and gamma is raised, until gamma WS is GAMMA_LIMIT of the loss. When it fails, gamma
    is lowered, but not below its first value, and retraining continues for `recovery` iterations. If this does not reach the
    gate, the last model that passed is restored and a prune of half the size is tried. The result is the passing model with the
    fewest intersections, at worst the dense one.

    Args:
        scene: training views train and score, and validation views gate.
        dense: the model to prune.
        variant: H, M or L.
        options: the options of the loop.
        seed: seed of the order of training views.
        rates: Adam's rates by field; None for `retraining_rates`.
        name: the stage's name in the chain.

    Attributes:
        history: one row for each check of the gate, that of the dense model first.
        gate: the quality that must be reached; None before the first step.
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
        self._training = self._retraining(dense, seed, rates)
        self._scores = None
        if self.options.criterion is not None:
            cameras = [widened(scene.cameras[view], self.options.margin) for view in scene.train]
            self._scores = Scores(self.options.criterion, cameras, share=-(-len(cameras) // self.options.scored), seed=seed)
        self._best = dense
        self._fraction, self._failures, self._first = self.options.fraction, 0, self.options.gamma_first
        self._passed: dict[str, object] | None = None

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians in training."""
        return self._training.gaussians

    def step(self) -> dict[str, float]:
        """Takes one iteration of retraining; if the gate was checked, the record has `psnr`, `entries`, `passed` and, where the
        gate reads it, `ssim` too."""
        if self.gate is None:
            dense = self._quality()
            self.gate = Gate.of(dense, QUALITY_LOSS[self.variant], self.options.gate)
            if self._first is None:
                self._first = GAMMA_SHARE * self._training.balance_before(
                    self._scene.train[:: -(-len(self._scene.train) // BALANCED)])
            self._decide(dense)
        loss = self._training.step(self.done, self.gamma)
        self.done += 1
        record = {"loss": loss, "points": len(self.gaussians), "gamma": self.gamma, "view": self._training.view}
        if self.done >= self._look or self.finished:
            narrowed = self._training.narrow(self._bounds)
            check = self._decide(self._quality())
            record |= {"psnr": check.psnr, "entries": check.entries, "passed": check.passed, "narrowed": narrowed}
            record |= {} if check.ssim is None else {"ssim": check.ssim}
        return record

    def result(self) -> Gaussians:
        """The passing model with the fewest intersections."""
        return self._best

    def state(self) -> dict[str, object]:
        """See `Stage`."""
        return {
            "done": self.done, "look": self._look, "gamma": self.gamma, "fraction": self._fraction, "failures": self._failures,
            "first": self._first, "gate": None if self.gate is None else vars(self.gate).copy(),
            "history": [vars(check).copy() for check in self.history], "best": self._best.tensors(),
            "current": self._snapshot(), "passed": None if self._passed is None else copy.deepcopy(self._passed),
        }

    def load(self, state: dict[str, object]) -> None:
        """See `Stage`."""
        self.done, self._look, self.gamma = state["done"], state["look"], state["gamma"]
        self._fraction, self._failures, self._first = state["fraction"], state["failures"], state["first"]
        self.gate = None if state["gate"] is None else Gate(**state["gate"])
        self.history = [Check(**check) for check in state["history"]]
        self._best = Gaussians(**state["best"]).detached()
        self._passed = copy.deepcopy(state["passed"])
        self._restore(state["current"])

    def _retraining(self, dense: Gaussians, seed: int, rates: Mapping[str, float] | None) -> Retraining:
        """What trains the Gaussians between checks."""
        return Retraining(self._scene, dense, seed, self.name, rates, squared=self._squared)

    @property
    def _squared(self) -> bool:
        """Whether to train on the squared error, too: where the gate reads PSNR alone. SSIM falls by it (docs/training.md)."""
        return self.options.gate == "psnr"

    @property
    def _removes(self) -> bool:
        """Whether points are removed at all."""
        return self._scores is not None

    def _next_gamma(self, passed: bool) -> float:
        """Gamma after a check."""
        limit = GAMMA_LIMIT * self._training.balance if self.options.gamma_first is None else math.inf
        return next_gamma(self.gamma, passed, self._first, limit)

    def _ask_less(self) -> None:
        """After a prune was undone: what the next one asks for is less."""
        self._fraction /= 2

    def _snapshot(self) -> dict[str, object]:
        return {"training": self._training.state(), "scores": None if self._scores is None else self._scores.state()}

    def _restore(self, snapshot: dict[str, object]) -> None:
        self._training.load(snapshot["training"])
        if self._scores is not None:
            self._scores.load(snapshot["scores"])

    def _quality(self) -> Quality:
        return evaluate(self._training.average, self._scene, self._validation, ssim=self.options.gate == "both")

    def _decide(self, quality: Quality) -> Check:
        """Checks the gate; keeps the model, prunes it and changes gamma as the result requires."""
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
            self.gamma = self._next_gamma(check.passed)
        pruned = self._go_on() if check.passed else self._wait()
        self._look = self.done + (options.interval if pruned else options.recovery or RECOVERY * options.interval)
        return check

    def _go_on(self) -> bool:
        """After a pass, prunes the model: more than the last time if that was easy, and less if it was not or if the next
        recovery would take longer than what is left."""
        if not self._removes:
            return True
        took = self._failures + 1
        growth = min(max(FEW / took, 0.5), 2.0)
        if took > 1:
            growth = min(growth, self._checks_left / (SLOWER * took))
        self._fraction = min(growth * self._fraction, self.options.fraction)
        self._training.settle()
        self._failures, self._passed = 0, self._snapshot()
        self._prune()
        return True

    def _wait(self) -> bool:
        """After a failure, undoes the prune and makes a smaller one if the gate is out of reach; returns whether it did."""
        self._failures += 1
        if self._passed is None or not self._hopeless():
            return False
        self._restore(self._passed)
        self._failures = 0
        self._ask_less()
        self._prune()
        return True

    @property
    def _checks_left(self) -> float:
        """Number of checks that the remaining iterations have room for."""
        return (self.total - self.done) / (self.options.recovery or RECOVERY * self.options.interval)

    def _hopeless(self) -> bool:
        """Whether the gate has failed too often since the last prune, or will, judging by the gain over the later half of the
        failures: the gain right after a prune is much larger than later ones."""
        if self._failures >= self.options.patience:
            return True
        if self._failures < 4:
            return False
        left = min(self.options.patience - self._failures, self._checks_left)
        half = self._failures // 2
        since, now = self.history[-1 - half].slack, self.history[-1].slack
        return now + (now - since) / half * left < 0

    def _prune(self) -> None:
        """Drops almost transparent points, then the share `fraction` with the lowest scores, in parts, with scores measured
        before each."""
        options = self.options
        self._keep(self.gaussians.amplified_opacity.detach() >= options.opacity_min)
        part = max(1, round(self._fraction / options.parts * len(self.gaussians)))
        for _ in range(options.parts):
            self._keep(without_lowest(self._scores.measure(self.gaussians), part))
        if options.opacity_clamp is not None:
            self._training.clamp_opacity(options.opacity_clamp)

    def _keep(self, keep: torch.Tensor) -> None:
        self._training.select(keep)
        if self._scores is not None:
            self._scores.select(keep)
