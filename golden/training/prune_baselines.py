"""Baselines of pruning: the paper's and the field's criteria, and learned masks, in the same loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from golden.diff.gaussians import Gaussians
from golden.training.masks import COMPACT, MaskStage
from golden.training.pruning import PruneOptions, PruneStage

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

PAPER = "ce"
"""The paper's criterion, under scale decay like ours."""

BASELINES = (PAPER, "count", "importance", "speedy", "pup", COMPACT, "random")
"""The paper's criterion, those of efficiency.CRITERIA that do not consider what a point costs, and learned masks."""


def baseline_stage(
    criterion: str, scene: TrainingScene, dense: Gaussians, variant: str = "H", options: PruneOptions | None = None, *,
    seed: int = 0, rates: Mapping[str, float] | None = None,
) -> PruneStage:
    """The loop of `PruneStage`, with its gates and its budget, but with a baseline's criterion (or masks), without scale decay
    except for the paper's.

    So models are compared at equal PSNR and differ only in how their points were chosen.

    Args:
        criterion: one of BASELINES.
        scene, dense, variant, options, seed, rates: see `PruneStage`.

    Raises:
        ValueError: the criterion is none of these.
    """
    if criterion not in BASELINES:
        raise ValueError(f"criterion must be one of {BASELINES}, not {criterion!r}")
    if criterion == COMPACT:
        return MaskStage(scene, dense, variant, options, seed=seed, rates=rates)
    options = replace(options or PruneOptions(), criterion=criterion)
    if criterion != PAPER:
        options = replace(options, scale_decay=False)
    return PruneStage(scene, dense, variant, options, seed=seed, rates=rates, name=f"prune-{criterion}")
