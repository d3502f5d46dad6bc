"""Chooses the stages that make what a user asked for: variants, levels, baselines, and each stage's share of the iterations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from golden.diff.gaussians import Gaussians
from golden.metrics.hvsq import FULL_WIDTH
from golden.metrics.level_pooling import LevelPooling
from golden.metrics.pooling import KINDS as POOLINGS
from golden.training.baselines import SeparateModels, SeparateOptions, SeparateStage, smfr
from golden.training.chain import Planned
from golden.training.dense import DenseOptions, DenseStage
from golden.training.evaluate import KINDS as GATES
from golden.training.evaluate import Gate, evaluate
from golden.training.finetune import FineTuneStage
from golden.training.foveated import FoveatedModel, Version
from golden.training.level_quality import Levels
from golden.training.levels import LevelOptions, LevelStage
from golden.training.minisplatting import BLURRED, REINITIALISED
from golden.training.one_shot import OneShotOptions, OneShotStage
from golden.training.prune_baselines import PAPER, baseline_stage
from golden.training.pruning import QUALITY_LOSS, PruneOptions, PruneStage
from golden.training.scene import TrainingScene
from golden.training.stage import Stage
from spec.constants import MAX_LEVELS
from spec.errors import InputError

VARIANTS = tuple(QUALITY_LOSS)
FOVEATED_BASELINES = ("smfr", "mmfr")
PRUNING_BASELINES = ("count", "importance", "speedy", "pup", "compact")
ONE_SHOT = "lightgs"
BASELINES = (PAPER, *FOVEATED_BASELINES, *PRUNING_BASELINES, ONE_SHOT)

RESULTS = (FoveatedModel, Version, SeparateModels)
"""Classes, beside Gaussians, of the stages' results."""

SHARES = {"dense": 0.45, "prune": 0.40, "finetune": 0.03, "level2": 0.04, "level3": 0.04, "level4": 0.04}
"""Each stage's share of the chain's iterations."""

SEPARATE_SHARE = 0.05
"""The share of each level of MMFR; these iterations are added to the chain's."""

DENSE = {"adc": {}, "minisplatting": {"blurred": BLURRED, "reinitialised": REINITIALISED}}
"""Ways of dense training, as changes of `DenseOptions`: adaptive density control of 3DGS, or that of Mini-Splatting-D."""

MIN_ITERATIONS = 20
"""Smallest number of iterations of a chain, with which every stage has at least one."""

EMBEDDED_DEFAULTS = {"iterations": 5000, "max_points": 40_000}
"""Defaults for the embedded scene. With 20,000 points pruning finds less that it can take away; 60,000 took longer and
were cut by the same factor when the paper's CE ranked them."""

DEFAULTS = {"iterations": 20_000, "max_points": 60_000}
"""Defaults for photographs."""

EMBEDDED_FULL = {"iterations": 16_000}
"""Defaults of `--full` for the embedded scene; `full_points` gives the cap."""

FULL = {"iterations": 30_000}
"""Defaults of `--full` for photographs."""

FULL_POINTS_PER_PIXEL = 1.5
"""Cap of the dense model under `--full`. What pruning can take away depends on it most: on bonsai at 200x133, a cap of 0.3
points a pixel let intersections be cut 1.82 times, one of 1.5 points 2.45 times."""

POINTS_STEP = 5000
"""Caps under `--full` are multiples of this."""

CHECKS = 60
"""Smallest number of times that pruning can check its gate. A prune takes at least one interval, and later recoveries
take ten to twenty."""

