"""What pruning is compared with: the field's criteria in the same loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from golden.diff.gaussians import Gaussians
from golden.training.pruning import PruneOptions, PruneStage

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

BASELINES = ("count", "importance", "random")
"""Criteria of efficiency.CRITERIA that look at points, not at what they cost."""


def baseline_stage(
    criterion: str, scene: TrainingScene, dense: Gaussians, variant: str = "H", options: PruneOptions | None = None, *,
    seed: int = 0, rates: Mapping[str, float] | None = None,
) -> PruneStage:
    """The loop of `PruneStage`, its gates and its budget, with a baseline's criterion and no scale decay.

    So that models are compared at equal PSNR, and by nothing but how their points were chosen.
    """
    if criterion not in BASELINES:
        raise ValueError(f"criterion must be one of {BASELINES}, not {criterion!r}")
    options = replace(options or PruneOptions(), criterion=criterion, scale_decay=False)
    return PruneStage(scene, dense, variant, options, seed=seed, rates=rates, name=f"prune-{criterion}")
