"""Baselines of foveated levels: random subsets of L1 (SMFR), and a separate model for each level (MMFR)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from golden.diff.gaussians import Gaussians, to_model
from golden.diff.render import render
from golden.metrics.level_pooling import LevelPooling
from golden.scenes.levels import smfr_levels
from golden.training.efficiency import Scores, without_lowest
from golden.training.foveated import FLOAT_BYTES, FoveatedModel, Storage, floats_per_point, level_alpha_max
from golden.training.level_quality import reference_image
from golden.training.levels import HVSQ_BYTES
from golden.training.optimiser import Optimiser, dense_rates
from golden.training.stage import Stage
from golden.training.views import PerView, view_at, views_within
from spec.constants import MAX_LEVELS

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene


def smfr(base: Gaussians, counts: Sequence[int], seed: int = 0) -> FoveatedModel:
    """Single-Model FR: L1, and nested random subsets of it with the given numbers of points; nothing is trained.

    Args:
        base: the Gaussians of L1.
        counts: number of points of each level; the first must be all of `base`.
        seed: seed of the permutation that ranks the points.

    Raises:
        ValueError: the counts break this rule or do not descend.
    """
    drawn = smfr_levels(to_model(base, up=np.array([0.0, -1.0, 0.0]), name="smfr"), len(counts), seed, counts)
    return FoveatedModel.nested(base, drawn.quality_bound)


@dataclass(frozen=True)
class SeparateModels:
    """Multi-Model FR: levels that share nothing.

    Attributes:
        models: the Gaussians of each level, L1 first.
    """

    models: tuple[Gaussians, ...]

    def __post_init__(self) -> None:
        if not 1 <= len(self.models) <= MAX_LEVELS:
            raise ValueError(f"models must be 1..{MAX_LEVELS}, not {len(self.models)!r}")

    @property
    def levels(self) -> int:
        """Number of levels."""
        return len(self.models)

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of points of each level."""
        return tuple(map(len, self.models))

    @property
    def storage(self) -> Storage:
        """Bytes: all parameters of all models, and no bounds."""
        first, *further = (FLOAT_BYTES * floats_per_point(model) * len(model) for model in self.models)
        return Storage(first, sum(further), 0)

    def level(self, index: int) -> Gaussians:
        """The Gaussians of a level (0-based)."""
        return self.models[index]


@dataclass(frozen=True)
class SeparateOptions:
    """Options of making a level of MMFR.

    Attributes:
        iterations: number of training iterations in all.
        prune_until: share of them over which pruning is spread.
        fraction: largest share of the points that is removed at a time.
        share: number of parts in which training views are scored, see `Scores`.
        pooling: as `LevelOptions.pooling`.
        memory: bytes that references prepared for HVSQ may take.
    """

    iterations: int = 400
    prune_until: float = 0.6
    fraction: float = 0.10
    share: int = 5
    pooling: LevelPooling = field(default_factory=LevelPooling)
    memory: int = 1 << 30

    def __post_init__(self) -> None:
        for name in ("iterations", "share"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, not {getattr(self, name)!r}")
        for name in ("prune_until", "fraction"):
            if not 0 < getattr(self, name) < 1:
                raise ValueError(f"{name} must lie in 0..1, not {getattr(self, name)!r}")


class SeparateStage(Stage):
    """One level of MMFR: L1 pruned to a number of points, by the criterion of our levels, with all parameters trained on HVSQ
    at the level's pooling.

    Points are removed in equal shares over the first part of the training, so that training recovers from each loss before the
    next.

    Args:
        scene: training views train and score.
        base: the Gaussians of L1.
        level: 1, 2 or 3 (0-based).
        points: number of points to keep, 1..len(base).
        options: see `SeparateOptions`.
        seed: seed of the order of views.
        dense: a model whose renders are the reference instead of the photographs.
    """

    def __init__(
        self, scene: TrainingScene, base: Gaussians, level: int, points: int, options: SeparateOptions | None = None,
        seed: int = 0, dense: Gaussians | None = None,
    ) -> None:
        if not 1 <= points <= len(base):
            raise ValueError(f"points must lie in 1..{len(base)}, those of L1, not {points!r}")
        options = options or SeparateOptions()
        self.name, self.total, self.done = f"separate{level + 1}", options.iterations, 0
        self._scene, self._seed, self._alpha_max = scene, seed, level_alpha_max(level)
        width, height = scene.size
        self._hvsq = PerView(
            lambda view: options.pooling.hvsq(reference_image(scene, view, dense, base.device), level),
            views_within(width * height, HVSQ_BYTES, options.memory))
        self._optimiser = Optimiser(base, dense_rates(1.0, scene.extent))
        self._scores = Scores(
            "removal", [scene.cameras[view] for view in scene.train], share=options.share, alpha_max=self._alpha_max,
            seed=seed)
        self._points_at = _points_at(len(base), points, options)

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians in training."""
        return self._optimiser.gaussians

    def step(self) -> dict[str, float]:
        """Takes one iteration, after a prune if one is due."""
        excess = len(self.gaussians) - self._points_at.get(self.done, len(self.gaussians))
        if excess > 0:
            keep = without_lowest(self._scores.measure(self.gaussians), excess)
            self._optimiser.select(keep)
            self._scores.select(keep)
        view = view_at(self._scene.train, self._seed, self.name, self.done)
        image = render(self.gaussians, self._scene.cameras[view], alpha_max=self._alpha_max).image
        loss = self._hvsq(view).absolute(self._scene.unmasked(view, image))
        loss.backward()
        self._optimiser.step()
        self.done += 1
        return {"loss": float(loss.detach()), "points": len(self.gaussians), "view": view}

    def result(self) -> Gaussians:
        """The level's model."""
        return self.gaussians.detached()

    def state(self) -> dict[str, object]:
        """See `Stage`."""
        return {"done": self.done, "training": self._optimiser.state(), "scores": self._scores.state()}

    def load(self, state: dict[str, object]) -> None:
        """See `Stage`."""
        self.done = state["done"]
        self._optimiser.load(state["training"])
        self._scores.load(state["scores"])


def _points_at(first: int, last: int, options: SeparateOptions) -> dict[int, int]:
    """For each iteration that a prune precedes, the number of points left after it.

    There are as many prunes as `fraction` requires, evenly spread, and each removes the same share.
    """
    prunes = int(np.ceil(np.log(last / first) / np.log1p(-options.fraction)))
    when = np.linspace(0, options.prune_until * options.iterations, prunes, endpoint=False).astype(int)
    counts = np.round(first * (last / first) ** (np.arange(1, prunes + 1) / prunes)).astype(int)
    return dict(zip(when.tolist(), counts.tolist(), strict=True))
