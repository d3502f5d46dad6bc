"""A model's quality on a set of views: PSNR, SSIM and HVSQ against the photographs, and the cost of its frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from golden.diff.gaussians import Gaussians
from golden.diff.render import render
from golden.metrics import image as metrics
from golden.metrics.hvsq import Hvsq
from spec.constants import ALPHA_MAX_L1, TILE

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

MARGIN = 0.5
"""Standard errors of the mean loss that a gate requires above its threshold."""

MOST_GAIN = 1.0
"""dB by which a view counts at most as better than the dense model's. Where a splat in front of one camera spoils a view of the
dense model, pruning it away gains many dB in that view, which would pay for losses in all others."""


@dataclass(frozen=True)
class Quality:
    """Quality as means over views.

    Attributes:
        psnr: dB, the mean of the views' PSNRs.
        ssim: scikit-image's, see `golden.metrics.image`; None where it was not asked for.
        entries: number of intersections in a frame (the tile-ellipse intersections of the paper).
        entries_per_tile: the same divided by the number of the frame's tiles.
        points: number of Gaussians in the model.
        hvsq: one value for each pooling size asked for.
        views: PSNR and, where asked for, SSIM of each view.
    """

    psnr: float
    ssim: float | None
    entries: float
    entries_per_tile: float
    points: int
    hvsq: tuple[float, ...] = ()
    views: tuple[tuple[float, ...], ...] = ()


KINDS = ("psnr", "both")
"""What a gate reads: PSNR alone, as the paper defines its variants, or SSIM too, as the code of its predecessor does."""


@dataclass(frozen=True)
class Gate:
    """The lowest accepted quality of a pruned model, measured on validation views.

    The validation views are few and represent all views to come. So means are lowered by MARGIN standard errors of the losses,
    that is, by MARGIN times the standard deviation of psnr_i - dense_i over the square root of the number of views. With many
    views this margin vanishes; with one view there is none. A view that gains counts with MOST_GAIN at most.

    Attributes:
        psnr: dB.
        ssim: 0..1, or None: SSIM is not read.
        dense: PSNR and, if it is read, SSIM of the dense model for each view, from which losses are counted; without them there
            is no margin, and gains count in full.
    """

    psnr: float
    ssim: float | None = None
    dense: tuple[tuple[float, ...], ...] = ()

    @classmethod
    def of(cls, dense: Quality, loss: float, kind: str = "psnr") -> Gate:
        """The gate that accepts a loss of at most the share `loss` (0..1) of the dense model's PSNR and, if `kind` is `both`,
        of its SSIM.

        Raises:
            ValueError: `loss` is not such a share, or there is no such kind.
        """
        if not 0 <= loss < 1:
            raise ValueError(f"loss must be a share of the dense quality in 0..1, not {loss!r}")
        if kind not in KINDS:
            raise ValueError(f"kind must be one of {KINDS}, not {kind!r}")
        if kind == "psnr":
            return cls((1 - loss) * dense.psnr, None, tuple(view[:1] for view in dense.views))
        return cls((1 - loss) * dense.psnr, (1 - loss) * dense.ssim, dense.views)

    @property
    def reads_ssim(self) -> bool:
        """Whether the gate needs SSIM."""
        return self.ssim is not None

    def slack(self, quality: Quality) -> float:
        """By how much PSNR, and SSIM if it is read, exceed their thresholds, as a share of the threshold, for the worse of the
        two; below 0 the gate fails."""
        found = np.array([quality.psnr, quality.ssim] if self.reads_ssim else [quality.psnr])
        least = np.array([self.psnr, self.ssim] if self.reads_ssim else [self.psnr])
        if len(self.dense) > 1 and len(self.dense) == len(quality.views):
            gains = np.array([view[: len(found)] for view in quality.views]) - np.array(self.dense)
            counted = np.minimum(gains, [MOST_GAIN, np.inf][: len(found)])
            found = found - (gains - counted).mean(axis=0) - MARGIN * counted.std(axis=0, ddof=1) / np.sqrt(len(counted))
        return float((found / least).min() - 1)

    def passes(self, quality: Quality) -> bool:
        """Whether all thresholds are met."""
        return self.slack(quality) >= 0


def evaluate(
    gaussians: Gaussians,
    scene: TrainingScene,
    views: Sequence[int],
    *,
    alpha_max: float = ALPHA_MAX_L1,
    hvsq: Sequence[Callable[[torch.Tensor], Hvsq]] = (),
    ssim: bool = True,
    progress: Callable[[int], object] | None = None,
) -> Quality:
    """Renders views of the scene and compares them with the photographs; images are clamped to 0..1 as on a display.

    PSNR is that of the pixels that a view's mask does not hide. For SSIM and HVSQ, hidden pixels count as equal.

    Args:
        gaussians: one level.
        scene: the scene.
        views: indices into the scene's cameras, at least one.
        alpha_max: upper bound of alpha.
        hvsq: makes the metric from a view's photograph, for each HVSQ that is wanted.
        ssim: whether SSIM is wanted; it takes about as long as rendering.
        progress: called with the number of views done.

    Raises:
        ValueError: there are no views.
    """
    if not len(views):
        raise ValueError("views must name at least one view, not none")
    rows = []
    with torch.no_grad():
        for done, view in enumerate(views, 1):
            camera, photograph = scene.cameras[view], scene.photograph(view).to(gaussians.device)
            rendering = render(gaussians, camera, alpha_max=alpha_max)
            shown = scene.unmasked(view, rendering.image.clamp(0.0, 1.0))
            tiles = -(-camera.width // TILE) * -(-camera.height // TILE)
            left, right = shown.cpu().numpy(), photograph.cpu().numpy()
            psnr = metrics.psnr(left, right) + 10 * np.log10(scene.shown_share(view))
            rows.append([psnr, metrics.ssim(left, right) if ssim else 0.0, rendering.entries, rendering.entries / tiles,
                         *(float(make(photograph)(shown)) for make in hvsq)])
            if progress is not None:
                progress(done)
    psnr, similarity, entries, per_tile, *pooled = (float(value) for value in np.mean(rows, axis=0))
    views = tuple(tuple(map(float, row[: 2 if ssim else 1])) for row in rows)
    return Quality(psnr, similarity if ssim else None, entries, per_tile, len(gaussians), tuple(pooled), views)
