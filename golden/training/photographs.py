"""Photographs to train from: they are checked, read whole, and reduced by averaging over areas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from golden.scenes.dataset import Dataset, image_size
from golden.scenes.masks import read_mask
from spec.errors import InputError


def area_resized(images: np.ndarray, width: int, height: int) -> np.ndarray:
    """Images at a smaller size, each pixel the mean over the area that it covers; exact at any ratio.

    The stored (sRGB) values are averaged, as in all of the field's trainers.

    Args:
        images: (..., H, W, 3) uint8.
        width, height: the new size in pixels.

    Returns:
        (..., height, width, 3) uint8, rounded to nearest.
    """
    (old_height, old_width), stack = images.shape[-3:-1], images.shape[:-3]
    result = np.empty((*stack, height, width, 3), np.uint8)
    if old_width % width == old_height % height == 0:  # Pillow's reduction of whole pixels is tens of times faster
        for at in np.ndindex(stack):
            result[at] = Image.fromarray(images[at]).reduce((old_width // width, old_height // height))
        return result
    across, down = _overlap(old_width, width), _overlap(old_height, height)
    for at in np.ndindex(stack):
        rows = (down @ images[at].reshape(old_height, -1).astype(np.float32)).reshape(height, old_width, 3)
        mean = (across @ rows.transpose(1, 0, 2).reshape(old_width, -1)).reshape(width, height, 3)
        result[at] = np.floor(mean.transpose(1, 0, 2) + 0.5)
    return result


def _overlap(old: int, new: int) -> np.ndarray:
    """(new, old) float32: the share of each new pixel that each old pixel covers."""
    edge = np.arange(new + 1) * (old / new)
    start = np.arange(old)
    shared = np.minimum(edge[1:, None], start + 1) - np.maximum(edge[:-1, None], start)
    return (np.maximum(shared, 0) * (new / old)).astype(np.float32)


def check_photographs(data: Dataset, path: Path) -> None:
    """Refuses photographs that training cannot use, before any of them is read whole.

    Raises:
        InputError: there are no photographs, fewer than three, or photographs of several sizes.
    """
    if data.images is None:
        raise InputError(f"{path}: has {len(data)} cameras and no photographs; a folder 'images' (or 'images_N') is needed")
    if len(data) < 3:
        word = "photograph" if len(data) == 1 else "photographs"
        raise InputError(f"{path}: has {len(data)} {word}; at least 3 are needed, to train, to validate and to test")
    sizes = [image_size(image) for image in data.images]
    for image, size in zip(data.images, sizes, strict=True):
        if size != sizes[0]:
            raise InputError(f"{image}: is {size[0]}x{size[1]}, {data.images[0].name} {sizes[0][0]}x{sizes[0][1]}; "
                             "photographs of one size are accepted (resize or crop them, then run COLMAP again)")


def read_photographs(data: Dataset, width: int, height: int) -> np.ndarray:
    """(V, height, width, 3) uint8, the photographs of a checked data set without their lenses' distortion, transparent ones
    over black, reduced by averaging over areas.

    Raises:
        InputError: a photograph is unreadable or is not of its camera's size.
    """
    result = np.empty((len(data), height, width, 3), np.uint8)
    for i in range(len(data)):
        pixels = data.pixels(i)
        opaque = pixels[..., :3]
        if (pixels[..., 3] < 255).any():
            opaque = np.floor(opaque * (pixels[..., 3:] / np.float32(255)) + 0.5).astype(np.uint8)
        result[i] = opaque if opaque.shape[:2] == (height, width) else area_resized(opaque, width, height)
    return result


def read_masks(data: Dataset, width: int, height: int) -> np.ndarray | None:
    """(V, height, width) bool: where the photographs show the scene; None if there are no masks.

    A reduced pixel shows the scene if all of the area that it covers does.

    Raises:
        InputError: a mask is unreadable, has other proportions than its photograph, or hides all of it.
    """
    if data.masks is None:
        return None
    result = np.ones((len(data), height, width), bool)
    for i, path in enumerate(data.masks):
        if path is None:
            continue
        camera, lens = data.cameras[i], data.lenses[i] if data.lenses is not None else None
        grey = np.repeat(read_mask(path, camera.width, camera.height)[..., None], 3, axis=2) * np.uint8(255)
        grey = grey if lens is None else lens.undistorted(grey, camera)
        result[i] = area_resized(grey, width, height)[..., 0] == 255
        if not result[i].any():
            raise InputError(f"{path}: hides all of {camera.name}; a mask that is white where the scene is seen is accepted "
                             "(or leave the photograph out)")
    return result
