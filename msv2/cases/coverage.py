"""Cases 11 to 20: covariances and alphas."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from msv2.cases.case import Gradients, Renderer, Shot, Shots, close, require, scene_case
from msv2.cases.makers import splats, view
from msv2.cases.projection import closed_form
from msv2.cases.splat import alphas, exponents
from spec.constants import ALPHA_MIN, SUPPORT_SIGMA

ON_A_PIXEL = ((32.5 - 32) / 50 * 2, (24.5 - 24) / 50 * 2, 2)
"""A mean that projects onto the centre of pixel (32, 24) of `view()`."""

AXES = {"one axis": (0, 0.1, 0.1), "two axes": (0, 0, 0.1), "another two": (0, 0.1, 0), "all axes": (0, 0, 0)}


@scene_case(
    11, "degenerate-axes", "scales of exactly 0 (a log scale of -inf) in one, two and three axes",
    "the splat stays, no narrower than the low-pass filter: closed form",
    shots=lambda renderer: {name: Shot(splats((0, 0, 2), scale=axes), view()) for name, axes in AXES.items()},
    gradients=(Gradients("one axis", lit=(0,), compared=()), Gradients("all axes", lit=(0,), compared=())))
def DEGENERATE_AXES(album, renderer, shots):
    for name, seen in album.items():
        closed_form(seen, shots[name], renderer, 0.8, what=f"{name}: ")
        require(seen.coverage.any(), f"{name}: the splat must show")


def _long_needles(renderer: Renderer) -> Shots:
    diagonal = (np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8))
    needles = {f"{length:g} long": Shot(splats(ON_A_PIXEL, scale=(length, 1e-9, 1e-9), quat=diagonal), view())
               for length in (1.0, 100.0, 1.2e4)}
    return {**needles, "dot": Shot(splats((0, 0, 1e4), scale=1e-11), view())}


@scene_case(
    12, "determinant", "needles along the diagonal, whose xx yy - xy^2 cancels in any format, and a dot of 1e-11 at 1e4",
    "the minor axis is the low-pass filter's, along and across the needle", shots=_long_needles,
    gradients=(Gradients("100 long", lit=(0,)), Gradients("12000 long", lit=(0,), compared=()), Gradients("dot", lit=(0,))))
def DETERMINANT(album, renderer, shots):
    closed_form(album["dot"], shots["dot"], renderer, 0.8, what="dot: ")
    for name in list(album)[:-1]:
        across = [album[name].at(32 - k, 24 + k) for k in (-1, 0, 1)]
        wanted = [0.8 * np.exp(-k * k / 0.3) for k in (-1, 0, 1)]
        within = 3 * renderer.error if renderer.name != "gradient" else 2e-3  # float32 offsets times a steep falloff
        close(f"{name}: coverage across", across, wanted, within)
        length = 25 * np.exp(shots[name].model.log_scales[0, 0])
        along = 0.8 * np.exp(-0.5 * 10**2 * 2 / (length**2 + 0.3))
        close(f"{name}: coverage along", [album[name].at(32 + k, 24 + k) for k in (-10, 10)], [along, along], within)


def _random_splats(renderer: Renderer) -> Shots:
    rng, shots = np.random.default_rng(1), {}
    for n in range(10):
        model = splats((*rng.uniform(-0.4, 0.4, 2), 2.0), scale=[10 ** rng.uniform(-8, 6, 3)], opacity=0.6)
        shots[f"splat {n}"] = Shot(replace(model, quats=rng.normal(size=(1, 4))), view(32, 32), rim=None)
    return shots


@scene_case(
    13, "exponent-not-positive", "single splats with axes of 1e-8 to 1e6, turned at random",
    "no coverage above the opacity: rounding never makes the falloff's exponent positive", shots=_random_splats,
    gradients=(Gradients("splat 3", compared=()),))
def EXPONENT_NOT_POSITIVE(album, renderer, shots):
    for name, seen in album.items():
        require(seen.coverage.max() <= 0.6 + renderer.error, f"{name}: coverage of {seen.coverage.max():.6f} above the opacity")
    require(max(seen.coverage.max() for seen in album.values()) > 0.55, "some splat must show nearly all of its opacity")


def _faint(renderer: Renderer) -> Shots:
    below = ALPHA_MIN * 2.0**-0.01
    return {"above": Shot(splats(ON_A_PIXEL, opacity=ALPHA_MIN * 2**0.01), view()),
            "below": Shot(splats(ON_A_PIXEL, ON_A_PIXEL, ON_A_PIXEL, opacity=[below, 0.0, 1e-300]), view(), empty=True)}


@scene_case(
    14, "opacity-below-the-cut", "opacities a hundredth of an octave to either side of 1/255, of 0 and of 1e-300",
    "above, one pixel shows it; below, culled as faint and counted, and no logarithm of 0", shots=_faint,
    gradients=(Gradients("above", lit=(0,)), Gradients("below", zero=(0, 1, 2))))
def OPACITY_BELOW_THE_CUT(album, renderer, shots):
    above, below = album["above"].coverage, album["below"]
    below.counts(faint=3, entries=0)
    require(not below.coverage.any(), "what is below the cut must not show")
    require(np.argwhere(above > 0).tolist() == [[24, 32]], f"{(above > 0).sum()} pixels show what lies above the cut, not one")
    close("coverage above", above[24, 32], ALPHA_MIN * 2**0.01, max(renderer.error / 4, 1e-9))


@scene_case(
    15, "alpha-at-the-cut", "an opacity of exactly 1/255, centred on a pixel",
    "shows there with 1/255 or not at all, by the last bit; nowhere else",
    shots=lambda renderer: {"shot": Shot(splats(ON_A_PIXEL, opacity=ALPHA_MIN), view(), empty=True)},
    gradients=(Gradients("shot", compared=()),))
def ALPHA_AT_THE_CUT(album, renderer, shots):
    covered = album["shot"].coverage
    require(np.argwhere(covered > 0).tolist() in ([], [[24, 32]]), "no other pixel may show it")
    require(renderer.name != "oracle" or covered[24, 32] > 0, "1/255 itself passes the test")
    close("coverage", covered[24, 32], ALPHA_MIN if covered[24, 32] else 0.0, max(renderer.error / 4, 1e-9))


def _stacked(renderer: Renderer) -> Shots:
    means = ((0, 0, 2), (0, 0, 3))
    colour, veils = [(1, 0, 0), (0, 1, 0)], [(0, 0, 2 + 0.1 * k) for k in range(40)]
    return {"outer": Shot(splats(*means, scale=5.0, opacity=2.0, colour=colour, levels=2), view(), outer=True),
            "level 1": Shot(splats(*means, scale=5.0, opacity=1.0, colour=colour), view()),
            "veils": Shot(splats(*veils, scale=5.0, opacity=0.3, colour=(0.5, 1, 0)), view())}


@scene_case(
    16, "opaque-against-the-stop", "one opaque splat before another, and forty veils: pixels stop below T = 1e-4",
    "the opaque one shows its colour (3DGS would drop it) and hides the other; at level 1, 0.99 of it and 0.0099 of the other",
    shots=_stacked, gradients=(Gradients("outer", lit=(0,), zero=(1,)), Gradients("level 1", lit=(0, 1))))
def OPAQUE_AGAINST_THE_STOP(album, renderer, shots):
    close("level 2", album["outer"].image[24, 32], (1, 0, 0), renderer.error)
    close("level 1", album["level 1"].image[24, 32], (0.99, 0.0099, 0), renderer.error)
    close("veils", album["veils"].image[24, 32], (0.5, 1, 0), renderer.error + 2e-4)
    left = 1 - album["veils"].coverage[24, 32]
    require(0.4e-4 < left < 2e-4, f"the pixel must stop as soon as less than 1e-4 of its light is left, not at {left:.3g}")


def _alpha_one(renderer: Renderer) -> Shots:
    model = splats(ON_A_PIXEL, (0.02, 0, 3), (0, 0.02, 4), scale=0.2, opacity=[1.0, 0.9, 1.0], levels=2,
                   colour=[(0.8, 0.2, 0.4), (0.1, 0.9, 0.3), (0.2, 0.3, 0.9)])
    return {"shot": Shot(model, view(), outer=True)}


@scene_case(
    17, "alpha-one-backward", "an alpha of exactly 1 in the middle of a stack: T is 0 behind it, and 1 - alpha is 0",
    "the splat alone in that pixel; gradients finite, without a division by 1 - alpha, and the oracle's", shots=_alpha_one,
    gradients=(Gradients("shot", lit=(0, 1, 2), moved=(0, 1, 2)),))
def ALPHA_ONE(album, renderer, shots):
    close("the pixel", album["shot"].image[24, 32], (0.8, 0.2, 0.4), 2 * renderer.error)
    close("what is left", album["shot"].coverage[24, 32], 1.0, max(renderer.error, 2.0**-15))


def _amplified(renderer: Renderer) -> Shots:
    model = splats((0, 0, 2), scale=0.2, opacity=128.0, colour=(0.25, 0.5, 0.75), levels=2)
    return {"shot": Shot(model, view(), outer=True, rim=1.0)}


@scene_case(
    18, "amplified-by-128", "an opacity of 128, the largest amplification",
    "opaque to the edge of its support, and nothing beyond: 128 exp(-4.5) is above 1", shots=_amplified,
    gradients=(Gradients("shot", lit=(0,)),))
def AMPLIFIED(album, renderer, shots):
    seen, shot = album["shot"], shots["shot"]
    q = exponents(shot.camera, shot.model.means[0], 0.2)
    rim = SUPPORT_SIGMA**2 / 2
    inside, outside = q < rim - 0.02, q > rim + 0.02
    require(inside.sum() > 500, "the footprint must be wide")
    close("colour inside", seen.image[inside], np.broadcast_to((0.25, 0.5, 0.75), (inside.sum(), 3)), renderer.error)
    close("coverage inside", seen.coverage[inside], 1.0, max(renderer.error, 2.0**-14))
    require(not seen.coverage[outside].any(), "nothing may show beyond the support")


def _axis_aligned(renderer: Renderer) -> Shots:
    shots = {}
    for name, scale in {"wide": (0.3, 0.05, 0.05), "high": (0.05, 0.3, 0.05), "round": (0.1, 0.1, 0.1)}.items():
        for box in (False, True):
            shots[f"{name}{', boxes' * box}"] = Shot(splats((0.2, 0.1, 2), scale=scale), view(), obb=box)
    return shots


@scene_case(
    19, "no-eigenvector", "covariances without an xy term, and circles, which have no axes at all",
    "closed form; by the oriented box the same pixels, and its tiles hold the ellipse's", shots=_axis_aligned,
    gradients=(Gradients("round", lit=(0,), moved=(0,)),))
def NO_EIGENVECTOR(album, renderer, shots):
    for name in ("wide", "high", "round"):
        exact, box = album[name], album[f"{name}, boxes"]
        wanted, sure = alphas(shots[name].camera, (0.2, 0.1, 2), np.exp(shots[name].model.log_scales[0]), 0.8)
        close(f"{name}: coverage", np.where(sure, exact.coverage, wanted), wanted, renderer.error)
        require(np.array_equal(exact.image, box.image), f"{name}: boxes must not change a pixel")
        missed = exact.tile_intersections is not None and (box.tile_intersections < exact.tile_intersections).any()
        require(not missed, f"{name}: a tile is missed")
        require(exact.entries is None or box.entries < 12, f"{name}: {box.entries} tiles by the box")


@scene_case(
    20, "banding", "one wide ramp of alpha from 0.8 down",
    "within a third of a grey level of the exponential, and never rising away from the centre",
    shots=lambda renderer: {"shot": Shot(splats((0, 0, 2), scale=1.0), view(160, 120))},
    gradients=(Gradients("shot", lit=(0,)),))
def BANDING(album, renderer, shots):
    seen, shot = album["shot"], shots["shot"]
    wanted, _ = alphas(shot.camera, shot.model.means[0], 1.0, 0.8)
    inside = wanted > 2 / 255
    close("coverage", np.where(inside, seen.coverage, wanted), wanted, min(renderer.error, 0.33 / 255))
    require((np.diff(seen.coverage[60, 80:]) <= 0).all(), "coverage must not rise away from the centre")


CASES = (DEGENERATE_AXES, DETERMINANT, EXPONENT_NOT_POSITIVE, OPACITY_BELOW_THE_CUT, ALPHA_AT_THE_CUT, OPAQUE_AGAINST_THE_STOP,
         ALPHA_ONE, AMPLIFIED, NO_EIGENVECTOR, BANDING)
