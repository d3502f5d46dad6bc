"""Chooses the stages that make what a user asked for: variants, levels, baselines, and each stage's share of the iterations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from golden.diff.gaussians import Gaussians
from golden.metrics.hvsq import pooling_px
from golden.training.baselines import SeparateModels, SeparateOptions, SeparateStage, smfr
from golden.training.chain import Planned
from golden.training.dense import DenseOptions, DenseStage
from golden.training.evaluate import Gate, evaluate
from golden.training.finetune import FineTuneStage
from golden.training.foveated import FoveatedModel, Version
from golden.training.level_quality import Levels
from golden.training.levels import LevelOptions, LevelStage
from golden.training.prune_baselines import baseline_stage
from golden.training.pruning import QUALITY_LOSS, PruneOptions, PruneStage
from golden.training.scene import TrainingScene
from golden.training.stage import Stage
from spec.constants import MAX_LEVELS
from spec.errors import InputError

VARIANTS = tuple(QUALITY_LOSS)
FOVEATED_BASELINES = ("smfr", "mmfr")
PRUNING_BASELINES = ("count", "importance")
BASELINES = (*FOVEATED_BASELINES, *PRUNING_BASELINES)

RESULTS = (FoveatedModel, Version, SeparateModels)
"""Classes, beside Gaussians, of the stages' results."""

SHARES = {"dense": 0.45, "prune": 0.40, "finetune": 0.03, "level2": 0.04, "level3": 0.04, "level4": 0.04}
"""Each stage's share of the chain's iterations."""

SEPARATE_SHARE = 0.05
"""The share of each level of MMFR; these iterations are added to the chain's."""

MIN_ITERATIONS = 20
"""Smallest number of iterations of a chain, with which every stage has at least one."""

EMBEDDED_DEFAULTS = {"iterations": 8000, "max_points": 20_000}
"""Defaults for the embedded scene."""

DEFAULTS = {"iterations": 20_000, "max_points": 60_000}
"""Defaults for photographs."""

CHECKS = 40
"""Smallest number of times that pruning checks its gate, however few iterations it has."""


