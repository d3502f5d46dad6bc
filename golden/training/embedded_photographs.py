"""The embedded scene's photographs and points: ray-traced once and then cached."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.embedded import scene
from golden.scenes.embedded.splats import CACHE
from golden.scenes.files import atomic_output
from golden.scenes.pictures import to_bytes
from spec.sources import fingerprint, sources_of

EMBEDDED_VIEWS = 48
"""Default number of photographs of the embedded scene. Of 24, only 16 train and 5 gate: with as many points and iterations, the
dense model had 27.3 dB on its three test views, against 29.9 dB on the eight of 64 photographs, and pruning took almost
nothing away where 64 let half of the points go. 48 take less time to trace."""


def photographs_and_points(
    cameras: Sequence[Camera], count: int, folder: Path = CACHE
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Photographs of the embedded cameras, which must have one size, and points on the surfaces that they see.

    They are kept in `folder`, one file for each size, number of cameras and points, and state of the source code. A file that
    cannot be read is made anew.

    Returns:
        (V, H, W, 3) uint8 photographs, (count, 3) float64 points in metres and their (count, 3) float64 colours in 0..1.
    """
    width, height = cameras[0].width, cameras[0].height
    source = fingerprint(sources_of("golden.training.embedded_photographs"))
    path = folder / f"embedded-views-{len(cameras)}-{width}x{height}-{count}-{source}.npz"
    try:
        with np.load(path, allow_pickle=False) as stored:
            return stored["images"], stored["points"], stored["colours"]
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile):
        pass  # absent or broken
    images = np.stack([to_bytes(scene.render_photograph(camera)) for camera in cameras])
    points, colours, _ = scene.surface_points(count)
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_output(path) as file:
        np.savez(file, images=images, points=points, colours=colours)
    return images, points, colours