MOST_INTERVAL = 100
"""Largest number of iterations between a prune and the check after it, as far as the running average looks back."""


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
        pooling_width: HVSQ pools as in a frame of this width in pixels, see `LevelPooling`.
        gate: what the gate of L1 reads: psnr, or both PSNR and SSIM.
        windows: HVSQ's pooling windows: blocks or box.
        dense: one of DENSE.
    """

    variant: str
    baseline: str | None
    enhancement: bool
    iterations: int
    max_points: int
    seed: int
    pooling_width: int = FULL_WIDTH
    gate: str = "psnr"
    windows: str = "blocks"
    dense: str = "adc"

    def __post_init__(self) -> None:
        for name, value, accepted in (
            ("variant", self.variant, VARIANTS), ("baseline", self.baseline, (None, *BASELINES)), ("gate", self.gate, GATES),
            ("pooling", self.windows, POOLINGS), ("dense", self.dense, tuple(DENSE))):
            if value not in accepted:
                raise InputError(f"{name} {value!r} is not accepted: choose one of {', '.join(filter(None, accepted))}")
        for name, least in (("iterations", MIN_ITERATIONS), ("max_points", 4), ("seed", 0)):
            if getattr(self, name) < least:
                raise InputError(f"{name.replace('_', '-')} {getattr(self, name)} is not accepted: {least} or more is")
        LevelPooling(self.pooling_width, self.windows)  # refuses a width below 1

    def budget(self, stage: str) -> int:
        """Number of iterations of a stage."""
        share = SEPARATE_SHARE if stage.startswith("separate") else SHARES[stage]
        return max(1, round(share * self.iterations))

    @property
    def pooling(self) -> LevelPooling:
        """HVSQ's pooling."""
        return LevelPooling(self.pooling_width, self.windows)

    def prune_options(self) -> PruneOptions:
        """The options of pruning, with an interval that leaves time for CHECKS checks of the gate."""
        iterations = self.budget("prune")
        return PruneOptions(iterations=iterations, interval=max(1, min(MOST_INTERVAL, iterations // CHECKS)), gate=self.gate)


def full_points(size: tuple[int, int]) -> int:
    """The cap of the dense model's points under `--full` for frames of a size (width, height)."""
    return max(POINTS_STEP, POINTS_STEP * round(FULL_POINTS_PER_PIXEL * size[0] * size[1] / POINTS_STEP))


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
    if recipe.baseline == ONE_SHOT:
        return [*stages, Planned("prune", recipe.budget("prune"), makers.one_shot)]
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
    return results.get(f"level{MAX_LEVELS}") or FoveatedModel(results.get("finetune") or results["prune"])


class _Makers:
    """Functions that make the stages of one recipe."""

    def __init__(self, recipe: Recipe, scene: TrainingScene, device: str) -> None:
        self.recipe, self.scene, self.device, self.seed = recipe, scene, device, recipe.seed

    def dense(self, results: dict[str, Any]) -> Stage:
        recipe = self.recipe
        options = DenseOptions(iterations=recipe.budget("dense"), max_points=recipe.max_points, **DENSE[recipe.dense])
        return DenseStage(self.scene, options, self.seed, self.device)

    def prune(self, results: dict[str, Any]) -> Stage:
        dense, recipe = results["dense"].to(self.device), self.recipe
        options = recipe.prune_options()
        if recipe.baseline in (PAPER, *PRUNING_BASELINES):
            return baseline_stage(recipe.baseline, self.scene, dense, recipe.variant, options, seed=self.seed)
        return PruneStage(self.scene, dense, recipe.variant, options, seed=self.seed)

    def one_shot(self, results: dict[str, Any]) -> Stage:
        options = OneShotOptions(iterations=self.recipe.budget("prune"))
        return OneShotStage(self.scene, results["dense"].to(self.device), options, seed=self.seed)

    def finetune(self, results: dict[str, Any]) -> Stage:
        dense = evaluate(results["dense"].to(self.device), self.scene, self.scene.validation)
        # Without the views there is no margin: it may be used up here.
        gate = Gate.of(replace(dense, views=()), QUALITY_LOSS[self.recipe.variant], self.recipe.gate)
        iterations = self.recipe.budget("finetune")
        return FineTuneStage(self.scene, results["prune"].to(self.device), gate, iterations=iterations,
                             interval=max(1, iterations // 5), seed=self.seed, pooling=self.recipe.pooling)

    def level(self, level: int) -> object:
        def make(results: dict[str, Any]) -> Stage:
            before = FoveatedModel(results["finetune"]) if level == 1 else results[f"level{level}"]
            iterations = self.recipe.budget(f"level{level + 1}")
            options = LevelOptions(
                iterations=iterations, opacity_enhancement=self.recipe.enhancement, pooling=self.recipe.pooling)
            if self.recipe.baseline == PAPER:
                options = replace(options, criterion=PAPER)
            dense = results["dense"].to(self.device)
            return LevelStage(self.scene, before.to(self.device), level, options, self.seed, posed=dense)

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
