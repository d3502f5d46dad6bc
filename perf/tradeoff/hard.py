"""The hard cases of docs/stability.md by the integer renderer, at a setting's formats: its worst error, and what breaks."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from golden.msv2_ref import culling, pipeline
from golden.stability.case import RENDERERS, CaseFailure, Seen, Shot
from golden.stability.check import MACHINE, album, see_oracle
from golden.stability.registry import CASES
from perf.tradeoff.knobs import Setting
from spec.config import AcceleratorConfig

SOURCES = ("spec/*.py", "golden/msv2_ref/*.py", "golden/oracle/*.py", "golden/stability/*.py", "golden/scenes/*.py",
           "perf/tradeoff/hard.py")
"""What these results are made of."""

_GOLDEN = RENDERERS["golden"]


def machine_of(setting: Setting) -> AcceleratorConfig:
    """The machine of the hard cases with the setting's numbers."""
    return MACHINE.with_(name="tradeoff", formats=setting.config.formats, support_sigma=setting.config.support_sigma)


def identity(setting: Setting) -> tuple[object, ...]:
    """What of a setting the hard cases depend on."""
    return machine_of(setting), setting.sh_degree, setting.obb


def hard_cases(setting: Setting) -> dict[str, object]:
    """Every case with shots: the worst error of an image (of 255) and its case, and what fails, with the reason.

    A case fails where what it expects does not come, or where an image is farther from the float64 renderer's than the shot
    allows. Both are what the default machine is held to.
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
                                     - np.minimum(_exact(case.id, name), top)).max())
                if error > worst:
                    worst, where = error, case.id
                if error > shot.rim:
                    raise CaseFailure(f"{name}: {255 * error:.2f}/255 off the oracle, more than {255 * shot.rim:.2f}/255")
            case.expect(seen, _GOLDEN, shots)
        except CaseFailure as failure:
            broken[case.id] = str(failure)
        except Exception as failure:  # a crash of a setting is a finding about it, and the other cases still run
            broken[case.id] = f"{type(failure).__name__}: {failure}"
    return {"worst_error_255": 255 * worst, "worst_case": where, "broken": broken}


def see(shot: Shot, setting: Setting) -> Seen:
    """A shot by the integer renderer at a setting."""
    config, model = machine_of(setting), shot.model
    if setting.sh_degree is not None and setting.sh_degree < model.sh_degree:
        model = model.with_sh_degree(setting.sh_degree)
    frame = pipeline.render(model, shot.camera, config=config, foveation=shot.foveation, background=shot.background,
                            beta=shot.beta, obb=shot.obb or setting.obb)
    reason, n = frame.projected.reason, config.formats
    coverage = n.transmittance.to_float(n.transmittance.raw_max) - frame.transmittance
    return Seen(
        frame.image, coverage, frame.depth, int((reason == culling.NEAR).sum()), int((reason == culling.FAINT).sum()),
        len(np.unique(frame.entries.splat)), len(frame.entries.splat), np.diff(frame.entries.start), frame)


@cache
def _exact(case_id: str, shot: str) -> np.ndarray:
    """The float64 renderer's image; one process asks for it at every setting."""
    case = next(case for case in CASES if case.id == case_id)
    return see_oracle(replace(case.shots(_GOLDEN)[shot]), _GOLDEN.weights).image
