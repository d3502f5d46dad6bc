"""Dense training: density control by its definition, the loss by scikit-image, and runs that resume bit for bit."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.gaussians import Gaussians  # noqa: E402
from golden.metrics.image import ssim  # noqa: E402
from golden.metrics.ssim import Ssim  # noqa: E402
from golden.oracle.project import rotation_matrices  # noqa: E402
from golden.training.dense import DenseOptions, DenseStage  # noqa: E402
from golden.training.densify import SPLIT_SHRINK, ScreenGradients, densify, rotated, split  # noqa: E402
from golden.training.losses import photometric  # noqa: E402
from golden.training.optimiser import Optimiser, dense_rates  # noqa: E402
from golden.training.scene import load_training_scene  # noqa: E402

OPTIONS = DenseOptions(iterations=40, max_points=700, densify_every=4, threshold=0.0)


@pytest.fixture(scope="module")
def scene():
    """The embedded scene, small, with few enough points that there is something to add."""
    scene = load_training_scene("embedded", (64, 64))
    return replace(scene, points=scene.points[:400], colours=scene.colours[:400])


def gaussians(n: int, seed: int = 0) -> Gaussians:
    random = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=random)

    return Gaussians(normal(n, 3), normal(n, 3) * 0.5, normal(n, 4), normal(n), torch.zeros(n), normal(n, 3), normal(n, 3, 3))


def run(stage: DenseStage, steps: int) -> list[dict[str, float]]:
    return [stage.step() for _ in range(steps)]


def equal(one: Gaussians, other: Gaussians) -> bool:
    return len(one) == len(other) and all(torch.equal(a, b) for a, b in zip(one.tensors().values(), other.tensors().values(),
                                                                            strict=True))


def test_photometric_loss():
    random = np.random.default_rng(0)
    image, target = random.random((2, 24, 20, 3)).astype(np.float32)
    loss = photometric(torch.from_numpy(image), Ssim(torch.from_numpy(target)), torch.from_numpy(target))
    assert float(loss) == pytest.approx(0.8 * np.abs(image - target).mean() + 0.2 * (1 - ssim(image, target)), abs=1e-6)


def test_rotated():
    g = gaussians(20)
    vectors = torch.randn(20, 3, generator=torch.Generator().manual_seed(1))
    want = np.einsum("nij,nj->ni", rotation_matrices(g.quats.double().numpy()), vectors.double().numpy())
    np.testing.assert_allclose(rotated(g.quats, vectors).numpy(), want, atol=1e-5)


def test_screen_gradients_are_means_over_the_views_that_show_a_point():
    gradients = ScreenGradients(4)
    gradients.observe(torch.tensor([0, 2]), torch.tensor([[0.3, 0.4], [1.0, 0.0]]), (200, 200))
    gradients.observe(torch.tensor([2, 3]), torch.tensor([[0.0, 2.0], [1.0, 0.0]]), (100, 400))
    assert gradients.mean.tolist() == pytest.approx([50.0, 0.0, (100 + 400) / 2, 50.0])
    other = ScreenGradients(1)
    other.load(gradients.state())
    gradients.observe(torch.tensor([0]), torch.ones(1, 2), (1, 1))
    assert other.mean.tolist() == pytest.approx([50.0, 0.0, 250.0, 50.0])


def test_halves_are_drawn_from_their_parents():
    parents = gaussians(3)
    many = parents.map(lambda tensor: tensor.repeat_interleave(4000, dim=0))
    halves = split(many, np.random.default_rng(0))
    assert len(halves) == 24000
    assert torch.allclose(halves.log_scales.exp() * SPLIT_SHRINK, many.log_scales.exp().repeat(2, 1))
    assert torch.equal(halves.sh_dc, many.sh_dc.repeat(2, 1)) and torch.equal(halves.opacity, many.opacity.repeat(2))
    rotation = rotation_matrices(parents.quats.double().numpy())
    for i in range(3):
        means = halves.means.reshape(2, 3, 4000, 3)[:, i].reshape(-1, 3).double().numpy()
        axes = rotation[i] * np.exp(parents.log_scales[i].double().numpy())
        covariance = axes @ axes.T
        deviation = np.sqrt(np.trace(covariance))
        assert np.abs(means.mean(axis=0) - parents.means[i].numpy()).max() < 0.06 * deviation
        assert np.abs(np.cov(means.T) - covariance).max() < 0.1 * deviation**2


def test_density_control():
    """Of eight points the budget goes to the three largest gradients; the small of them is cloned, the large ones split."""
    start = gaussians(8)
    start.log_scales[:] = -3.0
    start.log_scales[1, 2] = start.log_scales[6, 0] = 0.5
    gradient = torch.tensor([0.0, 5.0, 1.0, 9.0, 2.0, 0.5, 4.0, 3.0])
    optimiser = Optimiser(start, dense_rates(0.0, 1.0))
    assert densify(optimiser, gradient, threshold=0.6, budget=3, small=0.2, random=np.random.default_rng(0)) == 3
    g = optimiser.gaussians
    assert len(g) == 11
    assert torch.equal(g.sh_dc, torch.cat([start.sh_dc[[0, 2, 3, 4, 5, 7]], start.sh_dc[[3]], start.sh_dc[[1, 6, 1, 6]]]))
    assert torch.equal(g.means[6], start.means[3]) and not torch.equal(g.means[7], start.means[1])
    optimiser = Optimiser(start, dense_rates(0.0, 1.0))
    assert densify(optimiser, gradient, threshold=2.5, budget=99, small=9.0, random=np.random.default_rng(0)) == 4
    assert densify(optimiser, torch.ones(12), threshold=0.0, budget=-3, small=9.0, random=np.random.default_rng(0)) == 0
    assert len(optimiser.gaussians) == 12


def test_a_run(scene):
    stage = DenseStage(scene, replace(OPTIONS, iterations=200), 0)
    assert (stage.name, stage.total, stage.done, stage.finished) == ("dense", 200, 0, False)
    records = run(stage, 200)
    assert stage.finished and stage.done == 200
    loss = [record["loss"] for record in records]
    assert np.mean(loss[-10:]) < 0.75 * np.mean(loss[:5])
    points = [record["points"] for record in records]
    assert points[0] == 400 < points[-1] <= OPTIONS.max_points and points[-1] > 600 and points[100:] == points[100:101] * 100
    views = [record["view"] for record in records]
    n = len(scene.train)
    assert sorted(views[:n]) == sorted(views[n : 2 * n]) == list(scene.train) and views[:n] != views[n : 2 * n]
    result = stage.result()
    assert len(result) == points[-1] and result.sh_rest.shape[1] == 15 and result.sh_rest.any()
    assert not any(tensor.requires_grad for tensor in result.tensors().values())


def test_harmonics_grow_by_degrees(scene):
    stage = DenseStage(scene, replace(OPTIONS, sh_degree=2), 0)
    counts = [stage.step() and stage.gaussians.sh_rest.shape[1] for _ in range(14)]
    assert counts == [0] * 4 + [3] * 4 + [8] * 6
    assert DenseStage(scene, replace(OPTIONS, sh_degree=3), 0).result().sh_rest.shape[1] == 15


@pytest.mark.parametrize("stops", [(3, 7, 12, 13), (1, 19, 33)])
def test_a_resumed_run_is_the_uninterrupted_one(scene, tmp_path, stops):
    whole, stage = DenseStage(scene, OPTIONS, 5), DenseStage(scene, OPTIONS, 5)
    records, other = run(whole, 40), []
    for stop in stops:
        other += run(stage, stop - stage.done)
        torch.save(stage.state(), tmp_path / "state.pt")
        run(stage, 2)  # lost
        stage = DenseStage(scene, OPTIONS, 5)
        stage.load(torch.load(tmp_path / "state.pt"))
    other += run(stage, 40 - stage.done)
    assert records == other and equal(whole.result(), stage.result())


def test_transparent_points_fade_and_are_removed(scene):
    """One addition is due at iteration 4; a point that was nearly transparent is gone, the others' opacities are multiplied."""
    stages = [DenseStage(scene, replace(OPTIONS, opacity_decay=decay, threshold=1e9), 0) for decay in (1.0, 0.5)]
    for stage in stages:
        stage.gaussians.opacity.data[7] = -9.0
        run(stage, 4)
    kept, faded = (torch.sigmoid(stage.gaussians.opacity.detach()) for stage in stages)
    assert len(kept) == len(faded) == 399
    torch.testing.assert_close(faded, 0.5 * kept)


