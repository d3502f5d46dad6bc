"""A running average of Gaussians in training: what they have converged to, without the noise of the last few views."""

from __future__ import annotations

import torch

from golden.diff.gaussians import Gaussians

LOOKS_BACK = 100
"""Iterations that the average looks back, at most; of k iterations since it restarted, it looks back on about k / 4."""


class Average:
    """The running average of all fields.

    At constant rates parameters wander around what they have converged to: a gate that looks at them passes or fails by a few
    tenths of a dB with the views that came last. The average does not wander.

    Args:
        gaussians: where it starts; copied.
    """

    def __init__(self, gaussians: Gaussians) -> None:
        self.restart(gaussians)

    def restart(self, gaussians: Gaussians) -> None:
        """Forget what was: the average is `gaussians`."""
        self.gaussians, self._seen = gaussians.detached(), 0

    @torch.no_grad()
    def take(self, gaussians: Gaussians) -> None:
        """Take in the next iteration's, of the same points."""
        weight = max(4 / (5 + self._seen), 1 / LOOKS_BACK)
        self._seen += 1
        now = gaussians.tensors()
        for name, tensor in self.gaussians.tensors().items():
            tensor.lerp_(now[name].detach(), weight)

    def state(self) -> dict[str, object]:
        """For `load`."""
        return {"gaussians": self.gaussians.detached().tensors(), "seen": self._seen}

    def load(self, state: dict[str, object], device: torch.device | str) -> None:
        """Back to where `state` was taken."""
        self.gaussians, self._seen = Gaussians(**state["gaussians"]).to(device).detached(), state["seen"]
