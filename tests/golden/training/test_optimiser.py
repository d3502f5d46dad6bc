"""The optimiser of Gaussians against Adam by its formula, through every change of rows."""

import pytest

torch = pytest.importorskip("torch")

from golden.diff.gaussians import Gaussians  # noqa: E402
from golden.training.optimiser import EPS, Optimiser, dense_rates, means_rate  # noqa: E402

RATES = dense_rates(0.0, 2.0)


def gaussians(n: int = 6, harmonics: int = 3, seed: int = 0) -> Gaussians:
    random = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=random)

    return Gaussians(normal(n, 3), normal(n, 3), normal(n, 4), normal(n), torch.zeros(n), normal(n, 3), normal(n, harmonics, 3))


def gradients(like: Gaussians, seed: int) -> dict[str, torch.Tensor]:
    random = torch.Generator().manual_seed(seed)
    return {name: torch.randn(tensor.shape, generator=random) for name, tensor in like.tensors().items()}


def give(optimiser: Optimiser, grads: dict[str, torch.Tensor]) -> None:
    for name, tensor in optimiser.gaussians.tensors().items():
        if tensor.requires_grad:
            tensor.grad = grads[name].clone()


def adam(value, rate, grads):
    """Adam (Kingma and Ba 2015) in float64; the gradients of all steps so far."""
    value, first, second = value.double(), 0.0, 0.0
    for step, grad in enumerate(grads, 1):
        first = 0.9 * first + 0.1 * grad.double()
        second = 0.999 * second + 0.001 * grad.double() ** 2
        value = value - rate * (first / (1 - 0.9**step)) / ((second / (1 - 0.999**step)).sqrt() + EPS)
    return value


def test_steps_are_adams():
    start = gaussians()
    optimiser = Optimiser(start, RATES)
    grads = [gradients(start, seed) for seed in range(4)]
    for each in grads:
        give(optimiser, each)
        optimiser.step()
    for name, tensor in optimiser.gaussians.tensors().items():
        if name in RATES:
            want = adam(getattr(start, name), RATES[name], [each[name] for each in grads])
            torch.testing.assert_close(tensor.double(), want, rtol=2e-5, atol=2e-6)
            assert tensor.grad is None
    assert torch.equal(optimiser.gaussians.log_amp, start.log_amp) and not optimiser.gaussians.log_amp.requires_grad


def test_the_start_is_not_changed():
    start = gaussians()
    kept = start.detached()
    optimiser = Optimiser(start, RATES)
    give(optimiser, gradients(start, 1))
    optimiser.step()
    assert all(torch.equal(a, b) for a, b in zip(start.tensors().values(), kept.tensors().values(), strict=True))


@pytest.mark.parametrize("index", [torch.tensor([4, 1, 0]), torch.tensor([True, False, True, True, False, True])])
def test_selected_rows_go_on_as_if_alone(index):
    """Rows do not see each other: rows kept end as in a run of all rows."""
    start = gaussians()
    whole, part = Optimiser(start, RATES), Optimiser(start, RATES)
    for seed in range(4):
        grads = gradients(start, seed)
        give(whole, grads)
        whole.step()
        if seed == 2:
            part.select(index)
        give(part, grads if seed < 2 else {name: grad[index] for name, grad in grads.items()})
        part.step()
    for name, tensor in part.gaussians.tensors().items():
        assert torch.equal(tensor, getattr(whole.gaussians, name)[index]), name


def test_appended_rows_have_no_momentum_and_leave_the_others_alone():
    start, new = gaussians(), gaussians(2, seed=9)
    optimiser, other = Optimiser(start, RATES), Optimiser(start, RATES)
    for one in (optimiser, other):
        give(one, gradients(start, 1))
        one.step()
    optimiser.append(new)
    assert len(optimiser.gaussians) == 8 and torch.equal(optimiser.gaussians.means[6:], new.means)
    grads = gradients(optimiser.gaussians, 2)
    for name in grads:
        grads[name][6:] = 0
    give(optimiser, grads)
    give(other, {name: grad[:6] for name, grad in grads.items()})
    optimiser.step()
    other.step()
    for name, tensor in optimiser.gaussians.tensors().items():
        assert torch.equal(tensor[:6], getattr(other.gaussians, name)), name
        assert torch.equal(tensor[6:], getattr(new, name)), name


def test_a_reset_field_forgets_its_momentum():
    start = gaussians()
    optimiser = Optimiser(start, RATES)
    give(optimiser, gradients(start, 1))
    optimiser.step()
    index, values = torch.tensor([1, 3]), torch.tensor([-2.0, -3.0])
    means = optimiser.gaussians.means.detach().clone()
    optimiser.reset("opacity", values, index)
    give(optimiser, {name: torch.zeros_like(grad) for name, grad in gradients(start, 0).items()})
    optimiser.step()
    assert torch.equal(optimiser.gaussians.opacity[index], values)
    assert (optimiser.gaussians.opacity[0] != start.opacity[0]) and not torch.equal(optimiser.gaussians.means, means)
    with pytest.raises(ValueError, match="shape"):
        optimiser.reset("opacity", torch.zeros(3), index)


def test_wider_harmonics_start_at_zero():
    start = gaussians()
    optimiser = Optimiser(start, RATES)
    give(optimiser, gradients(start, 1))
    optimiser.step()
    before = optimiser.gaussians.sh_rest.detach().clone()
    optimiser.widen(8)
    assert optimiser.gaussians.sh_rest.shape == (6, 8, 3) and optimiser.gaussians.sh_rest.requires_grad
    assert torch.equal(optimiser.gaussians.sh_rest[:, :3], before) and not optimiser.gaussians.sh_rest[:, 3:].any()
    give(optimiser, gradients(optimiser.gaussians, 2))
    optimiser.step()
    with pytest.raises(ValueError, match="8"):
        optimiser.widen(3)


@pytest.mark.parametrize("steps", [0, 3])
def test_a_loaded_state_goes_on_bit_for_bit(tmp_path, steps):
    start = gaussians()
    whole = Optimiser(start, RATES)
    for seed in range(steps):
        give(whole, gradients(start, seed))
        whole.step()
    whole.set_rates({"means": 0.25})
    torch.save(whole.state(), tmp_path / "state.pt")
    resumed = Optimiser(gaussians(2, 0, seed=5), RATES)
    resumed.load(torch.load(tmp_path / "state.pt"))
    assert resumed.rates == whole.rates
    for optimiser in (whole, resumed):
        optimiser.select(torch.tensor([0, 2, 5]))
        for seed in range(10, 13):
            give(optimiser, gradients(optimiser.gaussians, seed))
            optimiser.step()
    for name, tensor in resumed.gaussians.tensors().items():
        assert torch.equal(tensor, getattr(whole.gaussians, name)), name
    with pytest.raises(ValueError, match="trained fields"):
        Optimiser(start, {"means": 1.0}).load(whole.state())


@pytest.mark.parametrize("rates", [{}, {"colour": 1.0}, {"means": -1.0}, {"means": float("nan")}])
def test_bad_rates(rates):
    with pytest.raises(ValueError, match="rates"):
        Optimiser(gaussians(), rates)


def test_rates_of_the_field():
    assert means_rate(0.0, 1.0) == pytest.approx(1.6e-4) and means_rate(1.0, 3.0) == pytest.approx(4.8e-6)
    assert means_rate(0.5, 1.0) == pytest.approx(1.6e-5) and means_rate(2.0, 1.0) == means_rate(1.0, 1.0)
    with pytest.raises(ValueError, match="log_amp"):
        Optimiser(gaussians(), RATES).set_rates({"log_amp": 1.0})
