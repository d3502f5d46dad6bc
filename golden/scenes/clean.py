"""Turns the fields that a reader found in a file into a model: checks them, and drops and counts splats that cannot be
drawn."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from golden.scenes.model import GaussianModel
from spec.errors import InputError

MAX_LOG_SCALE = float(np.log(np.finfo(np.float32).max))  # beyond it a standard deviation is infinite in every 3DGS renderer
CHECKED_SPLATS = 100  # `check_not_activated` judges a single field by its range only if the file has this many splats


@dataclass(frozen=True)
class Fields:
    """What the reader of a format returns, in the model's units and shapes (see GaussianModel), not yet checked."""

    means: np.ndarray
    log_scales: np.ndarray
    quats: np.ndarray
    opacity: np.ndarray
    sh_dc: np.ndarray
    sh_rest: np.ndarray
    quality_bound: np.ndarray | None = None


def build_model(
    fields: Fields, *, path: Path, name: str, up: tuple[float, float, float] | np.ndarray, up_source: str = "given",
) -> GaussianModel:
    """The model of a file's fields, without the splats that no renderer can draw.

    A splat is dropped when a field holds a NaN, when its position, rotation, scale or colour is infinite, or when its
    quaternion is zero and so cannot be normalised. It is counted in `dropped` under the first reason that applies. A log scale
    of -inf is a degenerate axis and is kept. An infinite opacity logit has become an opacity of 0 or 1 and is kept.

    Args:
        fields: the file's fields.
        path: the file, for messages.
        name: the model's name.
        up: (3,) the scene's up direction in world axes.
        up_source: how it is known; see GaussianModel.

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
        up_source=up_source,
    )
    return model if keep.all() else model.select(keep)


def concatenate(models: list[GaussianModel], name: str) -> GaussianModel:
    """One model made of several: points in the order of the list, counts of dropped points added, up taken from the largest
    model.

    Raises:
        InputError: the models differ in SH degree or in number of levels.
    """
    for key in ("sh_degree", "levels"):
        values = [getattr(model, key) for model in models]
        if len(set(values)) > 1:
            raise InputError(f"{name}: the parts have {key} {values}; all must have the same")
    arrays = ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound")
    reasons = dict.fromkeys(reason for model in models for reason in model.dropped)
    return GaussianModel(
        **{array: np.concatenate([getattr(model, array) for model in models]) for array in arrays},
        up=max(models, key=len).up, up_source=max(models, key=len).up_source, name=name,
        dropped={reason: sum(model.dropped.get(reason, 0) for model in models) for reason in reasons},
    )


def _usable(fields: Fields) -> tuple[np.ndarray, dict[str, int]]:
    """Mask (N,) of the splats to keep, and the number of dropped splats by reason."""
    groups = {
        "position": [fields.means], "scale": [fields.log_scales], "rotation": [fields.quats],
        "colour": [fields.sh_dc, fields.sh_rest],
    }
    bad = {f"nan {name}": _any(np.isnan, arrays) for name, arrays in (groups | {"opacity": [fields.opacity]}).items()}
    for name, arrays in groups.items():
        # a log scale may be -inf, and one whose exponential overflows counts as infinite
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
    """(N,) bool: whether any number of the splat, in any of the arrays, passes the test."""
    return np.any([test(array).reshape(len(array), math.prod(array.shape[1:])).any(axis=1) for array in arrays], axis=0)


def check_not_activated(path: Path, logits: np.ndarray, log_scales: np.ndarray) -> None:
    """Refuses a file that stores opacities and scales as they are rendered instead of as logits and logs.

    Rendered opacities lie within 0..1 and rendered scales above 0. If such numbers were a logit and a log, every splat would be
    50 to 73 % opaque and longer than one unit along every axis, and no training ends like that. If only one of the two fields
    looks activated, the file is refused only when it has at least CHECKED_SPLATS splats whose values use the range: opacities
    from nearly 0 to nearly 1, where trained logits span -5 to +10; or scales within 0..1 that span more than a decade, where
    logs would make all splats the same size within a factor of e. Scales that are merely all above 0 mean a scene in
    millimetres, and equal opacities mean a fresh or synthetic model: both are accepted.

    Args:
        path: the file, for messages.
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
