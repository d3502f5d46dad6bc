"""Cases 1 to 10: projection."""

from __future__ import annotations

import numpy as np

from msv2.cases.case import SMOOTH, Album, Gradients, Renderer, Shot, Shots, close, require, scene_case
from msv2.cases.makers import splats, view
from msv2.cases.splat import alphas

GREY = (0.5, 0.25, 0.75)


def only_background(album: Album, renderer: Renderer, shots: Shots) -> None:
    """Checks that nothing is drawn in any shot."""
    for name, seen in album.items():
        close(f"{name}: image", seen.image, np.broadcast_to(shots[name].background, seen.image.shape), renderer.error)
        require(seen.coverage is None or not seen.coverage.any(), f"{name}: nothing must be covered")


def closed_form(seen, shot: Shot, renderer: Renderer, opacity: float, mean=None, scale=None, what: str = "") -> None:
    """Checks that the coverage of a single splat is that of the closed form, wherever that is certain."""
    mean = shot.model.means[0] if mean is None else mean
    scale = np.exp(shot.model.log_scales[0]) if scale is None else scale
    wanted, sure = alphas(shot.camera, mean, scale, opacity)
    close(f"{what}coverage", np.where(sure, seen.coverage, wanted), wanted, renderer.error)


def _behind(name: str, *means: tuple[float, float, float], **options: object):
    def shots(renderer: Renderer) -> Shots:
        return {name: Shot(splats(*means, **options), view(), background=GREY, empty=True)}
    return shots


@scene_case(
    1, "point-at-the-camera", "points at the camera's centre and a thousandth beside it",
    "culled as near and counted, before anything is divided; background everywhere",
    shots=_behind("shot", (0, 0, 0), (1e-3, 0, 0)), gradients=(Gradients("shot", zero=(0, 1)),))
def AT_THE_CAMERA(album, renderer, shots):
    album["shot"].counts(near=2, entries=0)
    only_background(album, renderer, shots)


@scene_case(
    2, "depth-near-zero", "depths of +-1e-300, +-1e-9 and 0.1 in front of a near plane of 0.2",
    "culled as near and counted, before anything is divided; background everywhere",
    shots=_behind("shot", (0, 0, 1e-300), (0, 0, -1e-300), (1e-3, 0, 1e-9), (0, 1e-3, -1e-9), (0, 0, 0.1)),
    gradients=(Gradients("shot", zero=(0, 1, 2, 3, 4)),))
def DEPTH_NEAR_ZERO(album, renderer, shots):
    album["shot"].counts(near=5, entries=0)
    only_background(album, renderer, shots)


def _near_shots(renderer: Renderer) -> Shots:
    near = 0.25
    step = near * renderer.ulp
    model = splats((0, 0, near - step), (0, 0, near), (0, 0, near + step), scale=2e-3, opacity=0.9,
                   colour=[(1, 0, 0), (1, 0, 0), (0, 1, 0)])
    return {"shot": Shot(model, view(near=near), rim=None)}


@scene_case(
    3, "near-plane-ulp", "points at the near plane and an ulp of the renderer's depths to either side",
    "the one an ulp behind is drawn, the other two are culled and counted", shots=_near_shots,
    gradients=(Gradients("shot", zero=(0, 1), lit=(2,), compared=SMOOTH),))
def NEAR_PLANE(album, renderer, shots):
    seen = album["shot"]
    seen.counts(near=2, drawn=1)
    require(not seen.image[..., 0].any(), "what is culled must not show")
    centred = 0.9 * np.exp(-0.5 * 0.5 / ((50 * 2e-3 / 0.25) ** 2 + 0.3))
    close("green next to the centre", seen.image[24, 32, 1], centred, renderer.error)


@scene_case(
    4, "huge-behind-the-camera", "splats 1 and 1e6 behind the camera, with axes of 1e5",
    "culled as near, in spite of an extent that reaches in front",
    shots=_behind("shot", (0, 0, -1), (0, 0, -1e6), scale=1e5), gradients=(Gradients("shot", zero=(0, 1)),))
def BEHIND_THE_CAMERA(album, renderer, shots):
    album["shot"].counts(near=2, entries=0)
    only_background(album, renderer, shots)


def _far_outside(renderer: Renderer) -> Shots:
    def shot(*means: tuple[float, float, float]) -> Shot:
        return Shot(splats(*means, (0, 0, 1), (0.2, 0.1, 1), (-0.2, 0.1, 1), (0.1, -0.2, 1)), view())
    return {"alone": shot(), **{f"x {x:g}": shot((x, 0, 1), (0, -x, 1)) for x in (1e3, 1e12, 1e30)}}


@scene_case(
    5, "mean-far-outside", "means 1e3, 1e12 and 1e30 beside and above the frustum, at depth 1",
    "not drawn, and the splats in view look as if those were not there", shots=_far_outside,
    gradients=(Gradients("x 1000", zero=(0, 1), lit=(2,)), Gradients("x 1e+30", zero=(0, 1), lit=(2,), compared=())))
