"""The Warp kernels, run on Warp's CPU device, against numba's: the same lists, pictures, gradients and statistics.

Once a thread at a time, and once in blocks of 256 threads with their barriers and reductions, as on a GPU.
"""

import gc
import math
import re
import weakref
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

torch = pytest.importorskip("torch")
wp = pytest.importorskip("warp")

from golden.diff import blend_warp, pairs, pairs_warp, projection  # noqa: E402
from golden.diff.gaussians import from_model  # noqa: E402
from golden.diff.render import render  # noqa: E402
from golden.scenes.embedded.scene import cached_embedded_model, embedded_cameras  # noqa: E402
from tests.helpers.training_samples import SIZE, forward_camera, round_gaussians  # noqa: E402

BACKGROUND = (0.25, 0.5, 0.75)


@pytest.fixture(params=[False, True], ids=["threads", "blocks"])
def blocks(request, monkeypatch):
    monkeypatch.setattr(wp.config, "enable_cpu_blocks", request.param)


@pytest.fixture(scope="module")
def embedded():
    """2,000 Gaussians of degree 3 at 58x41, every third amplified: the last tiles are cut."""
    gaussians = from_model(cached_embedded_model(2000, sh_degree=3))
    amplified = replace(gaussians, log_amp=torch.where(torch.arange(len(gaussians)) % 3 == 0, 1.0, 0.0))
    return amplified, embedded_cameras()[0].resized(58, 41)


def drawn(gaussians, camera, backend, **settings):
    """A rendering, and gradients by field of a loss that weighs every pixel of all three results at random."""
    leaves = gaussians.map(lambda tensor: tensor.detach().clone().requires_grad_())
    rendering = render(leaves, camera, background=BACKGROUND, usage=True, backend=backend, **settings)
    results = (rendering.image, rendering.depth_sum, rendering.transmittance)
    generator = torch.Generator().manual_seed(5)
    sum((torch.randn(result.shape, generator=generator) * result).sum() for result in results).backward()
    return rendering, {name: tensor.grad for name, tensor in leaves.tensors().items()}


def check_alike(gaussians, camera, **settings):
    """Both backends' renderings and gradients agree as far as float32 lets them; the Warp rendering."""
    (numba, expected), (warp, found) = (drawn(gaussians, camera, backend, **settings) for backend in ("numba", "warp"))
    far = 1e-5 * max(1.0, float(numba.depth_sum.detach().abs().max()))
    for name in ("image", "depth_sum", "transmittance"):
        assert (getattr(warp, name) - getattr(numba, name)).abs().max() < far, name
    assert warp.entries == numba.entries > 0
    for name in ("index", "tiles", "dominated"):
        assert torch.equal(getattr(warp, name), getattr(numba, name)), name
        assert getattr(warp, name).dtype == getattr(numba, name).dtype
    assert warp.tiles.sum() > 0 and warp.dominated.sum() > 0
    assert torch.allclose(warp.weight, numba.weight, rtol=1e-4, atol=1e-4)
    assert torch.allclose(warp.mean2d.grad, numba.mean2d.grad, rtol=1e-3, atol=1e-4 * float(numba.mean2d.grad.abs().max()))
    for name, gradient in expected.items():
        difference = (found[name] - gradient).abs()
        assert (difference <= 1e-4 * gradient.abs().amax(0, keepdim=True) + 1e-9).all(), f"{name}: {difference.max()}"
    return warp


@pytest.mark.parametrize("alpha_max", [0.99, 1.0])
def test_embedded_scene_is_numbas(embedded, blocks, alpha_max):
    rendering = check_alike(*embedded, alpha_max=alpha_max)
    tiles = math.ceil(58 / 16) * math.ceil(41 / 16)
    assert rendering.entries > 4 * blend_warp.CHUNK * tiles  # several chunks a tile


def test_tiles_that_stop_use_no_more_splats(blocks):
    balls = [(32.0 + i % 5, 30.0 + i % 7, 1.0 + i / 64, 12.0 + i % 3, 0.9) for i in range(90)]
    rendering = check_alike(round_gaussians(balls), forward_camera())
    assert rendering.tiles.max() == 16 and rendering.tiles.min() < 16  # the frame's middle stops, its corners do not
    assert rendering.tiles[-1] < rendering.tiles[:5].min()


def test_alpha_of_one_ends_pixels(blocks):
    rows = [(20.5, 20.5, 1.0, 3.0, 1 - 1e-7), (20.5, 20.5, 2.0, 8.0, 0.9), (40.5, 33.5, 1.5, 5.0, 0.5)]
    gaussians = round_gaussians(rows * 8)  # equal depths: the row decides
    gaussians.log_amp[0] = math.log(20.0)
    gaussians.sh_dc[1] = -1.0
    rendering = check_alike(gaussians, forward_camera(), alpha_max=1.0)
    assert rendering.transmittance[20, 20] == 0 and rendering.image[20, 20].tolist() == [0.5] * 3


