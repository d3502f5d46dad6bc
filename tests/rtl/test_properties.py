"""Properties of the integer renderer for any model, camera and gaze: drawn by Hypothesis, shrunk to the smallest that fails.

The quick runs draw the same few examples every time, the long ones more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, find, given, settings
from hypothesis import strategies as st
from hypothesis.errors import NoSuchExample

from golden.msv2_ref import projection
from golden.msv2_ref.frame_memory import frame_pixels
from golden.msv2_ref.pipeline import render
from golden.oracle.render import render as oracle
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.model import GaussianModel
from msv2.cases.case import RIM
from msv2.cases.golden_faults import FAULTS
from msv2.cases.makers import splats
from spec.config import TINY
from spec.memory import frame_pixel

SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large]
QUICK = settings(max_examples=15, derandomize=True, deadline=None, database=None, suppress_health_check=SLOW)
LONG = settings(QUICK, max_examples=400)
N = TINY.formats


def real(low: float, high: float) -> st.SearchStrategy[float]:
    """float32 numbers of a range; shrink towards simple ones."""
    return st.floats(low, high, width=32)


POINT = st.tuples(
    st.tuples(real(-3, 3), real(-3, 3), real(-1, 6)), st.tuples(*[real(-14, 6)] * 3), st.tuples(*[real(-1, 1)] * 4),
    st.one_of(real(0, 1), real(0, 128)), st.tuples(*[real(-1, 3)] * 3))
"""Mean, log scales, quaternion, opacity, colour."""


@st.composite
def models(draw: st.DrawFn, levels: int = 1, least: int = 0) -> GaussianModel:
    """Up to six Gaussians: needles, discs, giants, dots, opacities up to 128, colours below 0 and far above 1."""
    points = draw(st.lists(POINT, min_size=least, max_size=6))
    made = splats(*(point[0] for point in points), colour=[point[4] for point in points] or (0, 0, 0), levels=levels,
                  opacity=[point[3] for point in points] or 0.0)
    if not points:
        return made
    quats = np.array([point[2] if any(point[2]) else (1, 0, 0, 0) for point in points], float)
    bound = draw(st.lists(st.integers(1, levels), min_size=len(points), max_size=len(points)))
    return replace(made, log_scales=np.array([point[1] for point in points], float), quats=quats,
                   quality_bound=np.array(bound, np.uint8))


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    """Frames of up to 3x3 tiles, of any focal length and principal point, turned about the vertical."""
    width, height = draw(st.integers(1, 40)), draw(st.integers(1, 40))
    turn = draw(real(-0.5, 0.5))
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    fx, fy = draw(real(5, 200)), draw(real(5, 200))
    cx, cy = draw(real(0, 1)) * width, draw(real(0, 1)) * height
    return Camera(rotation, np.array([0.0, 0.0, draw(real(-1, 1))]), fx, fy, cx, cy, width, height)


def fits_its_records(model: GaussianModel, camera: Camera) -> None:
    """Every point has a reason, every entry a tile of the frame, every pixel fits its record; twice the same bits."""
    frame = render(model, camera, config=TINY, background=(0.5, 0.25, 1.0))
    reason, key = frame.projected.reason, frame.projected.depth_key
    assert len(reason) == len(model) and (reason <= projection.OUTSIDE).all()
    conic = frame.projected.conic
    assert np.isfinite(conic).all() and (conic[reason == projection.VISIBLE][:, [0, 2]] > 0).all()
    assert ((key >= 0) & (key <= N.depth_key.raw_max)).all()
    assert len(frame.entries.start) == frame.registers.tiles_x * frame.registers.tiles_y + 1
    pixels = frame_pixels(frame)
    for f in frame_pixel(TINY).fields:
        low, high = f.raw_range
        assert ((pixels[f.name] >= low) & (pixels[f.name] <= high)).all(), f.name
    assert (pixels["transmittance"] <= N.transmittance.raw_max).all()
    again = render(model, camera, config=TINY, background=(0.5, 0.25, 1.0))
    assert np.array_equal(frame_pixels(again), pixels)


def covers_as_the_oracle(model: GaussianModel, camera: Camera) -> None:
    """Coverage does not hang on the order: within a rounding of float64's, but for the rim of 3 sigma of every splat, where an
    opacity above 1 is as much higher."""
    wide = np.exp(model.log_scales.max(axis=1, initial=-20.0)) < 50.0
    model = model.select(wide)
    n = render(model, camera, config=TINY)
    ours = N.transmittance.to_float(N.transmittance.raw_max) - n.transmittance
    error = np.abs(ours - oracle(model, camera).coverage)
    assert np.median(error) <= 1 / 255
    assert error.max() <= np.maximum(model.opacity[:, 0], 1).sum() * RIM + 1 / 255


def pixels_stay(model: GaussianModel, camera: Camera, beta: int, rows: list[int]) -> None:
    """No merge threshold, no tile test and, where all keys differ, no order of the input changes a bit."""
    frame = render(model, camera, config=TINY)
    wanted = frame_pixels(frame)
    assert np.array_equal(frame_pixels(render(model, camera, config=TINY, beta=beta)), wanted)
    assert np.array_equal(frame_pixels(render(model, camera, config=TINY, obb=True)), wanted)
    keys = frame.projected.depth_key[frame.projected.reason == projection.VISIBLE]
    if len(set(keys.tolist())) == len(keys):
        order = np.argsort(rows[: len(model)], kind="stable")
        assert np.array_equal(frame_pixels(render(model.select(order), camera, config=TINY)), wanted)


def gazes_hold(model: GaussianModel, size: tuple[int, int], gaze: tuple[float, float], fov: float) -> None:
    """Wherever the eye looks on the display: finite planes, level 1 there, weights in 0..1, a frame that fits its records."""
    width, height = size
    x, y = gaze[0] * width, gaze[1] * height
    found = foveation_map(Display(width, height, fov), (x, y), model.levels)
    assert found.tile_level[min(int(y), height - 1) // 16, min(int(x), width - 1) // 16] == 0
    assert np.isfinite(found.plane).all() and (found.tile_level < model.levels).all()
    for weights in (found.blend_weights_exact, found.blend_weights_plane):
        assert ((weights >= 0) & (weights <= 1)).all()
    camera = Camera(np.eye(3), np.zeros(3), 30.0, 30.0, width / 2, height / 2, width, height)
    frame = render(model, camera, config=TINY, foveation=found)
    pixels = frame_pixels(frame)
    assert (pixels["transmittance"] <= N.transmittance.raw_max).all() and (pixels["colour"] >= 0).all()
    level = np.repeat(found.tile_level.ravel(), np.diff(frame.entries.start))
    assert (model.quality_bound[frame.entries.splat] > level).all()


def needle() -> GaussianModel:
    """A splat of opacity 3, whose rim covers a pixel by 0.0334 in the oracle alone."""
    return replace(splats((0.08, 0.09, 2.17), opacity=3.0), log_scales=np.array([[-3.9, -1.7, -1.7]]),
                   quats=np.array([[1.03, 0.16, 0.62, 1.63]]))


ANY_FRAME = (models(), cameras())
ANY_MERGE = (models(), cameras(), st.integers(0, 50), st.lists(st.integers(0, 9), min_size=6, max_size=6))
ANY_GAZE = (models(levels=4), st.tuples(st.integers(1, 60), st.integers(1, 60)), st.tuples(real(0, 1), real(0, 1)),
            real(1, 179))


@QUICK
@given(*ANY_FRAME)
def test_any_frame_fits_its_records(model, camera):
    fits_its_records(model, camera)


@QUICK
@given(*ANY_FRAME)
@example(needle(), Camera(np.eye(3), np.zeros(3), 24.5, 156.0, 2.0, 19.5, 4, 39))
def test_any_frame_covers_as_the_oracle(model, camera):
    covers_as_the_oracle(model, camera)


@QUICK
@given(*ANY_MERGE)
def test_pixels_stay_whatever_is_merged(model, camera, beta, rows):
    pixels_stay(model, camera, beta, rows)


@QUICK
@given(*ANY_GAZE)
def test_any_gaze_holds(model, size, gaze, fov):
    gazes_hold(model, size, gaze, fov)


@pytest.mark.long
@LONG
@given(*ANY_FRAME)
def test_many_frames_fit_their_records_and_cover_as_the_oracle(model, camera):
    fits_its_records(model, camera)
    covers_as_the_oracle(model, camera)


@pytest.mark.long
@LONG
@given(*ANY_MERGE)
def test_many_pixels_stay_whatever_is_merged(model, camera, beta, rows):
    pixels_stay(model, camera, beta, rows)


@pytest.mark.long
@LONG
@given(*ANY_GAZE)
def test_many_gazes_hold(model, size, gaze, fov):
    gazes_hold(model, size, gaze, fov)


@pytest.mark.long
def test_a_seeded_fault_shrinks_to_one_splat():
    """Without the near plane's cull some drawn model fails, and what is reported is a single point behind the camera."""
    camera = Camera(np.eye(3), np.zeros(3), 30.0, 30.0, 8.0, 8.0, 16, 16)
    fault = next(fault for fault in FAULTS if fault.name == "no near plane")

    def fails(model: GaussianModel) -> bool:
        near = oracle(model, camera).culled["near"]
        return int((render(model, camera, config=TINY).projected.reason == projection.NEAR).sum()) != near

    with pytest.raises(NoSuchExample):
        find(models(), fails, settings=settings(QUICK, max_examples=15))
    with fault.drop(), np.errstate(all="ignore"):
        smallest = find(models(), fails, settings=settings(QUICK, max_examples=60))
    assert len(smallest) == 1 and smallest.means[0, 2] <= camera.near
