"""Frames of two eyes: who is rendered, who is warped, and with what settings; hard cases 48, 51 and 52.

Hard cases: 48 disparity beyond the row · 51 re-render list empty and full · 52 gaze off-screen, in a corner, moving.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.host.stereo_registers import disparity_scale
from golden.metrics.image import psnr_vs
from golden.msv2_ref import pipeline, warp
from golden.msv2_ref.eyes import BACKGROUND, FILLED, RENDERED, RERENDERED, WARPED, StereoFrame, render_stereo
from golden.msv2_ref.frame_memory import display_pixels, frame_pixels
from golden.oracle.render import render as render_oracle
from golden.scenes.camera import Camera
from golden.scenes.embedded.scene import cached_embedded_model, embedded_cameras
from golden.scenes.gaze import Display
from golden.scenes.load import load_scene
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import orbit_camera
from golden.scenes.pictures import to_bytes
from golden.scenes.stereo import stereo_pair, target_gaze, warpable_tiles
from spec.config import TINY
from spec.errors import InputError
from tests.helpers.golden_samples import map_for, random_model, splats, view

CONFIG = TINY.with_(name="stereo", stereo=True)
VEILS = CONFIG.with_(warp_veiled=True)


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
    assert not np.isin(frame.warped.origin[~again], (warp.HOLE,)).any()
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


def test_51_without_any_depth_but_with_some_background_everything_with_holes_is_rendered():
    veil = splats(*((x / 8, y / 8, 4.0) for x in range(-6, 7) for y in range(-5, 6)), scale=0.1, opacity=0.02)
    frame = two_eyes(veil, view(), threshold_deg=0.0)
    transmittance = frame_pixels(frame.source)["transmittance"]
    assert transmittance.max() == CONFIG.formats.transmittance.raw_max > transmittance.min()
    assert any("no pixel of the source eye has a depth" in w for w in frame.warnings)


def test_48_a_frame_narrower_than_its_disparities_is_said():
    wall = splats(*((x / 4, y / 4, 1.0) for x in range(-6, 7) for y in range(-5, 6)), scale=0.2, opacity=0.99)
    frame = two_eyes(wall, view(16, 16), baseline=5.0, threshold_deg=0.0)
    assert frame.rendered.all() and any("wider than the frame's 16 pixels" in w for w in frame.warnings)
    huge = stereo_pair(view(16, 16), ipd_metres=1e9)
    assert disparity_scale(CONFIG, huge, 1.0) == (1 << 24) - 1
    huge = stereo_pair(view(2048, 16), ipd_metres=1e9)
    assert disparity_scale(CONFIG, huge, 1.0) == (1 << 24) - 1  # beyond what it reaches
    with pytest.raises(InputError, match="frames 2048 wide are not accepted"):
        disparity_scale(CONFIG.with_(row_width=2048, warp_columns=2048), huge, 1.0)
    narrow, pair = CONFIG.with_(warp_columns=64), stereo_pair(view(64, 16), ipd_metres=1.1)
    frame = render_stereo(wall, pair, config=narrow, threshold_deg=0)
    assert any("wider than the 48 pixels that the machine moves them by" in w for w in frame.warnings)


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
    raw = warp.raw_disparity(
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


def test_a_warped_eye_is_close_to_the_rendered_one():
    """On the embedded scene: far above showing the source to both eyes."""
    camera = embedded_cameras()[0].resized(256, 144)
    frame = render_stereo(cached_embedded_model(), stereo_pair(camera), config=CONFIG, threshold_deg=0.0)
    whole = display_pixels(pipeline.render_frame(CONFIG, frame.source.words, frame.registers.target))["colour"] / 255.0
    seen = np.isin(frame.origin, (WARPED, FILLED))
    shown, source = frame.target_pixels["colour"] / 255.0, to_bytes(frame.source.image) / 255.0
    assert seen.mean() > 0.2
    assert psnr_vs(shown[seen], whole[seen]) > psnr_vs(source[seen], whole[seen]) + 10
