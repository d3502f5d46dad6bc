"""A frame's data as a plan of effects wants it: without what is absent, neutral where an effect is forced.

Neutral data makes an effect work without any bit of the image changing: coefficients of 0, levels like the first, blend
parameters below 0.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from golden.msv2_ref.quantise import GaussianWords
from golden.scenes.gaze import FoveationMap
from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS
from spec.effects import EffectPlan
from spec.records import gaussian_colour

_NOT_YET = (-1.0, 0.0, 0.0)
"""A blend plane before its band: weight 0."""


def with_sh_degree(words: GaussianWords, degree: int) -> GaussianWords:
    """The words with colour records of `degree`: coefficients beyond are dropped, missing ones 0."""
    if degree == words.sh_degree:
        return words
    colour = np.zeros(len(words.colour), gaussian_colour(words.config, degree).dtype)
    colour["dc"] = words.colour["dc"]
    if degree and words.sh_degree:
        count = min(colour["rest"].shape[1], words.colour["rest"].shape[1])
        colour["rest"][:, :count] = words.colour["rest"][:, :count]
    return replace(words, colour=colour, sh_degree=degree)


def prepare(
    plan: EffectPlan, config: AcceleratorConfig, words: GaussianWords, foveation: FoveationMap,
) -> tuple[GaussianWords, FoveationMap]:
    """Words and tiles of a frame for `plan.machine(config)`.

    Args:
        plan: the effects.
        config: the machine that has them all; its levels are those in use where levels are forced.
        words: the Gaussians.
        foveation: of the frame.
    """
    words = with_sh_degree(words, min(plan.sh_degree, config.sh_degree))
    if "levels" not in plan.active:
        return replace(words, levels=1), foveation
    if "levels" not in plan.called:  # every level is the first: all points are in all
        words = _all_levels(words, config.levels)
        foveation = replace(foveation, levels=config.levels)
    if "blend" in plan.active and "blend" not in plan.called:
        blend = foveation.tile_level + 1 < foveation.levels
        plane = np.where(blend[..., None], _NOT_YET, foveation.plane)
        foveation = replace(foveation, blend=blend, plane=plane)
    return words, foveation


def _all_levels(words: GaussianWords, levels: int) -> GaussianWords:
    geometry, colour = words.geometry.copy(), words.colour.copy()
    geometry["log2_opacity"] = geometry["log2_opacity"][:, :1]
    geometry["bound"] = MAX_LEVELS - 1
    colour["dc"] = np.tile(colour["dc"][:, :3], (1, MAX_LEVELS))
    return replace(words, geometry=geometry, colour=colour, levels=levels)
