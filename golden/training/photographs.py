"""Photographs to train from: they are checked, read whole, and reduced by averaging over areas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from golden.scenes.dataset import UNREADABLE, Dataset, image_size
from spec.errors import InputError

MASK_FOLDERS = ("masks", "mask")
"""Folders beside the photographs in which COLMAP and nerfstudio keep masks."""


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
        InputError: there are no photographs, fewer than three, photographs of several sizes, or masks.
    """
    if data.images is None:
        raise InputError(f"{path}: has {len(data)} cameras and no photographs; a folder 'images' (or 'images_N') is needed")
    if len(data) < 3:
        word = "photograph" if len(data) == 1 else "photographs"
        raise InputError(f"{path}: has {len(data)} {word}; at least 3 are needed, to train, to validate and to test")
    _check_masks(data, path)
    sizes = [image_size(image) for image in data.images]
    for image, size in zip(data.images, sizes, strict=True):
        if size != sizes[0]:
            raise InputError(f"{image}: is {size[0]}x{size[1]}, {data.images[0].name} {sizes[0][0]}x{sizes[0][1]}; "
                             "photographs of one size are accepted (resize or crop them, then run COLMAP again)")


def _check_masks(data: Dataset, path: Path) -> None:
    """Refuses masks instead of ignoring them: what they hide would be learnt as part of the scene."""
    folder = path if path.is_dir() else path.parent
    for name in MASK_FOLDERS:
        if (folder / name).is_dir():
            raise InputError(f"{folder / name}: masks are not supported; remove or rename the folder to train on "
                             "whole photographs")
    for name in (path.name,) if path.suffix == ".json" else ("transforms.json", "transforms_train.json"):
        if (folder / name).is_file() and '"mask_path"' in (folder / name).read_text(errors="replace"):
            raise InputError(f"{folder / name}: names masks (mask_path), which are not supported; remove the entries "
                             "to train on whole photographs")


def read_photographs(data: Dataset, width: int, height: int) -> np.ndarray:
    """(V, height, width, 3) uint8, the photographs of a checked data set, reduced by averaging over areas.

    Raises:
        InputError: a photograph is unreadable, is not of its camera's size, or has transparent pixels.
    """
    result = np.empty((len(data), height, width, 3), np.uint8)
    for i, path in enumerate(data.images):
        pixels = _opaque(path)
        camera = data.cameras[i]
        if pixels.shape[:2] != (camera.height, camera.width):
            raise InputError(f"{path}: is {pixels.shape[1]}x{pixels.shape[0]}, its camera {camera.width}x{camera.height}")
        result[i] = pixels if pixels.shape[:2] == (height, width) else area_resized(pixels, width, height)
    return result


def _opaque(path: Path) -> np.ndarray:
    """Reads a photograph as (H, W, 3) uint8; transparency, which is a mask, is refused."""
    try:
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGBA"))
    except UNREADABLE as error:
        raise InputError(f"{path}: is not a readable photograph ({error})") from error
    transparent = int((pixels[..., 3] < 255).sum())
    if transparent:
        raise InputError(f"{path}: {transparent} pixels are transparent; masks are not supported, opaque photographs "
                         "are accepted")
    return pixels[..., :3]
