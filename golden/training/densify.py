"""Adaptive density control (3DGS section 5.2): adds Gaussians where the gradients of the positions on the screen are large."""

from __future__ import annotations

import numpy as np
import torch

from golden.diff.gaussians import Gaussians
from golden.training.optimiser import Optimiser

PERCENT_DENSE = 0.01
"""Gaussians up to this share of the scene's extent are cloned, larger ones are split (3DGS)."""

SPLIT_SHRINK = 1.6
"""The scale of a split Gaussian's two parts is divided by this (3DGS)."""

MIN_OPACITY = 0.005
"""Gaussians of a lower opacity are removed (3DGS)."""


class ScreenGradients:
    """Each Gaussian's mean gradient on the screen over the views that showed it, since rows were last added or removed.

    Args:
        points: number of Gaussians.
        device: where to keep the sums.
    """

    def __init__(self, points: int, device: torch.device | str = "cpu") -> None:
        self.total = torch.zeros(points, device=device)
        self.views = torch.zeros(points, device=device)

    def observe(self, index: torch.Tensor, grad: torch.Tensor, size: tuple[int, int]) -> None:
        """Adds the gradients of one view.

        Args:
            index: (M,) rows of the Gaussians on the screen, each once.
            grad: (M, 2) gradients of the loss with respect to `mean2d`, in 1/px.
            size: (width, height) of the frame. As in 3DGS, gradients are converted to half frames, so that no resolution is
                favoured.
        """
        norm = torch.hypot(grad[:, 0] * (size[0] / 2), grad[:, 1] * (size[1] / 2))
        self.total[index] += norm
        self.views[index] += 1

    @property
    def mean(self) -> torch.Tensor:
        """(N,) mean gradient; 0 for Gaussians that no view has shown."""
        return self.total / self.views.clamp(min=1)

    def state(self) -> dict[str, torch.Tensor]:
        """Copies of the sums, for `load`."""
        return {"total": self.total.clone(), "views": self.views.clone()}

    def load(self, state: dict[str, torch.Tensor]) -> None:
        """Restores the sums from `state`."""
        self.total, self.views = (state[name].to(self.total.device).clone() for name in ("total", "views"))


def densify(optimiser: Optimiser, gradient: torch.Tensor, *, threshold: float, budget: int, small: float,
            random: np.random.Generator, blurred: torch.Tensor | None = None) -> int:
    """Clones and splits the Gaussians with the largest gradients, and splits those that blur a picture.

    A small one gets a copy of itself. A large one is replaced by two of 1/1.6 of its size, whose means are drawn from its own
    distribution.

    Args:
        optimiser: the Gaussians in training.
        gradient: (N,) see `ScreenGradients`.
        threshold: gradients must exceed it.
        budget: number of Gaussians that may be added.
        small: largest standard deviation, in world units, that counts as small.
        random: draws the means of split Gaussians.
        blurred: (N,) above 0 for Gaussians to split whatever their gradient and size, the largest first; they get up to half of
            the budget (Mini-Splatting has none).

    Returns:
        The number of Gaussians added.
    """
    budget, wide = max(budget, 0), torch.zeros_like(gradient, dtype=torch.bool)
    if blurred is not None:
        first = torch.argsort(blurred, descending=True, stable=True)[: budget // 2]
        wide[first[blurred[first] > 0]] = True
    others = torch.where(wide, -1.0, gradient)
    rows = torch.argsort(others, descending=True, stable=True)[: budget - int(wide.sum())]
    rows = torch.cat([rows[others[rows] > threshold], torch.nonzero(wide).squeeze(1)]).sort().values
    g = optimiser.gaussians.select(rows)
    large = (g.log_scales.max(dim=1).values.exp() > small) | wide[rows]
    clones, parents = g.select(~large), g.select(large)
    kept = torch.ones(len(optimiser.gaussians), dtype=torch.bool, device=g.device)
    kept[rows[large]] = False
    optimiser.select(kept)
    optimiser.append(clones)
    optimiser.append(split(parents, random))
    return len(rows)


def split(parents: Gaussians, random: np.random.Generator) -> Gaussians:
    """Two Gaussians for each parent, of 1/1.6 of its size, with means drawn from its distribution: all first ones, then all
    second."""
    n = len(parents)
    noise = torch.from_numpy(random.standard_normal((2 * n, 3)).astype(np.float32)).to(parents.device)
    both = parents.map(lambda tensor: tensor.repeat(2, *[1] * (tensor.ndim - 1)))
    offset = rotated(both.quats, noise * both.log_scales.exp())
    both.means = both.means + offset
    both.log_scales = both.log_scales - float(np.log(SPLIT_SHRINK))
    return both


def rotated(quats: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
    """The vectors (N, 3) rotated by the wxyz `quats` (N, 4), which need not be normalised."""
    quats = torch.nn.functional.normalize(quats, dim=1)
    w, axis = quats[:, :1], quats[:, 1:]
    twice = 2 * torch.linalg.cross(axis, vectors, dim=1)
    return vectors + w * twice + torch.linalg.cross(axis, twice, dim=1)
