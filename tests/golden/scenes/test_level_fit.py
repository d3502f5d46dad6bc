"""Levels that are fitted to a model's own pictures: the gradient, the choice, the result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.metrics.image import psnr_vs
from golden.msv2_ref import pipeline
from golden.scenes import level_fit
from golden.scenes.embedded.scene import cached_embedded_model
from golden.scenes.level_blend import draw, gradient
from golden.scenes.level_fit import enhanced_levels
from golden.scenes.level_views import LevelView, Shapes, look
from golden.scenes.levels import spread_levels
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import orbit_camera
from spec.config import PAPER
from tests.helpers.scenes_samples import float32_model


def ball(n: int = 400, seed: int = 5) -> GaussianModel:
    """A ball of round points, some of them nearly transparent, with harmonics of degree 1."""
    rng = np.random.default_rng(seed)
    model = float32_model(n, levels=1, sh_degree=1)
    means = rng.normal(size=(n, 3))
    means *= rng.random((n, 1)) / np.linalg.norm(means, axis=1, keepdims=True)
    return replace(model, means=means, log_scales=rng.uniform(-3.5, -2, (n, 3)), opacity=rng.uniform(0.05, 0.95, (n, 1)),
                   sh_rest=0.1 * model.sh_rest, quality_bound=np.ones(n, np.uint8))


def few_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes fits take a few small pictures."""
    for name, value in (("WIDTH", 96), ("HEIGHT", 54), ("VIEWS", 6), ("FEWEST_VIEWS", 6)):
        monkeypatch.setattr(level_fit, name, value)


@pytest.fixture
def small(monkeypatch):
    few_pictures(monkeypatch)


def view_of(model: GaussianModel, width: int = 75, height: int = 43) -> LevelView:
    return look(model, Shapes.of(model), orbit_camera(model, 0, 8, width, height))


def picture(view: LevelView, shown: np.ndarray, alpha_max: float = 0.99) -> np.ndarray:
    image = np.empty((view.camera.height, view.camera.width, 4), np.float32)
    draw(view.geometry, shown, view.start, view.splat, view.camera.width, view.camera.height, np.float32(alpha_max), image,
         np.zeros(0, np.float32))
    return image


def shown_by(view: LevelView, model: GaussianModel) -> np.ndarray:
    return level_fit._look(view, level_fit._log2(model.opacity[:, 0]), model.sh_dc[:, 0].astype(np.float32))


def test_pictures_and_intersections_are_those_of_the_machine():
    for model in (ball(), cached_embedded_model()):
        view = view_of(model)
        image, frame = picture(view, shown_by(view, model)), pipeline.render(model, view.camera, config=PAPER)
        assert psnr_vs(image[..., :3].astype(float), frame.image) > 50
        assert np.abs(image[..., 3] - frame.transmittance).max() < 0.02
        met = view.tiles_met(len(model))
        assert np.isclose(met.sum(), len(frame.entries.splat), rtol=0.1)  # a support of 3 sigma, whatever the opacity
        share = (met >= np.bincount(frame.entries.splat, minlength=len(model))).mean()
        assert share > 0.97  # the machine widens its test a little


def test_points_that_are_dropped_leave_the_lists():
    model = ball()
    chosen = np.arange(len(model)) % 3 > 0
    view, fewer = view_of(model), view_of(model)
    fewer.keep(chosen)
    np.testing.assert_array_equal(fewer.tiles_met(len(model)), np.where(chosen, view.tiles_met(len(model)), 0))
    dark = shown_by(view, model)
    dark[~chosen[view.index], 1] = -1  # no exponent is covered
    np.testing.assert_allclose(picture(fewer, shown_by(fewer, model)), picture(view, dark), atol=1e-6)


