"""Tests whether a splat's footprint meets a rectangle: the exact test, and GSCore's oriented bounding box.

A splat's falloff exponent is computed as a sum of two squares, q = (u^2 + v^2) / 2 with u = f0 dx + f1 dy and v = f2 dy, where
(f0, f1, f2) is the triangular factor of the conic. So rounding cannot make it negative, however thin the ellipse is.
"""

from __future__ import annotations

import math

import numpy as np

from golden.kernels import compiled

SLACK = 1e-7
"""Added to the exponent's bound in the rectangle tests, because they round differently from a pixel's own test. They may
accept an ellipse that passes very close to the rectangle, but they never miss one that meets it."""


@compiled
def exponent(dx: float, dy: float, factor: np.ndarray) -> float:
    """Falloff exponent q >= 0 at the offset (dx, dy), in pixels, from the splat's mean."""
    u = factor[0] * dx + factor[1] * dy
    v = factor[2] * dy
    return 0.5 * (u * u + v * v)


@compiled
def smallest_exponent(x0: float, y0: float, x1: float, y1: float, factor: np.ndarray) -> float:
    """Smallest q over the closed rectangle [x0, x1] x [y0, y1], whose corners are given relative to the splat's mean.

    q grows away from the mean, so the minimum is at the mean or on an edge that faces it. Along an edge q is a parabola, whose
    vertex is clamped to the edge.
    """
    dx = min(max(0.0, x0), x1)
    dy = min(max(0.0, y0), y1)
    if dx == 0.0 and dy == 0.0:
        return 0.0
    smallest = math.inf
    if dx != 0.0:  # the vertical edge at dx faces the mean
        vertex = -factor[0] * factor[1] * dx / (factor[1] ** 2 + factor[2] ** 2)
        smallest = min(smallest, exponent(dx, min(max(vertex, y0), y1), factor))
    if dy != 0.0:  # the horizontal edge at dy faces the mean
        vertex = -factor[1] / factor[0] * dy
        smallest = min(smallest, exponent(min(max(vertex, x0), x1), dy, factor))
    return smallest


@compiled
def ellipse_meets(x0: float, y0: float, x1: float, y1: float, factor: np.ndarray, q_max: float) -> bool:
    """Whether the ellipse q <= q_max meets the closed rectangle, given relative to the splat's mean. The test is exact."""
    return smallest_exponent(x0, y0, x1, y1, factor) <= q_max + SLACK


@compiled
def box_meets(x0: float, y0: float, x1: float, y1: float, cov2d: np.ndarray, factor: np.ndarray, q_max: float) -> bool:
    """Whether the ellipse's oriented bounding box meets the rectangle (GSCore, Lee et al. 2024, section 4.1).

    The separating axes are the rectangle's two and the box's two. The test is conservative, because the box's corners lie
    outside the ellipse.
    """
    a, b, c = cov2d
    angle = 0.5 * math.atan2(2 * b, a - c)  # angle of the major axis; 0 for a circle
    cosine, sine = math.cos(angle), math.sin(angle)
    determinant = 1 / (factor[0] * factor[2]) ** 2
    major_variance = 0.5 * (a + c) + math.hypot(0.5 * (a - c), b)
    minor_variance = determinant / major_variance  # the formula with a difference would cancel for needle-shaped splats
    radius = math.sqrt(2 * (q_max + SLACK))
    major, minor = radius * math.sqrt(major_variance), radius * math.sqrt(minor_variance)

    half_x, half_y = 0.5 * (x1 - x0), 0.5 * (y1 - y0)
    centre_x, centre_y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    reach_x = half_x + major * abs(cosine) + minor * abs(sine)
    reach_y = half_y + major * abs(sine) + minor * abs(cosine)
    reach_major = major + half_x * abs(cosine) + half_y * abs(sine)
    reach_minor = minor + half_x * abs(sine) + half_y * abs(cosine)
    return (
        abs(centre_x) <= reach_x
        and abs(centre_y) <= reach_y
        and abs(centre_x * cosine + centre_y * sine) <= reach_major
        and abs(centre_y * cosine - centre_x * sine) <= reach_minor
    )


@compiled
def meets_frame(
    mean2d: np.ndarray, factor: np.ndarray, q_max: np.ndarray, width: int, height: int
) -> np.ndarray:
    """(N,) bool: whether the ellipse q <= q_max (N,) meets the rectangle that the frame's pixel centres span."""
    meets = np.empty(len(mean2d), np.bool_)
    for i in range(len(mean2d)):
        x0, y0 = 0.5 - mean2d[i, 0], 0.5 - mean2d[i, 1]
        meets[i] = ellipse_meets(x0, y0, x0 + width - 1, y0 + height - 1, factor[i], q_max[i])
    return meets
