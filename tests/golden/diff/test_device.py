"""What `--device` names, and what is said where it cannot be had."""

import importlib.util
import os
import sys

import pytest

torch = pytest.importorskip("torch")

from golden.diff import device, import_torch  # noqa: E402
from golden.diff.projection import project_torch  # noqa: E402
from golden.diff.render import render  # noqa: E402
from golden.metrics.hvsq import Hvsq  # noqa: E402
from golden.metrics.ssim import Ssim  # noqa: E402
from golden.training.losses import photometric  # noqa: E402
from golden.training.optimiser import Optimiser, dense_rates  # noqa: E402
from spec.errors import InputError  # noqa: E402
from tests.helpers.training_samples import forward_camera, round_gaussians  # noqa: E402


@pytest.fixture
def gpu(monkeypatch):
    """A machine on which torch sees a GPU."""
    monkeypatch.setattr(torch.version, "cuda", "13.0")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)


def test_cpu_is_always_there():
    assert device.resolve_device("cpu") == torch.device("cpu")


def test_cuda_needs_a_torch_that_can_use_it(monkeypatch):
    monkeypatch.setattr(torch.version, "cuda", None)
    with pytest.raises(InputError, match=r"device cuda cannot be used: torch .* is built for the CPU alone"):
        device.resolve_device("cuda")
    assert device.resolve_device("auto") == torch.device("cpu")


def test_cuda_needs_a_gpu(monkeypatch, gpu):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match="finds no device"):
        device.resolve_device("cuda")
    assert device.resolve_device("auto") == torch.device("cpu")


def test_cuda_needs_warp(monkeypatch, gpu):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"Warp is not installed; the extra 'cuda' has it: make setup EXTRAS=cuda"):
        device.resolve_device("cuda")
    assert device.resolve_device("auto") == torch.device("cpu")


def test_auto_takes_cuda_where_all_is_there(monkeypatch, gpu):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    assert device.resolve_device("auto") == device.resolve_device("cuda") == torch.device("cuda")


def test_other_names_are_refused():
    with pytest.raises(InputError, match="device 'tpu' is not accepted: auto, cpu, cuda are"):
        device.resolve_device("tpu")


def test_backend_follows_the_tensors():
    assert device.resolve_backend(torch.device("cpu"), None) == "numba"
    assert device.resolve_backend(torch.device("cuda", 0), None) == "warp"
    assert device.resolve_backend(torch.device("cpu"), "warp") == "warp"
    with pytest.raises(ValueError, match="not on cuda"):
        device.resolve_backend(torch.device("cuda"), "numba")
    with pytest.raises(ValueError, match="not 'cupy'"):
        device.resolve_backend(torch.device("cpu"), "cupy")


def test_rendering_says_that_warp_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "warp", None)
    for module in ("blend_warp", "pairs_warp", "warp_launch"):
        monkeypatch.delitem(sys.modules, f"golden.training.{module}", raising=False)
        monkeypatch.delattr(f"golden.training.{module}", raising=False)
    with pytest.raises(InputError, match="Warp is not installed"):
        render(round_gaussians([(10.0, 10.0, 1.0, 2.0, 0.5)]), forward_camera(), backend="warp")


def test_losses_stay_on_their_device():
    """On torch's device of tensors without contents, which mixes with the CPU as little as CUDA does."""
    image = torch.rand(48, 64, 3, device="meta", requires_grad=True)
    target = torch.rand(48, 64, 3, device="meta")
    loss = photometric(image, Ssim(target), target) + Hvsq(target, 1.0).absolute(image) + Hvsq(target, 3.0)(image)
    loss.backward()
    assert loss.device.type == image.grad.device.type == "meta"


def test_projection_and_optimiser_stay_on_their_device(monkeypatch):
    monkeypatch.setattr("torch.fx.experimental._config.meta_nonzero_assume_all_nonzero", True)
    gaussians = round_gaussians([(10.0, 10.0, 1.0, 2.0, 0.5), (20.0, 10.0, 1.0, 2.0, 0.5)]).to("meta")
    gaussians.sh_rest = torch.zeros(2, 15, 3, device="meta")
    optimiser = Optimiser(gaussians, dense_rates(0.0, 1.0))
    splats = project_torch(optimiser.gaussians, forward_camera(), 4.5)
    sum(results.sum() for results in (splats.mean2d, splats.factor, splats.opacity, splats.colour, splats.depth)).backward()
    gradients = [tensor.grad for tensor in optimiser.gaussians.tensors().values() if tensor.requires_grad]
    assert gradients and all(gradient.device.type == "meta" for gradient in gradients)
    optimiser.append(gaussians)
    assert {tensor.device.type for tensor in (*vars(splats).values(), *optimiser.gaussians.tensors().values())} == {"meta"}


@pytest.mark.parametrize(("given", "expected"), [
    ({}, "1000"), ({"GOMP_SPINCOUNT": "7"}, "7"), ({"OMP_WAIT_POLICY": "ACTIVE"}, None)])
def test_idle_threads_sleep_unless_the_environment_says_otherwise(monkeypatch, given, expected):
    monkeypatch.setattr(os, "environ", dict(given))
    import_torch()
    assert os.environ.get("GOMP_SPINCOUNT") == expected
