"""The models that the tables compare, made by the stages of `golden/train.py` and what the comparisons need beside them.

Parts, each a chain of its own that can be made alone and goes on where it was interrupted: L1 and the levels (or what a
finished run of `golden/train.py` left of them), scale decay without pruning, levels without opacity enhancement, the separate
models of MMFR, and pruning by other gates and criteria.
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
from golden.training.pruning import PruneStage
from golden.training.recipe import VARIANTS, Recipe, plan
from golden.training.scene import TrainingScene
from msv2.studies.training.level_curves import LevelCurve, level_curves
from spec.constants import MAX_LEVELS

SCALE_DECAY = "scale-decay"
"""Name of the stage that controls scale decay and prunes nothing."""

PLAIN = "-plain"
"""Ends the names of levels without opacity enhancement."""

LEVELS = tuple(f"level{level + 1}" for level in range(1, MAX_LEVELS))
SEPARATE = tuple(f"separate{level + 1}" for level in range(1, MAX_LEVELS))

NEEDED = {
    "representations": ("level1", "levels", "plain", "mmfr"), "ablation": ("level1", "levels", SCALE_DECAY, "plain"),
    "pruning": ("level1", "pruning"), "latency": ("level1",)}
"""Parts that each table needs, by the names of `labels.TABLES`."""

PARTS = ("level1", "levels", SCALE_DECAY, "plain", "mmfr", "pruning")
"""In the order in which they are made."""


def parts_of(tables: Iterable[str]) -> tuple[str, ...]:
    """The parts that some tables need, in order."""
    needed = {part for table in tables for part in NEEDED[table]}
    return tuple(part for part in PARTS if part in needed)


@dataclass(frozen=True)
class Trained:
    """What a scene's tables are about.

    Attributes:
        recipe: of the chain.
        results: what stages left, by name.
        seconds: of training, by stage.
        records: of the chains' logs.
    """

    recipe: Recipe
    results: Mapping[str, Any]
    seconds: dict[str, float]
    records: Sequence[Mapping[str, Any]] = ()

    @property
    def ours(self) -> FoveatedModel:
        """Four levels, opacities enhanced."""
        return self.results[LEVELS[-1]]

    @property
    def plain(self) -> FoveatedModel:
        """Four levels without opacity enhancement."""
        return self.results[LEVELS[-1] + PLAIN]

    @property
    def smfr(self) -> FoveatedModel:
        """Random subsets with the points of `ours`."""
        return smfr(self.results["finetune"], self.ours.counts, self.recipe.seed)

    @property
    def mmfr(self) -> SeparateModels:
        """Separate models with the points of `ours`."""
        return SeparateModels((self.results["finetune"], *(self.results[name] for name in SEPARATE)))

    @property
    def curves(self) -> tuple[LevelCurve, ...]:
        """HVSQ of levels against their points while they were made."""
        return level_curves(self.records, self.ours.counts)

    @property
    def plain_curves(self) -> tuple[LevelCurve, ...]:
        """The same without opacity enhancement."""
        return level_curves(self.records, self.plain.counts, PLAIN)

    def seconds_of(self, stages: Sequence[str]) -> float:
        """Of several stages."""
        return sum(self.seconds.get(name, 0.0) for name in stages)


def part_plan(part: str, recipe: Recipe, scene: TrainingScene, device: str, before: Mapping[str, Any]) -> list[Planned]:
    """The stages of a part in order, but for those whose results are there.

    Args:
        part: one of PARTS.
        recipe: with opacity enhancement and no baseline, as the tables have both.
        scene: what is trained on and judged by.
        device: where to train.
        before: what the stages of earlier parts left, by name.
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
    """Names of the loops of pruning by criterion and variant: the recipe's is `prune`, the others' follow from both."""
    ours = {("ce", variant): "prune" if variant == recipe.variant else f"prune-{variant}" for variant in VARIANTS}
    return ours | {(criterion, recipe.variant): f"prune-{criterion}" for criterion in BASELINES}


def tuned_stage(prune: str) -> str:
    """Name of the stage that fine-tunes what a loop of ours left."""
    return prune.replace("prune", "finetune")


def _pruning(recipe: Recipe, scene: TrainingScene, device: str) -> list[Planned]:
    """From the recipe's dense model: its loop by other criteria, and the loop and fine-tuning by other gates."""
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
    """Pruning's loop, gate and budget with nothing pruned."""
    options = replace(recipe.prune_options(), criterion=None)
    return Planned(SCALE_DECAY, options.iterations, lambda results: PruneStage(
        scene, results["dense"].to(device), recipe.variant, options, seed=recipe.seed, name=SCALE_DECAY))


def _renamed(stage: Planned, name: str, given: Mapping[str, str]) -> Planned:
    """A recipe's stage under another name, which gets other stages' results, where there are any, for those it asks for."""
    return Planned(name, stage.total, lambda results: stage.make(
        results | {asked: results[other] for asked, other in given.items() if other in results}))


def _after(stage: Planned, before: Mapping[str, Any]) -> Planned:
    """A stage that gets copies of what earlier parts left, beside what its own chain did."""
    return Planned(stage.name, stage.total, lambda results: stage.make({**copy.deepcopy(dict(before)), **results}))
