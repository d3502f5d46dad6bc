"""Cases 36 to 44, 56 and 76: the order of splats, tiles, and sizes of frames."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from golden.msv2_ref import tile_merge
from golden.msv2_ref.pipeline import Frame, render
from golden.scenes.model import GaussianModel
from msv2.cases.case import SMOOTH, Case, Gradients, Renderer, Shot, Shots, close, require, scene_case
from msv2.cases.check import MACHINE, see_oracle
from msv2.cases.inversions import analyse, float64_z
from msv2.cases.makers import random_model, splats, turned_view, view
from msv2.cases.projection import closed_form
from spec.errors import InputError
from spec.records import COUNT_BITS, INDEX_BITS

STACK = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)], float)


def _permutations(renderer: Renderer) -> Shots:
    shots = {}
    for order in itertools.permutations(range(4)):
        rows = list(order)
        equal = splats(*[(0, 0, 2)] * 4, scale=0.5, opacity=0.6, colour=STACK[rows])
        apart = splats(*[(0, 0, 2 + 0.25 * row) for row in rows], scale=0.5, opacity=0.6, colour=STACK[rows])
        name = "".join(map(str, order))
        shots |= {f"equal {name}": Shot(equal, view(32, 32)), f"apart {name}": Shot(apart, view(32, 32))}
    return shots


@scene_case(
    36, "equal-depths", "four splats at one depth, and four at different ones, in all 24 orders of the input",
    "equal depths go by index: the frame composited by hand; different ones: one frame, bit by bit", shots=_permutations,
    gradients=(Gradients("equal 0123", lit=(0, 1, 2, 3), compared=SMOOTH), Gradients("apart 3120", lit=(0, 1, 2, 3))))
def EQUAL_DEPTHS(album, renderer, shots):
    def weights_of(depths: np.ndarray) -> np.ndarray:
        alpha = 0.6 * np.exp(-0.5 * 0.5 / ((50 * 0.5 / depths) ** 2 + 0.3))
        return alpha * np.cumprod(np.append(1.0, 1 - alpha))[:-1]

    by_index, by_depth = weights_of(np.full(4, 2.0)), weights_of(2 + 0.25 * np.arange(4))
    close("apart", album["apart 0123"].image[16, 16], by_depth @ STACK, 2 * renderer.error)
    for name, seen in album.items():
        order = [int(digit) for digit in name.split()[1]]
        if name.startswith("equal"):
            close(name, seen.image[16, 16], by_index @ STACK[order], 2 * renderer.error)
        else:
            require(np.array_equal(seen.image, album["apart 0123"].image), f"{name}: the order of the input must not matter")


def _outlier(renderer: Renderer) -> Shots:
    model, camera = random_model(np.random.default_rng(4), 120), turned_view(96, 72)
    fields = ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound")
    more = replace(model, **{name: np.concatenate([getattr(model, name), getattr(model, name)[:1]]) for name in fields})
    more.means[-1], more.opacity[-1] = (0.3, 0.2, 1e7), 0.005
    return {"without": Shot(model, camera, rim=4 / 255), "with": Shot(more, camera, rim=4 / 255)}


@scene_case(
    37, "far-outlier", "a faint splat at depth 1e7 behind a hundred at depths below 9",
    "costs neither the order nor the depth of the others: no key moves by more than 4 ulps", shots=_outlier,
    gradients=(Gradients("with", zero=(), compared=()),))
def FAR_OUTLIER(album, renderer, shots):
    both = [album[name] for name in ("without", "with")]
    close("image", both[1].image, both[0].image, 4 / 255)
    require((np.abs(both[1].image - both[0].image) > 1 / 255).mean() < 0.01, "the outlier must not be seen")
    if both[0].depth is not None:
        valid = ~np.isnan(both[0].depth) & ~np.isnan(both[1].depth)
        error = np.abs(both[1].depth / both[0].depth - 1)[valid]
        require(valid.sum() > 100 and np.percentile(error, 95) <= max(1e-6, 2 * renderer.depth), "depths must not change")
    if renderer.name == "golden":
        keys = [seen.frame.projected.depth_key[:120] for seen in both]
        require(np.abs(keys[1] - keys[0]).max() <= 4, "keys must not move")


BACKGROUND = (12_000, 5_000, 2_000, 800, 300, 100, 50, 2)
"""Depths from a sky at 60,000 times the near plane to an object at ten times, in the order of the input."""


def _background(renderer: Renderer) -> Shots:
    model = splats(*[(0, 0, z) for z in BACKGROUND], scale=[[z / 4] * 3 for z in BACKGROUND], opacity=0.6,
                   colour=np.resize(STACK, (len(BACKGROUND), 3)))
    return {"sky": Shot(model, view(32, 32))}


@scene_case(
    76, "distant-background", "eight splats at depths from 2 to 12,000, 60,000 times the near plane, the farthest first",
    "the frame composited by hand, from near to far: all keys differ", shots=_background,
    gradients=(Gradients("sky", lit=range(8), compared=SMOOTH),))
def DISTANT_BACKGROUND(album, renderer, shots):
    alpha = 0.6 * np.exp(-0.5 * 0.5 / ((50 / 4) ** 2 + 0.3))
    weights = alpha * (1 - alpha) ** np.arange(len(BACKGROUND))
    colours = np.resize(STACK, (len(BACKGROUND), 3))[::-1]
    close("sky", album["sky"].image[16, 16], weights @ colours, 2 * renderer.error)
    if renderer.name == "golden":
        keys = album["sky"].frame.projected.depth_key
        require((np.diff(keys) < 0).all(), f"keys must fall with the depth: {keys}")


def _inversions() -> float:
    camera, model = turned_view(64, 48), random_model(np.random.default_rng(6), 1500)
    found = analyse(render(model, camera, config=MACHINE), float64_z(model, camera))
    require(found["entries"] > 1000, "there must be entries to order")
    require(found["machine_inversions"] == 0, f"{found['machine_inversions']} pairs against the machine's own depth")
    require(found["largest_gap"] < 2.0**-15, f"a pair {found['largest_gap']:.2g} apart is inverted")
    require(found["float64_inversions"] < 1e-3 * found["neighbours"], f"{found['float64_inversions']} inversions")
    return found["max_abs_error"]


def _saturated_keys() -> None:
    depths = [0.3, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 1e3, 1e6, 1e8, 1e12, 1e15, 1e30]
    model = splats(*[(0, 0, z) for z in depths], scale=[[z / 100] * 3 for z in depths])
    key = render(model, view(), config=MACHINE).projected.depth_key
    require((np.diff(key)[:10] > 0).all(), f"keys must rise with the depth: {key}")
    require((key[10:] == MACHINE.formats.depth_key.raw_max).all(), f"keys must saturate and not wrap: {key}")


def _key_checks() -> float:
    _saturated_keys()
    return _inversions()


KEY_INVERSIONS = Case(
    38, "key-inversions", "1,500 splats whose keys are compared with float64's order; depths to 1e30",
    "no inversion by the machine's own depth; by float64's, few and counted, of depths closer than 2^-15; keys saturate",
    checks={"golden": _key_checks}, rtl=False,
    absent={"oracle": "its order is the measure", "gradient": "sorts by float32 depths",
            "rtl": "its order is played in the others"})


def _steps() -> list[Shot]:
    model, shots = random_model(np.random.default_rng(7), 120), []
    for step in range(4):
        angle = np.deg2rad(12 + 0.02 * step)
        rotation = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        shots.append(Shot(model, replace(turned_view(96, 72), rotation=rotation), rim=4 / 255))
    return shots


@scene_case(
    39, "small-rotations", "four frames, a fiftieth of a degree apart",
    "no pixel changes more than the oracle's does, by 4/255",
    shots=lambda renderer: {f"step {n}": shot for n, shot in enumerate(_steps())},
    gradients=(Gradients("step 0", compared=()),))
def SMALL_ROTATIONS(album, renderer, shots):
    exact = [see_oracle(shot).image for shot in shots.values()]
    ours = [seen.image for seen in album.values()]
    for n in range(1, 4):
        change, wanted = np.abs(ours[n] - ours[n - 1]).max(), np.abs(exact[n] - exact[n - 1]).max()
        require(change <= wanted + 4 / 255, f"step {n}: a pixel changes by {change:.4f}, the oracle's by {wanted:.4f}")


def _nothing(renderer: Renderer) -> Shots:
    background = (0.125, 0.25, 0.5)
    empty = splats((0, 0, 1)).select(np.zeros(1, bool))
    return {"behind": Shot(splats((0, 0, -1)), view(), background=background, empty=True),
            "empty": Shot(empty, view(40, 20), empty=True)}


@scene_case(
    40, "nothing-visible", "a model behind the camera, and one without points",
    "background, no coverage, no depth; the machine ends",
    shots=_nothing, gradients=(Gradients("behind", zero=(0,)),))
def NOTHING_VISIBLE(album, renderer, shots):
    for name, seen in album.items():
        seen.counts(entries=0, drawn=0)
        close(name, seen.image, np.broadcast_to(shots[name].background, seen.image.shape), 2 * renderer.error)
        require(not seen.coverage.any(), f"{name}: nothing may be covered")
        require(seen.depth is None or np.isnan(seen.depth).all(), f"{name}: there must be no depth")


def crowded(count: int, seed: int) -> GaussianModel:
    """Small faint splats, all of them between 4 and 12 pixels from the corner of `view()`."""
    rng = np.random.default_rng(seed)
    means = rng.uniform((-1.1, -0.8, 2.0), (-0.8, -0.5, 2.001), (count, 3))
    return splats(*means, scale=1e-3, opacity=0.05, colour=rng.uniform(0, 1, (count, 3)))


def _buffer_entries() -> int:
    return MACHINE.sort_chunk


@scene_case(
    41, "more-than-a-buffer", "three times as many entries in a tile as the sorter's half buffer holds",
    "none is lost: the tile is a group of its own, spills, and looks as the oracle's", gradients=(Gradients("shot"),),
    shots=lambda renderer: {"shot": Shot(crowded(3 * _buffer_entries() + 1, 8), view(32, 32, cx=32.0, cy=24.0))})
def MORE_THAN_A_BUFFER(album, renderer, shots):
    count = 3 * _buffer_entries() + 1
    album["shot"].counts(drawn=count)
    if renderer.name == "golden":
        frame: Frame = album["shot"].frame
        require((frame.groups == frame.groups[0]).sum() == 1, "the large tile must be a group of its own")


def _full_index() -> None:
    one = splats((0, 0, 2))
    many = replace(one, **{name: np.broadcast_to(values, (1 << INDEX_BITS, *values.shape[1:]))
                           for name, values in vars(one).items() if isinstance(values, np.ndarray) and name != "up"})
    try:
        render(many, view(16, 16), config=MACHINE)
    except InputError as error:
        require(str(1 << INDEX_BITS) in str(error), f"the refusal must name the number, not {error}")
    else:
        require(False, "more Gaussians than an index holds must be refused")
    hits = np.repeat([0, 1, 9], [5, 3, 1])
    counts, saturated, outside = tile_merge.count_tiles(hits, 4, count_bits=2)
    require(counts.tolist() == [3, 3, 0, 0] and saturated and outside, "a full counter stays full, and says so")
    require(INDEX_BITS <= COUNT_BITS, "a tile's counter must hold every Gaussian")


FULL_INDEX = Case(
    41, "more-than-an-index", "2^24 Gaussians, and tile counters that are full",
    "refused by number; a full counter stays full and says so",
    checks={"golden": _full_index}, rtl=False,
    absent={"oracle": "no such index", "gradient": "no such index",
            "rtl": "the errors ENTRIES_FULL, SPILL_FULL and a full counter are played in 41-recoverable-errors"})


def _edges(renderer: Renderer) -> Shots:
    sigma = np.sqrt(4 - 0.3) / 50 * 2  # so that 3 sigma are a radius of 6 pixels
    shots = {}
    for offset in (-0.05, -1e-3, 0.0, 1e-3, 0.05):
        mean = ((10.5 + offset - 32) / 50 * 2, (8.5 - 24) / 50 * 2, 2)
        for box in (False, True):
            model = splats(mean, scale=(sigma, sigma, 0), opacity=0.99)
            shots[f"{offset:+g}{', boxes' * box}"] = Shot(model, view(), obb=box, rim=4 / 255)
    return shots


@scene_case(
    42, "ellipse-on-a-tile-edge", "a circle that ends 0.05 and 0.001 pixels before, at and beyond the next tile's first column",
    "drawn there iff it reaches it, listed there if it is drawn", shots=_edges,
    gradients=(Gradients("+0.05", lit=(0,), compared=()),))
def ELLIPSE_ON_A_TILE_EDGE(album, renderer, shots):
    for name, seen in album.items():
        offset = float(name.split(",")[0])
        drawn = seen.coverage[8, 16] > 0
        listed = seen.tile_intersections is None or seen.tile_intersections[1] == 1
        require(not drawn or listed, f"{name}: drawn and not listed")
        if abs(offset) > 0.01 or (renderer.name == "oracle" and offset):
            require(drawn == (offset > 0), f"{name}: column 16 must {'' if offset > 0 else 'not '}be drawn")
        require(seen.coverage[8, 15] > 0 and not seen.coverage[:, 17:].any(), f"{name}: columns 15 and 17")


@scene_case(
    43, "all-in-one-tile", "a thousand splats in the first tile of twelve",
    "a list of a thousand, eleven empty ones; the oracle's image",
    shots=lambda renderer: {"shot": Shot(crowded(1000, 4), view())}, gradients=(Gradients("shot", compared=SMOOTH),))
def ALL_IN_ONE_TILE(album, renderer, shots):
    seen = album["shot"]
    seen.counts(entries=1000, drawn=1000)
    counts = seen.tile_intersections
    require(counts is None or counts.tolist() == [1000] + [0] * 11, "eleven tiles must be empty")
    require(not seen.coverage[:, 16:].any() and seen.coverage[:16, :16].max() > 0.5, "only the first tile may be covered")


BETAS = (None, 0, 1, 7, (1 << COUNT_BITS) - 1)


def _merged(renderer: Renderer) -> Shots:
    model = random_model(np.random.default_rng(9), 100)
    return {str(beta): Shot(model, turned_view(64, 48), beta=beta, rim=4 / 255) for beta in BETAS}


@scene_case(
    44, "merge-thresholds", "merge thresholds of 0, 1, 7, the largest, and the automatic one",
    "no pixel changes; group ids are consecutive", shots=_merged, columns=("oracle", "golden"),
    absent={"gradient": "does not merge"})
def MERGE_THRESHOLDS(album, renderer, shots):
    for name, seen in album.items():
        require(np.array_equal(seen.image, album["None"].image), f"beta {name} must not change a pixel")
        if renderer.name == "golden":
            groups = seen.frame.groups
            require(np.isin(np.diff(groups), (0, 1)).all() and groups[0] == 0, f"beta {name}: groups must be consecutive")


SIZES = ((1, 1), (16, 16), (17, 1), (50, 16), (MACHINE.row_width, 3), (3, 100), (33, 35))


@scene_case(
    56, "frame-sizes", "frames of 1x1, of one tile, of one row of tiles, of odd sizes and of the machine's widest row",
    "coverage in closed form in every pixel of the frame, the last columns and rows too",
    shots=lambda renderer: {f"{w}x{h}": Shot(splats((0, 0, 2), scale=2.0, opacity=0.9), view(w, h), background=(0.5, 0.5, 0.5))
                            for w, h in SIZES}, gradients=(Gradients("1x1", lit=(0,)), Gradients("17x1", lit=(0,))))
def FRAME_SIZES(album, renderer, shots):
    for name, seen in album.items():
        camera = shots[name].camera
        require(seen.image.shape == (camera.height, camera.width, 3), f"{name}: {seen.image.shape}")
        closed_form(seen, shots[name], renderer, 0.9, what=f"{name}: ")


CASES = (EQUAL_DEPTHS, FAR_OUTLIER, DISTANT_BACKGROUND, KEY_INVERSIONS, SMALL_ROTATIONS, NOTHING_VISIBLE, MORE_THAN_A_BUFFER,
         FULL_INDEX, ELLIPSE_ON_A_TILE_EDGE, ALL_IN_ONE_TILE, MERGE_THRESHOLDS, FRAME_SIZES)
