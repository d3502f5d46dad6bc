"""Levels 2-4: each is pruned from the level before while its HVSQ at its own pooling is no worse than L1's HVSQ at pooling 1.

Paper sections 4.3 and 4.4. Geometry is frozen: only opacity, its amplifier and the DC colour are trained, on HVSQ of whole
images, without a gaze and without scale decay. The gate reads the photographs of validation views, and interpolated poses with
the dense model's renders as references; never test views.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import torch

from golden.diff.gaussians import Gaussians
from golden.diff.render import render
from golden.metrics.hvsq import Hvsq
from golden.metrics.level_pooling import LevelPooling
from golden.training.efficiency import Scores, without_lowest
from golden.training.foveated import FoveatedModel, Version, level_alpha_max
from golden.training.level_quality import reference_image, view_hvsq
from golden.training.poses import with_poses
from golden.training.stage import Stage
from golden.training.version_training import VersionTraining
from golden.training.views import PerView, view_at, views_within

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

HVSQ_BYTES = 216
"""Largest number of bytes that an `Hvsq` keeps for a pixel."""

TRIM_PART = 200
"""The last trim stops when it knows the number of points to within one part in this many."""

MARGIN = 1.0
"""Standard errors of the views' mean that the gate adds. They are needed because a view on which L1 itself has a high HVSQ
at pooling 1 lets its levels pass too easily. On the scene fern, one of two such views gave L4 0.84 of its L1's HVSQ and the
other 1.26, and 1.26 is nearer to the test views' 1.5."""


@dataclass(frozen=True)
class LevelOptions:
    """Options of making a level.

    Attributes:
        iterations: number of training iterations in all.
        interval: iterations between two checks of a gate that fails; None: a fortieth of all, at least 5, at most 100.
        patience: number of failed checks in a row after which a prune is undone and a smaller one tried. It is undone earlier
            if progress between the last two checks shows that the gate will not be reached in time.
        fraction: share of the points that is removed each time the gate passes. It is halved when a prune is undone, and
            doubled up to this value when the gate passes right after a prune.
        parts: number of parts in which a prune is made; scores are measured again before each.
        criterion: one of `efficiency.CRITERIA`.
        share: number of parts in which training views are scored, see `Scores`.
        validation_views: largest number of views that the gate reads, evenly spread over the scene's validation views.
        poses: largest number of interpolated poses that the gate reads beside them, see `golden.training.poses`.
        opacity_min: points with a lower opacity are removed first.
        opacity_enhancement: whether the amplifier is trained; without it the model is the predecessor's.
        rate_opacity, rate_log_amp, rate_sh_dc: Adam's initial learning rates; they fall to a tenth. Rates two to four times as
            high prune further in a short run, but then test views lose what the gate's views gain.
        pooling: HVSQ's pooling.
        memory: bytes that references prepared for HVSQ may take.
    """

    iterations: int = 400
    interval: int | None = None
    patience: int = 6
    fraction: float = 0.10
    parts: int = 5
    criterion: str = "removal"
    share: int = 5
    validation_views: int = 8
    poses: int = 16
    opacity_min: float = 0.005
    opacity_enhancement: bool = True
    rate_opacity: float = 0.05
    rate_log_amp: float = 0.1
    rate_sh_dc: float = 0.005
    pooling: LevelPooling = field(default_factory=LevelPooling)
    memory: int = 1 << 30

    def __post_init__(self) -> None:
        for name in ("iterations", "interval", "patience", "parts", "share", "validation_views"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name} must be at least 1, not {value!r}")
        if not 0 < self.fraction < 1:
            raise ValueError(f"fraction must lie in 0..1, not {self.fraction!r}")


@dataclass(frozen=True)
class LevelCheck:
    """One check of the gate.

    Attributes:
        iteration: number of training iterations before it.
        points: number of the level's points, before the prune that follows a pass.
        hvsq: `target` times the mean over the validation views of the ratio between the level's HVSQ at its pooling and L1's at
            pooling 1, to which MARGIN standard errors are added; or the same over the interpolated poses, if it is larger. To a
            pose's HVSQ against the dense model, that model's own HVSQ on the validation photographs is added.
        target: the largest accepted `hvsq`.
        entries: mean number of intersections in a frame of the gate's views; of its photographs where these fail.
        passed: whether `hvsq` is at most `target`.
    """

    iteration: int
    points: int
    hvsq: float
    target: float
    entries: float
    passed: bool


