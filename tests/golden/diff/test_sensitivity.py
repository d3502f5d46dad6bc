"""Squared derivatives of an image, against a gradient of each pixel and channel by autograd in float64."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.gaussians import Gaussians  # noqa: E402
from golden.diff.reference import render as reference_render  # noqa: E402
from golden.diff.sensitivity import sensitivity  # noqa: E402
from golden.scenes.camera import Camera  # noqa: E402
from tests.helpers.training_dense_compositor import project  # noqa: E402
from tests.helpers.training_samples import crowd, forward_camera, pixels_covered, round_gaussians  # noqa: E402

BACKGROUND = (0.2, 0.5, 0.1)
CAMERA = Camera(np.eye(3), np.zeros(3), 40.0, 36.0, 12.0, 9.0, 25, 19)
"""25x19 pixels: two tiles each way, the last ones cut by the frame."""

ALPHA_MAX = 0.99


def pixel_gradients(gaussians: Gaussians) -> tuple[torch.Tensor, ...]:
    """d(every pixel and channel) / d(means, log scales, opacity logits), (H, W, 3, N, ...) float64: one backward pass for each,
    through the plain renderer in torch."""
    exact = gaussians.map(lambda tensor: tensor.double())
    leaves = [exact.means.requires_grad_(), exact.log_scales.requires_grad_(), exact.opacity.requires_grad_()]
    image = reference_render(exact, CAMERA, alpha_max=ALPHA_MAX, background=BACKGROUND).image
    each = [torch.autograd.grad(channel, leaves, retain_graph=True) for channel in image.flatten()]
    return tuple(torch.stack(gradients).reshape(*image.shape, *leaf.shape)
                 for gradients, leaf in zip(zip(*each, strict=True), leaves, strict=True))


def falloffs(gaussians: Gaussians) -> torch.Tensor:
    """(H, W, N) g = exp(-q) at every pixel, from another projection."""
    mean2d, conic, *_ = project(gaussians.map(lambda tensor: tensor.double()), CAMERA)
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width] + 0.5
    offset = torch.from_numpy(np.stack([columns, rows], -1))[:, :, None] - mean2d
    return torch.exp(-0.5 * torch.einsum("hwni,nij,hwnj->hwn", offset, conic, offset))


@pytest.fixture(scope="module")
def brute():
    gaussians = crowd()
    return gaussians, pixel_gradients(gaussians)


def test_fisher_is_the_sum_of_outer_products_over_pixels_and_channels(brute):
    gaussians, (means, log_scales, _) = brute
    found = sensitivity(gaussians, CAMERA, alpha_max=ALPHA_MAX, background=BACKGROUND)
    gradients = torch.cat([means, log_scales], -1).reshape(-1, len(gaussians), 6)
    expected = torch.einsum("pni,pnj->nij", gradients, gradients)
    assert found.index.tolist() == list(range(len(gaussians) - 1))
    for k, n in enumerate(found.index):
        scale = torch.sqrt(torch.diagonal(expected[n]))  # each pair of numbers is held to its own size
        assert (scale > 0).all()
        assert torch.allclose(found.fisher[k] / torch.outer(scale, scale), expected[n] / torch.outer(scale, scale), atol=2e-5)
        assert torch.linalg.eigvalsh(found.fisher[k] / torch.outer(scale, scale)).min() > -1e-12


def test_value_is_the_sum_of_squares_over_pixels_and_channels(brute):
    """alpha = o g, so dI/dg = o dI/dalpha = dI/do o / g; and the logit l has do/dl = o (1 - o)."""
    gaussians, (_, _, logits) = brute
    opacity = torch.sigmoid(gaussians.opacity.double())
    by_value = logits / ((1 - opacity) * falloffs(gaussians)[:, :, None])
    expected = by_value.square().sum((0, 1, 2))
    found = sensitivity(gaussians, CAMERA, alpha_max=ALPHA_MAX, background=BACKGROUND, fisher=False)
    assert found.fisher is None
    assert torch.allclose(found.value, expected[found.index], rtol=1e-4)
    both = sensitivity(gaussians, CAMERA, alpha_max=ALPHA_MAX, background=BACKGROUND)
    assert torch.equal(both.value, found.value)


def test_a_lone_splat_by_hand():
    """One grey ball on black: dI_c/dg = o c in every pixel where alpha is not clipped."""
    ball, opacity = round_gaussians([(24.5, 20.5, 2.0, 3.0, 0.8)]), 0.8
    found = sensitivity(ball, forward_camera(), fisher=False)
    assert float(found.value) == pytest.approx(3 * (opacity * 0.5) ** 2 * pixels_covered(3.0, 24.5, 20.5, opacity), rel=1e-5)


def test_threads_change_nothing():
    gaussians, threads = crowd(5), torch.get_num_threads()
    try:
        results = []
        for count in (1, 3):
            torch.set_num_threads(count)
            results.append(sensitivity(gaussians, CAMERA))
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(results[0].fisher, results[1].fisher) and torch.equal(results[0].value, results[1].value)
