"""The embedded scene's photographs: ray-traced once, then kept."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from golden.scenes import embedded, embedded_textures, embedded_views, embedded_world, raytrace
from golden.scenes.camera import Camera
from golden.scenes.embedded_splats import CACHE
from golden.scenes.files import atomic_output
from golden.scenes.pictures import to_bytes

SOURCES = (embedded, embedded_textures, embedded_views, embedded_world, raytrace)
"""What a photograph depends on, besides its size."""


def embedded_photographs(cameras: Sequence[Camera], folder: Path = CACHE) -> np.ndarray:
    """(V, H, W, 3) uint8 views of the embedded cameras, which are of one size.

    Kept in `folder`, one file for each size, number of views and state of the source; one that cannot be read is made anew.
    """
    width, height = cameras[0].width, cameras[0].height
    source = hashlib.sha256(b"".join(Path(module.__file__).read_bytes() for module in SOURCES)).hexdigest()[:16]
    path = folder / f"embedded-views-{len(cameras)}-{width}x{height}-{source}.npy"
    try:
        stored = np.load(path, allow_pickle=False)
        if stored.shape == (len(cameras), height, width, 3) and stored.dtype == np.uint8:
            return stored
    except (OSError, EOFError, ValueError):
        pass  # absent or broken
    traced = np.stack([to_bytes(embedded.render_reference(camera)[0]) for camera in cameras])
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_output(path) as file:
        np.save(file, traced)
    return traced
