"""Compact3DGS's way to prune (Lee et al. 2024, section 3.1): a learned mask for each Gaussian, and a loss that closes masks.

A mask is a number m with M = 1 while sigmoid(m) > 0.01 and 0 below, and a Gaussian is rendered with M times its opacity and M
times its scales. Backwards, M passes its gradient to sigmoid(m) (a straight-through estimator), so that Gaussians which the
photographs do not need are closed by the loss of masks, the mean of sigmoid(m) times a weight. A closed mask gets no gradient
from the photographs and does not open again; the points of closed masks are removed.

The published method has a fixed weight, and the share that is removed is what comes of it. Here the gate controls the weight as
it controls scale decay's, from the paper's on, so that the result can be compared with others at equal quality. Of the paper,
only the masks are taken: neither its grid of colours nor its quantisation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import torch

from golden.diff.gaussians import Gaussians
from golden.training.optimiser import EPS
from golden.training.pruning import PruneOptions, PruneStage
from golden.training.retrain import Retraining
from golden.training.scale_decay import GAMMA_FACTOR, GAMMA_LIMIT, next_gamma

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

COMPACT = "compact"
"""Name of the baseline."""

OPEN_ABOVE = 0.01
"""sigmoid(m) above which a mask is open (Lee et al.)."""

FIRST_MASK = 1.0
"""m of every Gaussian at the beginning (their public code), sigmoid 0.73."""

WEIGHT = 5e-4
"""First and smallest weight of the loss of masks (Lee et al.)."""

RATE = 0.1
"""Adam's rate of m. The paper has 30,000 iterations and a smaller rate; here a mask must be able to close within a few checks
of the gate: 128 iterations close one that only its own loss moves."""

WAIT = 60
"""Smallest number of iterations between a prune and the next check. The weight is not raised sooner, because the effect of the
one before is not seen sooner."""

CLOSED_LOG = -30.0
"""log M of a closed mask: an opacity this small is not rendered."""


def open_masks(masks: torch.Tensor) -> torch.Tensor:
    """(N,) bool: which masks are open."""
    return torch.sigmoid(masks.detach()) > OPEN_ABOVE


def masked(gaussians: Gaussians, masks: torch.Tensor) -> Gaussians:
    """The Gaussians with opacities and scales times M; gradients reach `masks` (N,) as if M were sigmoid(m)."""
    soft = torch.sigmoid(masks)
    opened = open_masks(masks)
    straight = 1 + soft - soft.detach()  # M of the open masks: 1, with the gradient of sigmoid(m)
    log = torch.where(opened, torch.log(straight), CLOSED_LOG)
    return replace(gaussians, log_scales=gaussians.log_scales + log[:, None], log_amp=gaussians.log_amp + log)


class MaskedRetraining(Retraining):
    """As `Retraining`, with a mask for each Gaussian; `step`'s gamma is the weight of the loss of masks instead of WS's."""

    def restart(self, gaussians: Gaussians) -> None:
        """Trains other Gaussians instead, all masks open."""
        super().restart(gaussians)
        self._start_masks(torch.full((len(gaussians),), FIRST_MASK, device=gaussians.device))

    @property
    def open(self) -> torch.Tensor:
        """(N,) bool: the Gaussians in training whose masks are open."""
        return open_masks(self._masks)

    @property
    def average(self) -> Gaussians:
        """The running average of the Gaussians with open masks."""
        return super().average.select(self.open)

    def step(self, iteration: int, gamma: float) -> float:
        """Takes one iteration and returns its loss."""
        loss = super().step(iteration, gamma)
        self._adam.step()
        self._adam.zero_grad(set_to_none=True)
        return loss

    def select(self, keep: torch.Tensor) -> None:
        """Keeps only the Gaussians in `keep`, (N,) bool, with their masks and moments."""
        super().select(keep)
        moments = {name: value[keep] if value.ndim else value for name, value in self._moments().items()}
        self._start_masks(self._masks.detach()[keep], moments)

    def state(self) -> dict[str, object]:
        """Everything that `load` needs."""
        moments = {name: value.clone() for name, value in self._moments().items()}
        return super().state() | {"masks": self._masks.detach().clone(), "moments": moments}

    def load(self, state: dict[str, object]) -> None:
        """Restores what `state` returned."""
        super().load(state)
        device = self.gaussians.device
        moments = {name: value.to(device).clone() for name, value in state["moments"].items()}
        self._start_masks(state["masks"].to(device).clone(), moments)

    def _shown(self) -> Gaussians:
        return masked(self.gaussians, self._masks)

    def _decay(self, *_rendered: torch.Tensor) -> torch.Tensor:
        """The loss of masks: the mean of sigmoid(m) over the Gaussians with open masks and closed ones alike."""
        return torch.sigmoid(self._masks).mean()

    def _start_masks(self, masks: torch.Tensor, moments: Mapping[str, torch.Tensor] | None = None) -> None:
        self._masks = masks.contiguous().requires_grad_()
        self._adam = torch.optim.Adam([self._masks], lr=RATE, eps=EPS)
        if moments:
            self._adam.state[self._masks] = dict(moments)

    def _moments(self) -> dict[str, torch.Tensor]:
        return self._adam.state.get(self._masks, {})


class MaskStage(PruneStage):
    """The loop of `PruneStage` in which masks decide what goes, instead of scores.

    When the gate passes, the points of closed masks are removed and the weight of the loss of masks rises, by a factor of 3 at
    first. When it fails, the weight falls to a third, but not below its first value. If the gate comes out of reach, the last
    model that passed is restored, with its masks and half the weight with which it passed, and the weight rises in smaller
    steps until a prune is easy again, as the share of the other criteria does.

    Args:
        scene, dense, variant, options, seed, rates: see `PruneStage`.
    """

    def __init__(
        self, scene: TrainingScene, dense: Gaussians, variant: str = "H", options: PruneOptions | None = None, *, seed: int = 0,
        rates: Mapping[str, float] | None = None,
    ) -> None:
        options = options or PruneOptions()
        options = replace(
            options, criterion=None, scale_decay=True, gamma_first=WEIGHT, interval=max(options.interval, WAIT),
            recovery=options.recovery or options.interval)
        super().__init__(scene, dense, variant, options, seed=seed, rates=rates, name=f"prune-{COMPACT}")

    def _retraining(self, dense: Gaussians, seed: int, rates: Mapping[str, float] | None) -> MaskedRetraining:
        return MaskedRetraining(self._scene, dense, seed, self.name, rates, squared=self._squared)

    @property
    def _removes(self) -> bool:
        return True

    def _next_gamma(self, passed: bool) -> float:
        rise = 1 + (GAMMA_FACTOR - 1) * self._fraction / self.options.fraction
        return next_gamma(self.gamma, passed, self._first, GAMMA_LIMIT * self._training.balance, rise)

    def _ask_less(self) -> None:
        super()._ask_less()
        last = next(check.gamma for check in reversed(self.history) if check.passed)
        self.gamma = last * self._fraction / self.options.fraction

    def _prune(self) -> None:
        """Drops the points of closed masks, and almost transparent ones."""
        opaque = self.gaussians.amplified_opacity.detach() >= self.options.opacity_min
        self._keep(self._training.open & opaque)
