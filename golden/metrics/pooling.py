"""Means over pooling windows: boxes of fractional width around every pixel, of one size for all pixels or one for each, or
blocks.

A box of width w around a pixel covers some neighbours only in part. Each neighbour is weighted by the share of it that lies in
the box, so the mean is continuous in w, and up to w = 1 it is the pixel itself. At the image's edges only what lies inside the
image counts.

Blocks are the windows of the code behind the paper's numbers: along each axis, n pixels are reduced to floor(n / w) by
averaging over areas, and brought back to n by bilinear interpolation. An area begins and ends at whole pixels, so neighbouring
areas may share a pixel. Blocks do not follow the pixel, so a shift of the image by less than a block changes little: they are
more lenient than boxes of the same width.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
import torch

from golden.metrics.banded import Banded, separable

KINDS = ("blocks", "box")
"""The kinds of windows of one width for all pixels."""


class Pooling(Protocol):
    """A linear map from planes (P, h, w) to the means over each pixel's window, (P, h, w)."""

    def mean(self, planes: torch.Tensor) -> torch.Tensor:
        """The means, in the planes' dtype."""

    def adjoint(self, planes: torch.Tensor) -> torch.Tensor:
        """The transposed map."""


class UniformPooling:
    """Windows that all have the same width, computed as products with two banded matrices."""

    def __init__(self, width_px: float, size: tuple[int, int], like: torch.Tensor, kind: str = "box") -> None:
        """Prepares the matrices.

        Args:
            width_px: width of the windows in pixels.
            size: (h, w) of the planes.
            like: a tensor of the planes' device and dtype.
            kind: one of KINDS.
        """
        matrix = _block_matrix if kind == "blocks" else _box_matrix
        self._bands = [Banded(matrix(width_px, n), like) for n in size]

    def mean(self, planes: torch.Tensor) -> torch.Tensor:
        """See `Pooling`."""
        return separable(planes, *self._bands)

    def adjoint(self, planes: torch.Tensor) -> torch.Tensor:
        """See `Pooling`."""
        return separable(planes, *self._bands, adjoint=True)


class MapPooling:
    """Boxes with a width for each pixel, from the integral image in float64, interpolated where a box ends inside a pixel.

    It is meant for judging, not for training: it keeps 256 bytes a pixel and takes ten times as long as one width for all. On
    CUDA the sums of the adjoint have no fixed order.
    """

    def __init__(self, width_px: np.ndarray, like: torch.Tensor) -> None:
        """Prepares the boxes' corners.

        Args:
            width_px: (h, w) widths in pixels; a width below 1 acts as 1.
            like: a tensor of the planes' device.
        """
        self.size = width_px.shape
        half = np.maximum(width_px, 1.0) / 2
        ends = []
        for axis, n in enumerate(self.size):
            centre = np.arange(n).reshape((-1, 1) if axis == 0 else (1, -1)) + 0.5
            ends.append((np.maximum(centre - half, 0.0), np.minimum(centre + half, n)))
        (top, bottom), (left, right) = ends
        area = (bottom - top) * (right - left)
        # Each of the box's four corners lies between four points of the integral image, which makes 16 terms a pixel.
        terms = [
            (row * (self.size[1] + 1) + column, (weight_y * weight_x / area).ravel())
            for y, sign_y in ((top, -1), (bottom, 1))
            for x, sign_x in ((left, -1), (right, 1))
            for row, weight_y in _between(y, sign_y, self.size[0])
            for column, weight_x in _between(x, sign_x, self.size[1])
        ]
        self._terms = [(torch.from_numpy(i.ravel()).to(like.device), torch.from_numpy(w).to(like.device)) for i, w in terms]

    def mean(self, planes: torch.Tensor) -> torch.Tensor:
        """See `Pooling`."""
        integral = planes.double().cumsum(1).cumsum(2)
        integral = torch.nn.functional.pad(integral, (1, 0, 1, 0)).flatten(1)
        result = torch.zeros(len(planes), self.size[0] * self.size[1], dtype=torch.float64, device=planes.device)
        for index, weight in self._terms:
            result += integral[:, index] * weight
        return result.view(planes.shape).to(planes)

    def adjoint(self, planes: torch.Tensor) -> torch.Tensor:
        """See `Pooling`."""
        height, width = self.size
        values = planes.double().flatten(1)
        corners = torch.zeros(len(planes), (height + 1) * (width + 1), dtype=torch.float64, device=planes.device)
        for index, weight in self._terms:
            corners.index_add_(1, index, values * weight)
        corners = corners.view(-1, height + 1, width + 1)[:, 1:, 1:]
        return corners.flip(1, 2).cumsum(1).cumsum(2).flip(1, 2).to(planes).contiguous()


def _box_matrix(width: float, n: int) -> np.ndarray:
    """(n, n) float64: row i holds the weights of the inputs in the box around pixel i."""
    centre = np.arange(n) + 0.5
    start, end = np.maximum(centre - width / 2, 0.0)[:, None], np.minimum(centre + width / 2, n)[:, None]
    pixel = np.arange(n)[None, :]
    return np.maximum(np.minimum(pixel + 1, end) - np.maximum(pixel, start), 0.0) / (end - start)


def _block_matrix(width: float, n: int) -> np.ndarray:
    """(n, n) float64: the average over floor(n / width) areas, at least one, followed by bilinear interpolation."""
    count = max(1, math.floor(n / width))
    area = np.arange(count)
    start, end = area * n // count, -(-(area + 1) * n // count)
    pixel = np.arange(n)
    down = ((pixel >= start[:, None]) & (pixel < end[:, None])) / (end - start)[:, None]
    place = np.clip((pixel + 0.5) * count / n - 0.5, 0.0, count - 1)  # in areas; outside the outermost centres it is constant
    below = np.minimum(place.astype(np.int64), max(count - 2, 0))
    share = (place - below)[:, None]
    return (1 - share) * down[below] + share * down[np.minimum(below + 1, count - 1)]


def _between(position: np.ndarray, sign: int, n: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """The two points of the integral image around positions in 0..n, with their weights times `sign`."""
    below = np.minimum(np.floor(position).astype(np.int64), n - 1)
    share = position - below
    return [(below, sign * (1 - share)), (below + 1, sign * share)]
