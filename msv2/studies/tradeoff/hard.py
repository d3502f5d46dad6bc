"""Runs the hard cases of docs/stability.md on the integer renderer with a setting's formats: finds its worst error, and which
cases break."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from golden.msv2_ref import pipeline, projection
from golden.oracle import render as oracle
from msv2.cases.case import RENDERERS, RIM, CaseFailure, Seen, Shot
from msv2.cases.check import MACHINE, album
from msv2.cases.registry import CASES
from msv2.studies.tradeoff.knobs import Setting
from spec.config import AcceleratorConfig
from spec.constants import SUPPORT_SIGMA

_GOLDEN = RENDERERS["golden"]


def machine_of(setting: Setting) -> AcceleratorConfig:
    """The configuration of the hard cases with the setting's formats."""
    config = setting.config
    return MACHINE.with_(
        name="tradeoff", formats=config.formats, support_sigma=config.support_sigma, sh_degree=config.sh_degree)


def identity(setting: Setting) -> tuple[object, ...]:
    """The parts of a setting on which the hard cases depend."""
    return machine_of(setting), setting.sh_degree, setting.obb


def hard_cases(setting: Setting) -> dict[str, object]:
    """Runs every case with shots. Returns the worst error of an image (of 255), its case, and the failing cases with reasons.

    A case fails if its expectation is not met, or if an image is farther from the float64 renderer's than its shot allows. The
    default machine is held to the same rules. However, the float64 renderer uses the setting's support radius, and the error
    that a shot allows at the rims of footprints is adapted to that radius.
    """
    broken, worst, where = {}, 0.0, ""
    for case in CASES:
        if case.shots is None or "golden" not in case.columns:
            continue
        shots = case.shots(_GOLDEN)
        try:
            seen = album(case, _GOLDEN, lambda shot: see(shot, setting))
            for name, shot in shots.items():
                if shot.rim is None:
                    continue
                top = _GOLDEN.largest_colour
                error = float(np.abs(np.minimum(seen[name].image, top)
                                     - np.minimum(_exact(case.id, name, setting.config.support_sigma), top)).max())
                if error > worst:
                    worst, where = error, case.id
                if error > rim_of(shot.rim, setting):
                    raise CaseFailure(
                        f"{name}: {255 * error:.2f}/255 off the oracle, more than {255 * rim_of(shot.rim, setting):.2f}/255")
            case.expect(seen, _GOLDEN, shots)
        except CaseFailure as failure:
            broken[case.id] = str(failure)
        except Exception as failure:  # a crash is a finding about the setting; the other cases still run
            broken[case.id] = f"{type(failure).__name__}: {failure}"
    return {"worst_error_255": 255 * worst, "worst_case": where, "broken": broken}


def see(shot: Shot, setting: Setting) -> Seen:
    """A shot, rendered by the integer renderer with a setting."""
    config, model = machine_of(setting), shot.model
    if setting.sh_degree is not None and setting.sh_degree < model.sh_degree:
        model = model.with_sh_degree(setting.sh_degree)
    frame = pipeline.render(model, shot.camera, config=config, foveation=shot.foveation, background=shot.background,
                            beta=shot.beta, obb=shot.obb or setting.obb)
    reason, n = frame.projected.reason, config.formats
    coverage = n.transmittance.to_float(n.transmittance.raw_max) - frame.transmittance
    return Seen(
        frame.image, coverage, frame.depth, int((reason == projection.NEAR).sum()), int((reason == projection.FAINT).sum()),
        len(np.unique(frame.entries.splat)), len(frame.entries.splat), np.diff(frame.entries.start), frame)


def rim_of(allowed: float, setting: Setting) -> float:
    """A shot's bound, adapted to another support radius r: an alpha of 1 is exp(-r^2 / 2) at the rim."""
    sigma = setting.config.support_sigma
    if allowed < RIM or sigma is None or sigma >= SUPPORT_SIGMA:
        return allowed
    return allowed * math.exp((SUPPORT_SIGMA**2 - sigma**2) / 2)


@cache
def _exact(case_id: str, name: str, support_sigma: float | None) -> np.ndarray:
    """The float64 renderer's image. It is cached because a process needs it for every setting."""
    shot = next(case for case in CASES if case.id == case_id).shots(_GOLDEN)[name]
    return oracle.render(shot.model, shot.camera, foveation=shot.foveation, weights=_GOLDEN.weights,
                         background=shot.background, support_sigma=support_sigma).image
