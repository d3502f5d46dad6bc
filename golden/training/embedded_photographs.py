"""The embedded scene's photographs and points: ray-traced once, then kept."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from golden.scenes import embedded, embedded_textures, embedded_views, embedded_world, raytrace
from golden.scenes.camera import Camera
from golden.scenes.embedded_splats import CACHE
from golden.scenes.files import atomic_output
from golden.scenes.pictures import to_bytes

SOURCES = (embedded, embedded_textures, embedded_views, embedded_world, raytrace)
"""What photographs and points depend on, besides their size and number."""


def photographs_and_points(
    cameras: Sequence[Camera], count: int, folder: Path = CACHE
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Views of the embedded cameras, which are of one size, and points on the surfaces they see.

    Kept in `folder`, one file for each size, number of views and points, and state of the source; one that cannot be read is
    made anew.

    Returns:
        (V, H, W, 3) uint8 photographs, (count, 3) float64 points in metres and their (count, 3) float64 colours in 0..1.
    """
    width, height = cameras[0].width, cameras[0].height
    source = hashlib.sha256(b"".join(Path(module.__file__).read_bytes() for module in SOURCES)).hexdigest()[:16]
    path = folder / f"embedded-views-{len(cameras)}-{width}x{height}-{count}-{source}.npz"
    try:
        with np.load(path, allow_pickle=False) as stored:
            return stored["images"], stored["points"], stored["colours"]
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile):
        pass  # absent or broken
    images = np.stack([to_bytes(embedded.render_reference(camera)[0]) for camera in cameras])
    points, colours, _ = embedded.surface_points(count)
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_output(path) as file:
        np.savez(file, images=images, points=points, colours=colours)
    return images, points, colours
