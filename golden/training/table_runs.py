"""The models that the tables compare, made by the stages of `golden/train.py` and what the comparisons need beside them.

One chain a scene: the recipe's own stages (or what a finished run of `golden/train.py` left of them), scale decay without
pruning, levels without opacity enhancement, and the separate models of MMFR.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from golden.training.baselines import SeparateModels, smfr
from golden.training.chain import Planned
from golden.training.foveated import FoveatedModel
from golden.training.gaussians import Gaussians
from golden.training.level_curves import LevelCurve, level_curves
from golden.training.pruning import PruneOptions, PruneStage
from golden.training.recipe import CHECKS, ReadyStage, Recipe, plan
from golden.training.scene import TrainingScene
from golden.training.stage import Stage
from spec.constants import MAX_LEVELS

SCALE_DECAY = "scale-decay"
"""Name of the stage that controls scale decay and prunes nothing."""

PLAIN = "-plain"
"""Ends the names of levels without opacity enhancement."""

LEVELS = tuple(f"level{level + 1}" for level in range(1, MAX_LEVELS))
SEPARATE = tuple(f"separate{level + 1}" for level in range(1, MAX_LEVELS))


@dataclass(frozen=True)
class Trained:
    """What a scene's tables are about.

    Attributes:
        dense, decayed, pruned, level1: models of one level: dense training's, with scale decay alone, pruned by CE under scale
            decay, and that after fine-tuning on HVSQ.
        ours, plain: four levels with and without opacity enhancement.
        smfr, mmfr: the baselines, with the points per level of `ours`.
        seconds: of training, by stage.
        curves, plain_curves: HVSQ of levels against their points while they were made, with and without opacity enhancement.
    """

    dense: Gaussians
    decayed: Gaussians
    pruned: Gaussians
    level1: Gaussians
    ours: FoveatedModel
    plain: FoveatedModel
    smfr: FoveatedModel
    mmfr: SeparateModels
    seconds: dict[str, float]
    curves: tuple[LevelCurve, ...] = ()
    plain_curves: tuple[LevelCurve, ...] = ()

    @classmethod
    def of(
        cls, results: Mapping[str, Any], spent: Mapping[str, Mapping[str, float]], records: Sequence[Mapping[str, Any]],
        seed: int,
    ) -> Trained:
        """From the results of a finished chain of `table_plan`, what its stages took, and the records of its log."""
        ours, plain = results[LEVELS[-1]], results[LEVELS[-1] + PLAIN]
        separate = SeparateModels((results["finetune"], *(results[name] for name in SEPARATE)))
        return cls(
            results["dense"], results[SCALE_DECAY], results["prune"], results["finetune"], ours, plain,
            smfr(results["finetune"], ours.counts, seed), separate, {name: each["seconds"] for name, each in spent.items()},
            level_curves(records, ours.counts), level_curves(records, plain.counts, PLAIN))

    def seconds_of(self, stages: tuple[str, ...]) -> float:
        """Of several stages."""
        return sum(self.seconds.get(name, 0.0) for name in stages)


def table_plan(recipe: Recipe, scene: TrainingScene, device: str, ready: Mapping[str, Any] | None = None) -> list[Planned]:
    """The stages in order.

    Args:
        recipe: with opacity enhancement and no baseline, as the tables have both.
        scene: what is trained on and judged by.
        device: where to train.
        ready: results of stages of the recipe that are there already, by name.
    """
    ready = ready or {}

    def planned(stage: Planned) -> Planned:
        if stage.name not in ready:
            return stage
        return Planned(stage.name, 0, lambda _: ReadyStage(stage.name, ready[stage.name]))

    ours = [planned(stage) for stage in plan(recipe, scene, device)]
    plain = [_plain(stage) for stage in plan(replace(recipe, enhancement=False), scene, device) if stage.name in LEVELS]
    separate = [stage for stage in plan(replace(recipe, baseline="mmfr"), scene, device) if stage.name in SEPARATE]
    return [*ours, Planned(SCALE_DECAY, recipe.budget("prune"), _scale_decay(recipe, scene, device)), *plain, *separate]


def _scale_decay(recipe: Recipe, scene: TrainingScene, device: str) -> Callable[[dict[str, Any]], Stage]:
    """Pruning's loop, gate and budget with nothing pruned."""
    iterations = recipe.budget("prune")
    options = PruneOptions(iterations=iterations, interval=max(1, iterations // CHECKS), criterion=None)
    return lambda results: PruneStage(
        scene, results["dense"].to(device), recipe.variant, options, seed=recipe.seed, name=SCALE_DECAY)


def _plain(stage: Planned) -> Planned:
    """A level's stage under another name, on the levels that go by such names too."""
    def make(results: dict[str, Any]) -> Stage:
        own = {name: results[name + PLAIN] for name in LEVELS if name + PLAIN in results}
        return stage.make({**{name: left for name, left in results.items() if name not in LEVELS}, **own})

    return Planned(stage.name + PLAIN, stage.total, make)
