"""Training of what levels have of their own: opacity, DC colour, and the amplifier under its rules (paper section 4.4)."""

from __future__ import annotations

import math

import torch

from golden.diff.gaussians import Gaussians
from golden.training.optimiser import Optimiser
from spec.constants import AMP_MAX

AMPLIFIED_ABOVE = 0.8
"""Opacity above which the amplifier is trained (paper section 4.4)."""

LAST_RATE = 0.1
"""Learning rates at the end, in shares of the first."""


class VersionTraining:
    """Adam on opacity, DC colour and amplifier of one level's Gaussians; all else is frozen.

    The amplifier moves only where the opacity before the step is above AMPLIFIED_ABOVE, and stays within 1..AMP_MAX. Where the
    opacity has fallen below, it keeps its last value, gets no gradient, and Adam's momentum does not move it.

    Args:
        gaussians: copied.
        rate_opacity, rate_sh_dc: first learning rates.
        rate_log_amp: first learning rate, or None: the amplifier is not trained.
    """

    def __init__(self, gaussians: Gaussians, rate_opacity: float, rate_sh_dc: float, rate_log_amp: float | None) -> None:
        self._rates = {"opacity": rate_opacity, "sh_dc": rate_sh_dc}
        if rate_log_amp is not None:
            self._rates["log_amp"] = rate_log_amp
        self._optimiser = Optimiser(gaussians, self._rates)
        self._amplifies = rate_log_amp is not None

    @property
    def gaussians(self) -> Gaussians:
        """The tensors to render from; others after each change of points."""
        return self._optimiser.gaussians

    @torch.no_grad()
    def step(self, progress: float = 0.0) -> None:
        """One step down the gradients in the tensors, which are then gone; `progress`, 0..1, says how far rates have fallen."""
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
        """Drop all Gaussians but `keep`, (n,) bool."""
        self._optimiser.select(keep)

    def state(self) -> dict[str, object]:
        """For `load`; copies."""
        return self._optimiser.state()

    def load(self, state: dict[str, object]) -> None:
        """Back to where `state` was taken."""
        self._optimiser.load(state)
