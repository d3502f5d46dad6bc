"""Trains the models that the tables compare: with the stages of `golden/train.py`, and with further ones for comparisons.

The work is split into parts. Each part is a chain of its own, which can be made alone and continues where it was interrupted.
The parts are L1 and the levels (or what a finished run of `golden/train.py` left of them), scale decay without pruning, levels
without opacity enhancement, the separate models of MMFR, and pruning by other gates and criteria.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from golden.training.baselines import SeparateModels, smfr
from golden.training.chain import Planned
from golden.training.foveated import FoveatedModel
from golden.training.prune_baselines import BASELINES, baseline_stage
from golden.training.pruning import OURS, PruneStage
from golden.training.recipe import VARIANTS, Recipe, plan
from golden.training.scene import TrainingScene
from msv2.studies.training.level_curves import LevelCurve, level_curves
from spec.constants import MAX_LEVELS

SCALE_DECAY = "scale-decay"
"""Name of the stage with scale decay and without pruning."""

PLAIN = "-plain"
"""Suffix of the names of levels without opacity enhancement."""

LEVELS = tuple(f"level{level + 1}" for level in range(1, MAX_LEVELS))
SEPARATE = tuple(f"separate{level + 1}" for level in range(1, MAX_LEVELS))

NEEDED = {
    "representations": ("level1", "levels", "plain", "mmfr"), "ablation": ("level1", "levels", SCALE_DECAY, "plain"),
    "pruning": ("level1", "pruning"), "latency": ("level1",)}
"""The parts that each table needs, by the names of `labels.TABLES`."""

PARTS = ("level1", "levels", SCALE_DECAY, "plain", "mmfr", "pruning")
"""The parts, in the order in which they are made."""


def parts_of(tables: Iterable[str]) -> tuple[str, ...]:
    """The parts that the tables need, in order."""
    needed = {part for table in tables for part in NEEDED[table]}
    return tuple(part for part in PARTS if part in needed)


@dataclass(frozen=True)
class Trained:
    """The trained models of a scene.

    Attributes:
        recipe: the recipe of the chain.
        results: the results of the stages, by name.
        seconds: the seconds of training, by stage.
        records: the records of the chains' logs.
    """

    recipe: Recipe
    results: Mapping[str, Any]
    seconds: dict[str, float]
    records: Sequence[Mapping[str, Any]] = ()

    @property
    def ours(self) -> FoveatedModel:
        """Four levels with opacity enhancement."""
        return self.results[LEVELS[-1]]

    @property
    def plain(self) -> FoveatedModel:
        """Four levels without opacity enhancement."""
        return self.results[LEVELS[-1] + PLAIN]

    @property
    def smfr(self) -> FoveatedModel:
        """Random subsets with as many points as `ours`."""
        return smfr(self.results["finetune"], self.ours.counts, self.recipe.seed)

    @property
    def mmfr(self) -> SeparateModels:
        """Separate models with as many points as `ours`."""
        return SeparateModels((self.results["finetune"], *(self.results[name] for name in SEPARATE)))

    @property
    def curves(self) -> tuple[LevelCurve, ...]:
        """HVSQ of the levels against their points during training."""
        return level_curves(self.records, self.ours.counts)

    @property
    def plain_curves(self) -> tuple[LevelCurve, ...]:
        """HVSQ of the levels without opacity enhancement against their points during training."""
        return level_curves(self.records, self.plain.counts, PLAIN)

    def seconds_of(self, stages: Sequence[str]) -> float:
        """The seconds of several stages together."""
        return sum(self.seconds.get(name, 0.0) for name in stages)


def part_plan(part: str, recipe: Recipe, scene: TrainingScene, device: str, before: Mapping[str, Any]) -> list[Planned]:
    """The stages of a part in order, without those that have results already.

    Args:
        part: one of PARTS.
        recipe: the recipe, with opacity enhancement and no baseline, since the tables contain both.
        scene: the scene for training and evaluation.
        device: the device on which to train.
        before: the results of the stages of earlier parts, by name.
    """
    own = {stage.name: stage for stage in plan(recipe, scene, device)}
    if part == "level1":
        stages = [stage for name, stage in own.items() if name not in LEVELS]
    elif part == "levels":
        stages = [own[name] for name in LEVELS]
    elif part == SCALE_DECAY:
        stages = [_scale_decay(recipe, scene, device)]
    elif part == "plain":
        before = {name: left for name, left in before.items() if name not in LEVELS}
        stages = [_renamed(stage, stage.name + PLAIN, {name: name + PLAIN for name in LEVELS})
                  for stage in plan(replace(recipe, enhancement=False), scene, device) if stage.name in LEVELS]
    elif part == "mmfr":
        stages = [stage for stage in plan(replace(recipe, baseline="mmfr"), scene, device) if stage.name in SEPARATE]
    else:
        stages = _pruning(recipe, scene, device)
    return [_after(stage, before) for stage in stages if stage.name not in before]


def prune_stages(recipe: Recipe) -> dict[tuple[str, str], str]:
    """Names of the pruning loops by criterion and variant. The recipe's loop is `prune`; other names follow from both."""
    ours = {(OURS, variant): "prune" if variant == recipe.variant else f"prune-{variant}" for variant in VARIANTS}
    return ours | {(criterion, recipe.variant): f"prune-{criterion}" for criterion in BASELINES}


def tuned_stage(prune: str) -> str:
    """Name of the stage that fine-tunes the result of one of our loops."""
    return prune.replace("prune", "finetune")


def _pruning(recipe: Recipe, scene: TrainingScene, device: str) -> list[Planned]:
    """The stages that start from the recipe's dense model: its loop with other criteria, and loop and fine-tuning with other
    gates."""
    options, baselines, ours = recipe.prune_options(), [], []

    def baseline(criterion: str) -> Planned:
        return Planned(prune_stages(recipe)[criterion, recipe.variant], options.iterations, lambda results: baseline_stage(
            criterion, scene, results["dense"].to(device), recipe.variant, options, seed=recipe.seed))

    for (criterion, variant), name in prune_stages(recipe).items():
        if criterion in BASELINES:
            baselines.append(baseline(criterion))
        elif variant != recipe.variant:
            stages = {stage.name: stage for stage in plan(replace(recipe, variant=variant), scene, device)}
            ours += [_renamed(stages["prune"], name, {}),
                     _renamed(stages["finetune"], tuned_stage(name), {"prune": name})]
    return [*baselines, *ours]


def _scale_decay(recipe: Recipe, scene: TrainingScene, device: str) -> Planned:
    """The loop, the gate and the budget of pruning, but without pruning."""
    options = replace(recipe.prune_options(), criterion=None)
    return Planned(SCALE_DECAY, options.iterations, lambda results: PruneStage(
        scene, results["dense"].to(device), recipe.variant, options, seed=recipe.seed, name=SCALE_DECAY))


def _renamed(stage: Planned, name: str, given: Mapping[str, str]) -> Planned:
    """A recipe's stage under another name. `given` maps names of results that it asks for to those that it gets, if they
    exist."""
    return Planned(name, stage.total, lambda results: stage.make(
        results | {asked: results[other] for asked, other in given.items() if other in results}))


def _after(stage: Planned, before: Mapping[str, Any]) -> Planned:
    """A stage that gets copies of the results of earlier parts, besides those of its own chain."""
    return Planned(stage.name, stage.total, lambda results: stage.make({**copy.deepcopy(dict(before)), **results}))
