"""Cases 32 to 35: colours, thin axes, and coordinates of planetary size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from msv2.cases.case import Gradients, Renderer, Shot, Shots, close, require, scene_case
from msv2.cases.makers import splats, view
from msv2.cases.projection import closed_form
from spec.constants import SH_C1


def _negative(renderer: Renderer) -> Shots:
    model = splats((0, 0, 2), scale=1.0, opacity=0.9, colour=(-0.5, -3, 0.25))
    rest = np.zeros((1, 3, 3))
    rest[0, 1, :2] = 1.25 / SH_C1  # along z; this is beyond 2, the limit of the integer renderer's `sh_rest`
    rest[0, 1, 0] = 1.9
    return {"shot": Shot(replace(model, sh_rest=rest), view(), rim=None)}


@scene_case(
    32, "negative-colour-sum", "base colours of -0.5 and -3 that a view-dependent part of +0.93 and more is added to",
    "clamped after the sum, to 0.43 and 0: before the sum it would be 0.93 and 1.25", shots=_negative,
    gradients=(Gradients("shot", lit=(0,)),))
def NEGATIVE_COLOUR_SUM(album, renderer, shots):
    seen = album["shot"]
    # The view-dependent colour is evaluated along the direction to the splat's mean, so every pixel has the same colour.
    got = seen.image[24, 32] / seen.coverage[24, 32]
    close("colour", got, (-0.5 + 1.9 * SH_C1, 0, 0.25), max(1e-6, 2 * renderer.error))


@scene_case(
    33, "colour-above-one", "a colour of 40, 1.5 and 0.5",
    "kept by the renderers in floats; cut at the format's largest by the integer renderer, which counts it; no wrap",
    shots=lambda renderer: {"shot": Shot(splats((0, 0, 2), scale=1.0, opacity=0.9, colour=(40, 1.5, 0.5)), view(), rim=None)},
    gradients=(Gradients("shot", lit=(0,)),))
def COLOUR_ABOVE_ONE(album, renderer, shots):
    seen = album["shot"]
    got = seen.image[24, 32] / seen.coverage[24, 32]
    close("colour", got, np.minimum((40, 1.5, 0.5), renderer.largest_colour), max(1e-4, 3 * renderer.error))
    if renderer.name == "golden":
        require(seen.frame.words.saturated["dc"] == 1, f"one base colour must be counted, not {seen.frame.words.saturated}")


def _thin(renderer: Renderer) -> Shots:
    axes = {"edge on": (1e-7, 0.2, 0.2), "from above": (0.2, 1e-7, 0.2), "from the front": (0.2, 0.2, 1e-7)}
    rng = np.random.default_rng(5)
    means = np.column_stack([rng.uniform(-0.8, 0.8, (40, 2)), rng.uniform(1.5, 4, 40)])
    turned = splats(*means, scale=(0.2, 0.2, 1e-7), colour=rng.uniform(0, 1, (40, 3)), opacity=0.6)
    shots = {name: Shot(splats((0.2, 0.1, 2), scale=scale), view()) for name, scale in axes.items()}
    return {**shots, "turned": Shot(replace(turned, quats=rng.normal(size=(40, 4))), view(), rim=4 / 255)}


@scene_case(
    34, "thin-axes", "discs a millionth thick, seen edge on, from above, from the front, and forty turned at random",
    "closed form, and the oracle's image: the short formats keep the thin axis", shots=_thin,
    gradients=(Gradients("edge on", lit=(0,)), Gradients("turned", lit=tuple(range(4)))))
def THIN_AXES(album, renderer, shots):
    for name in ("edge on", "from above", "from the front"):
        closed_form(album[name], shots[name], renderer, 0.8, what=f"{name}: ")


PLANET = np.array((6.4e6, -1.2e6, 3.3e6))


def _planetary(renderer: Renderer) -> Shots:
    model = splats((0, 0, 2), (0.2, 0.1, 3), (-0.1, 0.2, 2.5), scale=0.3, colour=[(1, 0, 0), (0, 1, 0), (0, 0, 1)])
    far = {} if renderer.name == "gradient" else {
        f"{size:g} times": Shot(replace(model, means=model.means + size * PLANET), view(translation=-size * PLANET))
        for size in (1.0, 100.0)}
    return {"at the origin": Shot(model, view()), **far}


@scene_case(
    35, "planetary-coordinates", "a scene 7e6 and 7e8 units away from its coordinates' origin",
    "the frame of the same scene at the origin: the camera is subtracted before anything is narrowed", shots=_planetary,
    gradients=(Gradients("at the origin", lit=(0, 1, 2)),))
def PLANETARY_COORDINATES(album, renderer, shots):
    for name, seen in album.items():
        close(name, seen.image, album["at the origin"].image, max(1e-6, 2 * renderer.error))
        require(seen.coverage[24, 32] > 0.9, f"{name}: the splats must show")


CASES = (NEGATIVE_COLOUR_SUM, COLOUR_ABOVE_ONE, THIN_AXES, PLANETARY_COORDINATES)
