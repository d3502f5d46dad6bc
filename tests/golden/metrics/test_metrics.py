"""Metrics against values known in closed form and against scikit-image."""

import math

import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio

from golden.metrics.image import max_abs_error, psnr, psnr_vs, ssim
from golden.metrics.rings import ring_errors
from golden.scenes.gaze import Display


@pytest.fixture
def pair():
    rng = np.random.default_rng(3)
    a = rng.uniform(0, 1, (24, 31, 3))
    return a, np.clip(a + rng.normal(0, 0.05, a.shape), 0, 1)


def test_psnr_of_a_constant_error_is_known():
    image = np.full((12, 12, 3), 0.5)
    assert psnr(image, image + 0.1) == pytest.approx(20.0)
    assert psnr(np.full((2, 2, 3), 10, np.uint8), np.full((2, 2, 3), 35, np.uint8)) == pytest.approx(20 * math.log10(255 / 25))
    assert psnr(image, image) == math.inf


def test_psnr_is_scikit_images(pair):
    assert psnr(*pair) == pytest.approx(peak_signal_noise_ratio(*pair, data_range=1))
    eight = [(255 * p).astype(np.uint8) for p in pair]
    assert psnr(*eight) == pytest.approx(peak_signal_noise_ratio(*eight))


def test_ssim_is_one_for_equal_images_and_falls_with_noise(pair):
    a, b = pair
    assert ssim(a, a) == pytest.approx(1)
    assert 0 < ssim(a, b) < 1
    # Two constant images: SSIM is the luminance term alone (Wang et al. 2004, equation 6).
    flat = ssim(np.full((16, 16, 3), 0.25), np.full((16, 16, 3), 0.5))
    assert flat == pytest.approx((2 * 0.25 * 0.5 + 1e-4) / (0.25**2 + 0.5**2 + 1e-4))


def test_psnr_vs_shows_images_as_a_display_does():
    a = np.zeros((4, 4, 3))
    a[..., 0] = 3.0  # all above 1 looks alike
    b = a.copy()
    b[..., 0], b[..., 1] = 1.0, -2.0
    assert psnr_vs(a, b) == math.inf and max_abs_error(a, b) == 0
    b[..., 1] = 1e-3
    assert psnr_vs(a, b) == pytest.approx(60 + 10 * math.log10(3))  # one channel of three
    assert max_abs_error(a, b) == pytest.approx(1e-3)


@pytest.mark.parametrize(
    "other", [np.zeros((4, 5, 3)), np.zeros((4, 4, 3), np.uint8)], ids=["shape", "dtype"]
)
def test_unlike_images_are_refused(other):
    with pytest.raises(ValueError, match="not "):
        psnr(np.zeros((4, 4, 3)), other)


def test_rings_part_the_image():
    display = Display(64, 40)
    eccentricity = display.eccentricity((32, 20))
    image = np.zeros((40, 64, 3))
    reference = image + np.where((eccentricity >= 18) & (eccentricity < 27), 0.1, 0.0)[..., None]
    rings = ring_errors(image, reference, eccentricity)
    assert sum(r.pixels for r in rings) == 64 * 40
    assert [r.psnr_db for r in rings] == [math.inf, pytest.approx(20), math.inf, math.inf]
    assert [r.max_abs_error for r in rings] == [0, pytest.approx(0.1), 0, 0]
    empty = ring_errors(image, reference, eccentricity, (0, 89, 89.5))[1]
    assert empty.pixels == 0 and math.isnan(empty.psnr_db) and math.isnan(empty.max_abs_error)
