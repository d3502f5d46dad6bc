"""What pruning ranks Gaussians by: computational efficiency (paper section 3.2), and what the field used before.

Every criterion is a score, the lowest goes first. Criteria that are measured on views keep each view's score, so that a
part of the views can be measured again after each part of a prune while the others' last scores stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from golden.diff.gaussians import Gaussians
from golden.diff.render import Rendering, render
from golden.scenes.camera import Camera
from golden.training.views import generator
from spec.constants import ALPHA_MAX_L1

CRITERIA = ("ce", "importance", "count", "random")
"""Val / Comp; LightGaussian's significance; opacity; no criterion at all."""

VOLUME_POWER = 0.1
"""Exponent of a Gaussian's volume in `importance`, as LightGaussian's public code is run."""

TIE_BREAK = 2.0**-20
"""Weight of sum(T alpha) beside dominated pixels in CE: most Gaussians of a dense model dominate nothing, and of those the
ones with the least contribution per tile go first. Far too small to change the order of Gaussians that dominate a pixel."""


def efficiency(rendering: Rendering, count: int) -> torch.Tensor:
    """(count,) float32 CE = Val / Comp of one view.

    Val: pixels whose largest T alpha is the Gaussian's. Comp: tiles that used it before the whole tile stopped. 0 where no
    tile used it. Ties are broken by TIE_BREAK.

    Args:
        rendering: made with `usage=True`.
        count: Gaussians in the model.
    """
    value = rendering.dominated + TIE_BREAK * rendering.weight
    score = torch.where(rendering.tiles > 0, value / rendering.tiles.clamp(min=1), 0.0)
    return _scatter(score, rendering.index, count)


def contribution(rendering: Rendering, count: int) -> torch.Tensor:
    """(count,) float32 sum over pixels of T alpha, of one view rendered with `usage=True`."""
    return _scatter(rendering.weight, rendering.index, count)


def _scatter(values: torch.Tensor, index: torch.Tensor, count: int) -> torch.Tensor:
    """(count,) float32 `values` at `index`, 0 elsewhere."""
    full = torch.zeros(count, dtype=torch.float32, device=values.device)
    full[index] = values.to(torch.float32)
    return full


def importance(contributions: torch.Tensor, log_scales: torch.Tensor) -> torch.Tensor:
    """(N,) LightGaussian's global significance: sum over the pixels of all views of T alpha, times volume^0.1.

    Fan et al. 2023, equations of section 3.2, with alpha for opacity, so that a pixel at the rim of a footprint counts
    less. The normalisation of volumes by a quantile changes no rank and is left out, as is its clipping, which the public
    code does not do.

    Args:
        contributions: (N,) sum of T alpha over all views.
        log_scales: (N, 3).
    """
    return contributions * torch.exp(VOLUME_POWER * log_scales.sum(dim=1))


def widened(camera: Camera, margin: float) -> Camera:
    """The camera with its frame grown by a share of its size on every side: what lies just outside is judged too."""
    left, top = round(margin * camera.width), round(margin * camera.height)
    return replace(
        camera, cx=camera.cx + left, cy=camera.cy + top, width=camera.width + 2 * left, height=camera.height + 2 * top)


class Scores:
    """The scores of all Gaussians by one criterion, kept current through retraining and pruning.

    Attributes:
        criterion: one of CRITERIA.
        share: parts that the views are measured in; 1 measures all views at every call.
    """

    def __init__(
        self, criterion: str, cameras: Sequence[Camera], *, share: int = 1, alpha_max: float = ALPHA_MAX_L1, seed: int = 0
    ) -> None:
        if criterion not in CRITERIA:
            raise ValueError(f"criterion must be one of {CRITERIA}, not {criterion!r}")
        if not cameras:
            raise ValueError("cameras must hold at least one camera, not none")
        if share < 1:
            raise ValueError(f"share must be at least 1, not {share!r}")
        self.criterion, self.share = criterion, min(share, len(cameras))
        self._cameras, self._alpha_max, self._seed = cameras, alpha_max, seed
        self._calls = 0
        self._rows: torch.Tensor | None = None

    @torch.no_grad()
    def measure(self, gaussians: Gaussians) -> torch.Tensor:
        """(N,) scores: of the views, the next part is measured anew, all of them at the first call."""
        turn, self._calls = self._calls, self._calls + 1
        if self.criterion == "count":
            return gaussians.amplified_opacity.detach()
        if self.criterion == "random":
            drawn = generator(self._seed, "prune", turn).random(len(gaussians), dtype=np.float32)
            return torch.from_numpy(drawn).to(gaussians.device)
        if self._rows is None:
            self._rows = torch.zeros((len(self._cameras), len(gaussians)), device=gaussians.device)
            part = range(len(self._cameras))
        else:
            part = range(turn % self.share, len(self._cameras), self.share)
        of_view = efficiency if self.criterion == "ce" else contribution
        for view in part:
            rendering = render(gaussians, self._cameras[view], alpha_max=self._alpha_max, usage=True)
            self._rows[view] = of_view(rendering, len(gaussians))
        if self.criterion == "ce":
            return self._rows.amax(dim=0)
        return importance(self._rows.sum(dim=0), gaussians.log_scales.detach())

    def select(self, keep: torch.Tensor) -> None:
        """Follow the Gaussians through a prune: `keep` is (N,) bool or rows."""
        if self._rows is not None:
            self._rows = self._rows[:, keep]

    def state(self) -> dict[str, object]:
        """For `load`."""
        return {"calls": self._calls, "rows": None if self._rows is None else self._rows.clone()}

    def load(self, state: dict[str, object]) -> None:
        """Back to where `state` was taken."""
        self._calls = state["calls"]
        self._rows = None if state["rows"] is None else state["rows"].clone()


def without_lowest(scores: torch.Tensor, count: int) -> torch.Tensor:
    """(N,) bool: all but the `count` lowest scores; of equal ones the first in the model go first."""
    keep = torch.ones(len(scores), dtype=torch.bool, device=scores.device)
    keep[torch.argsort(scores, stable=True)[:count]] = False
    return keep
