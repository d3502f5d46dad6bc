"""From a file's fields to a model: checks, counted drops, one set of units."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from golden.scenes.model import GaussianModel
from spec.errors import InputError

MAX_LOG_SCALE = float(np.log(np.finfo(np.float32).max))  # beyond it a standard deviation is infinite in every 3DGS renderer
CHECKED_SPLATS = 100  # the one-field checks below need a population; a handful of splats may have any values


@dataclass(frozen=True)
class Fields:
    """What a format's reader returns, in the model's units and shapes (see GaussianModel), not yet checked."""

    means: np.ndarray
    log_scales: np.ndarray
    quats: np.ndarray
    opacity: np.ndarray
    sh_dc: np.ndarray
    sh_rest: np.ndarray
    quality_bound: np.ndarray | None = None


def build_model(fields: Fields, *, path: Path, name: str, up: tuple[float, float, float] | np.ndarray) -> GaussianModel:
    """The model of a file's fields, without the splats no renderer can draw.

    A splat is dropped, and counted in `dropped` under the first reason that applies, when a field holds a NaN, when its
    position, rotation, scale or colour is infinite, or when its quaternion is zero (nothing to normalise). A log scale of -inf
    is a degenerate axis and stays; an infinite opacity logit has become 0 or 1 and stays.

    Raises:
        InputError: no splat is left.
    """
    keep, dropped = _usable(fields)
    if not keep.any():
        reasons = ", ".join(f"{count} {reason}" for reason, count in dropped.items()) or "the file holds 0"
        raise InputError(f"{path}: no usable splat ({reasons}); at least one is needed")
    bound = fields.quality_bound
    if bound is None:
        bound = np.ones(len(keep), np.uint8)
    model = GaussianModel(
        means=fields.means, log_scales=fields.log_scales, quats=fields.quats, opacity=fields.opacity, sh_dc=fields.sh_dc,
        sh_rest=fields.sh_rest, quality_bound=bound, up=np.asarray(up, np.float64), name=name, dropped=dropped,
    )
    return model if keep.all() else model.select(keep)


def concatenate(models: list[GaussianModel], name: str) -> GaussianModel:
    """One model of several, points in the order of the list, counts of dropped points added, up by the largest part.

    Raises:
        InputError: the parts differ in SH degree or in number of levels.
    """
    for key in ("sh_degree", "levels"):
        values = [getattr(model, key) for model in models]
        if len(set(values)) > 1:
            raise InputError(f"{name}: parts have {key} {values}; one and the same is accepted")
    arrays = ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound")
    reasons = dict.fromkeys(reason for model in models for reason in model.dropped)
    return GaussianModel(
        **{array: np.concatenate([getattr(model, array) for model in models]) for array in arrays},
        up=max(models, key=len).up, name=name,
        dropped={reason: sum(model.dropped.get(reason, 0) for model in models) for reason in reasons},
    )


def _usable(fields: Fields) -> tuple[np.ndarray, dict[str, int]]:
    """Mask (N,) of the splats to keep, and how many are dropped by reason."""
    groups = {
        "position": [fields.means], "scale": [fields.log_scales], "rotation": [fields.quats],
        "colour": [fields.sh_dc, fields.sh_rest],
    }
    bad = {f"nan {name}": _any(np.isnan, arrays) for name, arrays in (groups | {"opacity": [fields.opacity]}).items()}
    for name, arrays in groups.items():
        # a log scale may be -inf, and one whose exponential overflows is as infinite as +inf
        bad[f"infinite {name}"] = _any((lambda x: x > MAX_LOG_SCALE) if name == "scale" else np.isinf, arrays)
    bad["zero rotation"] = (fields.quats == 0).all(axis=1)

    keep, dropped = np.ones(len(fields.means), bool), {}
    for reason, mask in bad.items():
        count = int(np.count_nonzero(keep & mask))
        if count:
            dropped[reason] = count
        keep &= ~mask
    return keep, dropped


def _any(test: Callable[[np.ndarray], np.ndarray], arrays: list[np.ndarray]) -> np.ndarray:
    """(N,) whether any number of a splat in any of the arrays passes the test."""
    return np.any([test(array).reshape(len(array), math.prod(array.shape[1:])).any(axis=1) for array in arrays], axis=0)


def check_not_activated(path: Path, logits: np.ndarray, log_scales: np.ndarray) -> None:
    """Refuse a file that stores opacities and scales as they are rendered, where their logits and logs belong.

    Opacities lie within 0..1 and scales above 0. As a logit and a log, that would be a model whose every splat is 50 to 73 %
    opaque and longer than one unit along every axis: no training ends so. One of the two alone is suspect only when it also
    uses its range in a population of splats: opacities from nearly 0 to nearly 1 where trained logits span -5 to +10,
    or scales within 0..1 over more than a decade, where the logs would make every splat the same size within a factor of e.
    Scales above 0 alone are a scene in millimetres, equal opacities a fresh or synthetic model: both pass.

    Args:
        logits: (N,) what the file calls opacity.
        log_scales: (N, 3) what the file calls scale.

    Raises:
        InputError: the values are activated already.
    """
    logits, scales = logits[~np.isnan(logits)], log_scales[~np.isnan(log_scales)]
    if not logits.size or not scales.size:
        return
    population = len(logits) >= CHECKED_SPLATS
    unit_opacity = logits.min() >= 0 and logits.max() <= 1
    positive_scale = scales.min() > 0
    if unit_opacity and (positive_scale or (population and logits.min() < 0.1 and logits.max() > 0.9)):
        raise InputError(
            f"{path}: opacities lie within {logits.min():.4g}..{logits.max():.4g}, so they look activated already; "
            "logits are accepted (3DGS stores logit(opacity) and log(scale))"
        )
    if positive_scale and population and scales.max() <= 1 and scales.max() > 10 * scales.min():
        raise InputError(
            f"{path}: scales lie within {scales.min():.4g}..{scales.max():.4g}, so they look activated already; "
            "natural logs are accepted (3DGS stores logit(opacity) and log(scale))"
        )
