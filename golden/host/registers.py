"""The host's side of a frame: what software computes in float64 and writes into the machine's registers and tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.host.quantise import GaussianWords
from golden.kernels import compiled
from golden.scenes.camera import Camera
from golden.scenes.gaze import FoveationMap
from spec.chunks import REACH_MARGIN, support
from spec.config import AcceleratorConfig
from spec.constants import (
    DEPTH_FRAME_MARGIN,
    DEPTH_GAP,
    DEPTH_NEAR_PERCENTILE,
    DEPTH_PERCENTILE,
    DEPTH_REACH,
    EXPONENT_SCALE,
    FRUSTUM_MARGIN,
    TILE,
    WARP_DEPTH_ERROR_PX,
)


@dataclass(frozen=True)
class FrameRegisters:
    """Camera and frame registers. Floats are already rounded to the machine's `view` format unless stated otherwise.

    Attributes:
        position: (3,) camera centre relative to the words' origin.
        rotation: (3, 3) world to camera, its first two rows times the focal lengths.
        turn: (3, 3) the same divided by EXPONENT_SCALE, in the `work` format, for the Jacobian. Operands of a sum must have no
            more significand bits than its result; otherwise rounding the float64 sum once would not be correct rounding.
        centre: (2,) int64, cx and cy as raw `mean2d`.
        limits: (4,) bounds to which fx x/z (low, high) and fy y/z (low, high) are clamped, pixels.
        reach: (2,) pixels that a splat with a standard deviation of 1 at z = 1 reaches at most along x, along y; only machines
            with chunks have this setting (`spec.chunks`).
        near: near plane in world units.
        width, height: size of the frame in pixels.
        depth_scale: reciprocal of the z at which `depth` saturates.
        depth_far: that z, float64, in world units; the host converts raw depths back with it.
        background: (3,) int64 raw `colour`.
        header: (tiles, 3) int64, row-major: each tile's level (0-based), its blend flag, and whether its level is above 0.
        plane: (tiles, 3) int64 raw `plane`.
    """

    position: np.ndarray
    rotation: np.ndarray
    turn: np.ndarray
    centre: np.ndarray
    limits: np.ndarray
    reach: np.ndarray
    near: float
    width: int
    height: int
    depth_scale: float
    depth_far: float
    background: np.ndarray
    header: np.ndarray
    plane: np.ndarray

    @property
    def tiles_x(self) -> int:
        """Number of tile columns."""
        return -(-self.width // TILE)

    @property
    def tiles_y(self) -> int:
        """Number of tile rows."""
        return -(-self.height // TILE)


@compiled
def _depths_in_view(mean, rotation, translation, near, fx, fy, cx, cy, width, height):
    """The z of the points in front of the camera that project into the frame widened by DEPTH_FRAME_MARGIN on every side.

    This is a loop and not a matrix product, so that the bits of the result do not depend on a BLAS library.
    """
    r, t, found, count = rotation, translation, np.empty(len(mean)), 0
    least, most = -DEPTH_FRAME_MARGIN, 1 + DEPTH_FRAME_MARGIN
    for i in range(len(mean)):
        mx, my, mz = mean[i, 0], mean[i, 1], mean[i, 2]
        x = r[0, 0] * mx + r[0, 1] * my + r[0, 2] * mz + t[0]
        y = r[1, 0] * mx + r[1, 1] * my + r[1, 2] * mz + t[1]
        z = r[2, 0] * mx + r[2, 1] * my + r[2, 2] * mz + t[2]
        px, py = fx * x + cx * z, fy * y + cy * z
        inside = (px > least * width * z) & (px < most * width * z) & (py > least * height * z) & (py < most * height * z)
        found[count] = z
        count += inside & (z > near)
    return found[:count]


def depths_in_view(mean: np.ndarray, origin: np.ndarray, camera: Camera) -> np.ndarray:
    """The z of the points in front of the camera and inside the widened frustum, in world units; the arguments are those of
    `depth_far`."""
    c = camera
    translation = c.translation + c.rotation @ origin
    return _depths_in_view(mean, c.rotation, translation, c.near, c.fx, c.fy, c.cx, c.cy, c.width, c.height)


def depth_far(mean: np.ndarray, origin: np.ndarray, camera: Camera, per_near: float = 0.0) -> float:
    """The z at which depth saturates, from the points in front of the camera and inside the widened frustum.

    It is a high percentile, so that a single outlier does not cost all other points their resolution. In a frame that is to be
    warped it may lie farther, as far as the rounding of near depths allows: where a far layer saturates, what lies in front of
    it looks nearer than it is.

    Args:
        mean: (N, 3) float64 relative to `origin`.
        origin: (3,) float64, world units.
        camera: the camera.
        per_near: for frames that are to be warped, the limit as a multiple of the squared near z, in reciprocal world units.

    Returns:
        z in world units.
    """
    c, z = camera, depths_in_view(mean, origin, camera)
    if not len(z):
        return 2 * c.near
    near, far = np.percentile(z, (DEPTH_NEAR_PERCENTILE, DEPTH_PERCENTILE))
    far = min(float(far), DEPTH_GAP * float(np.percentile(z, DEPTH_PERCENTILE, method="lower")))
    return min(float(z.max()), max(DEPTH_REACH * far, per_near * float(near) ** 2))


def frame_registers(
    config: AcceleratorConfig, camera: Camera, words: GaussianWords, foveation: FoveationMap, background: np.ndarray,
    baseline_px: float | None = None,
) -> FrameRegisters:
    """Computes the registers of one frame.

    Args:
        config: the machine.
        camera: the camera.
        words: the DRAM image; its origin is used, and its means for the depth range.
        foveation: tile levels and blend planes of the gaze.
        background: (3,) float in [0, 1].
        baseline_px: for a frame that is to be warped, the distance between the eyes in world units times the focal length in
            pixels.
    """
    n = config.formats
    # Half an ulp of depth is far * 2^-(frac + 1). It moves a pixel at z by baseline_px / z^2 times as much.
    per_near = WARP_DEPTH_ERROR_PX * 2.0 ** (n.depth.frac_bits + 1) / baseline_px if baseline_px else 0.0
    far = depth_far(words.decoded.mean, words.origin, camera, per_near)
    depth_scale = max(float(n.view.round(1 / far)), 2.0**n.view.exp_min)  # a scene of 1e38 units has no smaller one
    margin = FRUSTUM_MARGIN
    right, below = camera.width - camera.cx, camera.height - camera.cy
    limits = [-margin * camera.cx, margin * right, -margin * camera.cy, margin * below]
    slopes = np.abs(np.reshape(limits, (2, 2))).max(axis=1)
    reach = support(config) * (1 + REACH_MARGIN) * np.hypot([camera.fx, camera.fy], slopes)
    in_pixels = camera.rotation * [[camera.fx], [camera.fy], [1.0]]
    level, blend = foveation.tile_level.reshape(-1).astype(np.int64), foveation.blend.reshape(-1).astype(np.int64)
    return FrameRegisters(
        position=n.view.round(camera.position - words.origin),
        rotation=n.view.round(in_pixels), turn=n.work.round(in_pixels / EXPONENT_SCALE),
        centre=n.mean2d.quantise([camera.cx, camera.cy]), limits=n.view.round(limits),
        reach=n.view.round(reach), near=float(n.view.round(camera.near)),
        width=camera.width, height=camera.height,
        depth_scale=depth_scale, depth_far=1 / depth_scale,
        background=n.colour.quantise(background), header=np.stack([level, blend, (level > 0).astype(np.int64)], 1),
        plane=n.plane.quantise(foveation.plane.reshape(-1, 3)))
