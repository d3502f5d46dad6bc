"""Scores by which pruning ranks Gaussians: what the images would lose without one, the paper's computational efficiency
(section 3.2), and the field's earlier criteria.

With every criterion, the Gaussians with the lowest score are pruned first. Criteria that are measured on views keep the score
of each view or of each part of the views. So some of the views can be measured again after each part of a prune, while the
others' last scores stand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from golden.diff.gaussians import Gaussians
from golden.diff.removal import removal
from golden.diff.render import Rendering, render
from golden.diff.sensitivity import PLACED, sensitivity
from golden.scenes.camera import Camera
from golden.training.views import generator
from spec.constants import ALPHA_MAX_L1

SENSITIVITIES = ("speedy", "pup")
"""Criteria that ask how much the images depend on a Gaussian: those of Speedy-Splat and of PUP 3D-GS."""

REMOVALS = ("removal", "removal_per_tile")
"""Criteria that ask what the images lose without a Gaussian: the squared change, summed over the pixels of all views, and the
same over the number of tiles that use it. The latter is CE with what the image loses as its Val: of all Gaussians, those that
cost the most intersections for the least error go first."""

CRITERIA = ("ce", *REMOVALS, "importance", "count", *SENSITIVITIES, "random")
"""The criteria: the paper's Val / Comp; what the images lose; LightGaussian's significance; opacity; sensitivities; a random
number."""

VOLUME_POWER = 0.1
"""Exponent of a Gaussian's volume in `importance`, with the value that LightGaussian's public code uses."""

TIE_BREAK = 2.0**-20
"""Weight of sum(T alpha) relative to dominated pixels in CE. Most Gaussians of a dense model dominate no pixel, and of those
the ones that contribute least per tile are pruned first. The weight is far too small to change the order of Gaussians that
dominate a pixel."""


def efficiency(rendering: Rendering, count: int) -> torch.Tensor:
    """(count,) float32 CE = Val / Comp of one view.

    Val is the number of pixels in which the Gaussian has the largest T alpha. Comp is the number of tiles that used it before
    all their pixels had stopped. The score is 0 if no tile used it. TIE_BREAK breaks ties.

    Args:
        rendering: a rendering made with `usage=True`.
        count: number of Gaussians in the model.
    """
    value = rendering.dominated + TIE_BREAK * rendering.weight
    score = torch.where(rendering.tiles > 0, value / rendering.tiles.clamp(min=1), 0.0)
    return _scatter(score, rendering.index, count)


def contribution(rendering: Rendering, count: int) -> torch.Tensor:
    """(count,) float32 sum of T alpha over the pixels of one view, which must be rendered with `usage=True`."""
    return _scatter(rendering.weight, rendering.index, count)


def _scatter(values: torch.Tensor, index: torch.Tensor, count: int) -> torch.Tensor:
    """(count,) float32 `values` at `index`, 0 elsewhere."""
    full = torch.zeros(count, dtype=torch.float32, device=values.device)
    full[index] = values.to(torch.float32)
    return full


def importance(contributions: torch.Tensor, log_scales: torch.Tensor) -> torch.Tensor:
    """(N,) LightGaussian's global significance: the sum of T alpha over the pixels of all views, times volume^0.1.

    Fan et al. 2023, equations of section 3.2, with alpha instead of opacity, so that a pixel at the rim of a footprint counts
    less. The normalisation of volumes by a quantile is left out because it changes no rank. Its clipping is left out because
    the public code does not do it.

    Args:
        contributions: (N,) sum of T alpha over all views.
        log_scales: (N, 3).
    """
    return contributions * torch.exp(VOLUME_POWER * log_scales.sum(dim=1))


UPPER = torch.triu_indices(PLACED, PLACED)
"""Rows and columns of the numbers that are kept of a symmetric matrix of PUP's."""


def speedy(values: torch.Tensor) -> torch.Tensor:
    """(N,) Speedy-Splat's score: the log of the sum of (dI / dg)^2 over the pixels, channels and views, g being a Gaussian's
    projected value (Hanson et al. 2024, "Speedy-Splat", section 4). The log of 0 is -inf: what no view sees goes first.

    Args:
        values: (N,) or (N, 1) sums over all views.
    """
    return torch.log(values.reshape(len(values)))


