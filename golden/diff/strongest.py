"""Which Gaussian each pixel of an image shows most: the one with the largest share T alpha. On the CPU."""

from __future__ import annotations

import numpy as np
import torch

from golden.diff.blend_usage import strongest_of_tiles
from golden.diff.gaussians import Gaussians
from golden.diff.projection import project
from golden.diff.sensitivity import blended
from golden.scenes.camera import Camera
from spec.constants import ALPHA_MAX_L1, SUPPORT_SIGMA, TILE


@torch.no_grad()
def strongest(gaussians: Gaussians, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) int64 rows of the Gaussians with the largest T alpha, -1 where there is none, and (H, W) float32 1 -
    transmittance.

    Args:
        gaussians: the Gaussians, on the CPU.
        camera: the camera.
    """
    splats = project(gaussians, camera, SUPPORT_SIGMA)
    blending = blended(splats, camera, ALPHA_MAX_L1, (0.0, 0.0, 0.0))
    tiles = strongest_of_tiles(blending.lists, blending.used, blending.table, blending.alpha_max, blending.size)
    across, down = blending.tiles_x, -(-camera.height // TILE)
    rows = tiles.reshape(down, across, TILE, TILE).swapaxes(1, 2).reshape(down * TILE, across * TILE)
    rows = rows[: camera.height, : camera.width]
    index = np.append(splats.index.numpy(), -1)  # a row of -1 stays -1
    return index[rows], 1 - blending.transmittance
