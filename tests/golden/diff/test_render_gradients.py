"""Gradients of the differentiable renderer: against torch's on a dense float64 compositor, against finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.gaussians import to_model  # noqa: E402
from golden.diff.projection import project, project_torch  # noqa: E402
from golden.diff.render import render  # noqa: E402
from golden.oracle.render import render as render_oracle  # noqa: E402
from tests.helpers.training_scenes import (  # noqa: E402
    BACKGROUND,
    CAMERA,
    check_against_dense,
    gradients,
    images,
    random_gaussians,
    random_loss,
    single,
    tilted_camera,
    trainable,
)

UP = np.array([0.0, -1.0, 0.0])


@pytest.mark.parametrize(("coefficients", "alpha_max"), [(0, 1.0), (3, 0.99), (8, 1.0), (15, 0.99)])
def test_random_scenes(coefficients, alpha_max):
    for camera in (CAMERA, tilted_camera()):
        check_against_dense(random_gaussians(60, coefficients, coefficients), camera, alpha_max)


def test_without_support_bound():
    check_against_dense(random_gaussians(60, 20), CAMERA, 0.99, support_sigma=None)


def test_finite_differences_of_the_oracle():
    gaussians, camera, step = random_gaussians(6, 5, 3, amplified=False), CAMERA.resized(29, 21), 1e-6
    gaussians.opacity.clamp_(-2, 2)
    ours = gradients(gaussians, lambda g: [render(g, camera, background=BACKGROUND).image])
    model = to_model(gaussians, up=UP, name="random")
    logits = np.log(model.opacity / (1 - model.opacity))

    def loss(name, values):
        changed = replace(model, opacity=1 / (1 + np.exp(-values))) if name == "opacity" else replace(model, **{name: values})
        shown = render_oracle(changed, camera, background=BACKGROUND).image
        return float(random_loss([torch.from_numpy(shown)], 1))

    for name in ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest"):
        values = logits if name == "opacity" else getattr(model, name)
        numeric = np.zeros(values.size)
        for k in range(values.size):
            nudge = np.zeros(values.size)
            nudge[k] = step
            nudge = nudge.reshape(values.shape)
            numeric[k] = (loss(name, values + nudge) - loss(name, values - nudge)) / (2 * step)
        error = np.abs(ours[name].numpy().ravel() - numeric)
        assert error.max() <= 1e-4 * np.abs(numeric).max(), name


def test_alpha_of_one_and_no_light_left():
    behind = [[0.0, 0.0, 2.0], [0.05, 0.0, 3.0], [0.0, 0.05, 4.0]]
    camera = replace(CAMERA, cx=25.5, cy=18.5)  # the first mean is a pixel's centre: alpha is 1 and T is 0, exactly
    opaque = single(means=behind, opacity=[16.0, 1.0, 16.0], log_amp=[0.7, 0.0, 0.0], sh_dc=[[0.3, 1.0, 0.1]])
    found = check_against_dense(opaque, camera, 1.0)
    shown = render(opaque, camera, alpha_max=1.0)
    assert shown.transmittance[18, 25] == 0.0
    assert (found["means"][0] != 0).all() and (found["means"][1] != 0).all()

    trained = trainable(opaque)
    render(trained, camera, alpha_max=1.0).image[18, 25].sum().backward()  # only the first splat's colour shows here
    assert (trained.sh_dc.grad[0] > 0).all() and (trained.sh_dc.grad[1:] == 0).all()
    assert (trained.opacity.grad == 0).all() and (trained.means.grad == 0).all()  # clipped, and hidden


def test_saturated_stack():
    stack = single(means=[[0.02 * k, 0.0, 2.0 + 0.1 * k] for k in range(80)], opacity=[3.0], log_scales=[[-1.0, -1.2, -1.1]],
                   sh_dc=[[0.02 * k, 0.5 - 0.01 * k, 0.1] for k in range(80)])
    for alpha_max in (0.99, 1.0):
        found = check_against_dense(stack, CAMERA, alpha_max)
        assert (found["sh_dc"][40:].abs() < found["sh_dc"].abs().max()).all()


def test_clipped_opacity_has_no_gradient():
    clipped = single(opacity=[8.0], log_amp=[3.0], log_scales=[[4.0, 4.0, 4.0]])  # above alpha_max in every pixel
    for alpha_max in (0.99, 1.0):
        found = check_against_dense(clipped, CAMERA, alpha_max)
        assert (found["opacity"] == 0).all() and (found["means"][:, :2] == 0).all() and (found["sh_dc"] != 0).all()


def test_amplifier_beyond_its_bound_has_no_gradient():
    found = check_against_dense(single(log_amp=[6.0], opacity=[2.0]), CAMERA, 1.0)
    assert (found["log_amp"] == 0).all() and (found["sh_dc"] != 0).all()


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2])
def test_needles(angle):
    quat = [[np.cos(angle / 2), 0.1, 0.0, np.sin(angle / 2)]]
    for scales in ([[1.0, -9.0, -9.0]], [[0.0, -6.0, -8.0]], [[-1.0, -float("inf"), -9.0]]):
        needle = single(log_scales=scales, quats=quat)
        check_against_dense(needle, CAMERA, 0.99, bound=2e-4)  # float32 offsets times a steep falloff


def test_needle_beyond_the_frustum_margin():
    """Its mean lies where the Jacobian is clamped, its end in the frame."""
    needle = single(means=[[2.9, 0.3, 2.0]], log_scales=[[0.5, -3.0, -3.0]], quats=[[1.0, 0.0, 0.1, 0.05]], opacity=[2.0])
    found = check_against_dense(needle, CAMERA, 0.99, bound=2e-4)
    assert render(needle, CAMERA).tiles[0] > 0 and (found["means"] != 0).all()


def test_near_plane():
    means = [[0.001, 0.0, 0.2001], [0.0, 0.0, 0.1999], [0.1, 0.0, 0.19], [0.0, 0.01, 0.25]]
    found = check_against_dense(single(means=means, log_scales=[[-5.0, -5.2, -4.8]]), CAMERA, 0.99, bound=1e-4)
    assert (found["means"][[1, 2]] == 0).all() and (found["means"][[0, 3]] != 0).any(1).all()


def test_colour_below_zero_has_no_gradient():
    found = check_against_dense(single(sh_dc=[[-3.0, 0.2, -1.78]]), CAMERA, 0.99)
    assert found["sh_dc"][0, 0] == 0 and found["sh_dc"][0, 2] == 0 and found["sh_dc"][0, 1] != 0


def test_background_alone_has_no_gradient():
    far = single(means=[[0.0, 0.0, 2.0]], log_scales=[[-6.0, -6.0, -6.0]])
    trained = trainable(far)
    shown = render(trained, CAMERA, background=BACKGROUND)
    lit = shown.transmittance < 1
    assert lit.any()
    shown.image[~lit].sum().backward()
    assert all((tensor.grad == 0).all() for tensor in trained.tensors().values())


@pytest.mark.parametrize("count", [0, 3])
def test_nothing_in_view(count):
    nothing = random_gaussians(count, 0)
    nothing.means[:, 2] -= 50
    trained = trainable(nothing)
    shown = render(trained, CAMERA, background=BACKGROUND, usage=True)
    assert torch.equal(shown.image, torch.tensor(BACKGROUND).expand(37, 53, 3))
    assert shown.entries == 0 and len(shown.index) == 0 and len(shown.weight) == 0
    random_loss(images(shown), 0).backward()
    assert all((tensor.grad == 0).all() for tensor in trained.tensors().values())


def test_enormous_splats():
    vast = single(log_scales=[[25.0, 20.0, 25.0], [200.0, 200.0, 200.0], [88.0, -9.0, -9.0], [-2.0, -2.0, -2.0]],
                  means=[[0.0, 0.0, 2.0], [0.0, 0.0, 3.0], [1e30, 1e30, 0.3], [0.0, 0.0, 4.0]])
    shown = render(vast, CAMERA)
    assert shown.index.tolist() == [0, 3]
    assert (shown.transmittance - (1 - torch.sigmoid(torch.tensor(0.5)))).max() < 1e-6
    found = gradients(vast, lambda g: images(render(g, CAMERA)))
    assert all(torch.isfinite(gradient).all() for gradient in found.values()) and (found["sh_dc"][[0, 3]] != 0).all()


@pytest.mark.parametrize("field", ["means", "log_scales", "quats", "opacity", "log_amp", "sh_dc", "sh_rest"])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_what_is_not_finite_is_left_out(field, value):
    gaussians, whole = random_gaussians(20, 6), random_gaussians(20, 6)
    getattr(gaussians, field)[4] = value
    rest = whole.select(torch.arange(20) != 4)
    assert torch.equal(render(gaussians, CAMERA).image, render(rest, CAMERA).image)
    found = gradients(gaussians, lambda g: images(render(g, CAMERA)))
    assert all(torch.isfinite(gradient).all() for gradient in found.values())


def test_torch_operations_project_as_the_kernels_do():
    gaussians = random_gaussians(500, 12)
    gaussians.quats[3], gaussians.sh_rest[5, 2], gaussians.opacity[7] = 0, float("nan"), -12.0
    for camera in (CAMERA, tilted_camera()):
        found = {}
        for name, draw in (("kernels", lambda g, c=camera: project(g, c, 3.0)),
                           ("torch", lambda g, c=camera: project_torch(g, c, 4.5))):
            trained = trainable(gaussians)
            splats = draw(trained)
            random_loss([splats.mean2d, splats.factor, splats.opacity, splats.colour, splats.depth], 3).backward()
            found[name] = splats, trained
        ours, theirs = found["kernels"][0], found["torch"][0]
        assert torch.equal(ours.index, theirs.index) and 20 < len(ours.index) < 500
        for name in ("mean2d", "factor", "opacity", "colour", "depth", "q_max", "radius"):
            a, b = getattr(ours, name).detach(), getattr(theirs, name).detach()
            assert ((a - b).abs() <= 1e-4 * (1e-2 + b.abs())).all(), name
        for name, tensor in found["kernels"][1].tensors().items():
            other = getattr(found["torch"][1], name).grad
            assert (tensor.grad - other).abs().max() <= 1e-4 * other.abs().max(), name


def test_only_what_is_trained_costs_a_gradient():
    gaussians = random_gaussians(60, 8)
    full = gradients(gaussians, lambda g: images(render(g, CAMERA)))
    for wanted in (("opacity", "log_amp", "sh_dc"), ("means",), ("sh_rest",)):
        part = gaussians.detached()
        for name in wanted:
            getattr(part, name).requires_grad_(True)
        random_loss(images(render(part, CAMERA)), 1).backward()
        for name, tensor in part.tensors().items():
            if name in wanted:
                assert (tensor.grad - full[name]).abs().max() <= 1e-6 * full[name].abs().max(), name
            else:
                assert tensor.grad is None, name