def pup(products: torch.Tensor) -> torch.Tensor:
    """(N,) PUP's score: log |det F| of a Gaussian's 6x6 matrix F, the sum of the outer products of dI / d(mean, log scales)
    over the pixels, channels and views (Hanson et al. 2024, "PUP 3D-GS", section 4). In the log scales as there, not in the
    scales, which would rank otherwise. -inf where F is singular.

    Args:
        products: (N, 21) upper triangles of the sums over all views, float64.
    """
    matrix = products.new_zeros(len(products), PLACED, PLACED)
    matrix[:, UPPER[0], UPPER[1]] = matrix[:, UPPER[1], UPPER[0]] = products
    return torch.linalg.slogdet(matrix).logabsdet


def widened(camera: Camera, margin: float) -> Camera:
    """The camera with its frame widened by a share of its size on every side, so that points just outside the frame are
    scored too."""
    left, top = round(margin * camera.width), round(margin * camera.height)
    return replace(
        camera, cx=camera.cx + left, cy=camera.cy + top, width=camera.width + 2 * left, height=camera.height + 2 * top)


class Scores:
    """The scores of all Gaussians by one criterion, kept up to date through retraining and pruning.

    Args:
        criterion: one of CRITERIA.
        cameras: the views' cameras.
        share: number of parts in which the views are measured; 1 measures all views at every call.
        alpha_max: upper bound of alpha.
        seed: seed of the criterion `random`.

    Raises:
        ValueError: the criterion is unknown, there is no camera, or `share` is below 1.
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
        """(N,) scores. One part of the views is measured again, and all of them at the first call."""
        turn, self._calls = self._calls, self._calls + 1
        if self.criterion == "count":
            return gaussians.amplified_opacity.detach()
        if self.criterion == "random":
            drawn = generator(self._seed, "prune", turn).random(len(gaussians), dtype=np.float32)
            return torch.from_numpy(drawn).to(gaussians.device)
        if self.criterion in SENSITIVITIES:
            return self._sensitivities(gaussians, turn)
        if self.criterion in REMOVALS:
            return self._removals(gaussians, turn)
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

    def _removals(self, gaussians: Gaussians, turn: int) -> torch.Tensor:
        """The scores of REMOVALS. A row holds the sums over a part of the views: squared changes, and tiles."""
        parts = [turn % self.share]
        if self._rows is None:
            self._rows = torch.zeros((self.share, 2, len(gaussians)), dtype=torch.float64, device=gaussians.device)
            parts = range(self.share)
        for part in parts:
            self._rows[part] = 0
            for view in range(part, len(self._cameras), self.share):
                found = removal(gaussians, self._cameras[view], alpha_max=self._alpha_max)
                self._rows[part].index_add_(1, found.index, torch.stack([found.change, found.tiles.double()]))
        change, tiles = self._rows.sum(dim=0)
        return change if self.criterion == "removal" else change / tiles.clamp(min=1)

    def _sensitivities(self, gaussians: Gaussians, turn: int) -> torch.Tensor:
        """The scores of SENSITIVITIES. A row holds the sums over a part of the views: 21 numbers of PUP's for each view
        would take too much memory."""
        matrices = self.criterion == "pup"
        parts = [turn % self.share]
        if self._rows is None:
            shape = self.share, len(gaussians), UPPER.shape[1] if matrices else 1
            self._rows, parts = torch.zeros(shape, dtype=torch.float64, device=gaussians.device), range(self.share)
        for part in parts:
            self._rows[part] = 0
            for view in range(part, len(self._cameras), self.share):
                found = sensitivity(gaussians, self._cameras[view], alpha_max=self._alpha_max, fisher=matrices)
                numbers = found.fisher[:, UPPER[0], UPPER[1]] if matrices else found.value[:, None]
                self._rows[part].index_add_(0, found.index, numbers)
        return (pup if matrices else speedy)(self._rows.sum(dim=0))

    def select(self, keep: torch.Tensor) -> None:
        """Removes the scores of pruned Gaussians; `keep` is (N,) bool or rows."""
        if self._rows is not None:
            self._rows = self._rows[..., keep] if self.criterion in REMOVALS else self._rows[:, keep]

    def state(self) -> dict[str, object]:
        """Everything that `load` needs."""
        return {"calls": self._calls, "rows": None if self._rows is None else self._rows.clone()}

    def load(self, state: dict[str, object]) -> None:
        """Restores what `state` returned."""
        self._calls = state["calls"]
        self._rows = None if state["rows"] is None else state["rows"].clone()


def without_lowest(scores: torch.Tensor, count: int) -> torch.Tensor:
    """(N,) bool: all but the `count` lowest scores. Of equal scores, those that come first in the model are removed first."""
    keep = torch.ones(len(scores), dtype=torch.bool, device=scores.device)
    keep[torch.argsort(scores, stable=True)[:count]] = False
    return keep
