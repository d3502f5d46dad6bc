"""A running average of Gaussians in training: the values they have converged to, without the noise of the last few views."""

from __future__ import annotations

import torch

from golden.diff.gaussians import Gaussians

LOOKS_BACK = 100
"""Largest number of iterations over which the average extends. After k iterations since a restart it extends over about k /
4."""


class Average:
    """The running average of all fields.

    At constant learning rates, parameters fluctuate around the values to which they have converged. A gate that read the
    parameters themselves would pass or fail by a few tenths of a dB depending on the last views. The average does not
    fluctuate.

    Args:
        gaussians: the initial average; copied.
    """

    def __init__(self, gaussians: Gaussians) -> None:
        self.restart(gaussians)

    def restart(self, gaussians: Gaussians) -> None:
        """Forgets everything before: the average becomes `gaussians`."""
        self.gaussians, self._seen = gaussians.detached(), 0

    @torch.no_grad()
    def take(self, gaussians: Gaussians) -> None:
        """Includes the next iteration's Gaussians, which must be the same points."""
        weight = max(4 / (5 + self._seen), 1 / LOOKS_BACK)
        self._seen += 1
        now = gaussians.tensors()
        for name, tensor in self.gaussians.tensors().items():
            tensor.lerp_(now[name].detach(), weight)

    def state(self) -> dict[str, object]:
        """Everything that `load` needs."""
        return {"gaussians": self.gaussians.detached().tensors(), "seen": self._seen}

    def load(self, state: dict[str, object], device: torch.device | str) -> None:
        """Restores what `state` returned."""
        self.gaussians, self._seen = Gaussians(**state["gaussians"]).to(device).detached(), state["seen"]
