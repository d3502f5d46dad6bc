"""The host's side of a frame: what software computes in float64 and writes into the machine's registers and tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.msv2_ref.quantise import GaussianWords
from golden.msv2_ref.rounding import pattern, round_to
from golden.scenes.camera import Camera
from golden.scenes.gaze import FoveationMap
from spec.config import AcceleratorConfig
from spec.constants import FRUSTUM_MARGIN, TILE


@dataclass(frozen=True)
class FrameRegisters:
    """Camera and frame registers. Floats are already rounded to the machine's `view` format unless said otherwise.

    Attributes:
        position: (3,) camera centre relative to the words' origin, in the `position` format widened to 24 bits.
        rotation: (3, 3) world to camera.
        focal: (2,) fx, fy in pixels.
        centre: (2,) int64, cx, cy, raw `mean2d`.
        limits: (4,) clamp of x/z (low, high) and y/z (low, high).
        near: near plane.
        width, height: frame in pixels.
        key_near: integer pattern (exponent and fraction) of the near plane; depth key = pattern of z minus this.
        depth_scale: reciprocal of the z that saturates `depth`.
        depth_far: that z, float64; the host turns depths back with it.
        background: (3,) int64 raw `colour`.
        header: (tiles, 3) int64: level index, blend, outer of each tile, row-major.
        plane: (tiles, 3) int64 raw `plane`.
    """

    position: np.ndarray
    rotation: np.ndarray
    focal: np.ndarray
    centre: np.ndarray
    limits: np.ndarray
    near: float
    width: int
    height: int
    key_near: int
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


def depth_far(means: np.ndarray, camera: Camera) -> float:
    """The z at which depth saturates: from the points in front of the camera and inside the widened frustum.

    A high percentile, so that one outlier does not cost everyone's resolution.
    """
    x, y, z = camera.rotation @ means.T + camera.translation[:, None]
    visible = z > camera.near
    for along, focal, centre, size in ((x, camera.fx, camera.cx, camera.width), (y, camera.fy, camera.cy, camera.height)):
        pixel = focal * along + centre * z
        visible &= (pixel > -0.15 * size * z) & (pixel < 1.15 * size * z)
    z = z[visible]
    return min(float(z.max()), 4.0 * float(np.percentile(z, 99))) if len(z) else 2 * camera.near


def frame_registers(
    config: AcceleratorConfig, camera: Camera, words: GaussianWords, foveation: FoveationMap, background: np.ndarray,
) -> FrameRegisters:
    """Registers for one frame.

    Args:
        config: the machine.
        camera: the view.
        words: the DRAM image: its origin, and its means for the depth range.
        foveation: tile levels and blend planes of the gaze.
        background: (3,) float in [0, 1].
    """
    n = config.formats
    far = depth_far(words.decoded.mean + words.origin, camera)
    margin = FRUSTUM_MARGIN
    limits = [-margin * camera.cx / camera.fx, margin * (camera.width - camera.cx) / camera.fx,
              -margin * camera.cy / camera.fy, margin * (camera.height - camera.cy) / camera.fy]
    level, blend = foveation.tile_level.reshape(-1).astype(np.int64), foveation.blend.reshape(-1).astype(np.int64)
    return FrameRegisters(
        position=np.float32(camera.position - words.origin).astype(np.float64),
        rotation=n.view.round(camera.rotation), focal=n.view.round([camera.fx, camera.fy]),
        centre=n.mean2d.quantise([camera.cx, camera.cy]), limits=n.view.round(limits), near=float(n.view.round(camera.near)),
        width=camera.width, height=camera.height,
        key_near=pattern(float(n.view.round(camera.near)), round_to(n.view)),
        depth_scale=float(n.view.round(1 / far)), depth_far=1 / float(n.view.round(1 / far)),
        background=n.colour.quantise(background), header=np.stack([level, blend, (level > 0).astype(np.int64)], 1),
        plane=n.plane.quantise(foveation.plane.reshape(-1, 3)))
