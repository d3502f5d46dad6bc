"""The hard cases on the differentiable renderer: expected images, finite gradients, and gradients that agree with the oracle.

    python -m msv2.cases.gradients [CASE ...] [--faults]    writes JSON of all cases, or of the named ones

The directional derivatives of a weighted sum of the image are compared with finite differences of the float64 oracle.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch

from golden.diff.blend_cpu import Blending
from golden.diff.gaussians import Gaussians, from_model
from golden.diff.pairs import tile_lists
from golden.diff.render import render, render_foveated
from golden.scenes.conventions import logit, sigmoid
from golden.scenes.model import GaussianModel
from msv2.cases.case import GRADIENT, Case, Gradients, Seen, Shot, require
from msv2.cases.check import Cell, check_shots, see_oracle, told_cell
from msv2.cases.golden_faults import Fault, replaced, told
from msv2.cases.registry import CASES, case_named
from spec.command_line import command_parser
from spec.constants import ALPHA_MAX_L1, COVERAGE_VALID, SH_C0

STEPS = {"sh_dc": 1e-4, "opacity": 1e-8, "means": 1e-9, "log_scales": 1e-8, "quats": 1e-8}
"""Half the step of a finite difference, by field; for opacities a step of the logit. The steps are so small that hardly a pixel
crosses a cut within them."""

KINK = 1e-3
"""Colours nearer than this to 0, where they are clamped, are left out of finite differences."""

TOLERANCE = 2e-3
"""Tolerance of a directional derivative relative to the sum of its terms' magnitudes, for float32 against float64."""

OPAQUE = 0.999
"""Opacities above this value have no usable logit and are left out of finite differences."""


def level_of(model: GaussianModel, level: int) -> Gaussians:
    """The Gaussians of a level, counted from 0."""
    rows = model.quality_bound > level
    shown = replace(model.select(rows), opacity=model.opacity[rows, level : level + 1],
                    sh_dc=model.sh_dc[rows, level : level + 1], quality_bound=np.ones(rows.sum(), np.uint8))
    return from_model(shown)


def trainable(gaussians: Gaussians) -> Gaussians:
    """The Gaussians with gradients enabled in every field."""
    return gaussians.map(lambda tensor: tensor.detach().clone().requires_grad_(True))


def draw(shot: Shot) -> tuple[Seen, list[Gaussians], torch.Tensor]:
    """Renders a shot with the differentiable renderer. Returns the result, the Gaussians of each level, and the image
    tensor."""
    if shot.gaze is not None:
        levels = [trainable(level_of(shot.model, level)) for level in range(shot.model.levels)]
        image = render_foveated(levels, shot.camera, shot.foveation, background=shot.background)
        return Seen(image.detach().double().numpy(), *[None] * 7), levels, image
    gaussians = trainable(level_of(shot.model, 1 if shot.outer else 0))
    shown = render(gaussians, shot.camera, alpha_max=1.0 if shot.outer else ALPHA_MAX_L1, background=shot.background)
    coverage = 1 - shown.transmittance.detach().double().numpy()
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(coverage >= COVERAGE_VALID, shown.depth_sum.detach().double().numpy() / coverage, np.nan)
    seen = Seen(shown.image.detach().double().numpy(), coverage, depth, None, None, None, None, None, shown)
    return seen, [gaussians], shown.image


def see_gradient(shot: Shot) -> Seen:
    """Renders a shot with the differentiable renderer."""
    return draw(shot)[0]


def weights_of(shot: Shot) -> np.ndarray:
    """(H, W, 3) float64 weights of the loss, positive and negative."""
    return np.random.default_rng(1).normal(size=(shot.camera.height, shot.camera.width, 3))


def check_gradients(case: Case, wanted: Gradients) -> None:
    """Raises CaseFailure where a gradient is not finite, not as the case expects, or does not agree with the oracle."""
    shot = case.shots(GRADIENT)[wanted.shot]
    _, levels, image = draw(shot)
    (image * torch.from_numpy(weights_of(shot)).float()).sum().backward()
    for gaussians in levels:
        for name, tensor in gaussians.tensors().items():
            finite = tensor.grad is not None and torch.isfinite(tensor.grad).all()
            require(finite, f"{wanted.shot}: {name} must have finite gradients")
    grads = {name: tensor.grad.double().numpy() for name, tensor in levels[0].tensors().items()}
    for row in wanted.zero:
        still = all((grad[row] == 0).all() for grad in grads.values())
        require(still, f"{wanted.shot}: row {row} must have no gradient")
    for rows, name in ((wanted.lit, "sh_dc"), (wanted.moved, "means")):
        for row in rows:
            require((grads[name][row] != 0).any(), f"{wanted.shot}: row {row} must have a gradient of {name}")
    for name in wanted.compared:
        _compare(shot, grads, name, STEPS[name])


def _changed(shot: Shot, name: str, change: np.ndarray) -> Shot:
    """The shot with a field of its model changed by `change`; opacities are changed as logits."""
    level = 1 if shot.outer else 0
    values = getattr(shot.model, name)
    if name == "opacity":
        moved = sigmoid(logit(np.minimum(values[:, level], OPAQUE)) + change)
        plain = np.where(values[:, level] < OPAQUE, moved, values[:, level])
        values = np.where(np.arange(values.shape[1]) == level, plain[:, None], values)
    elif name == "sh_dc":
        values = values + np.where(np.arange(values.shape[1]) == level, 1.0, 0.0)[:, None] * change[:, None]
    else:
        values = values + change
    return replace(shot, model=replace(shot.model, **{name: values}))


