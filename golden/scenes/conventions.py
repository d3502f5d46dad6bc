"""Every conversion between conventions, in one place: axes, up direction, quaternion order, pixel centres, activations.

Inside the project, scales are logs, opacities are activated, quaternions are wxyz, and SH arrays have the coefficient's index
before the channel. Cameras are OpenCV cameras (x right, y down, z forward) that map world to camera, with pixel centres at
integers + 0.5.

| source                  | how it differs from the above |
|-------------------------|------------------------------------------------------------------------------------------------------|
| INRIA PLY               | opacity is a logit; `f_rest` runs over coefficients first, then channels |
| compressed PLY, SOG     | as PLY once unpacked; opacity bytes 0 and 255 come out as logits of finite size |
| SPZ                     | as PLY once unpacked; the world is RUB (y up), PLY is RDF (y down): only `up` differs |
| .splat                  | linear scales, colour and opacity as bytes, quaternion bytes (b - 128) / 128 in wxyz |
| COLMAP                  | no difference: OpenCV axes, world to camera, the top left pixel's centre is at (0.5, 0.5) |
| nerfstudio, Blender     | camera to world, OpenGL axes (x right, y up, z backward) |
| LLFF poses_bounds.npy   | camera to world, axes (down, right, backward); principal point in the middle |
| INRIA cameras.json      | camera to world, OpenCV axes |
| gsplat .npz             | no difference: OpenCV axes, world to camera |

A world frame is never rotated, because the SH coefficients would have to be rotated with it and no renderer needs a particular
frame. Instead, the `up` vector of a model or data set says which way is up.
"""

from __future__ import annotations

import numpy as np

from spec.constants import SH_C0

UP_BY_FORMAT = {
    "ply": (0.0, -1.0, 0.0),
    "compressed ply": (0.0, -1.0, 0.0),
    "splat": (0.0, -1.0, 0.0),
    "sog": (0.0, -1.0, 0.0),
    "spz": (0.0, 1.0, 0.0),
    "nerfstudio": (0.0, 0.0, 1.0),
}
"""The world's up direction by file format. PLY and the formats packed from it follow COLMAP's habit (y down), and SPZ is RUB
by its specification. SOG defines no axes, so its entry is only the fallback of `orbit.estimate_up`. These entries are the up of
the benchmarks' orbit; other cameras take what `orientation.find_orientation` finds. COLMAP and LLFF worlds have arbitrary axes
and are not listed: `up_of_cameras` finds their up direction."""

MAX_LOGIT = 30.0
"""Exported logits are clipped to +-30. sigmoid(30) is exactly 1 in float32, and every reader accepts a finite number."""


def sigmoid(logit: np.ndarray) -> np.ndarray:
    """Opacity of a logit, float64, without overflow: -inf gives 0, +inf gives 1, NaN stays NaN."""
    logit = np.asarray(logit, np.float64)
    small = np.exp(-np.abs(logit))
    return np.where(logit >= 0, 1.0, small) / (1.0 + small)


def logit(opacity: np.ndarray) -> np.ndarray:
    """Logit of an opacity, float64, clipped to +-MAX_LOGIT, so that opacities 0, 1 and amplified ones above 1 give finite
    numbers."""
    opacity = np.clip(np.asarray(opacity, np.float64), 0.0, 1.0)
    with np.errstate(divide="ignore"):
        return np.clip(np.log(opacity) - np.log1p(-opacity), -MAX_LOGIT, MAX_LOGIT)


def colour_to_sh_dc(colour: np.ndarray) -> np.ndarray:
    """SH DC coefficient of a colour in 0..1, float64, same shape."""
    return (np.asarray(colour, np.float64) - 0.5) / SH_C0


def log_of_linear_scales(scales: np.ndarray) -> np.ndarray:
    """Natural log of linear scales, float64. A scale of 0 (a degenerate axis) gives -inf, a negative scale NaN."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(np.asarray(scales, np.float64))


def quats_from_splat_bytes(quats: np.ndarray) -> np.ndarray:
    """Converts the (N, 4) uint8 quaternions of a .splat file to (N, 4) float64 wxyz.

    Byte 128 stands for zero, so the largest component is at most 127/128.
    """
    return (quats.astype(np.float64) - 128.0) / 128.0


def sh_rest_from_ply(f_rest: np.ndarray) -> np.ndarray:
    """Converts (N, 3K) in PLY order (all coefficients of red, then of green, then of blue) to (N, K, 3)."""
    n, columns = f_rest.shape
    return np.ascontiguousarray(f_rest.reshape(n, 3, columns // 3).transpose(0, 2, 1))


def sh_rest_to_ply(sh_rest: np.ndarray) -> np.ndarray:
    """The inverse of `sh_rest_from_ply`."""
    return sh_rest.transpose(0, 2, 1).reshape(len(sh_rest), -1)


def camera_from_opencv(camera_to_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and translation (3,), world to camera, from a rigid (3, 4) or (4, 4) camera-to-world pose in OpenCV
    axes."""
    pose = np.asarray(camera_to_world, np.float64)
    rotation = pose[:3, :3].T
    return rotation, -rotation @ pose[:3, 3]


def camera_from_opengl(camera_to_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `camera_from_opencv`, from a pose in OpenGL axes (x right, y up, z backward), which nerfstudio and Blender write."""
    return camera_from_opencv(np.asarray(camera_to_world, np.float64)[:3] * [1.0, -1.0, -1.0, 1.0])


def camera_from_llff(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `camera_from_opencv`, from the first four columns of an LLFF pose, whose axes are (down, right, backward)."""
    down, right, backward, position = np.asarray(pose, np.float64)[:3, :4].T
    return camera_from_opencv(np.stack([right, down, -backward, position], axis=1))


def up_of_cameras(rotations: np.ndarray) -> np.ndarray:
    """(3,) unit mean of the cameras' own up directions: people hold cameras upright.

    Args:
        rotations: (N, 3, 3) world to camera.
    """
    up = -np.asarray(rotations, np.float64)[:, 1].mean(axis=0)
    return up / np.linalg.norm(up)