def test_the_gradient_is_that_of_finite_differences():
    model = ball(60)
    view, rng = view_of(model), np.random.default_rng(1)
    shown = shown_by(view, model)
    shown[:, 1] = np.minimum(shown[:, 1], 4)  # the border of a splat must not move with its opacity
    slope = rng.normal(size=(view.camera.height, view.camera.width, 4)).astype(np.float32)
    found = np.zeros((len(shown), 4), np.float32)
    gradient(view.geometry, shown, view.start, view.splat, view.camera.width, view.camera.height, np.float32(1),
             picture(view, shown, 1), slope, found)
    for row in rng.choice(len(shown), 8, replace=False):
        for column, (place, unit) in enumerate(((0, 1 / np.log(2)), (2, 1), (3, 1), (4, 1))):
            step, sums = 2e-2, []
            for sign in (1, -1):
                moved = shown.copy()
                moved[row, place] += np.float32(sign * step * unit)
                sums.append((picture(view, moved, 1).astype(float) * slope).sum())
            assert found[row, column] == pytest.approx((sums[0] - sums[1]) / (2 * step), abs=2e-2, rel=2e-2)


def test_levels_are_nested_and_closer_to_the_model_than_spread_ones(small):
    model = ball()
    told = []
    made, spread = enhanced_levels(model, progress=lambda *numbers: told.append(numbers)), spread_levels(model)
    assert told[-1] == (sum(level_fit.STEPS),) * 2 and len(told) == sum(level_fit.STEPS)
    counts = [int((made.quality_bound > level).sum()) for level in range(4)]
    assert counts[0] == len(model) > counts[1] > counts[2] > counts[3] > 0
    np.testing.assert_array_equal(made.opacity[:, 0], model.opacity[:, 0])
    np.testing.assert_array_equal(made.sh_dc[:, 0], model.sh_dc[:, 0])
    np.testing.assert_array_equal(made.sh_rest, model.sh_rest)
    assert 0 < made.opacity.min() and made.opacity.max() <= 128
    view = view_of(model, 96, 54)  # none of the cameras that the levels were fitted to
    full = picture(view, shown_by(view, model))[..., :3].astype(float)

    def quality(leveled: GaussianModel) -> float:
        """PSNR of L4 in the whole frame."""
        seen = view_of(model, 96, 54)
        seen.keep(leveled.quality_bound == 4)
        shown = level_fit._look(seen, level_fit._log2(leveled.opacity[:, 3]), leveled.sh_dc[:, 3].astype(np.float32))
        return psnr_vs(picture(seen, shown, 1)[..., :3].astype(float), full)

    assert quality(made) > quality(spread) + 3


def test_the_same_arguments_give_the_same_levels(small):
    model = ball(120)
    first, again, other = enhanced_levels(model), enhanced_levels(model), enhanced_levels(model, seed=1)
    for name in ("quality_bound", "opacity", "sh_dc"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert (first.opacity != other.opacity).any()
    fewer = enhanced_levels(model, 2)
    np.testing.assert_array_equal(fewer.quality_bound, np.minimum(first.quality_bound, 2))
    np.testing.assert_array_equal(fewer.opacity, first.opacity[:, :2])
    assert enhanced_levels(model, 1).levels == 1
    with pytest.raises(ValueError, match="not 5"):
        enhanced_levels(model, 5)


def test_points_that_no_camera_sees_have_spread_levels(small, monkeypatch):
    model = ball(300)
    above = [orbit_camera(model, 0, 8, 96, 54, radius=0.3)]  # inside the ball, so it looks away from half of it
    monkeypatch.setattr(level_fit, "cameras", lambda _: above)
    seen = look(model, Shapes.of(model), above[0]).tiles_met(len(model)) > 0
    made, spread = enhanced_levels(model), spread_levels(model)
    assert 0 < seen.sum() < len(model)
    np.testing.assert_array_equal(made.quality_bound[~seen], spread.quality_bound[~seen])
    used = np.arange(4) < spread.quality_bound[~seen, None]
    wanted = np.where(used, spread.opacity[~seen], model.opacity[~seen])
    np.testing.assert_array_equal(made.opacity[~seen], wanted)


def test_one_point_can_have_levels(small):
    model = ball(5).select(np.array([1]))
    assert enhanced_levels(model).quality_bound[0] == 4


def test_the_cameras_are_none_of_the_projects_own():
    model = ball()
    own = np.array([orbit_camera(model, i, 8, 640, 360).position for i in range(8)])
    for camera in level_fit.cameras(model):
        assert np.linalg.norm(own - camera.position, axis=1).min() > 0.01 * np.linalg.norm(own[0] - own[4])