def test_the_seed_decides(scene):
    one, again, other = (DenseStage(scene, OPTIONS, seed) for seed in (1, 1, 2))
    assert run(one, 12) == run(again, 12) and equal(one.result(), again.result())
    assert [r["view"] for r in run(other, 12)] != [r["view"] for r in run(DenseStage(scene, OPTIONS, 1), 12)]


def test_a_loss_that_is_not_finite_changes_nothing(scene):
    stage = DenseStage(scene, OPTIONS, 0)
    run(stage, 6)
    state, before = stage.state(), stage.result()
    stage.gaussians.sh_dc.data[:] = 1e38
    record = stage.step()
    assert not np.isfinite(record["loss"]) and record["view"] in scene.train and stage.done == 6
    stage.load(state)
    assert equal(stage.result(), before) and np.isfinite(stage.step()["loss"])


def test_rates_fall_at_the_end():
    options = DenseOptions(gain=3.0, means_gain=2.0, cooling=0.4, cooled=0.25)
    for progress, share in ((0.0, 1.0), (0.6, 1.0), (0.8, 0.5), (1.0, 0.25)):
        field, rates = dense_rates(progress, 5.0), options.rates(progress, 5.0)
        assert rates == pytest.approx({name: rate * (2 if name == "means" else 3 * share) for name, rate in field.items()})
    plain = replace(options, gain=1.0, means_gain=1.0, cooling=0.0)
    assert plain.rates(1.0, 5.0) == dense_rates(1.0, 5.0)


@pytest.mark.parametrize("bad", [{"iterations": 0}, {"densify_from": 0.6}, {"densify_until": 1.5}, {"max_points": 3},
                                 {"cooling": 1.5}, {"cooled": 0.0}, {"opacity_decay": 0.0}])
def test_bad_options(scene, bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        DenseStage(scene, replace(OPTIONS, **bad), 0)
