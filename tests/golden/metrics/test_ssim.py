"""The differentiable SSIM against scikit-image's and against finite differences."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.metrics.image import ssim  # noqa: E402
from golden.metrics.ssim import Ssim  # noqa: E402


def pair(height, width, seed=0, noise=0.1):
    """A smooth picture with flat parts, and the same with noise: float64 (H, W, 3)."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width] / max(height, width)
    reference = 0.5 + 0.4 * np.sin(np.stack([9 * x, 7 * y, 40 * x * y], axis=-1))
    reference[: height // 3, : width // 3] = 0.25  # variance 0: only the stabilisers keep the quotient finite
    return np.clip(reference + rng.normal(0, noise, reference.shape), 0, 1), reference


@pytest.mark.parametrize("height, width", [(11, 11), (11, 40), (43, 42), (74, 75), (106, 149)])  # 10 + 32 is one block
def test_equals_scikit_image(height, width):
    image, reference = pair(height, width)
    expected = ssim(image, reference)
    exact = Ssim(torch.from_numpy(reference))(torch.from_numpy(image))
    assert exact.item() == pytest.approx(expected, abs=1e-12)
    single = Ssim(torch.from_numpy(reference).float())(torch.from_numpy(image).float())
    assert single.dtype == torch.float32 and single.item() == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("noise", [0.002, 0.5])
def test_equals_scikit_image_near_and_far(noise):
    image, reference = pair(60, 90, noise=noise)
    single = Ssim(torch.from_numpy(reference).float())(torch.from_numpy(image).float())
    assert single.item() == pytest.approx(ssim(image, reference), abs=1e-5)


def test_is_one_for_equal_images_and_stationary_there():
    _, reference = pair(40, 50)
    image = torch.from_numpy(reference).requires_grad_()
    value = Ssim(image)(image)
    value.backward()
    assert value.item() == pytest.approx(1, abs=1e-12)
    assert image.grad.abs().max() < 1e-9


def test_gradient_is_that_of_finite_differences():
    image, reference = (torch.from_numpy(a) for a in pair(17, 14))
    metric = Ssim(reference)
    assert torch.autograd.gradcheck(metric, image.requires_grad_(), atol=1e-8, rtol=1e-5)
    assert torch.autograd.gradcheck(metric.map, image, atol=1e-7, rtol=1e-5)


def test_map_is_local():
    image, reference = (torch.from_numpy(a) for a in pair(40, 50))
    metric = Ssim(reference)
    whole = metric.map(image)
    assert whole.shape == (30, 40, 3) and whole.mean().item() == pytest.approx(metric(image).item())
    changed = image.clone()
    changed[20, 25, 1] += 0.3
    y, x, channel = torch.nonzero(metric.map(changed) != whole, as_tuple=True)
    assert (y.min(), y.max(), x.min(), x.max()) == (10, 20, 15, 25)  # windows that hold pixel (20, 25)
    assert set(channel.tolist()) == {1}


@pytest.mark.parametrize(
    "reference, message",
    [(torch.zeros(10, 20, 3), "10, 20"), (torch.zeros(20, 20), "20, 20"), (torch.zeros(20, 20, 3, dtype=torch.uint8), "uint8")],
)
def test_bad_references_are_refused(reference, message):
    with pytest.raises(ValueError, match=message):
        Ssim(reference)


def test_another_size_is_refused():
    with pytest.raises(ValueError, match="12, 20"):
        Ssim(torch.zeros(20, 20, 3))(torch.zeros(12, 20, 3))
