"""Learned masks: what they show, their gradients, and the gated loop that closes them, on the embedded scene at 64x64."""

from dataclasses import replace

import pytest

torch = pytest.importorskip("torch")

from golden.diff.render import render  # noqa: E402
from golden.training import masks as masks_module  # noqa: E402
from golden.training.evaluate import Gate, evaluate  # noqa: E402
from golden.training.masks import FIRST_MASK, MaskedRetraining, MaskStage, masked, open_masks  # noqa: E402
from golden.training.pruning import PruneOptions  # noqa: E402
from tests.helpers.training_samples import guarded, same, small_dense, small_scene  # noqa: E402

OPTIONS = PruneOptions(iterations=80, interval=8)


@pytest.fixture(scope="module")
def scene():
    return guarded(small_scene())


@pytest.fixture(scope="module")
def dense():
    return small_dense()


@pytest.fixture
def quick(monkeypatch):
    """Masks that close within five steps, so that tests need few."""
    monkeypatch.setattr(masks_module, "RATE", 1.2)
    monkeypatch.setattr(masks_module, "WAIT", 5)


def run(stage, steps=None):
    for _ in range(stage.total - stage.done if steps is None else steps):
        stage.step()
    return stage


def test_open_masks_change_nothing_and_closed_ones_remove(scene, dense):
    """sigmoid(m) > 0.01 is open: the picture is the one of the Gaussians that are left, and the model is unchanged."""
    numbers = torch.linspace(-6.0, 2.0, len(dense))
    opened = open_masks(numbers)
    assert opened.tolist() == (numbers > -4.5951199).tolist() and 0 < opened.sum() < len(dense)
    before = dense.detached()
    camera = scene.cameras[scene.train[0]]
    shown, left = render(masked(dense, numbers), camera), render(dense.select(opened), camera)
    assert torch.allclose(shown.image, left.image, atol=1e-6) and len(shown.index) == len(left.index)
    assert same(dense, before)


def test_gradients_pass_straight_through(scene, dense):
    """dL/dm = dL/dM sigmoid'(m), with M times opacity and scales; closed masks get none from the picture."""
    camera, numbers = scene.cameras[scene.train[0]], torch.linspace(-6.0, 2.0, len(dense)).requires_grad_()
    weights = torch.rand((camera.height, camera.width, 3), generator=torch.Generator().manual_seed(1))
    (render(masked(dense, numbers), camera).image * weights).sum().backward()
    opened = open_masks(numbers)
    times = torch.ones(int(opened.sum()), requires_grad=True)
    left = dense.select(opened)
    opacity = torch.logit((torch.sigmoid(left.opacity) * times).clamp(max=1 - 1e-6))
    image = render(replace(left, opacity=opacity, log_scales=left.log_scales + torch.log(times)[:, None]), camera).image
    (image * weights).sum().backward()
    soft = torch.sigmoid(numbers.detach())[opened]
    expected = times.grad * soft * (1 - soft)
    assert torch.allclose(numbers.grad[opened], expected, rtol=1e-3, atol=1e-5) and expected.abs().max() > 0.1
    assert (numbers.grad[~opened] == 0).all()


def test_the_loss_of_masks_closes_what_no_view_needs(scene, dense):
    """A Gaussian that no view sees gets no gradient from photographs: with any weight its mask closes
    in 128 steps."""
    model = dense.detached()
    model.means[0] = torch.tensor([0.0, 0.0, 1e4])
    training = MaskedRetraining(scene, model, 0, "masks")
    closed = [bool(~training.open[0]) for iteration in range(128) if training.step(iteration, 1e-7)]
    assert closed == [False] * 127 + [True]
    assert training.open.sum() > 0.5 * len(model)
    assert len(training.average) == int(training.open.sum())
    idle = MaskedRetraining(scene, model, 0, "masks")
    for iteration in range(3):
        idle.step(iteration, 0.0)
    assert float(idle._masks.detach()[0]) == FIRST_MASK


def test_the_loop_removes_closed_masks_and_respects_the_gate(scene, dense, quick):
    stage = run(MaskStage(scene, dense, "L", OPTIONS))
    gate = Gate.of(evaluate(dense, scene, scene.validation), 0.03)
    quality = evaluate(stage.result(), scene, scene.validation)
    assert stage.gate == gate and gate.passes(quality)
    passed = [row for row in stage.history if row.passed]
    assert quality.entries == min(row.entries for row in passed) < 0.97 * stage.history[0].entries
    assert len(stage.result()) < 0.97 * len(dense) and stage.name == "prune-compact"
    assert max(row.gamma for row in stage.history) > masks_module.WEIGHT


def test_a_weight_that_closes_everything_leaves_what_passed(scene, dense, quick, monkeypatch):
    monkeypatch.setattr(masks_module, "WEIGHT", 1e3)
    stage = run(MaskStage(scene, dense, "H", replace(OPTIONS, iterations=16)))
    assert not any(row.passed for row in stage.history[1:]) and stage.history[1].points < 0.1 * len(dense)
    assert same(stage.result(), dense)


def test_undone_with_half_the_weight(scene, dense, quick, monkeypatch):
    """After `patience` failures all points are back, and the weight is half of the one that passed."""
    monkeypatch.setattr(masks_module, "WEIGHT", 1e3)
    stage = MaskStage(scene, dense, "H", replace(OPTIONS, iterations=60, patience=2, recovery=2))
    records = [stage.step() for _ in range(12)]
    checks = [i for i, record in enumerate(records) if "passed" in record]
    assert [records[i]["passed"] for i in checks[:2]] == [False, False]
    assert stage.history[0].gamma == 0 and len(stage.gaussians) == len(dense)  # the dense model passed without a weight
    assert records[checks[1] + 1]["gamma"] == 0


def test_resumed_as_uninterrupted(scene, dense, quick):
    stage = run(MaskStage(scene, dense, "L", OPTIONS))
    for stop in (5, 33, 61):
        first, second = (MaskStage(scene, dense, "L", OPTIONS) for _ in range(2))
        second.load(run(first, stop).state())
        assert same(run(second).result(), stage.result()) and second.history == stage.history
