"""A steerable pyramid of six orientations, filtered in the spatial domain (Simoncelli and Freeman 1995).

The taps are those published for order 5 (`sp5Filters` of matlabPyrTools, also in pyrtools). As in the field's metamer losses,
they are cut to their central 5x5, and the low-pass is scaled back to its sum before the cut, 0.99918. The high-pass sums to
-0.029 after the cut, so 3 % of a uniform offset remain in it. The bands are odd functions and pass nothing of an offset.
"""

from __future__ import annotations

import numpy as np
import torch
from torch.nn.functional import avg_pool2d, conv2d, pad

LEVELS = 5
"""Number of pyramid levels: four with bands, each half the size of the one before, and the low-pass."""

ORIENTATIONS = 6
MULTIPLE = 2**LEVELS
"""Image sizes must be multiples of this, so that every level halves exactly and is at least 2 pixels wide and high."""

REACH = 2
"""Number of pixels that a filter reaches to each side."""

# One quadrant of each symmetric filter, from the centre outwards.
_HIGH = ((0.813802, -0.11435863, -0.00981051), (-0.11435863, -0.07027679, -0.00673482), (-0.00981051, -0.00673482, -0.00290081))
_LOW = ((0.4030415, 0.1592557, -0.03848215), (0.1592557, 0.05586982, -0.01551246), (-0.03848215, -0.01551246, 0.00341614))

# The rows above the centre and the left half of the centre's row, for the odd bands; the rest is the negative of these,
# rotated by 180 degrees.
_VERTICAL = (
    (-0.00893064, -0.03075356, 0.0, 0.03075356, 0.00893064),
    (0.01189859, -0.08226445, 0.0, 0.08226445, -0.01189859),
    (0.02755155, -0.11732297),
)
_OBLIQUE = (
    (-0.01977507, 0.01486305, 0.04435647, -0.00853965, -0.01161195),
    (-0.04084211, -0.04819057, 0.09454202, 0.05394139, -0.03930573),
    (-0.00228219, -0.1222723),
)


def filters() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(5, 5) high-pass, (5, 5) low-pass and (6, 5, 5) band taps, float64, applied as correlations."""
    vertical, oblique = _odd(_VERTICAL), _odd(_OBLIQUE)
    # All six come from two by rotation and reflection. Two are needed because a 30 degree rotation is no symmetry of the grid.
    bands = [vertical, oblique, -oblique.T, -vertical.T, np.rot90(oblique), oblique[:, ::-1]]
    return _symmetric(_HIGH), _symmetric(_LOW), np.stack(bands)


class SteerablePyramid:
    """Computes the maps of an image: one high-pass, six bands on each of four levels, one low-pass."""

    def __init__(self, like: torch.Tensor) -> None:
        """Prepares the filters.

        Args:
            like: a tensor of the images' device and dtype.
        """
        shape = (-1, 1, 2 * REACH + 1, 2 * REACH + 1)
        self._high, self._low, self._bands = (torch.from_numpy(taps.reshape(shape)).to(like) for taps in filters())

    def __call__(self, planes: torch.Tensor) -> tuple[torch.Tensor, list[torch.Tensor], torch.Tensor]:
        """Computes the maps. Halving takes the mean of 2x2 pixels (bilinear); beyond its edges the image is mirrored.

        Args:
            planes: (C, H, W), H and W multiples of 32.

        Returns:
            The high-pass (C, H, W), for each level the bands (6C, h, w), and the low-pass (C, H / 16, W / 16).
        """
        images = planes[:, None]
        high = _filtered(images, self._high)
        low = _filtered(images, self._low)
        bands = []
        for _ in range(LEVELS - 1):
            bands.append(_filtered(low, self._bands).flatten(0, 1))
            low = avg_pool2d(low, 2)
        return high[:, 0], bands, low[:, 0]


def _filtered(images: torch.Tensor, taps: torch.Tensor) -> torch.Tensor:
    """The correlation with the taps, of the images' size."""
    return _Correlation.apply(pad(images, (REACH,) * 4, mode="reflect"), taps)


class _Correlation(torch.autograd.Function):
    """conv2d whose derivative is a conv2d of each band on its own, then summed: on CPUs this takes a fifteenth of the time of
    one with a single channel of results, and torch's own backward pass is slower still."""

    @staticmethod
    def forward(ctx: object, images: torch.Tensor, taps: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(taps)
        return conv2d(images, taps)

    @staticmethod
    def backward(ctx: object, grad: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        (taps,) = ctx.saved_tensors
        return conv2d(grad, taps.flip(2, 3), padding=2 * REACH, groups=len(taps)).sum(1, keepdim=True), None


def _symmetric(quadrant: tuple[tuple[float, ...], ...]) -> np.ndarray:
    """The filter that results from mirroring a quadrant at its first row and column."""
    right = np.array(quadrant)
    lower = np.concatenate([right[:, :0:-1], right], axis=1)
    return np.concatenate([lower[:0:-1], lower])


def _odd(first_half: tuple[tuple[float, ...], ...]) -> np.ndarray:
    """The 5x5 odd filter, f(-x) = -f(x), from the taps before its centre."""
    half = np.concatenate([np.array(row) for row in first_half])
    return np.concatenate([half, [0.0], -half[::-1]]).reshape(2 * REACH + 1, 2 * REACH + 1)
