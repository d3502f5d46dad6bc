"""HVSQ: how far the local statistics of two images differ, as peripheral vision sees them (Walton et al. 2021).

Lower is better. Both images are converted to YCrCb and to a steerable pyramid. Its 25 high-pass and band maps are compared by
mean and standard deviation over every pixel's pooling window, and its low-pass is compared directly. So there are 51 maps of
squared differences. Windows are boxes or blocks whose width in pixels halves from level to level of the pyramid
(`golden.metrics.pooling` defines both). The width is the same for the whole image, or each pixel has its own box from its
eccentricity.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch.nn.functional import avg_pool2d, interpolate, threshold

from golden.metrics.pooling import KINDS, MapPooling, Pooling, UniformPooling
from golden.metrics.pyramid import LEVELS, MULTIPLE, ORIENTATIONS, SteerablePyramid
from golden.scenes.gaze import Display
from spec.constants import DISPLAY_FOV_DEG

POOLING_PX = (1.0, 3.0, 7.0, 12.0)
"""Pooling widths of levels 1 to 4 in pixels of a frame that is FULL_WIDTH wide: those at the eccentricity where each region
starts."""

FULL_WIDTH = 1237
POOLING_PER_ECCENTRICITY = 0.05
"""Pooling diameter in radians per squared radian of eccentricity."""

MAPS = 2 * (1 + ORIENTATIONS * (LEVELS - 1)) + 1
"""Number of compared maps: mean and standard deviation of the high-pass and of every band, and the low-pass."""

MIN_VARIANCE = 1e-7


def pooling_px(level: int, width: int) -> float:
    """Pooling width in pixels, for `Hvsq`, of a 0-based level in frames of a given width in pixels.

    A width below 1 acts as 1, so in frames under 412 pixels the first two levels are judged alike.

    Raises:
        ValueError: there is no such level.
    """
    if level not in range(len(POOLING_PX)):
        raise ValueError(f"level {level!r} has no pooling width: 0 to {len(POOLING_PX) - 1} have")
    return POOLING_PX[level] * width / FULL_WIDTH


def pooling_map(eccentricity_deg: np.ndarray, fov_deg: float = DISPLAY_FOV_DEG) -> np.ndarray:
    """(H, W) float64 pooling widths in pixels on a flat display: each pixel's square has the area of its pooling ellipse.

    Pooling regions are cones around each pixel's direction. The display cuts them in ellipses that grow towards its edges.

    Args:
        eccentricity_deg: (H, W) degrees from the gaze, see `golden.scenes.gaze.Display.eccentricity`.
        fov_deg: angle that the width of that display spans, in degrees.
    """
    height, width = eccentricity_deg.shape
    display = Display(width, height, fov_deg)
    directions = display.directions(np.arange(width)[None, :] + 0.5, np.arange(height)[:, None] + 0.5)
    distance = np.linalg.norm(directions, axis=-1)
    diameter = POOLING_PER_ECCENTRICITY * np.radians(eccentricity_deg) ** 2
    axis = directions[0, 0, 2]  # distance from the eye to the display's centre, in pixels
    return math.sqrt(math.pi) / 2 * diameter * distance * np.sqrt(distance / axis)


class Hvsq:
    """HVSQ of images against one reference, differentiable in the image; deterministic on the CPU.

    Image and reference are resized (bilinear) to the next multiples of 32, and windows are in pixels of that size. The
    reference's statistics are computed once (see `nbytes`). They take up to 216 bytes a pixel in float32, and half of it where
    no window is wider than a pixel; a map of widths takes up to 340 bytes a pixel more. Values outside 0..1 are compared as
    they are.
    """

    def __init__(self, reference: torch.Tensor, pooling: float | np.ndarray | torch.Tensor, kind: str = "box") -> None:
        """Prepares the statistics of the reference.

        Args:
            reference: (H, W, 3) RGB floats of range 1; its device and dtype are those of all results.
            pooling: width of the pooling windows in pixels, one for all (`pooling_px`) or (H, W) (`pooling_map`).
            kind: one of `golden.metrics.pooling.KINDS`; a map of widths has boxes.

        Raises:
            ValueError: the reference or the width has the wrong shape or dtype, a width is negative or not finite, or there is
                no such kind for this width.
        """
        if reference.ndim != 3 or reference.shape[2] != 3 or not reference.is_floating_point():
            raise ValueError(f"a reference must be (H, W, 3) floats, not {tuple(reference.shape)} {reference.dtype}")
        self.shape = reference.shape
        self._size = tuple(-(-n // MULTIPLE) * MULTIPLE for n in self.shape[:2])
        self._pyramid = SteerablePyramid(reference)
        widths = self._checked(pooling)
        if kind not in KINDS or (widths.ndim and kind != "box"):
            raise ValueError(f"kind {kind!r} is not accepted: {' or '.join(KINDS)} is, and box alone with a map of widths")
        self._pooling = _poolings(widths, self._size, reference, kind)
        with torch.no_grad():
            *levels, self._low = self._features(reference)
            self._reference = [
                [_statistics(maps, pooling) for maps in group] for group, pooling in zip(levels, self._pooling, strict=True)
            ]

    def __call__(self, image: torch.Tensor, mask: torch.Tensor | None = None) -> torch.Tensor:
        """HVSQ as a scalar tensor.

        Args:
            image: (H, W, 3), of the reference's size.
            mask: (H, W) bool or weights over whose pixels the mean is taken; None for all pixels.

        Raises:
            ValueError: the image has another size, or the mask is empty.
        """
        return self._reduced(self._terms(image, squared=True), mask)

    def absolute(self, image: torch.Tensor, mask: torch.Tensor | None = None) -> torch.Tensor:
        """The training loss: as HVSQ, but with absolute instead of squared differences."""
        return self._reduced(self._terms(image, squared=False), mask)

    def regions(self, image: torch.Tensor, masks: Sequence[torch.Tensor]) -> torch.Tensor:
        """(R,) HVSQ of each of R regions, from one comparison; see `__call__`."""
        terms = self._terms(image, squared=True)
        return torch.stack([self._reduced(terms, mask) for mask in masks])

    def per_pixel(self, image: torch.Tensor) -> torch.Tensor:
        """(H, W) the terms of each pixel, summed; a term of a coarse level is repeated over the pixels that it covers.

        The mean is HVSQ where H and W are multiples of 32. Otherwise the map is resized back and the mean differs slightly.
        """
        terms = self._terms(image, squared=True)
        whole = sum(interpolate(term[None, None], size=self._size, mode="nearest") for term in terms)
        return _resized(whole, self.shape[:2])[0, 0]

    @property
    def nbytes(self) -> int:
        """Size of the reference's statistics in bytes."""
        kept = [self._low, *(part for group in self._reference for statistics in group for part in statistics)]
        return sum(part.nbytes for part in kept if part is not None)

    def _terms(self, image: torch.Tensor, squared: bool) -> list[torch.Tensor]:
        """For each level, a map of that level's size with the sum of its terms, and last the low-pass's; HVSQ is the sum of
        their means."""
        if image.shape != self.shape:
            raise ValueError(f"image must have the reference's shape {tuple(self.shape)}, not {tuple(image.shape)}")
        *levels, low = self._features(image)
        terms = []
        for maps, references, pooling in zip(levels, self._reference, self._pooling, strict=True):
            terms.append(sum(_Difference.apply(m, *r, pooling, squared) for m, r in zip(maps, references, strict=True)))
        difference = low - self._low
        terms.append((difference**2 if squared else difference.abs()).sum(0))
        return [term / (3 * MAPS) for term in terms]

    def _reduced(self, terms: list[torch.Tensor], mask: torch.Tensor | None) -> torch.Tensor:
        """The sum of the terms' means over the pixels of a mask."""
        if mask is None:
            return sum(term.mean() for term in terms)
        if mask.shape != self.shape[:2]:
            raise ValueError(f"mask must have the image's size {tuple(self.shape[:2])}, not {tuple(mask.shape)}")
        weight = _resized(mask.to(terms[0])[None, None], self._size)
        if not weight.sum() > 0:
            raise ValueError("mask must hold a pixel, not none")
        return sum((term * avg_pool2d(weight, self._size[0] // len(term))[0, 0]).sum() * (self._size[0] // len(term)) ** 2
                   for term in terms) / weight.sum()

    def _features(self, image: torch.Tensor) -> list:
        """For each level its groups of maps, and last the low-pass, all from the YCrCb planes."""
        high, bands, low = self._pyramid(_ycrcb(_resized(image.permute(2, 0, 1)[None], self._size)[0]))
        return [[high, bands[0]], *([level] for level in bands[1:]), low]

    def _checked(self, pooling: float | np.ndarray | torch.Tensor) -> np.ndarray:
        """The widths as an array, () or (H, W)."""
        if isinstance(pooling, torch.Tensor):
            pooling = pooling.detach().cpu().numpy()
        pooling = np.asarray(pooling, dtype=np.float64)
        if pooling.shape not in ((), tuple(self.shape[:2])):
            raise ValueError(f"pooling must be a number or have the image's size {tuple(self.shape[:2])}, not {pooling.shape}")
        if not (np.isfinite(pooling).all() and (pooling >= 0).all()):
            raise ValueError(f"pooling widths must be finite and not negative, not {pooling.min()} to {pooling.max()}")
        return pooling


def foveated(reference: torch.Tensor, eccentricity_deg: np.ndarray, fov_deg: float = DISPLAY_FOV_DEG) -> Hvsq:
    """HVSQ for one gaze, in which each pixel's window depends on its eccentricity. It judges whole foveated or warped frames.

    Args:
        reference: (H, W, 3), see `Hvsq`.
        eccentricity_deg: (H, W) degrees, see `golden.scenes.gaze.Display.eccentricity`.
        fov_deg: angle that the width of the display spans for those eccentricities, in degrees.
    """
    return Hvsq(reference, pooling_map(eccentricity_deg, fov_deg))


class _Difference(torch.autograd.Function):
    """(h, w) sum over maps of the differences between their statistics and the reference's, with the derivative in closed
    form."""

    @staticmethod
    def forward(
        ctx: object, maps: torch.Tensor, mean_r: torch.Tensor, deviation_r: torch.Tensor | None, pooling: Pooling | None,
        squared: bool,
    ) -> torch.Tensor:
        mean, deviation = _statistics(maps, pooling)
        difference = mean - mean_r
        by_mean = 2 * difference if squared else difference.sign()
        total = _size(difference, squared)
        by_square = None  # twice the derivative with respect to the pooled square
        if deviation is not None:
            difference = deviation - deviation_r
            by_square = 2 * difference if squared else difference.sign()
            # Where the variance is clamped, the deviation is constant and its derivative 0.
            by_square /= threshold(deviation, math.sqrt(MIN_VARIANCE) * (1 + 1e-6), math.inf)
            by_mean.addcmul_(mean, by_square, value=-1)
            total += _size(difference, squared)
        ctx.save_for_backward(maps, by_mean, by_square)
        ctx.pooling = pooling
        return total

    @staticmethod
    def backward(ctx: object, grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        maps, by_mean, by_square = ctx.saved_tensors
        if by_square is None:
            return by_mean * grad, None, None, None, None
        result = ctx.pooling.adjoint(by_square * grad).mul_(maps)
        return result.add_(ctx.pooling.adjoint(by_mean * grad)), None, None, None, None


def _size(difference: torch.Tensor, squared: bool) -> torch.Tensor:
    """(h, w) sum over maps of the squared or absolute differences; the argument's memory is overwritten."""
    return (difference.square_() if squared else difference.abs_()).sum(0)


def _statistics(maps: torch.Tensor, pooling: Pooling | None) -> tuple[torch.Tensor, torch.Tensor | None]:
    """Pooled mean and standard deviation of (C, h, w) maps; the deviation is None where no window is wider than a pixel."""
    if pooling is None:
        return maps, None
    mean = pooling.mean(maps)
    variance = pooling.mean(maps.square()).addcmul_(mean, mean, value=-1)
    return mean, variance.clamp_(min=MIN_VARIANCE).sqrt_()


def _poolings(widths: np.ndarray, size: tuple[int, int], like: torch.Tensor, kind: str) -> list[Pooling | None]:
    """The pooling of each level that has bands.

    It is None where no window is wider than a pixel: the mean is then the pixel itself and there is no deviation.
    """
    whole = _resized(torch.from_numpy(widths)[None, None], size) if widths.ndim else None
    poolings: list[Pooling | None] = []
    for scale in (2**level for level in range(LEVELS - 1)):
        if whole is None:
            shape = (size[0] // scale, size[1] // scale)
            poolings.append(UniformPooling(float(widths) / scale, shape, like, kind) if widths > scale else None)
        else:
            level = avg_pool2d(whole, scale)[0, 0].numpy() / scale
            poolings.append(MapPooling(level, like) if (level > 1).any() else None)
    return poolings


def _ycrcb(rgb: torch.Tensor) -> torch.Tensor:
    """Converts (3, H, W) RGB to ITU-R BT.601 luma and scaled colour differences, without the offsets, which would cancel
    here."""
    red, green, blue = rgb
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    return torch.stack([luma, 0.713 * (red - luma), 0.564 * (blue - luma)])


def _resized(images: torch.Tensor, size: Sequence[int]) -> torch.Tensor:
    """Bilinear resizing of (1, C, H, W) to a size; returns the argument itself where it already has that size."""
    if tuple(images.shape[2:]) == tuple(size):
        return images
    return interpolate(images, size=tuple(size), mode="bilinear", align_corners=False)
