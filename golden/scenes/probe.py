"""Finds out which effects of `spec.effects` a model and a request call for."""

from __future__ import annotations

import numpy as np

from golden.scenes.gaze import FoveationMap
from golden.scenes.model import GaussianModel
from spec.constants import MAX_SH_DEGREE
from spec.effects import EFFECTS, EffectPlan, choose_plan


def used_sh_degree(model: GaussianModel) -> int:
    """The smallest SH degree that includes all of the model's coefficients that are not 0."""
    used = np.flatnonzero(np.abs(model.sh_rest).max(axis=(0, 2), initial=0.0))
    return int(np.sqrt(used[-1] + 1)) if len(used) else 0


def probe(
    model: GaussianModel, foveation: FoveationMap, *, effects: str = "auto", stereo: bool = False, depth: bool = False,
    contention: bool = False,
) -> EffectPlan:
    """The plan of effects for a frame, with a reason for each effect.

    Args:
        model: the Gaussians.
        foveation: tile levels and blend planes of the gaze; for two eyes, the source's.
        effects: what the user wants: auto, all, none, or names separated by commas.
        stereo: whether two eyes are asked for.
        depth: whether depths are asked for.
        contention: whether a memory of limited bandwidth is asked for.

    Raises:
        InputError: see `spec.effects.choose_plan`.
    """
    degree, blends = used_sh_degree(model), int(foveation.blend.sum())
    highest, dropped = int(foveation.tile_level.max(initial=0)) + 1, sum(model.dropped.values())
    enhanced = int((model.opacity[:, : foveation.levels] > 1).any(axis=1).sum())
    second = "the warped eye has holes" if stereo else "one eye"
    findings = {
        "sh": (degree > 0, f"harmonics of degree {degree} of {model.sh_degree}" if degree else
               "no coefficient beyond the first"),
        "levels": (highest > 1, f"tiles of level {highest}" if highest > 1 else
                   "no gaze" if foveation.gaze_xy is None else "all tiles are of level 1"),
        "blend": (blends > 0, f"{blends} tiles with two levels" if blends else "no tile with two levels"),
        "enhancement": (enhanced > 0, f"{enhanced:,} points of opacity above 1" if enhanced else "no opacity above 1"),
        "depth": (stereo or depth, "to warp" if stereo else "asked for" if depth else "not asked for"),
        "stereo": (stereo, "two eyes asked for" if stereo else "one eye"),
        "fill": (stereo, second), "rerender": (stereo, second),
        "cleaning": (dropped > 0, f"{dropped:,} points dropped" if dropped else "every number is finite"),
        "contention": (contention, "memory with limits" if contention else "no memory is simulated, or one without limits"),
    }
    called = {name for name, (wanted, _) in findings.items() if wanted}
    if "blend" in called and "levels" not in called:  # all tiles have level 1, but some show level 2 towards their edge
        called.add("levels")
        findings["levels"] = (True, "tiles blend with level 2")
    reasons = {name: findings[name][1] for name in EFFECTS}
    return choose_plan(effects, reasons, frozenset(called), min(degree, MAX_SH_DEGREE))
