"""Masks of photographs: which pixels show the scene, and which something that must not be learnt."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from golden.scenes.dataset import UNREADABLE, open_image
from spec.errors import InputError

FOLDERS = ("masks", "mask")
"""Folders beside those of the photographs in which COLMAP, nerfstudio and gsplat keep masks."""

SHOWN = 128
"""Smallest grey value of a pixel that shows the scene: masks are white there and black where the photograph is ignored."""


def masks_beside(folder: Path, names: Sequence[str], reduced: str = "") -> tuple[Path | None, ...] | None:
    """The masks in a data set's folder of masks.

    The mask of `a/b.jpg` is `a/b.jpg.png` (COLMAP's name), `a/b.jpg` or `a/b.png` in the folder.

    Args:
        folder: the data set's folder.
        names: the photographs' names below their folder.
        reduced: the suffix of the photographs' folder, such as "_4"; a folder of masks with the same suffix is preferred.

    Returns:
        A path for each name, None where a photograph has no mask and is used whole; or None if there is no folder of masks.

    Raises:
        InputError: there is such a folder, and no photograph has a mask in it.
    """
    places = [folder / (name + suffix) for suffix in dict.fromkeys((reduced, "")) for name in FOLDERS]
    place = next((place for place in places if place.is_dir()), None)
    if place is None:
        return None
    found = tuple(_mask_of(place, name) for name in names)
    if not any(found):
        raise InputError(f"{place}: has no mask of {names[0]}, nor of any other photograph; {names[0]}.png (white where the "
                         "scene is seen, black where the photograph is ignored) is one, or remove the folder")
    return found


def _mask_of(place: Path, name: str) -> Path | None:
    candidates = (place / f"{name}.png", place / name, (place / name).with_suffix(".png"))
    return next((path for path in candidates if path.is_file()), None)


def read_mask(path: Path, width: int, height: int) -> np.ndarray:
    """(height, width) bool: where a photograph of that size shows the scene.

    A mask of another size is enlarged or reduced, if it has the photograph's proportions.

    Raises:
        InputError: the file is unreadable, or has other proportions than the photograph.
    """
    try:
        with open_image(path) as image:
            grey = image.convert("L")
            grey.load()
    except UNREADABLE as error:
        raise InputError(f"{path}: is not a readable mask ({error})") from error
    scale = (grey.width / width + grey.height / height) / 2
    if abs(grey.width - scale * width) > 1 or abs(grey.height - scale * height) > 1:
        raise InputError(f"{path}: is {grey.width}x{grey.height}, its photograph {width}x{height}; masks of the photograph's "
                         "proportions are accepted")
    if grey.size != (width, height):
        grey = grey.resize((width, height), Image.Resampling.NEAREST)
    return np.asarray(grey) >= SHOWN
