"""Finds the splats that may be too wide for a camera: the quick first part of `golden.training.representable`."""

from __future__ import annotations

import numpy as np

from golden.kernels import compiled

TOLERANCE = np.float32(1e-3)
"""Relative slack of the comparisons, far above the rounding of float32, so that no splat is missed."""


@compiled(nogil=True)
def find_candidates(means, widest, rotations, translations, lenses, farthest, found, cameras):
    """Finds splats whose centre is beyond a distance on the screen and that are wider than accepted there.

    Args:
        means: (N, 3) float32, world.
        widest: (N,) float32, largest standard deviations.
        rotations, translations: (C, 3, 3) and (C, 3) float32, world to camera.
        lenses: (C, 6) float32: fx, fy, cx, cy, near, and what the larger of |x| and |y| is multiplied by to give the accepted
            width.
        farthest: distance in pixels from the frame's corner.
        found: (N,) bool, all false; set for splats that are candidates for some camera.
        cameras: (C,) bool, all false; set for cameras for which some splat is a candidate.
    """
    less = np.float32(1) - TOLERANCE
    limit = np.float32(farthest) * less
    for c in range(len(rotations)):
        r, t = rotations[c], translations[c]
        fx, fy, cx, cy, near, share = lenses[c, 0], lenses[c, 1], lenses[c, 2], lenses[c, 3], lenses[c, 4], lenses[c, 5]
        for i in range(len(means)):
            px, py, pz, enough = means[i, 0], means[i, 1], means[i, 2], widest[i] / (share * less)
            x = r[0, 0] * px + r[0, 1] * py + r[0, 2] * pz + t[0]
            if abs(x) >= enough:  # most splats are narrow, and end here
                continue
            y = r[1, 0] * px + r[1, 1] * py + r[1, 2] * pz + t[1]
            z = r[2, 0] * px + r[2, 1] * py + r[2, 2] * pz + t[2]
            if abs(y) < enough and z > near * less and (
                    abs(x * fx + cx * z) >= limit * z or abs(y * fy + cy * z) >= limit * z):
                found[i] = cameras[c] = True
