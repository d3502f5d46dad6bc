"""The host's side of a frame: what software computes in float64 and writes into the machine's registers and tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.host.quantise import GaussianWords
from golden.kernels import compiled
from golden.scenes.camera import Camera
from golden.scenes.gaze import FoveationMap
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
    """Camera and frame registers. Floats are already rounded to the machine's `view` format unless said otherwise.

    Attributes:
        position: (3,) camera centre relative to the words' origin.
        rotation: (3, 3) world to camera, its first two rows times the focal lengths.
        turn: (3, 3) the same over EXPONENT_SCALE in the `work` format, for the Jacobian: no operand of a sum may be longer than
            its result, or one rounding of a float64 sum would not be the correct one.
        centre: (2,) int64, cx, cy, raw `mean2d`.
        limits: (4,) clamp of fx x/z (low, high) and fy y/z (low, high), pixels.
        near: near plane.
        width, height: frame in pixels.
        depth_scale: reciprocal of the z that saturates `depth`.
        depth_far: that z, float64; the host turns depths back with it.
        background: (3,) int64 raw `colour`.
        header: (tiles, 3) int64: level index, blend, outer of each tile, row-major.
        plane: (tiles, 3) int64 raw `plane`.
    """

    position: np.ndarray
    rotation: np.ndarray
    turn: np.ndarray
    centre: np.ndarray
    limits: np.ndarray
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
        """Tile columns."""
        return -(-self.width // TILE)

    @property
    def tiles_y(self) -> int:
        """Tile rows."""
        return -(-self.height // TILE)


@compiled
def _depths_in_view(mean, rotation, translation, near, fx, fy, cx, cy, width, height):
    """The z in front of the camera whose pixel lies inside the frame widened by DEPTH_FRAME_MARGIN on every side.

    One loop and not matrix products: the bits then depend on no BLAS.
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


def depth_far(mean: np.ndarray, origin: np.ndarray, camera: Camera, per_near: float = 0.0) -> float:
    """The z at which depth saturates: from the points in front of the camera and inside the widened frustum.

    A high percentile, so that one outlier does not cost everyone's resolution. In a frame that is to be warped it may lie as
    far beyond as the rounding of near depths allows: a far layer that saturates makes what is before it look nearer.

    Args:
        mean: (N, 3) float64 relative to `origin`.
        origin: (3,) float64 world units.
        camera: the view.
        per_near: in frames that are to be warped: times the square of the near z, how far it may lie. Reciprocal world units.
    """
    c = camera
    translation = c.translation + c.rotation @ origin
    z = _depths_in_view(mean, c.rotation, translation, c.near, c.fx, c.fy, c.cx, c.cy, c.width, c.height)
    if not len(z):
        return 2 * c.near
    near, far = np.percentile(z, (DEPTH_NEAR_PERCENTILE, DEPTH_PERCENTILE))
    far = min(float(far), DEPTH_GAP * float(np.percentile(z, DEPTH_PERCENTILE, method="lower")))
    return min(float(z.max()), max(DEPTH_REACH * far, per_near * float(near) ** 2))


def frame_registers(
    config: AcceleratorConfig, camera: Camera, words: GaussianWords, foveation: FoveationMap, background: np.ndarray,
    baseline_px: float | None = None,
) -> FrameRegisters:
    """Registers for one frame.

    Args:
        config: the machine.
        camera: the view.
        words: the DRAM image: its origin, and its means for the depth range.
        foveation: tile levels and blend planes of the gaze.
        background: (3,) float in [0, 1].
        baseline_px: of a frame that is to be warped: distance between the eyes, world units, times the focal length in pixels.
    """
    n = config.formats
    # Half an ulp of depth, far 2^-(frac + 1), moves what is at z by baseline_px / z^2 times as much.
    per_near = WARP_DEPTH_ERROR_PX * 2.0 ** (n.depth.frac_bits + 1) / baseline_px if baseline_px else 0.0
    far = depth_far(words.decoded.mean, words.origin, camera, per_near)
    margin = FRUSTUM_MARGIN
    right, below = camera.width - camera.cx, camera.height - camera.cy
    limits = [-margin * camera.cx, margin * right, -margin * camera.cy, margin * below]
    in_pixels = camera.rotation * [[camera.fx], [camera.fy], [1.0]]
    level, blend = foveation.tile_level.reshape(-1).astype(np.int64), foveation.blend.reshape(-1).astype(np.int64)
    return FrameRegisters(
        position=n.view.round(camera.position - words.origin),
        rotation=n.view.round(in_pixels), turn=n.work.round(in_pixels / EXPONENT_SCALE),
        centre=n.mean2d.quantise([camera.cx, camera.cy]), limits=n.view.round(limits), near=float(n.view.round(camera.near)),
        width=camera.width, height=camera.height,
        depth_scale=float(n.view.round(1 / far)), depth_far=1 / float(n.view.round(1 / far)),
        background=n.colour.quantise(background), header=np.stack([level, blend, (level > 0).astype(np.int64)], 1),
        plane=n.plane.quantise(foveation.plane.reshape(-1, 3)))