def FAR_OUTSIDE(album, renderer, shots):
    for name, seen in album.items():
        seen.counts(drawn=4)
        close(f"{name}: image", seen.image, album["alone"].image, 2 * renderer.error)


def _needles(renderer: Renderer) -> Shots:
    margin = 1.3 * 32 / 50
    return {f"{side * share:+g}": Shot(
        splats((side * share * margin * 2, 0.01, 2), scale=(1e-9, 1e-9, 0.875), opacity=0.9), view())
        for side in (1, -1) for share in (0.5, 0.999, 1.5)}


@scene_case(
    6, "needle-at-the-frustum", "needles along z at 0.5, 0.999 and 1.5 times the margin of the Jacobian's clamp, to both sides",
    "the clamp is the identity inside, and holds the needle's length outside: coverage in closed form", shots=_needles,
    gradients=(Gradients("+0.999", lit=(0,), moved=(0,)), Gradients("-1.5", lit=(0,), moved=(0,))))
def NEEDLE_AT_THE_FRUSTUM(album, renderer, shots):
    for name, seen in album.items():
        closed_form(seen, shots[name], renderer, 0.9, what=f"{name}: ")
    require(0.15 < album["+1.5"].at(63, 24) < 0.2, "the clamped needle must fade to 0.17 at the frame's edge")


def _principal_points(renderer: Renderer) -> Shots:
    model = splats((0.1, -0.1, 2), (-0.2, 0.1, 3))
    return {"centred": Shot(model, view()), "a tile": Shot(model, view(cx=48.0)), "odd": Shot(model, view(cx=39.0, cy=19.0))}


@scene_case(
    7, "principal-point", "the principal point off the centre, by a tile and by 7 and -5 pixels", "the image moves along",
    shots=_principal_points, gradients=(Gradients("odd", lit=(0, 1), moved=(0, 1)),))
def PRINCIPAL_POINT(album, renderer, shots):
    centred = album["centred"]
    close("moved by a tile", album["a tile"].image[:, 16:], centred.image[:, :-16], renderer.error)
    close("moved by 7, -5", album["odd"].image[3:36, 17:57], centred.image[8:41, 10:50], 2 * renderer.error)
    require(centred.coverage[8:41, 10:50].max() > 0.7, "the splats must show")


@scene_case(
    8, "fills-the-screen", "a splat of a thousand pixels' radius before the camera",
    "in every tile's list once; coverage in closed form", gradients=(Gradients("shot", lit=(0,)),),
    shots=lambda renderer: {"shot": Shot(splats((0, 0, 5), scale=100), view())})
def FILLS_THE_SCREEN(album, renderer, shots):
    seen = album["shot"]
    require(seen.tile_intersections is None or (seen.tile_intersections == 1).all(), "every tile must list the splat once")
    closed_form(seen, shots["shot"], renderer, 0.8)


def _giants(renderer: Renderer) -> Shots:
    scales = {"needle": (1e4, 1e-6, 1e-6), "giant": (1e7, 1e7, 1e7), "edge on": (1e6, 1e-9, 1e6)}
    return {**{name: Shot(splats((0, 0.01, 2), scale=scale), view()) for name, scale in scales.items()},
            "edge on, near": Shot(splats((0, 0, 0.21), scale=(1e6, 1e-9, 1e6)), view())}


@scene_case(
    9, "needles-and-giants", "a needle 1e4 long and 1e-6 wide, a ball of 1e7, discs of 1e6 seen edge on",
    "coverage in closed form; the footprint is bounded by the frame and wraps nowhere", shots=_giants,
    gradients=(Gradients("needle", lit=(0,)), Gradients("giant", lit=(0,), compared=())))
def NEEDLES_AND_GIANTS(album, renderer, shots):
    for name, seen in album.items():
        if renderer.name != "gradient" or name == "needle":
            closed_form(seen, shots[name], renderer, 0.8, what=f"{name}: ")
    require(album["needle"].entries in (None, 4), f"the needle crosses 4 tiles, not {album['needle'].entries}")


@scene_case(
    10, "centre-outside", "a ball whose centre lies 43 pixels left of the frame", "what reaches in is drawn: closed form",
    shots=lambda renderer: {"shot": Shot(splats((-3, 0, 2), scale=1.0), view())},
    gradients=(Gradients("shot", lit=(0,), moved=(0,)),))
def CENTRE_OUTSIDE(album, renderer, shots):
    closed_form(album["shot"], shots["shot"], renderer, 0.8)
    require(album["shot"].at(0, 24) > 0.1, "the ball must reach into the frame")


CASES = (AT_THE_CAMERA, DEPTH_NEAR_ZERO, NEAR_PLANE, BEHIND_THE_CAMERA, FAR_OUTSIDE, NEEDLE_AT_THE_FRUSTUM, PRINCIPAL_POINT,
         FILLS_THE_SCREEN, NEEDLES_AND_GIANTS, CENTRE_OUTSIDE)
