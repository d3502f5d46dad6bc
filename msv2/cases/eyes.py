"""Cases 45 to 52: depth, frames of two eyes, and gazes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from golden.msv2_ref import warp
from golden.msv2_ref.eyes import RENDERED, StereoFrame, render_stereo
from golden.msv2_ref.frame_memory import display_pixels
from golden.msv2_ref.pipeline import render
from golden.oracle import warp as oracle
from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from golden.scenes.stereo import check_gaze, stereo_pair, target_gaze
from msv2.cases.case import Case, Gradients, Renderer, Shot, Shots, close, require, scene_case
from msv2.cases.check import MACHINE, see_oracle
from msv2.cases.makers import random_model, splats, turned_view, view
from spec.constants import TILE
from spec.errors import InputError
from spec.memory import frame_pixel
from spec.stereo import background_transmittance, reach, solid_transmittance

STEREO_MACHINE = MACHINE.with_(name=f"{MACHINE.name}_stereo", stereo=True)
"""The configuration that plays frames of two eyes."""


@dataclass(frozen=True)
class TwoEyes:
    """The inputs of a case's frame of two eyes. The baseline is in world units, and gazes are in pixels."""

    model: GaussianModel
    camera: Camera
    baseline: float
    threshold_deg: float = 0.0
    source_eye: str = "left"
    gaze: tuple[float, float] | None = None
    gaze_target: tuple[float, float] | None = None
    background: tuple[float, float, float] = (0.25, 0.5, 0.75)

    @property
    def frame(self) -> StereoFrame:
        """The frame that the integer renderer makes."""
        pair = stereo_pair(self.camera, ipd_metres=self.baseline, source_eye=self.source_eye)
        return render_stereo(self.model, pair, config=STEREO_MACHINE, threshold_deg=self.threshold_deg, gaze=self.gaze,
                             gaze_target=self.gaze_target, background=self.background)

    @property
    def warped(self) -> oracle.OracleWarp:
        """The oracle's frame of the source eye, warped to the other eye in float64."""
        seen = see_oracle(Shot(self.model, self.camera, background=self.background))
        return oracle.warp(seen.image, seen.depth, seen.coverage, self.baseline * self.camera.fx,
                           -1 if self.source_eye == "left" else 1, reach=reach(STEREO_MACHINE))


def _covered(renderer: Renderer) -> Shots:
    return {"thin": Shot(splats((0, 0, 2), scale=3.0, opacity=0.45), view()),
            "solid": Shot(splats((0, 0, 2), scale=3.0, opacity=0.55), view())}


@scene_case(
    45, "no-coverage-no-depth", "coverages of 0.45 and of 0.55, and the warp unit at its limits of 1/255 and 1/2",
    "depth is invalid below one half and the splat's above; not warped in between", shots=_covered,
    gradients=(Gradients("thin", lit=(0,)),), columns=("oracle", "golden", "gradient"), checks={"golden": lambda: _limits()})
def NO_COVERAGE(album, renderer, shots):
    if renderer.name == "gradient":
        return
    require(np.isnan(album["thin"].depth).all() and album["thin"].coverage.max() > 0.44, "0.45 must have no depth")
    close("depth", album["solid"].depth[20:28, 28:36], 2.0, 2 * renderer.depth)