def _compare(shot: Shot, grads: dict[str, np.ndarray], name: str, step: float) -> None:
    """Raises CaseFailure where the derivative along a random direction differs from the oracle's finite difference."""
    direction, level = np.random.default_rng(2).normal(size=grads[name].shape), 1 if shot.outer else 0
    if name == "opacity":
        direction = np.where(shot.model.opacity[:, level] < OPAQUE, direction, 0.0)
    if name == "sh_dc":  # the clamp at 0 is a kink
        direction = np.where(np.abs(SH_C0 * shot.model.sh_dc[:, level] + 0.5) > KINK, direction, 0.0)
    images = [see_oracle(_changed(shot, name, sign * step * direction)).image for sign in (1, -1)]
    losses = [float((image * weights_of(shot)).sum()) for image in images]
    numeric, terms = (losses[0] - losses[1]) / (2 * step), grads[name] * direction
    error, scale = abs(float(terms.sum()) - numeric), float(np.abs(terms).sum())
    require(error <= TOLERANCE * max(scale, 1e-2), f"the derivative along {name} must be {numeric:.6g}, not {terms.sum():.6g}")


def run(case: Case) -> float | None:
    """Runs a case. Returns the largest difference of an image to the oracle's; raises CaseFailure where an expectation
    fails."""
    worst = check_shots(case, GRADIENT, see_gradient)
    for wanted in case.gradients:
        check_gradients(case, wanted)
    return worst


def takes_part(case: Case) -> bool:
    """Whether the case is run on the differentiable renderer."""
    return case.shots is not None and "gradient" in case.columns


def cell(case: Case) -> Cell:
    """Runs a case; a failure is returned instead of raised."""
    if not takes_part(case):
        return Cell("-", words=case.absent.get("gradient", "no part in it"))
    return told_cell(lambda: run(case))


def _spoilt(change: Callable[[Blending, list[np.ndarray]], None]) -> Callable[[], AbstractContextManager]:
    """A context in which `change` modifies the gradients of mean2d, factor, opacity, colour and depth that blending returns."""
    original = Blending.backward

    def backward(blending: Blending, *asked: np.ndarray, **options: bool) -> tuple[np.ndarray, ...]:
        results = list(original(blending, *asked, **options))
        change(blending, results)
        return tuple(results)
    return replaced(("golden.diff.blend_cpu.Blending.backward", backward))


def _divided(blending: Blending, results: list[np.ndarray]) -> None:
    with np.errstate(all="ignore"):
        results[2] /= np.float32(blending.transmittance.min())


def _forgotten(blending: Blending, results: list[np.ndarray]) -> None:
    results[2][:] = 0


def _leaking(blending: Blending, results: list[np.ndarray]) -> None:
    results[3][:] += 1e-3


def _backwards(*lists: object) -> object:
    return tile_lists(*lists[:3], 1 / lists[3], *lists[4:])


FAULTS = (
    Fault("a division by what is left of the light", "gradient", "alpha-one-backward", _spoilt(_divided)),
    Fault("no gradient of the opacity", "gradient", "centre-outside", _spoilt(_forgotten)),
    Fault("a gradient for what is hidden", "gradient", "opaque-against-the-stop", _spoilt(_leaking)),
    Fault("back to front", "gradient", "equal-depths", replaced(("golden.diff.render.tile_lists", _backwards))),
    Fault("alpha may be 1 at level 1", "gradient", "opaque-against-the-stop",
          replaced((f"{__name__}.ALPHA_MAX_L1", 1.0))),
)
"""The faults of the differentiable renderer."""


def caught(fault: Fault) -> tuple[bool, str]:
    """Whether the fault makes its case fail, and the failure's message."""
    with fault.drop():
        got = cell(case_named(fault.case))
    return told(got), got.words or f"{fault.case} does not notice"


def _told_fault(fault: Fault) -> dict[str, object]:
    seen, words = caught(fault)
    return {"name": fault.name, "column": fault.column, "case": fault.case, "caught": seen, "words": words}


def main(argv: Sequence[str] | None = None) -> None:
    """Runs the command line."""
    parser = command_parser("python -m msv2.cases.gradients", __doc__)
    parser.add_argument("cases", nargs="*", metavar="CASE", help="ids of cases (default: all)")
    parser.add_argument("--faults", action="store_true", help="also run the seeded faults")
    parser.add_argument("--json", metavar="FILE", help="write the results to this file instead of the screen")
    args = parser.parse_args(argv)
    torch.set_num_threads(1)
    chosen = [case for case in CASES if not args.cases or case.id in args.cases]
    found = {"cells": {case.id: asdict(cell(case)) for case in chosen},
             "faults": [_told_fault(fault) for fault in FAULTS] if args.faults else []}
    text = json.dumps(found)
    if args.json:
        Path(args.json).write_text(text)
    else:
        print(text)


if __name__ == "__main__":
    main()
