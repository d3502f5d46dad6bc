"""The integer warp unit against the oracle and against its definition; frames of two eyes; hard cases 45 to 52.

Hard cases: 45 no coverage, depth invalid · 46 depth normalised · 47 zero disparity at infinity · 48 depth near 0, disparity
beyond the row · 49 many pixels onto one target · 50 hole patterns around the median's limits · 51 re-render list empty and
full · 52 gaze off-screen, in a corner, moving.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from golden_samples import map_for, random_model, splats, view

from golden.metrics.image import psnr_vs
from golden.msv2_ref import pipeline, warp_unit
from golden.msv2_ref.stereo import (
    BACKGROUND,
    FILLED,
    RENDERED,
    RERENDERED,
    WARPED,
    StereoFrame,
    disparity_scale,
    render_stereo,
)
from golden.msv2_ref.views import display_pixels, frame_pixels
from golden.oracle import warp as oracle
from golden.oracle.render import render as render_oracle
from golden.scenes.camera import Camera
from golden.scenes.embedded import cached_embedded_model, embedded_cameras
from golden.scenes.gaze import Display
from golden.scenes.load import load_scene
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import orbit_camera
from golden.scenes.pictures import to_bytes
from golden.scenes.stereo import stereo_pair, target_gaze, warpable_tiles
from spec.config import TINY
from spec.errors import InputError
from spec.memory import frame_pixel
from spec.stereo import background_transmittance, solid_transmittance

CONFIG = TINY.with_(name="stereo", stereo=True)
INTERIOR, VEILS = CONFIG.with_(warp_fill="interior"), CONFIG.with_(warp_veiled=True)
N = CONFIG.formats
SOLID, VEILED, EMPTY = 0, 20000, N.transmittance.raw_max
"""Raw transmittances of a pixel with a depth, of one without, of background."""

SCALE = 1 << 10
"""Disparity scale of 1/16 pixel at full depth: the smallest disparity that `pixels` can make."""


def pixels(disparity: np.ndarray, transmittance: np.ndarray | int = SOLID, seed: int = 0) -> np.ndarray:
    """FramePixel records of random colours whose disparity at SCALE is nearest to the one given, in pixels."""
    disparity = np.atleast_2d(np.asarray(disparity, float))
    out = np.zeros(disparity.shape, frame_pixel(CONFIG).dtype)
    out["colour"] = np.random.default_rng(seed).integers(0, 1 << N.accumulator.frac_bits, (*disparity.shape, 3))
    out["transmittance"] = transmittance
    weight = (N.transmittance.raw_max >> 3) - (out["transmittance"] >> 3)
    with np.errstate(divide="ignore"):
        out["depth"] = np.minimum(np.round(SCALE * weight / (disparity * 256)), N.depth_accumulator.raw_max)
    return out


def warped(frame: np.ndarray, scale: int = SCALE, *, right: bool = False, config=CONFIG) -> warp_unit.WarpedFrame:
    return warp_unit.warp(config, frame, scale, right)


def by_hand(frame: np.ndarray, scale: int, right: bool, veiled: bool) -> tuple[np.ndarray, np.ndarray]:
    """Column and key of every pixel in Python's integers, -1 where it is not warped; the text of docs/stereo.md."""
    columns, keys = np.full(frame.shape, -1), np.zeros(frame.shape, int)
    most = (1 << CONFIG.row_width.bit_length() + 8) - 1
    for (y, x), pixel in np.ndenumerate(frame):
        t, d = int(pixel["transmittance"]), int(pixel["depth"])
        if 255 * (32768 - t) < 32768:
            columns[y, x] = x
        elif veiled or 2 * (32768 - t) >= 32768:
            raw = most if d == 0 else min(most, scale * (4095 - t // 8) // d)
            to = x + ((raw if right else -raw) + 128) // 256
            if 0 <= to < frame.shape[1]:
                columns[y, x], keys[y, x] = to, raw + 1
    return columns, keys


@pytest.mark.parametrize("right", [False, True])
@pytest.mark.parametrize("config", [CONFIG, VEILS], ids=["solid", "veiled"])
@pytest.mark.parametrize("size", [(1, 1), (5, 37), (18, 61), (16, 512)])
def test_columns_and_keys_are_those_of_the_text(size, config, right):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        frame = np.zeros(size, frame_pixel(CONFIG).dtype)
        frame["transmittance"] = rng.choice([0, 4000, 16383, 16384, 16385, 20000, 32639, 32640, 32767], size)
        frame["depth"] = np.where(rng.random(size) < 0.1, rng.integers(0, 3, size), (1 << 18) * rng.random(size) ** 3)
        for scale in (0, 1, 700, 1 << 16, (1 << 24) - 1):
            moved = warp_unit.warp_pixels(config, frame, scale, right)
            columns, keys = by_hand(frame, scale, right, config.warp_veiled)
            assert np.array_equal(np.where(moved["keep"] == 1, moved["x"], -1), columns)
            assert np.array_equal(moved["key"], keys)
            assert np.array_equal(moved["row"], np.indices(size)[0] % 16)


@pytest.mark.parametrize("right", [False, True])
@pytest.mark.parametrize("config", [CONFIG, INTERIOR, VEILS], ids=["majority", "interior", "veiled"])
def test_scatter_and_fill_are_the_oracles(config, right):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        disparity = rng.choice([0.25, 1.5, 2.0, 3.75, 8.0], (35, 13)).repeat(4, 1)[:, :49]
        t = rng.choice([SOLID, 9000, VEILED, EMPTY], disparity.shape, p=[0.6, 0.3, 0.05, 0.05])
        frame = pixels(disparity, t, seed)
        raw = warp_unit.raw_disparity(CONFIG, frame["transmittance"], frame["depth"], SCALE)
        shown = display_colours(frame)
        found = warped(frame, right=right, config=config)
        depth, coverage = 256.0 / np.maximum(raw, 1), 1 - frame["transmittance"] / 32768
        wanted = oracle.warp(shown / 255.0, depth, coverage, 1.0, 1 if right else -1, veiled=config.warp_veiled,
                             majority=config.warp_fill == "majority")
        assert np.array_equal(found.origin, wanted.origin)
        assert np.array_equal(found.pixels["colour"], np.round(wanted.image * 255))
        assert np.array_equal(found.invalid, wanted.tiles.reshape(-1))
        solid = np.isin(found.origin, (warp_unit.WARPED, warp_unit.FILLED))
        assert np.array_equal(found.pixels["coverage"], np.where(solid, 255, 0))


def display_colours(frame: np.ndarray) -> np.ndarray:
    return np.minimum((510 * frame["colour"].astype(int) + (1 << 14)) // (2 << 14), 255)


def test_equal_keys_never_meet():
    """Why the order in which a row's pixels come does not matter: equal disparities move equally far."""
    rng = np.random.default_rng(0)
    frame = pixels(rng.choice([0.5, 1.0, 1.25, 6.0], (64, 64)))
    moved = warp_unit.warp_pixels(CONFIG, frame, SCALE, False)
    places = np.stack([np.indices(moved.shape)[0], moved["x"], moved["key"]], -1)[moved["keep"] == 1]
    assert len(np.unique(places, axis=0)) == len(places) and len(np.unique(places[:, :2], axis=0)) < len(places)
    order = rng.permutation(64)
    strips = warp_unit.scatter(CONFIG, moved)
    assert np.array_equal(warp_unit.scatter(CONFIG, moved[:, order]), strips)


def test_45_no_coverage_and_no_depth():
    found = warped(pixels(np.full((20, 20), 4.0), EMPTY))
    assert (found.origin == warp_unit.BACKGROUND).all() and not found.invalid.any() and not found.pixels["coverage"].any()
    assert np.array_equal(found.pixels["colour"], display_colours(pixels(np.full((20, 20), 4.0), EMPTY)))
    for t, origin in (
        (background_transmittance(N) - 1, warp_unit.HOLE), (solid_transmittance(N) + 1, warp_unit.HOLE),
        (solid_transmittance(N), warp_unit.WARPED), (background_transmittance(N), warp_unit.BACKGROUND),
    ):
        assert warped(pixels(0.25, t)).origin.tolist() == [[origin]]


def test_46_depth_is_normalised():
    """Half the coverage and half the sum are the same depth."""
    for t in (SOLID, 8192, 16384):
        raw = warp_unit.raw_disparity(CONFIG, *(pixels(5.0, t)[name] for name in ("transmittance", "depth")), SCALE)
        assert abs(int(raw[0, 0]) - 5 * 256) <= 1


def test_47_what_is_at_infinity_stays():
    frame = pixels(np.full((3, 9), 1e-9))
    for right in (False, True):
        found = warped(frame, 40, right=right)
        assert np.array_equal(found.moved["x"][0], np.arange(9)) and (found.origin == warp_unit.WARPED).all()


def test_48_beyond_the_row_and_depth_zero():
    frame = pixels(np.full((1, 40), 39.0))
    frame["depth"][0, 5:] = 0
    for right in (False, True):
        found = warped(frame, right=right)
        assert found.strips["valid"].sum() == right and found.invalid.all()


def test_49_the_nearest_of_many_wins_whatever_the_order():
    disparity = np.array([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]])
    frame = pixels(disparity)
    found = warped(frame)  # all to column -1 + ...: x - (x + 1)
    assert found.strips["valid"].sum() == 0
    many = warped(pixels(disparity - 1))  # all to column 0, the last is the nearest
    assert many.strips["valid"].tolist() == [[1] + [0] * 7]
    assert many.strips["colour"][0, 0].tolist() == display_colours(pixels(disparity - 1))[0, 7].tolist()
    hidden = pixels([[2.0, 0.25, 0.25]], [[EMPTY, SOLID, SOLID]])
    assert warped(hidden, 4 * SCALE).strips["key"][0, 0] > 0  # anything hides the background


@pytest.mark.parametrize(("holes", "filled"), [
    ([(1, 1)], [(1, 1)]), ([(1, 1), (0, 0), (0, 1), (0, 2)], [(1, 1)]), ([(1, 1), (0, 0), (0, 1), (0, 2), (1, 0)], []),
    ([(1, 0)], [(1, 0)]), ([(1, 0), (2, 0)], []), ([(0, 1)], [(0, 1)]), ([(0, 0)], []), ([(15, 4)], [(15, 4)]),
    ([(16, 4)], [(16, 4)]), ([(15, 4), (16, 4)], [(15, 4), (16, 4)]), ([(15, 4), (15, 5)], []),
])
def test_50_five_neighbours_of_the_strip_fill_a_hole(holes, filled):
    holes_and_fills(INTERIOR, (32, 9), holes, filled)


@pytest.mark.parametrize(("size", "holes", "filled"), [
    ((32, 9), [(1, 1), (0, 0), (0, 2), (1, 0)], [(0, 2), (1, 0), (1, 1)]),
    ((32, 9), [(1, 1), (0, 0), (0, 1), (0, 2), (1, 0)], [(0, 2)]), ((32, 9), [(1, 0), (2, 0)], [(1, 0), (2, 0)]),
    ((32, 9), [(1, 0), (2, 0), (1, 1), (2, 1)], [(1, 1), (2, 1)]),
    ((32, 9), [(15, 4), (15, 5)], [(15, 4), (15, 5)]),
    ((32, 9), [(16, 4), (16, 5), (16, 3)], [(16, 3), (16, 4), (16, 5)]),
    ((32, 9), [(15, 4), (14, 4), (14, 5)], [(14, 4), (14, 5), (15, 4)]),
    ((32, 9), [(0, 4), (1, 3), (1, 4), (1, 5)], [(1, 3), (1, 4), (1, 5)]),
    ((32, 9), [(0, 0)], [(0, 0)]), ((32, 9), [(31, 8), (31, 7)], [(31, 7), (31, 8)]),
    ((32, 9), [(16, 0), (16, 1), (17, 0)], [(16, 1), (17, 0)]),
    ((17, 9), [(16, 0)], [(16, 0)]), ((17, 9), [(16, 4)], [(16, 4)]), ((17, 9), [(16, 4), (16, 5)], []),
    ((32, 1), [(7, 0), (15, 0), (16, 0)], [(7, 0), (15, 0), (16, 0)]), ((32, 1), [(7, 0), (8, 0)], []),
    ((17, 1), [(16, 0)], []), ((1, 2), [(0, 1)], [(0, 1)]), ((32, 2), [(3, 0), (3, 1)], [(3, 0), (3, 1)]),
], ids=str)
def test_50_more_than_half_of_the_neighbours_that_exist_fill_a_hole(size, holes, filled):
    holes_and_fills(CONFIG, size, holes, filled)


def holes_and_fills(config, size, holes, filled):
    t = np.full(size, SOLID)
    t[tuple(np.transpose(holes))] = VEILED
    found = warped(pixels(np.full(size, 0.25), t), config=config)
    assert sorted(map(tuple, np.argwhere(found.origin == warp_unit.FILLED).tolist())) == sorted(filled)
    tiles = -(-size[0] // 16)
    assert found.invalid.tolist() == [any(y // 16 == tile for y, _ in set(holes) - set(filled)) for tile in range(tiles)]


def test_45_veiled_pixels_are_warped_where_the_machine_does():
    veil = pixels(np.full((20, 20), 4.0), VEILED)
    assert warped(veil).invalid.all()
    found = warped(veil, config=VEILS)
    assert (found.origin[:, :16] == warp_unit.WARPED).all() and (found.origin[:, 16:] == warp_unit.HOLE).sum() > 40
    assert np.array_equal(found.pixels["colour"][:, :16], display_colours(veil)[:, 4:])


def test_50_the_median_of_an_even_number_is_the_lower_middle():
    frame = pixels(np.full((3, 3), 0.25))
    frame["transmittance"][1, 1] = frame["transmittance"][0, 0] = frame["transmittance"][0, 2] = VEILED
    found = warped(frame).pixels["colour"][1, 1]
    around = display_colours(frame)[[0, 1, 1, 2, 2, 2], [1, 0, 2, 0, 1, 2]]
    assert found.tolist() == np.sort(around, axis=0)[2].tolist()


def ball(seed: int = 3, levels: int = 1) -> GaussianModel:
    """A model with depth everywhere in the middle and background around."""
    rng = np.random.default_rng(seed)
    return replace(random_model(rng, 400, levels), means=rng.normal((0, 0, 4), 0.7, (400, 3)))


def two_eyes(model: GaussianModel, camera: Camera, *, levels: int = 1, baseline: float = 0.2, eye: str = "left",
             **options) -> StereoFrame:
    pair = stereo_pair(camera, ipd_metres=baseline, source_eye=eye)
    foveation = map_for(camera, (0.5, 0.5), levels)
    return render_stereo(model, pair, config=CONFIG, foveation=foveation, **options)


@pytest.mark.parametrize("eye", ["left", "right"])
@pytest.mark.parametrize(("size", "levels"), [((96, 64), 4), ((75, 41), 2), ((33, 17), 1)])
def test_rendered_tiles_are_those_of_the_whole_target_frame(eye, size, levels):
    frame = two_eyes(ball(levels=levels), view(*size), levels=levels, eye=eye, threshold_deg=14.0)
    whole = pipeline.render_frame(CONFIG, frame.source.words, frame.registers.target)
    direct, again = display_pixels(whole), np.isin(frame.origin, (RENDERED, RERENDERED))
    assert again.any() and not again.all()
    assert np.array_equal(frame.target_pixels[again], direct[again])
    assert np.array_equal(frame.target_pixels[~again], frame.warped.pixels[~again])
    assert not np.isin(frame.warped.origin[~again], (warp_unit.HOLE,)).any()
    assert sum(frame.shares[name] for name in ("rendered", "rerendered", "warped", "background", "filled")) == pytest.approx(1)
    counts, every = np.diff(frame.target.entries.start), np.diff(whole.entries.start)
    assert np.array_equal(counts, np.where(frame.rendered, every, 0))
    pairs = len(whole.entries.splat) + whole.entries.filtered
    assert len(frame.target.entries.splat) + frame.target.entries.filtered == pairs
    assert len(frame.target.headers) == frame.rendered.sum() == frame.events["target_tiles"]


def test_the_source_eyes_colours_are_the_monocular_frames():
    camera, model = view(96, 64), ball(levels=4)
    mono = pipeline.render(model, camera, config=TINY, foveation=map_for(camera, (0.5, 0.5), 4))
    eyes = two_eyes(model, camera, levels=4)
    for name in ("colour", "transmittance"):
        assert np.array_equal(getattr(mono.pixels, name), getattr(eyes.source.pixels, name))
    left, right = eyes.images
    assert np.array_equal(left, display_pixels(mono)["colour"]) and right.shape == left.shape
    mirrored = two_eyes(model, camera, levels=4, eye="right")
    assert np.array_equal(mirrored.images[1], left)


def test_51_everything_and_nothing_is_rendered():
    model = ball()
    everything = two_eyes(model, view(), threshold_deg=180.0)
    assert everything.rendered.all() and (everything.origin == RENDERED).all()
    empty = two_eyes(splats((0, 0, -1)), view(), threshold_deg=0.0, background=(0.2, 0.4, 0.6))
    assert not empty.rendered.any() and (empty.origin == BACKGROUND).all() and empty.warnings == ()
    assert np.array_equal(empty.target_pixels, empty.source_pixels) and len(empty.target.entries.splat) == 0
    none = two_eyes(model, view(), threshold_deg=0.0)
    assert not (none.origin == RENDERED).any() and set(np.unique(none.origin)) >= {RERENDERED, WARPED}


def test_51_without_any_depth_everything_is_rendered():
    veil = splats(*((x, y, 4.0) for x in range(-6, 7) for y in range(-5, 6)), scale=0.9, opacity=0.02)
    frame = two_eyes(veil, view(), threshold_deg=0.0)
    assert frame.rendered.all() and any("no pixel of the source eye has a depth" in w for w in frame.warnings)
    pair = stereo_pair(view(), ipd_metres=0.2)
    veiled = render_stereo(veil, pair, config=VEILS, threshold_deg=0.0)
    assert veiled.shares["warped"] > 0.5 and veiled.warnings == ()


def test_48_a_frame_narrower_than_its_disparities_is_said():
    wall = splats(*((x / 4, y / 4, 1.0) for x in range(-6, 7) for y in range(-5, 6)), scale=0.2, opacity=0.99)
    frame = two_eyes(wall, view(16, 16), baseline=5.0, threshold_deg=0.0)
    assert frame.rendered.all() and any("wider than the frame's 16 pixels" in w for w in frame.warnings)
    huge = stereo_pair(view(16, 16), ipd_metres=1e9)
    assert disparity_scale(CONFIG, huge, 1.0) == (1 << 24) - 1
    with pytest.raises(InputError, match="frames 2048 wide are not accepted"):
        disparity_scale(CONFIG, stereo_pair(view(2048, 16), ipd_metres=1e9), 1.0)


def test_52_gazes():
    pair, display = stereo_pair(view(64, 48), ipd_metres=0.4), Display(64, 48)
    assert target_gaze(pair, (30.0, 20.0), 4.0) == ((25.0, 20.0), None)
    assert target_gaze(stereo_pair(view(64, 48), ipd_metres=0.4, source_eye="right"), (30.0, 20.0), 4.0) == ((35.0, 20.0), None)
    assert target_gaze(pair, (30.0, 20.0), np.nan) == ((30.0, 20.0), None)
    clamped, warning = target_gaze(pair, (3.0, 20.0), 4.0)
    assert clamped == (0.0, 20.0) and "off-screen" in warning and "-2.0" in warning
    model = ball()
    for corner in ((0.0, 0.0), (64.0, 48.0)):
        frame = two_eyes(model, view(64, 48), gaze_target=corner)
        assert frame.gaze[1] == corner
        assert not warpable_tiles(display, corner)[int(corner[1] > 0) * -1, int(corner[0] > 0) * -1]
    for bad in ((-1.0, 5.0), (65.0, 5.0), (5.0, float("nan"))):
        with pytest.raises(InputError, match=r"of the right \(target\) eye is off-screen"):
            two_eyes(model, view(64, 48), gaze_target=bad)
    moving = [two_eyes(model, view(64, 48), gaze_target=(x, 24.0)).rendered for x in (8.0, 30.0, 56.0)]
    assert not np.array_equal(moving[0], moving[2])


@pytest.mark.parametrize("threshold", [-1.0, 180.1, float("nan"), float("inf")])
def test_thresholds_out_of_range(threshold):
    with pytest.raises(InputError, match="eccentricity threshold"):
        two_eyes(ball(), view(), threshold_deg=threshold)


def test_the_threshold_is_the_least_eccentric_pixels():
    display, gaze = Display(70, 50), (20.0, 30.0)
    eccentricity = display.eccentricity(gaze)
    for threshold in (0.0, 10.0, 18.0, 180.0):
        wanted = [[(eccentricity[y : y + 16, x : x + 16] >= threshold).all() for x in range(0, 70, 16)]
                  for y in range(0, 50, 16)]
        assert warpable_tiles(display, gaze, threshold).tolist() == wanted
    assert warpable_tiles(display, (20.5, 30.5), 0.0).all()  # a pixel that is gazed at exactly


def test_machines_without_stereo_are_refused():
    with pytest.raises(ValueError, match="must be a machine with stereo"):
        render_stereo(ball(), stereo_pair(view()), config=TINY)


@pytest.mark.parametrize(("options", "words"), [
    ({"ipd_metres": 0.0}, "IPD 0.0"), ({"ipd_metres": -0.063}, "IPD -0.063"), ({"ipd_metres": float("nan")}, "IPD nan"),
    ({"units_per_metre": 0.0}, "units per metre 0.0"), ({"source_eye": "third"}, "source eye 'third'"),
])
def test_bad_pairs(options, words):
    with pytest.raises(InputError, match=words):
        stereo_pair(view(), **options)


def test_the_pair_is_rectified():
    camera = embedded_cameras()[1]
    for eye, step in (("left", 1), ("right", -1)):
        pair = stereo_pair(camera, ipd_metres=0.063, units_per_metre=2.0, source_eye=eye)
        assert np.allclose(camera.rotation @ (pair.target.position - camera.position), [step * 0.126, 0, 0], atol=1e-12)
        point = np.array([0.3, -0.2, 5.0])
        seen = [c.fx * (c.rotation @ (camera.rotation.T @ (point - camera.translation)) + c.translation)[0] / 5.0 + c.cx
                for c in (pair.source, pair.target)]
        assert seen[1] - seen[0] == pytest.approx(pair.sign * float(pair.disparity(5.0)))


def disparity_errors(model: GaussianModel, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Of all pixels with a depth in both renderers: error of the disparity in pixels, relative error of the depth."""
    pair = stereo_pair(camera)
    frame = pipeline.render(model, camera, config=CONFIG, baseline_px=float(pair.disparity(1.0)))
    exact, records = render_oracle(model, camera), frame_pixels(frame)
    raw = warp_unit.raw_disparity(
        CONFIG, records["transmittance"], records["depth"], disparity_scale(CONFIG, pair, frame.registers.depth_far))
    wanted = pair.disparity(exact.depth)
    both = np.isfinite(exact.depth) & np.isfinite(frame.depth) & (wanted < camera.width)
    assert both.mean() > 0.3
    return np.abs(raw / 256 - wanted)[both], np.abs(frame.depth / exact.depth - 1)[both]


@pytest.mark.parametrize("index", [0, 3])
def test_disparities_of_the_embedded_scene(index):
    """The sky lies 50 times as far as the room: depths err where a part in a thousand of it shines through."""
    pixels, depth = disparity_errors(cached_embedded_model(), embedded_cameras()[index].resized(256, 144))
    assert (pixels <= 1 / 8).mean() >= 0.999
    assert np.median(depth) <= 0.001 and np.percentile(depth, 99) <= 0.01


@pytest.mark.parametrize("scene", ["truck.splat", "rock_sh3"])
def test_disparities_and_depths_of_trained_scenes(scene, data_dir):
    model = load_scene(data_dir / "trained" / scene).model
    pixels, depth = disparity_errors(model, orbit_camera(model, 1, 8, 256, 144))
    assert (pixels <= 1 / 8).mean() >= 0.999
    assert (depth <= 0.002).mean() >= 0.999


def test_depth_saturates_later_where_frames_are_warped():
    """As far out as half an ulp at the 1st percentile of z is worth 1/8 pixel, or at the farthest z."""
    model = splats(*((x / 40, 0, 4.0) for x in range(-49, 50)), (0, 0, 1000.0), scale=0.01)
    mono = pipeline.render(model, view(), config=CONFIG)
    assert mono.registers.depth_far < 500  # four times an interpolated percentile
    far = {px: pipeline.render(model, view(), config=CONFIG, baseline_px=px).registers.depth_far for px in (10.0, 100.0, 1e9)}
    assert far[10.0] == pytest.approx(1000, rel=1e-5) and far[1e9] == mono.registers.depth_far
    assert far[100.0] == pytest.approx(max(2**15 / 8 * 16 / 100, mono.registers.depth_far), rel=1e-5)


def read_pgm(path) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(path))


def test_middlebury_cones_warped_by_their_true_disparity(data_dir, record_property):
    """The left photograph, warped, against the right one: sees the signs, the rounding and the order of depths."""
    folder = data_dir / "stereo" / "cones"
    if not folder.is_dir():
        pytest.skip(f"no Middlebury cones at {folder}")
    left, right, known = (read_pgm(folder / name) for name in ("im2.png", "im6.png", "disp2.pgm"))
    disparity = known / 4.0
    scale = 80000
    frame = np.zeros(known.shape, frame_pixel(CONFIG).dtype)
    frame["colour"] = np.round(left[..., :3] / 255.0 * (1 << N.accumulator.frac_bits))
    frame["transmittance"] = np.where(known > 0, SOLID, VEILED)
    frame["depth"] = np.where(known > 0, np.round(scale * 4095 / np.maximum(known * 64.0, 1)), 0)
    found = warped(frame, scale)
    valid = found.origin == warp_unit.WARPED
    raw = warp_unit.raw_disparity(CONFIG, frame["transmittance"], frame["depth"], scale)
    assert np.abs(raw / 256 - disparity)[known > 0].max() <= 1 / 128
    assert np.array_equal(display_colours(frame), left[..., :3])
    with_warp, without = (psnr_vs(image[valid] / 255.0, right[..., :3][valid] / 255.0)
                          for image in (found.pixels["colour"], left[..., :3]))
    record_property("psnr_warped_db", with_warp)
    record_property("psnr_unwarped_db", without)
    print(f"cones: {with_warp:.2f} dB warped, {without:.2f} dB not, over {valid.mean():.1%} of the pixels")
    assert valid.mean() > 0.7 and with_warp > without + 8


def test_a_warped_eye_is_close_to_the_rendered_one():
    """On the embedded scene: far above showing the source to both eyes."""
    camera = embedded_cameras()[0].resized(256, 144)
    frame = render_stereo(cached_embedded_model(), stereo_pair(camera), config=CONFIG, threshold_deg=0.0)
    whole = display_pixels(pipeline.render_frame(CONFIG, frame.source.words, frame.registers.target))["colour"] / 255.0
    seen = np.isin(frame.origin, (WARPED, FILLED))
    shown, source = frame.target_pixels["colour"] / 255.0, to_bytes(frame.source.image) / 255.0
    assert seen.mean() > 0.2
    assert psnr_vs(shown[seen], whole[seen]) > psnr_vs(source[seen], whole[seen]) + 10
