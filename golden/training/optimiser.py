"""Adam on the fields of Gaussians, whose rows are added and removed during training."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields

import torch

from golden.diff.gaussians import Gaussians

EPS = 1e-15
"""Adam's epsilon (3DGS). It is so small that points with a tiny gradient take steps as large as any other."""

RATES = {"sh_dc": 2.5e-3, "sh_rest": 2.5e-3 / 20, "opacity": 0.05, "log_scales": 0.005, "quats": 0.001}
"""Learning rates by field (3DGS), except for the means'."""

MEANS_RATE = (1.6e-4, 1.6e-6)
"""The means' first and last rate, as shares of the scene's extent (3DGS)."""

MOMENTS = ("exp_avg", "exp_avg_sq")
"""The parts of Adam's state that have a row for each Gaussian; the count of steps has none."""

Change = Callable[[str, torch.Tensor], torch.Tensor]
"""A function of a field's name and its tensor, or a moment of it, that gives the new tensor."""


def means_rate(progress: float, extent: float) -> float:
    """The means' rate in world units; it falls exponentially from the first to the last with `progress` in 0..1."""
    first, last = (math.log(rate) for rate in MEANS_RATE)
    return extent * math.exp(first + (last - first) * min(max(progress, 0.0), 1.0))


def dense_rates(progress: float, extent: float) -> dict[str, float]:
    """Rates of all fields that dense training changes, at `progress` in 0..1."""
    return {"means": means_rate(progress, extent), **RATES}


class Optimiser:
    """Gaussians in training: fields with a rate are leaves that require gradients, and the others are frozen.

    Attributes:
        gaussians: the tensors to render from. `select`, `append`, `reset`, `widen` and `load` replace them by other tensors.
    """

    def __init__(self, gaussians: Gaussians, rates: Mapping[str, float]) -> None:
        """Starts without momentum, from a copy of `gaussians`.

        Args:
            gaussians: the Gaussians.
            rates: learning rate by name of field, all >= 0.

        Raises:
            ValueError: a field is unknown, a rate is negative or not finite, or there is none at all.
        """
        known = [field.name for field in fields(Gaussians)]
        for name, rate in rates.items():
            if name not in known or not (math.isfinite(rate) and rate >= 0):
                raise ValueError(f"rates must be finite, >= 0 and of {known}, not {name!r}: {rate!r}")
        if not rates:
            raise ValueError(f"rates must name at least one field of {known}, not none")
        self.gaussians = gaussians.detached()
        self._trained = tuple(name for name in known if name in rates)
        for name in self._trained:
            getattr(self.gaussians, name).requires_grad_()
        groups = [{"params": [getattr(self.gaussians, name)], "lr": float(rates[name]), "name": name} for name in self._trained]
        self._adam = torch.optim.Adam(groups, eps=EPS, fused=True)

    @property
    def rates(self) -> dict[str, float]:
        """Learning rate by field."""
        return {group["name"]: group["lr"] for group in self._adam.param_groups}

    def set_rates(self, rates: Mapping[str, float]) -> None:
        """Sets new rates for some of the trained fields.

        Raises:
            ValueError: a field is not trained.
        """
        for name, rate in rates.items():
            self._group(name)["lr"] = float(rate)

    def step(self) -> None:
        """Takes one step along the gradients in the tensors, and then removes the gradients."""
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)

    def select(self, index: torch.Tensor) -> None:
        """Keeps the rows at `index` (boolean mask or integers) with their momentum."""
        self._change(lambda name, tensor: tensor[index])

    def append(self, gaussians: Gaussians) -> None:
        """Adds rows without momentum."""
        new = gaussians.tensors()
        self._change(lambda name, tensor: torch.cat([tensor, new[name].detach()]),
                     lambda name, moment: torch.cat([moment, torch.zeros_like(new[name])]))

    def reset(self, name: str, values: torch.Tensor, index: torch.Tensor | None = None) -> None:
        """Sets new values of one field, for all rows or those at `index`; their momentum becomes zero.

        Raises:
            ValueError: the values do not have the shape of the field's rows.
        """
        rows = slice(None) if index is None else index
        field = getattr(self.gaussians, name).detach()
        if values.shape != field[rows].shape:
            raise ValueError(f"{name} must have shape {tuple(field[rows].shape)} here, not {tuple(values.shape)}")

        def written(tensor: torch.Tensor, content: torch.Tensor | float) -> torch.Tensor:
            tensor = tensor.clone()
            tensor[rows] = content
            return tensor

        self._change(lambda n, tensor: written(tensor, values) if n == name else tensor,
                     lambda n, moment: written(moment, 0.0) if n == name else moment)

    def widen(self, count: int) -> None:
        """Extends the harmonics to `count` coefficients a channel; the new ones are zero.

        Raises:
            ValueError: there are more already.
        """
        missing = count - self.gaussians.sh_rest.shape[1]
        if missing < 0:
            raise ValueError(f"count must be at least {self.gaussians.sh_rest.shape[1]}, not {count!r}")
        pad = (0, 0, 0, missing)
        self._change(lambda name, t: torch.nn.functional.pad(t, pad) if name == "sh_rest" else t)

    def state(self) -> dict[str, object]:
        """Copies of everything that `load` needs, for `torch.save`."""
        adam = {name: {key: value.clone() for key, value in self._moments(name).items()} for name in self._trained}
        return {"gaussians": self.gaussians.detached().tensors(), "adam": adam, "rates": self.rates}

    def load(self, state: dict[str, object]) -> None:
        """Restores what `state` returned; training continues bit for bit as it would have.

        Raises:
            ValueError: the state is of other trained fields.
        """
        if set(state["rates"]) != set(self._trained):
            raise ValueError(f"state must be of the trained fields {self._trained}, not {tuple(state['rates'])}")
        device = self.gaussians.device
        self._adam.state.clear()
        self._adopt(Gaussians(**state["gaussians"]).to(device).detached())
        for name, moments in state["adam"].items():
            if moments:
                leaf = getattr(self.gaussians, name)
                self._adam.state[leaf] = {key: value.to(device).clone() for key, value in moments.items()}
        self.set_rates(state["rates"])

    def _group(self, name: str) -> dict[str, object]:
        for group in self._adam.param_groups:
            if group["name"] == name:
                return group
        raise ValueError(f"{name!r} is not trained; {self._trained} are")

    def _moments(self, name: str) -> dict[str, torch.Tensor]:
        """Adam's state of one field; empty before the first step."""
        return self._adam.state.get(getattr(self.gaussians, name), {})

    def _change(self, of_field: Change, of_moment: Change | None = None) -> None:
        """Replaces each field by `of_field(name, tensor)` and each moment by `of_moment`, which is `of_field` by default."""
        of_moment = of_moment or of_field
        moments = {name: self._moments(name) for name in self._trained}
        self._adam.state.clear()
        self._adopt(Gaussians(**{name: of_field(name, tensor.detach()) for name, tensor in self.gaussians.tensors().items()}))
        for name, old in moments.items():
            if old:
                new = {key: of_moment(name, value) if key in MOMENTS else value for key, value in old.items()}
                self._adam.state[getattr(self.gaussians, name)] = new

    def _adopt(self, gaussians: Gaussians) -> None:
        """Makes other tensors the trained ones."""
        self.gaussians = gaussians
        for name in self._trained:
            leaf = getattr(gaussians, name).detach().contiguous().requires_grad_()
            setattr(gaussians, name, leaf)
            self._group(name)["params"] = [leaf]