def _pixels(transmittance: np.ndarray | int, shape: tuple[int, int] = (1, 1)) -> np.ndarray:
    """FramePixel records with random colours, a disparity of a quarter of a pixel, and these raw transmittances."""
    n, out = MACHINE.formats, np.zeros(shape, frame_pixel(MACHINE).dtype)
    out["colour"] = np.random.default_rng(0).integers(0, 1 << n.accumulator.frac_bits, (*shape, 3))
    out["transmittance"] = transmittance
    weight = (n.transmittance.raw_max >> 3) - (out["transmittance"] >> 3)
    out["depth"] = np.minimum((1 << 10) * weight // 64, n.depth_accumulator.raw_max)
    return out


def _origins(pixels: np.ndarray, rule: str = STEREO_MACHINE.warp_fill) -> warp.WarpedFrame:
    return warp.warp(STEREO_MACHINE.with_(warp_fill=rule), pixels, 1 << 10, False)


def _limits() -> None:
    n = MACHINE.formats
    background, solid = background_transmittance(n), solid_transmittance(n)
    for raw, origin in ((background, warp.BACKGROUND), (background - 1, warp.HOLE), (solid + 1, warp.HOLE),
                        (solid, warp.WARPED), (n.transmittance.raw_max, warp.BACKGROUND)):
        got = int(_origins(_pixels(raw)).origin[0, 0])
        require(got == origin, f"a raw transmittance of {raw} must give origin {origin}, not {got}")


@scene_case(
    46, "depth-is-normalised", "splats at depths 2 and 4, of opacities 0.5 and 0.9",
    "the mean of the depths, weighted by T alpha",
    shots=lambda renderer: {"shot": Shot(splats((0, 0, 2), (0, 0, 4), scale=30.0, opacity=[0.5, 0.9]), view())},
    gradients=(Gradients("shot", lit=(0, 1)),))
def DEPTH_IS_NORMALISED(album, renderer, shots):
    a, b = 0.5, 0.5 * 0.9
    if album["shot"].depth is not None:
        close("depth", album["shot"].depth[24, 32], (2 * a + 4 * b) / (a + b), max(1e-3, 3 * renderer.depth))


def _far_wall() -> Mapping[str, TwoEyes]:
    model = splats((0, 0, 1e6), (1e5, 0, 1e6), scale=2e6, opacity=[0.9, 0.9], colour=[(0.9, 0.3, 0.1), (0.2, 0.4, 0.8)])
    return {eye: TwoEyes(model, view(), 0.1, source_eye=eye) for eye in ("left", "right")}


def _at_infinity(column: str) -> None:
    for name, eyes in _far_wall().items():
        if column == "oracle":
            warped = eyes.warped
            source = see_oracle(Shot(eyes.model, eyes.camera, background=eyes.background)).image
            require((warped.origin == oracle.WARPED).all() and np.array_equal(warped.image, source), f"{name}: must stay")
        else:
            frame = eyes.frame
            require(np.array_equal(frame.target_pixels["colour"], frame.source_pixels["colour"]), f"{name}: must stay")
            require((frame.warped.origin == warp.WARPED).all(), f"{name}: all must be warped")


def _near_ball() -> Mapping[str, TwoEyes]:
    model = splats((0, 0, 0.3), scale=0.05, opacity=0.95, colour=(0.9, 0.1, 0.1))
    return {eye: TwoEyes(model, view(), 5.0, source_eye=eye) for eye in ("left", "right")}


def _beyond_the_row(column: str) -> None:
    for name, eyes in _near_ball().items():
        origin = eyes.warped.origin if column == "oracle" else eyes.frame.warped.origin
        kinds = (oracle if column == "oracle" else warp)
        require(not (origin == kinds.WARPED).any(), f"{name}: what leaves the row must not come back on the other side")
        require((origin == kinds.HOLE).any(), f"{name}: where it was there must be holes")
    if column == "golden":
        pixels = _pixels(0, (1, 40))
        pixels["depth"][0, 5:] = 0  # an infinite disparity
        moved = warp.warp_pixels(STEREO_MACHINE, pixels, (1 << 24) - 1, False)
        require(not moved["keep"][0, 5:].any(), "a depth of 0 must be dropped")


def _two_layers() -> Mapping[str, TwoEyes]:
    near, far = (0.1, 0.9, 0.2), (0.8, 0.1, 0.3)
    grid = [(x, y, 8.0) for x in np.linspace(-7, 7, 15) for y in np.linspace(-5, 5, 11)]
    model = splats(*grid, (0.02, 0.02, 1.0), scale=[[0.8] * 3] * len(grid) + [[0.1, 0.4, 1e-3]],
                   opacity=[0.97] * len(grid) + [1.0], colour=[far] * len(grid) + [near])
    return {eye: TwoEyes(model, view(), 0.2, source_eye=eye) for eye in ("left", "right")}


def _nearest_wins(column: str) -> None:
    for name, eyes in _two_layers().items():
        sign = -1 if eyes.source_eye == "left" else 1
        # The bar covers 0.99 and the wall behind it the rest: a depth of 1.07, so 9.4 pixels of disparity; the wall has 1.25.
        columns = slice(*sorted((33 + sign * 8, 33 + sign * 11)))
        if column == "oracle":
            image = eyes.warped.image
        else:
            frame = eyes.frame
            image = frame.warped.pixels["colour"] / 255
            landed = np.zeros((48, 65), int)
            moved = frame.warped.moved
            np.add.at(landed, (np.indices((48, 64))[0], np.where(moved["keep"] == 1, moved["x"], 64)), 1)
            require((landed[:, :64] > 1).any(), f"{name}: pixels must meet")
        green, red = image[24, columns, 1], image[24, columns, 0]
        require(((green > 0.8) & (red < 0.2)).any(), f"{name}: the nearer layer must win in {columns}, not {green} green")


HOLES = {
    "interior": (
        ([(1, 1)], [(1, 1)]), ([(1, 1), (0, 0), (0, 1), (0, 2)], [(1, 1)]), ([(1, 1), (0, 0), (0, 1), (0, 2), (1, 0)], []),
        ([(1, 0)], [(1, 0)]), ([(1, 0), (2, 0)], []), ([(0, 1)], [(0, 1)]), ([(0, 0)], []), ([(15, 4)], [(15, 4)]),
        ([(16, 4)], [(16, 4)]), ([(15, 4), (16, 4)], [(15, 4), (16, 4)]), ([(15, 4), (15, 5)], [])),
    "majority": (
        ([(1, 1), (0, 0), (0, 2), (1, 0)], [(0, 2), (1, 0), (1, 1)]), ([(1, 1), (0, 0), (0, 1), (0, 2), (1, 0)], [(0, 2)]),
        ([(1, 0), (2, 0)], [(1, 0), (2, 0)]), ([(1, 0), (2, 0), (1, 1), (2, 1)], [(1, 1), (2, 1)]), ([(0, 0)], [(0, 0)]),
        ([(15, 4), (15, 5)], [(15, 4), (15, 5)]), ([(31, 8), (31, 7)], [(31, 7), (31, 8)])),
}
"""By the machine's rule of filling: sets of holes in a frame of 32x9 pixels, and those of them with enough warped neighbours in
their strip to be filled."""


def _holes_filled(column: str, rule: str, holes: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    """The places that are filled, (n, 2), and for each strip whether a hole is left."""
    raw = np.zeros((32, 9), int)
    raw[tuple(np.transpose(holes))] = 20000  # neither background nor solid
    if column == "golden":
        found = _origins(_pixels(raw, (32, 9)), rule)
        return np.argwhere(found.origin == warp.FILLED), found.invalid
    warped = oracle.warp(np.zeros((32, 9, 3)), np.ones((32, 9)), 1 - raw / 32768, 0.25, -1, majority=rule == "majority")
    return np.argwhere(warped.origin == oracle.FILLED), warped.tiles.ravel()


def _hole_patterns(column: str) -> None:
    for rule, patterns in HOLES.items():
        for holes, filled in patterns:
            got, invalid = _holes_filled(column, rule, holes)
            require(sorted(map(tuple, got.tolist())) == sorted(filled),
                    f"{rule}, holes {holes}: {filled} must be filled, not {got.tolist()}")
            left = [any(y // TILE == strip for y, _ in set(holes) - set(filled)) for strip in range(2)]
            require(invalid.tolist() == left, f"{rule}, holes {holes}: tiles {left} must be rendered, not {invalid.tolist()}")
    if column == "golden":
        raw = np.zeros((3, 3), int)
        raw[1, 1] = raw[0, 0] = raw[0, 2] = 20000
        pixels = _pixels(raw, (3, 3))
        shown = np.minimum((510 * pixels["colour"].astype(int) + (1 << 14)) // (2 << 14), 255)
        around = np.sort(shown[[0, 1, 1, 2, 2, 2], [1, 0, 2, 0, 1, 2]], axis=0)[2]
        close("the lower middle of six", _origins(pixels).pixels["colour"][1, 1], around, 0)


def _lists() -> Mapping[str, TwoEyes]:
    solid = _two_layers()["left"]
    return {"empty": replace(_far_wall()["left"], threshold_deg=0.0), "full": replace(solid, threshold_deg=180.0),
            "some": replace(solid, threshold_deg=18.0)}


def _rendered_lists(column: str) -> None:
    eyes = _lists()
    if column == "oracle":
        require(not eyes["empty"].warped.tiles.any(), "no tile may be left with a hole")
        return
    frames = {name: asked.frame for name, asked in eyes.items()}
    counts = {name: int(frame.rendered.sum()) for name, frame in frames.items()}
    require(counts["empty"] == 0 and counts["full"] == 12 and 0 < counts["some"] <= 12, f"tiles rendered: {counts}")
    full = frames["full"]
    plain = render(eyes["full"].model, full.pair.target, config=STEREO_MACHINE, background=eyes["full"].background)
    close("a full list: the target by itself", full.target_pixels["colour"], display_pixels(plain)["colour"], 1)
    require((full.origin == RENDERED).all(), "a full list: all must be rendered")


GAZES = {"a corner": (0.0, 0.0), "the other": (96.0, 72.0), "moved": (40.0, 30.0), "by a pixel": (41.0, 30.0),
         "the side": (96.0, 20.0)}


def _gazes(renderer: Renderer) -> Shots:
    model = random_model(np.random.default_rng(3), 120, 4)
    shots = {name: Shot(model, turned_view(96, 72), gaze=gaze, rim=6 / 255) for name, gaze in GAZES.items()}
    return dict(list(shots.items())[:1]) if renderer.name == "gradient" else shots


def _off_screen() -> None:
    camera = view()
    ways = (lambda gaze: check_gaze("left", gaze, camera), lambda gaze: Shot(splats((0, 0, 2)), camera, gaze).foveation)
    for gaze in ((-0.1, 0), (64.1, 0), (0, 48.1), (np.nan, 0), (np.inf, 1)):
        for look in ways:
            try:
                look(gaze)
            except InputError as error:
                require("off" in str(error), f"the refusal must say that {gaze} is off the screen, not {error}")
            else:
                require(False, f"gaze {gaze} must be refused")
    pair = stereo_pair(camera, ipd_metres=100.0)
    (x, _), warning = target_gaze(pair, (10.0, 10.0), 1.0)
    require(x == 0.0 and warning is not None, "a gaze that leaves the other eye's screen is clamped, and said")


@scene_case(
    52, "gaze-off-and-at-the-edge", "gazes off the screen, in two corners, at the side, and moved by a pixel; four levels",
    "refused off the screen; elsewhere the oracle's image, level 1 where the eye looks", shots=_gazes,
    gradients=(Gradients("a corner", compared=()),), checks={"oracle": _off_screen})
def GAZE(album, renderer, shots):
    for name, shot in shots.items():
        x, y = (min(int(place), size - 1) // TILE for place, size in zip(shot.gaze, (96, 72), strict=True))
        require(shot.foveation.tile_level[y, x] == 0, f"{name}: the gazed tile must be of level 1")
        require(np.isfinite(shot.foveation.plane).all(), f"{name}: planes must be finite")
        require(album[name].image.any(), f"{name}: something must show")


def _stereo(number: int, name: str, what: str, expected: str, check: Callable[[str], None],
            eyes: Callable[[], Mapping[str, TwoEyes]] | None, *, rtl: str = "") -> Case:
    absent = {"gradient": "one eye is trained"} | ({} if eyes else {"rtl": rtl})
    checks = {column: partial(check, column) for column in ("oracle", "golden")}
    return Case(number, name, what, expected, checks=checks, absent=absent, rtl=eyes is not None, eyes=eyes)


AT_INFINITY = _stereo(47, "at-infinity", "a wall at depth 1e6, seen by eyes 0.1 apart, either one the source",
                      "no disparity: the target is the source, bit by bit", _at_infinity, _far_wall)
BEYOND_THE_ROW = _stereo(48, "beyond-the-row", "a ball at depth 0.3 seen by eyes 5 apart; depth sums of 0",
                         "dropped, never on the row's other side; holes where it was", _beyond_the_row, _near_ball)
NEAREST_WINS = _stereo(49, "many-onto-one", "a bar at depth 1 before a wall at depth 8, whose pixels meet in the other eye",
                       "the nearest wins at its own disparity, whichever eye is the source", _nearest_wins, _two_layers)
HOLE_PATTERNS = _stereo(50, "hole-patterns", "holes with one to eight neighbours, at a strip's edges and in corners",
                        "filled by the machine's rule, by the lower middle; the others' tiles are rendered", _hole_patterns,
                        None, rtl="patterns are played in the warp unit's own suite, frames with holes in 51")
RENDERED_LISTS = _stereo(51, "lists-empty-and-full", "targets of which no tile is rendered, all are, and some",
                         "none; all, and the target is that eye's own frame; some", _rendered_lists, _lists)

CASES = (NO_COVERAGE, DEPTH_IS_NORMALISED, AT_INFINITY, BEYOND_THE_ROW, NEAREST_WINS, HOLE_PATTERNS, RENDERED_LISTS, GAZE)