@dataclass(frozen=True)
class Recipe:
    """The choices that determine how a scene is trained.

    Attributes:
        variant: H, M or L, which says how much of the dense model's quality L1 may lose.
        baseline: one of BASELINES, or None for the project's own levels.
        enhancement: whether levels 2-4 may amplify opacities.
        iterations: number of iterations of the whole chain, including dense training.
        max_points: upper limit of the dense model's Gaussians.
        seed: seed of everything drawn at random.
        pooling_width: HVSQ pools as in a frame of this width in pixels; None: as in the scene's frames.
    """

    variant: str
    baseline: str | None
    enhancement: bool
    iterations: int
    max_points: int
    seed: int
    pooling_width: int | None = None

    def __post_init__(self) -> None:
        for name, value, accepted in (("variant", self.variant, VARIANTS), ("baseline", self.baseline, (None, *BASELINES))):
            if value not in accepted:
                raise InputError(f"{name} {value!r} is not accepted: choose one of {', '.join(filter(None, accepted))}")
        for name, least in (("iterations", MIN_ITERATIONS), ("max_points", 4), ("seed", 0)):
            if getattr(self, name) < least:
                raise InputError(f"{name.replace('_', '-')} {getattr(self, name)} is not accepted: {least} or more is")
        if self.pooling_width is not None and self.pooling_width < 1:
            raise InputError(f"pooling-width {self.pooling_width} is not accepted: 1 or more is")

    def budget(self, stage: str) -> int:
        """Number of iterations of a stage."""
        share = SEPARATE_SHARE if stage.startswith("separate") else SHARES[stage]
        return max(1, round(share * self.iterations))

    @property
    def pooling(self) -> tuple[float, ...] | None:
        """Pooling widths of HVSQ in pixels, one for each level; None if they are scaled to the scene's frames."""
        if self.pooling_width is None:
            return None
        return tuple(pooling_px(level, self.pooling_width) for level in range(MAX_LEVELS))

    def prune_options(self) -> PruneOptions:
        """The default options of pruning, with more frequent checks of the gate if there are few iterations."""
        iterations = self.budget("prune")
        return PruneOptions(iterations=iterations, interval=max(1, min(PruneOptions.interval, iterations // CHECKS)))


class ReadyStage(Stage):
    """A stage without iterations: its result exists already or is made at once."""

    def __init__(self, name: str, made: object) -> None:
        self.name, self.total, self.done = name, 0, 0
        self._made = made

    def step(self) -> dict[str, float]:
        """Never called, because the stage has no iterations."""
        raise ValueError(f"{self.name} has no iterations")

    def state(self) -> dict[str, object]:
        """An empty state."""
        return {}

    def load(self, state: dict[str, object]) -> None:
        """Does nothing, because there is no state."""

    def result(self) -> object:
        """The result that the stage was made with."""
        return self._made


def plan(recipe: Recipe, scene: TrainingScene, device: str, dense: Gaussians | None = None) -> list[Planned]:
    """The stages of a recipe, in order.

    Args:
        recipe: the choices.
        scene: the scene to train on and to judge by.
        device: where to train.
        dense: a trained model, which takes the place of dense training.
    """
    makers = _Makers(recipe, scene, device)
    stages = [Planned("dense", 0, lambda _: ReadyStage("dense", dense)) if dense is not None
              else Planned("dense", recipe.budget("dense"), makers.dense)]
    stages += [Planned("prune", recipe.budget("prune"), makers.prune),
               Planned("finetune", recipe.budget("finetune"), makers.finetune)]
    if recipe.baseline in PRUNING_BASELINES:
        return stages
    for level in range(1, MAX_LEVELS):
        name = f"level{level + 1}"
        stages.append(Planned(name, recipe.budget(name), makers.level(level)))
    if recipe.baseline == "smfr":
        stages.append(Planned("smfr", 0, makers.smfr))
    if recipe.baseline == "mmfr":
        for level in range(1, MAX_LEVELS):
            name = f"separate{level + 1}"
            stages.append(Planned(name, recipe.budget(name), makers.separate(level)))
    return stages


def levels_of(results: dict[str, Any]) -> Levels:
    """The levels of a finished chain, which are saved and reported."""
    if "smfr" in results:
        return results["smfr"]
    if "separate2" in results:
        return SeparateModels((results["finetune"], *(results[f"separate{level + 1}"] for level in range(1, MAX_LEVELS))))
    return results.get(f"level{MAX_LEVELS}") or FoveatedModel(results["finetune"])


class _Makers:
    """Functions that make the stages of one recipe."""

    def __init__(self, recipe: Recipe, scene: TrainingScene, device: str) -> None:
        self.recipe, self.scene, self.device, self.seed = recipe, scene, device, recipe.seed

    def dense(self, results: dict[str, Any]) -> Stage:
        recipe = self.recipe
        options = DenseOptions(iterations=recipe.budget("dense"), max_points=recipe.max_points)
        return DenseStage(self.scene, options, self.seed, self.device)

    def prune(self, results: dict[str, Any]) -> Stage:
        dense, recipe = results["dense"].to(self.device), self.recipe
        options = recipe.prune_options()
        if recipe.baseline in PRUNING_BASELINES:
            return baseline_stage(recipe.baseline, self.scene, dense, recipe.variant, options, seed=self.seed)
        return PruneStage(self.scene, dense, recipe.variant, options, seed=self.seed)

    def finetune(self, results: dict[str, Any]) -> Stage:
        dense = evaluate(results["dense"].to(self.device), self.scene, self.scene.validation)
        gate = Gate.of(replace(dense, views=()), QUALITY_LOSS[self.recipe.variant])  # no margin here: it may be used up
        iterations = self.recipe.budget("finetune")
        return FineTuneStage(self.scene, results["prune"].to(self.device), gate, iterations=iterations,
                             interval=max(1, iterations // 5), seed=self.seed,
                             pooling=None if self.recipe.pooling is None else self.recipe.pooling[0])

    def level(self, level: int) -> object:
        def make(results: dict[str, Any]) -> Stage:
            before = FoveatedModel(results["finetune"]) if level == 1 else results[f"level{level}"]
            iterations = self.recipe.budget(f"level{level + 1}")
            options = LevelOptions(
                iterations=iterations, opacity_enhancement=self.recipe.enhancement, pooling=self.recipe.pooling)
            return LevelStage(self.scene, before.to(self.device), level, options, self.seed)

        return make

    def smfr(self, results: dict[str, Any]) -> Stage:
        return ReadyStage("smfr", smfr(results["finetune"], results[f"level{MAX_LEVELS}"].counts, self.seed))

    def separate(self, level: int) -> object:
        def make(results: dict[str, Any]) -> Stage:
            points = results[f"level{MAX_LEVELS}"].counts[level]
            options = SeparateOptions(iterations=self.recipe.budget(f"separate{level + 1}"), pooling=self.recipe.pooling)
            return SeparateStage(self.scene, results["finetune"].to(self.device), level, points, options, self.seed)

        return make


def models_of(results: dict[str, Any], stages: Sequence[str]) -> list[tuple[str, int, Gaussians]]:
    """For each stage that trains: its name, and the 0-based level and the Gaussians of its result."""
    rows = []
    for name in stages:
        left = results[name]
        if isinstance(left, Gaussians):
            rows.append((name, int(name[-1]) - 1 if name.startswith("separate") else 0, left))
        elif name.startswith("level"):
            rows.append((name, left.levels - 1, left.level(left.levels - 1)))
    return rows