def test_masked_tiles_show_the_background(embedded, blocks):
    gaussians, camera = embedded
    mask = torch.zeros(3, 4, dtype=torch.bool)
    mask[1, 0] = mask[2, 3] = True
    rendering = check_alike(gaussians, camera, tile_mask=mask)
    assert torch.equal(rendering.image[:16], torch.tensor(BACKGROUND).expand(16, 58, 3))
    assert set(rendering.tiles.tolist()) <= {0, 1, 2}


def test_support_without_a_bound(embedded, blocks):
    check_alike(*embedded, support_sigma=None)


def test_whole_path_of_a_gpu_is_the_cpus(embedded):
    """Projected by torch's operations, as Gaussians on a GPU are: in float32 a footprint's rim may round to the other side."""
    numba, expected = drawn(*embedded, "numba")
    with mock.patch.object(projection, "_project_kernels", projection.project_torch):
        warp, found = drawn(*embedded, "warp")
    assert (warp.image - numba.image).abs().max() < 0.01 and (warp.image - numba.image).abs().mean() < 1e-5
    assert abs(warp.entries - numba.entries) <= 1e-3 * numba.entries
    for name, gradient in expected.items():
        difference, scale = (found[name] - gradient).abs(), gradient.abs().max()
        assert difference.max() < 0.02 * scale and difference.mean() < 1e-5 * scale, name


@pytest.mark.parametrize("rows", [[(10.0, 10.0, 0.1, 2.0, 0.5)], [(-90.0, 10.0, 1.0, 2.0, 0.5)]], ids=["near", "beside"])
def test_nothing_in_view_is_the_background(rows, blocks):
    rendering, gradients = drawn(round_gaussians(rows), forward_camera(), "warp")
    assert rendering.entries == 0 and len(rendering.tiles) == len(rendering.dominated) == len(rendering.weight)
    assert torch.equal(rendering.image, torch.tensor(BACKGROUND).expand(SIZE, SIZE, 3))
    assert not any(gradient.any() for gradient in gradients.values() if gradient is not None)


def test_a_rendering_repeats_bit_for_bit(embedded, blocks):
    (first, gradients), (second, again) = (drawn(*embedded, "warp") for _ in range(2))
    for name in ("image", "depth_sum", "transmittance", "weight"):
        assert torch.equal(getattr(first, name), getattr(second, name)), name
    assert all(torch.equal(gradient, again[name]) for name, gradient in gradients.items())


def test_no_gradients_nothing_kept(embedded):
    gaussians, camera = embedded
    splats = projection.project(gaussians, camera, 3.0)
    blending = blend_warp.blend(splats, camera, 0.99, BACKGROUND, np.ones((3, 4), bool))[1]
    assert blending._before.numel() == 0
    assert not blending.image.requires_grad


def test_what_is_kept_goes_with_the_rendering(embedded):
    gaussians, camera = embedded
    leaves = gaussians.map(lambda tensor: tensor.detach().clone().requires_grad_())
    splats = projection.project(leaves, camera, 3.0)
    images, blending = blend_warp.blend(splats, camera, 0.99, BACKGROUND, np.ones((3, 4), bool))
    assert blending._before.numel() > 0
    gone = weakref.ref(blending)
    del blending
    assert gone() is not None  # the graph holds it
    gc.disable()
    try:
        del images
        assert gone() is None
    finally:
        gc.enable()


def test_lists_are_numbas(embedded):
    gaussians, camera = embedded
    splats = projection.project(gaussians, camera.resized(200, 152), 3.0)
    tensors = (splats.mean2d, splats.factor.contiguous(), splats.q_max, splats.depth)
    mask = torch.rand(10, 13, generator=torch.Generator().manual_seed(1)) < 0.8
    warp = pairs_warp.tile_lists(*tensors, 200, 152, mask)
    numba = pairs.tile_lists(*(tensor.numpy() for tensor in tensors), 200, 152, mask.numpy())
    for name in ("start", "splat", "pair", "order", "room"):
        assert np.array_equal(getattr(warp, name).numpy(), getattr(numba, name)), name


@pytest.mark.parametrize("module", [blend_warp, pairs_warp])
def test_kernels_compile_for_gpus_and_add_no_floats_atomically(module, tmp_path):
    """On a GPU, atomic additions of floats come in any order: results would differ from run to run."""
    try:
        wp.compile_aot_module(module, arch=75, module_dir=tmp_path, use_ptx=True)
    except RuntimeError as error:
        pytest.skip(f"Warp compiles nothing for CUDA here: {error}")
    (path,) = tmp_path.glob("*.ptx")
    code = path.read_bytes().decode("latin-1")
    assert ".entry" in code
    assert not re.findall(r"\b(?:atom|red)\.(?:\w+\.)*add\.(?:noftz\.)?(?:f|bf)\d+", code)
