"""Trains what levels have of their own: opacity, DC colour, and the amplifier under its rules (paper section 4.4)."""

from __future__ import annotations

import math

import torch

from golden.diff.gaussians import Gaussians
from golden.training.optimiser import Optimiser
from spec.constants import AMP_MAX

AMPLIFIED_ABOVE = 0.8
"""Opacity above which the amplifier is trained (paper section 4.4)."""

LAST_RATE = 0.1
"""Learning rates at the end, as a share of the first ones."""


class VersionTraining:
    """Adam on opacity, DC colour and amplifier of one level's Gaussians; everything else is frozen.

    The amplifier changes only where the opacity before the step is above AMPLIFIED_ABOVE, and stays within 1..AMP_MAX. Where
    the opacity has fallen below, the amplifier keeps its last value: it gets no gradient, and Adam's momentum does not move it.

    Args:
        gaussians: the Gaussians, which are copied.
        rate_opacity, rate_sh_dc: initial learning rates.
        rate_log_amp: initial learning rate, or None: the amplifier is not trained.
    """

    def __init__(self, gaussians: Gaussians, rate_opacity: float, rate_sh_dc: float, rate_log_amp: float | None) -> None:
        self._rates = {"opacity": rate_opacity, "sh_dc": rate_sh_dc}
        if rate_log_amp is not None:
            self._rates["log_amp"] = rate_log_amp
        self._optimiser = Optimiser(gaussians, self._rates)
        self._amplifies = rate_log_amp is not None

    @property
    def gaussians(self) -> Gaussians:
        """The tensors to render from; `select` and `load` replace them by other tensors."""
        return self._optimiser.gaussians

    @torch.no_grad()
    def step(self, progress: float = 0.0) -> None:
        """Takes one step along the gradients in the tensors, and then removes the gradients.

        Args:
            progress: place in the run, 0..1, which determines how far the rates have fallen.
        """
        self._optimiser.set_rates({name: rate * LAST_RATE**progress for name, rate in self._rates.items()})
        if not self._amplifies:
            self._optimiser.step()
            return
        log_amp = self.gaussians.log_amp
        trained = torch.sigmoid(self.gaussians.opacity) > AMPLIFIED_ABOVE
        log_amp.grad *= trained
        before = log_amp.clone()
        self._optimiser.step()
        log_amp.copy_(torch.where(trained, log_amp.clamp(0.0, math.log(AMP_MAX)), before))

    def select(self, keep: torch.Tensor) -> None:
        """Keeps only the Gaussians in `keep`, (n,) bool."""
        self._optimiser.select(keep)

    def state(self) -> dict[str, object]:
        """Copies of everything that `load` needs."""
        return self._optimiser.state()

    def load(self, state: dict[str, object]) -> None:
        """Restores what `state` returned."""
        self._optimiser.load(state)
