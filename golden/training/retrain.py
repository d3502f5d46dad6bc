"""Retraining a model of fixed points on photographs: the part that pruning and its baselines have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import torch

from golden.diff.gaussians import Gaussians
from golden.diff.render import Rendering, render
from golden.metrics.ssim import Ssim
from golden.training.average import Average
from golden.training.losses import photometric, with_squared_error
from golden.training.optimiser import Optimiser, dense_rates
from golden.training.representable import Bounds
from golden.training.scale_decay import balance, weighted_scale
from golden.training.views import PerView, view_at, views_within
from spec.constants import ALPHA_MAX_L1

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

SSIM_BYTES = 36
"""Bytes that an `Ssim` keeps for a pixel."""

SSIM_BUDGET = 2**30
"""Bytes for the views' `Ssim` objects; those of further views are made again at each use."""

PROGRESS = 0.5
"""Retraining uses the means' rate that dense training has at this share of its run: a tenth of the first, ten times the
last."""


GAIN = 3.0
"""Factor on 3DGS's rates of all fields but the means. The running average evens out the noise, and a pruned model recovers
sooner. How much it helps depends on the scene: 1,500 iterations of pruning left 1/5.9 of the intersections of fern's dense
model at 504x378 with this factor and 1/5.2 without it; 6,400 left 1/1.78 of bonsai's at 200x133 with and without it."""


def retraining_rates(scene: TrainingScene) -> dict[str, float]:
    """Constant learning rates of all fields but the amplifier."""
    rates = dense_rates(PROGRESS, scene.extent)
    return {name: rate if name == "means" else GAIN * rate for name, rate in rates.items()}


class Retraining:
    """Adam on all parameters with the composite loss 0.8 L1 + 0.2 (1 - SSIM) + gamma WS, one training view in each iteration.
    To the photographs' part the squared error can be added with the same weight.

    Args:
        scene: the scene to train on; test and validation views are not read.
        gaussians: the Gaussians, which are copied.
        seed, purpose: seeds of the order of views.
        rates: Adam's rates by field; None for `retraining_rates`.
        squared: whether the squared error is added.

    Attributes:
        view: the view of the last iteration; None before the first.
    """

    def __init__(
        self, scene: TrainingScene, gaussians: Gaussians, seed: int, purpose: str, rates: Mapping[str, float] | None = None,
        *, squared: bool = False,
    ) -> None:
        self.view: int | None = None
        self._squared = squared
        self._scene, self._seed, self._purpose = scene, seed, purpose
        self._rates = retraining_rates(scene) if rates is None else rates
        width, height = scene.cameras[scene.train[0]].width, scene.cameras[scene.train[0]].height
        device = gaussians.device
        self._ssim = PerView(
            lambda view: Ssim(scene.photograph(view).to(device)), views_within(width * height, SSIM_BYTES, SSIM_BUDGET))
        self.restart(gaussians)

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians in training."""
        return self._optimiser.gaussians

    def restart(self, gaussians: Gaussians) -> None:
        """Trains other Gaussians instead, with fresh moments."""
        self._optimiser = Optimiser(gaussians, self._rates)
        self._average = Average(self.gaussians)
        self._sums = [0.0, 0.0]

    @property
    def balance(self) -> float:
        """The gamma with which scale decay would weigh as much as the photographs, over the iterations since `settle`."""
        return balance(*self._sums)

    @torch.no_grad()
    def balance_before(self, views: Sequence[int]) -> float:
        """The same for the Gaussians as they are, from renders of some training views."""
        for view in views:
            self._rendered(view)
        found, self._sums = self.balance, [0.0, 0.0]
        return found

    @property
    def average(self) -> Gaussians:
        """A copy of the running average since points were last added or removed."""
        return self._average.gaussians.detached()

    def narrow(self, bounds: Bounds) -> int:
        """Narrows scales beyond `bounds`; returns how many of the average's Gaussians were too wide."""
        bounds.apply(self.gaussians)
        return bounds.apply(self._average.gaussians)

    def settle(self) -> None:
        """Continues from the running average; the balance is counted anew."""
        with torch.no_grad():
            for name, tensor in self._average.gaussians.tensors().items():
                getattr(self.gaussians, name).copy_(tensor)
        self._sums = [0.0, 0.0]

    def select(self, keep: torch.Tensor) -> None:
        """Keeps only the Gaussians in `keep`, (N,) bool, with their moments."""
        self._optimiser.select(keep)
        self._average.restart(self.gaussians)

    def clamp_opacity(self, highest: float) -> None:
        """Lowers opacities above `highest` (0..1) to it and resets their moments."""
        logits = self.gaussians.opacity.detach()
        limit = float(torch.logit(torch.tensor(highest)))
        above = torch.nonzero(logits > limit).squeeze(1)
        self._optimiser.reset("opacity", torch.full_like(logits[above], limit), above)
        self._average.restart(self.gaussians)

    def step(self, iteration: int, gamma: float) -> float:
        """Takes one iteration and returns its loss."""
        self.view = view = view_at(self._scene.train, self._seed, self._purpose, iteration)
        loss, decay = self._rendered(view)
        if gamma > 0:
            loss = loss + gamma * decay
        loss.backward()
        self._optimiser.step()
        self._average.take(self.gaussians)
        return float(loss.detach())

    def _rendered(self, view: int) -> tuple[torch.Tensor, torch.Tensor]:
        """The loss of a view's photograph, and the loss that gamma weighs."""
        rendering = render(self._shown(), self._scene.cameras[view], alpha_max=ALPHA_MAX_L1)
        image, photograph = self._scene.unmasked(view, rendering.image), self._scene.photograph(view).to(self.gaussians.device)
        loss = photometric(image, self._ssim(view), photograph)
        if self._squared:
            loss = with_squared_error(loss, image, photograph)
        decay = self._decay(rendering)
        self._sums[0] += float(loss.detach())
        self._sums[1] += float(decay.detach())
        return loss, decay

    def _shown(self) -> Gaussians:
        """What is rendered while training."""
        return self.gaussians

    def _decay(self, rendering: Rendering) -> torch.Tensor:
        """The loss that gamma weighs: WS."""
        return weighted_scale(self.gaussians.log_scales, rendering.index, rendering.tiles)

    def state(self) -> dict[str, object]:
        """Everything that `load` needs."""
        return {"optimiser": self._optimiser.state(), "average": self._average.state(), "sums": list(self._sums)}

    def load(self, state: dict[str, object]) -> None:
        """Restores what `state` returned."""
        self._optimiser.load(state["optimiser"])
        self._average.load(state["average"], self.gaussians.device)
        self._sums = list(state["sums"])
