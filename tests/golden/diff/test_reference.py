"""The plain torch renderer is an independent opinion: it must agree with the oracle, and the trained renderer with it."""

import math
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff import reference  # noqa: E402
from golden.diff.gaussians import from_model, to_model  # noqa: E402
from golden.diff.projection import project, project_torch  # noqa: E402
from golden.diff.render import render  # noqa: E402
from golden.oracle.render import render as render_oracle  # noqa: E402
from golden.scenes.embedded.scene import cached_embedded_model, embedded_cameras  # noqa: E402
from spec.guard_band import UNBOUNDED  # noqa: E402
from tests.helpers.training_samples import SIZE, forward_camera, round_gaussians  # noqa: E402

BACKGROUND = (0.25, 0.5, 0.75)


@pytest.fixture(scope="module")
def embedded():
    """2,000 Gaussians of degree 3 at 58x41: the last tiles are cut."""
    return from_model(cached_embedded_model(2000, sh_degree=3)), embedded_cameras()[0].resized(58, 41)


def test_draws_the_oracles_picture(embedded):
    gaussians, camera = embedded
    oracle = render_oracle(to_model(gaussians, up=np.array([0.0, -1, 0]), name="e"), camera, background=BACKGROUND)
    assert 0.01 < oracle.transmittance.mean() < 0.9
    for dtype, far in ((torch.float32, 2e-5), (torch.float64, 1e-6)):
        drawn = reference.render(gaussians.map(lambda tensor, dtype=dtype: tensor.to(dtype)), camera, background=BACKGROUND)
        assert drawn.image.dtype == dtype
        assert np.abs(drawn.image.numpy() - oracle.image).max() < far
        assert np.abs(drawn.transmittance.numpy() - oracle.transmittance).max() < far
        depth = drawn.depth_sum.numpy() / (1 - drawn.transmittance.numpy())
        valid = np.isfinite(oracle.depth)
        assert valid.any() and np.abs(depth[valid] / oracle.depth[valid] - 1).max() < 10 * far


@pytest.mark.parametrize("support_sigma", [3.0, None])
def test_alpha_of_one_shows_and_ends_the_pixel(support_sigma):
    camera = forward_camera()
    rows = [(20.5, 20.5, 1.0, 3.0, 1 - 1e-7), (20.5, 20.5, 2.0, 8.0, 0.9), (40.5, 33.5, 1.5, 5.0, 0.5)]
    gaussians = round_gaussians(rows)
    gaussians.log_amp[0] = math.log(20.0)
    gaussians.sh_dc[1] = -1.0
    oracle = render_oracle(
        to_model(gaussians, up=np.array([0.0, -1, 0]), name="e"), camera, support_sigma=support_sigma, alpha_max=(1.0,))
    drawn = reference.render(gaussians, camera, alpha_max=1.0, support_sigma=support_sigma)
    assert drawn.transmittance[20, 20] == 0 and drawn.image[20, 20].tolist() == [0.5] * 3
    assert np.abs(drawn.image.numpy() - oracle.image).max() < 1e-5
    assert np.abs(drawn.transmittance.numpy() - oracle.transmittance).max() < 1e-5


def test_all_renderers_have_the_same_guard_band():
    """Giants two pixels inside and outside of each of its ends, along x and along y."""
    camera, end = forward_camera(), 1 << 14
    near = [(side * (end + off) if axis == 0 else 20.0, side * (end + off) if axis == 1 else 20.0, 0.25, 16000.0, 0.4)
            for axis in (0, 1) for side in (1, -1) for off in (-2, 2)]
    gaussians = round_gaussians(near)
    inside = [0, 2, 4, 6]
    assert project(gaussians, camera, 3.0).index.tolist() == inside
    assert project_torch(gaussians, camera, 4.5).index.tolist() == inside
    for draw in (project(gaussians, camera, 3.0, UNBOUNDED), project_torch(gaussians, camera, 4.5, UNBOUNDED)):
        assert len(draw.index) == 8
    oracle = render_oracle(to_model(gaussians, up=np.array([0.0, -1, 0]), name="e"), camera)
    assert oracle.culled["outside"] == 4 and oracle.coverage.min() > 0.3
    for drawn in (reference.render(gaussians, camera), render(gaussians, camera)):
        assert np.abs(drawn.image.numpy() - oracle.image).max() < 1e-4


def test_nothing_in_view_is_the_background():
    gaussians = round_gaussians([(10.0, 10.0, 0.1, 2.0, 0.5)])  # nearer than the near plane
    drawn = reference.render(gaussians, forward_camera(), background=BACKGROUND)
    assert torch.equal(drawn.image, torch.tensor(BACKGROUND).expand(SIZE, SIZE, 3))
    assert (drawn.transmittance == 1).all() and (drawn.depth_sum == 0).all()


def gradients(draw, gaussians, camera, alpha_max):
    """Image, and gradients by field of a loss that weighs every pixel of all three results at random."""
    leaves = gaussians.map(lambda tensor: tensor.detach().clone().requires_grad_())
    drawn = draw(leaves, camera, alpha_max=alpha_max, background=BACKGROUND)
    results = (drawn.image, drawn.depth_sum, drawn.transmittance)
    generator = torch.Generator().manual_seed(5)
    sum((torch.randn(result.shape, generator=generator) * result).sum() for result in results).backward()
    return drawn.image.detach(), {name: tensor.grad for name, tensor in leaves.tensors().items()}


@pytest.mark.parametrize("alpha_max", [0.99, 1.0])
def test_trained_renderers_gradients_are_autograds(embedded, alpha_max):
    gaussians, camera = embedded
    amplified = replace(gaussians, log_amp=torch.where(torch.arange(len(gaussians)) % 3 == 0, 1.0, 0.0))
    precise_image, precise = gradients(
        reference.render, amplified.map(lambda tensor: tensor.double()), camera, alpha_max)
    image, ours = gradients(render, amplified, camera, alpha_max)
    assert (image - precise_image).abs().max() < 2e-5
    for name, expected in precise.items():
        scale = expected.abs().max()
        assert scale > 0, name
        difference = (ours[name] - expected).abs()
        # A pixel on the threshold of a splat's support falls to either side in float32: the largest may be such a pixel's.
        assert difference.max() < 0.02 * scale, name
        assert difference.mean() < 1e-5 * scale, name