class LevelStage(Stage):
    """Makes the next level of a model.

    The level starts with the points of the level before, with their opacities, amplifiers and colours. When the gate passes,
    the level is stored as the best so far and pruned, and one iteration follows. When the gate fails, the level is trained
    until it passes again. If it does not pass in time, the best level is restored and a prune of half the size is tried. At the
    end the best passing level is trimmed without training: of its points, in the order of their scores, as few are kept as the
    gate accepts.

    Args:
        scene: photographs; its training views train and rank points, and its validation views gate.
        model: the levels so far.
        level: the level to make, 0-based: 1, 2 or 3.
        options: see `LevelOptions`.
        seed: seed of the order of views.
        dense: a model whose renders are the reference instead of the photographs.
        posed: the dense model whose renders are the references of interpolated poses; None: the gate reads no poses.

    Attributes:
        gaussians: the level in training; its geometry is not trained.
        target: HVSQ of L1 at pooling 1 on the gate's validation views.
        history: one row for each check of the gate.
    """

    def __init__(
        self, scene: TrainingScene, model: FoveatedModel, level: int, options: LevelOptions | None = None, seed: int = 0,
        dense: Gaussians | None = None, posed: Gaussians | None = None,
    ) -> None:
        if level != model.levels:
            raise ValueError(f"level must be {model.levels}, the one after those of the model, not {level!r}")
        options = options or LevelOptions()
        self.name, self.total, self.done = f"level{level + 1}", options.iterations, 0
        self.options, self.history, self._seed = options, [], seed
        self._interval = options.interval or min(max(options.iterations // 40, 5), 100)
        self._scene, self._model, self._alpha_max = scene, model, level_alpha_max(level)
        device, (width, height) = model.base.device, scene.size
        self._gate_views = scene.validation[:: -(-len(scene.validation) // options.validation_views)]
        self._photographs, self._judged = len(self._gate_views), scene
        if posed is not None:
            self._judged, poses = with_poses(scene, posed, options.poses)
            self._gate_views = (*self._gate_views, *poses)

        def references(level: int) -> PerView[Hvsq]:
            kept = views_within(width * height, HVSQ_BYTES, options.memory)
            return PerView(lambda view: options.pooling.hvsq(reference_image(self._judged, view, dense, device), level), kept)

        self._hvsq, first = references(level), references(0)
        self._targets, _ = view_hvsq(model.level(0), self._judged, self._gate_views, first, level_alpha_max(0))
        self._missing = np.zeros(len(self._gate_views))
        if len(self._gate_views) > self._photographs:
            self._targets[self._photographs :] += self._missing_of(posed, first)
            self._missing[self._photographs :] = self._missing_of(posed, self._hvsq)
        self.target = float(self._targets[: self._photographs].mean())
        for view in self._gate_views:  # what is asked for first is kept, and these are read at every check of the gate
            self._hvsq(view)
        self._rows = model.versions[-1].rows.clone() if model.versions else torch.arange(len(model.base), device=device)
        self._training = VersionTraining(
            model.level(level - 1), options.rate_opacity, options.rate_sh_dc,
            options.rate_log_amp if options.opacity_enhancement else None)
        cameras = [scene.cameras[view] for view in scene.train]
        self._scores = Scores(options.criterion, cameras, share=options.share, alpha_max=self._alpha_max, seed=seed)
        self._fraction, self._failures, self._next_gate = options.fraction, 0, 0
        self._best: dict[str, object] | None = None

    @property
    def gaussians(self) -> Gaussians:
        """The level in training."""
        return self._training.gaussians

    def step(self) -> dict[str, float]:
        """Takes one training iteration, after a check of the gate if one is due; its record then has `hvsq`, `entries` and
        `passed`."""
        record = {}
        if self.done >= self._next_gate:
            record |= self._decide()
        view = view_at(self._scene.train, self._seed, self.name, self.done)
        rendering = render(self.gaussians, self._scene.cameras[view], alpha_max=self._alpha_max)
        loss = self._hvsq(view).absolute(self._scene.unmasked(view, rendering.image))
        loss.backward()
        self._training.step(self.done / self.total)
        self.done += 1
        if self.finished:
            record |= self._finish()
        return {"loss": float(loss.detach()), "points": len(self.gaussians), "view": view, "target": self.target, **record}

    def result(self) -> FoveatedModel:
        """The model with this level added; the level has all points of the one before if not a single prune passed."""
        g = self.gaussians.detached()
        return self._model.with_level(Version(self._rows.clone(), g.opacity, g.log_amp, g.sh_dc))

    def state(self) -> dict[str, object]:
        """See `Stage`."""
        return {
            "done": self.done, "target": self.target, "history": [vars(row).copy() for row in self.history],
            "fraction": self._fraction, "failures": self._failures, "next_gate": self._next_gate,
            "current": self._snapshot(), "best": None if self._best is None else copy.deepcopy(self._best),
        }

    def load(self, state: dict[str, object]) -> None:
        """See `Stage`."""
        self.done, self.target = state["done"], state["target"]
        self.history = [LevelCheck(**row) for row in state["history"]]
        self._fraction, self._failures, self._next_gate = state["fraction"], state["failures"], state["next_gate"]
        self._best = copy.deepcopy(state["best"])
        self._restore(state["current"])

    def _decide(self) -> dict[str, float]:
        """Checks the gate and acts on the result."""
        check = self._look()
        wait = self._interval
        if check.passed:
            if self._failures == 0:
                self._fraction = min(2 * self._fraction, self.options.fraction)
            self._best, self._failures, wait = self._snapshot(), 0, 1
            self._prune(self._fraction)
        else:
            self._failures += 1
            if self._best is not None and self._hopeless():
                self._restore(self._best)
                self._fraction, self._failures, wait = self._fraction / 2, 0, 1
                self._prune(self._fraction)
        self._next_gate = self.done + wait
        return {"hvsq": check.hvsq, "entries": check.entries, "passed": float(check.passed)}

    def _hopeless(self) -> bool:
        """Whether the gate has failed too often since the last prune, or will, judging by the gain of the last interval."""
        left = self.options.patience - self._failures
        if left < 0:
            return True
        if self._failures < 3:  # the gain of the first interval after a prune is much larger than later ones
            return False
        before, now = self.history[-2].hvsq, self.history[-1].hvsq
        return now - (before - now) * left > self.target

    def _missing_of(self, dense: Gaussians, hvsq: PerView[Hvsq]) -> float:
        """What a pose's HVSQ lacks because its reference is the dense model's render: that model's own mean HVSQ on the
        validation photographs. The terms of HVSQ are squares, so errors that do not depend on each other add."""
        values, _ = view_hvsq(dense, self._judged, self._gate_views[: self._photographs], hvsq, level_alpha_max(0))
        return float(values.mean())

    def _look(self) -> LevelCheck:
        """Checks the gate. The photographs, which are fewer, come first: where they fail, no pose is rendered."""
        count = self._photographs
        hvsq, entries = self._judge(slice(0, count))
        if hvsq <= self.target and count < len(self._gate_views):
            of_poses, more = self._judge(slice(count, None))
            entries += (more - entries) * (1 - count / len(self._gate_views))
            hvsq = max(hvsq, of_poses)
        check = LevelCheck(self.done, len(self.gaussians), hvsq, self.target, entries, hvsq <= self.target)
        self.history.append(check)
        return check

    def _judge(self, part: slice) -> tuple[float, float]:
        """The HVSQ that is compared with the target, of a part of the gate's views, and their mean number of intersections."""
        values, entries = view_hvsq(self.gaussians, self._judged, self._gate_views[part], self._hvsq, self._alpha_max)
        values = values + self._missing[part]
        if self.target > 0 and self._targets.all():
            return self.target * _cautious_mean(values / self._targets[part]), entries
        return float(values.mean()), entries

    def _finish(self) -> dict[str, float]:
        """Restores the best passing level and trims it; if none ever passed, the level stays as training left it."""
        if not self._look().passed:
            if self._best is None:
                return {}
            self._restore(self._best)
        self._trim()
        check = self._look()
        return {"hvsq": check.hvsq, "entries": check.entries, "passed": float(check.passed)}

    def _trim(self) -> None:
        """Drops as many points, in the order of their scores, as the gate accepts."""
        whole = self._snapshot()
        scores = self._scores.measure(self.gaussians)
        drops, fails = 0, len(scores)  # dropping so many points is known to pass; dropping so many is taken to fail
        while fails - drops > max(1, len(scores) // TRIM_PART):
            middle = (drops + fails) // 2
            self._restore(whole)
            self._keep(without_lowest(scores, middle))
            drops, fails = (middle, fails) if self._look().passed else (drops, middle)
        self._restore(whole)
        self._keep(without_lowest(scores, drops))

    def _prune(self, fraction: float) -> None:
        """Drops almost transparent points, then the share `fraction` with the lowest scores, in parts, with scores measured
        before each."""
        self._keep(self.gaussians.amplified_opacity.detach() >= self.options.opacity_min)
        part = max(1, round(fraction / self.options.parts * len(self.gaussians)))
        for _ in range(self.options.parts):
            self._keep(without_lowest(self._scores.measure(self.gaussians), part))

    def _keep(self, keep: torch.Tensor) -> None:
        """Keeps only the points in `keep`, (n,) bool; does nothing if none would be left."""
        if bool(keep.any()):
            self._rows = self._rows[keep]
            self._training.select(keep)
            self._scores.select(keep)

    def _snapshot(self) -> dict[str, object]:
        return {"rows": self._rows.clone(), "training": self._training.state(), "scores": self._scores.state()}

    def _restore(self, snapshot: dict[str, object]) -> None:
        self._rows = snapshot["rows"].to(self._rows.device).clone()
        self._training.load(snapshot["training"])
        self._scores.load(snapshot["scores"])


def _cautious_mean(ratios: np.ndarray) -> float:
    """The mean of (V,) ratios, V >= 1, with MARGIN standard errors added."""
    error = ratios.std(ddof=1) / np.sqrt(len(ratios)) if len(ratios) > 1 else 0.0
    return float(ratios.mean() + MARGIN * error)
