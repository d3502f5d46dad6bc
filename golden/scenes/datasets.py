"""Loads posed photographs from a path and chooses the reader that the path needs."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from golden.scenes import colmap, llff, sfm_npz, transforms
from golden.scenes.camera import Camera
from golden.scenes.dataset import Dataset
from golden.scenes.masks import masks_beside
from spec.errors import InputError


def load_dataset(path: Path | str) -> Dataset:
    """Loads the data set at a path: a COLMAP, LLFF, nerfstudio or Blender folder, its transforms.json, or gsplat's .npz.

    Where a folder holds both a COLMAP model and `poses_bounds.npy`, the model is read, since the other was made from it.

    Raises:
        InputError: there is no data set, or anything is wrong in it; the message names the file, the value and what is
            accepted.
    """
    data = _read(Path(path))
    if data.masks is not None or data.images is None:
        return data
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    places = [image.parent.name for image in data.images]
    reduced = re.fullmatch(r"images(_\d+)", places[0])
    names = [camera.name for camera in data.cameras]
    return replace(data, masks=masks_beside(folder, names, reduced.group(1) if reduced else ""))


def _read(path: Path) -> Dataset:
    """The data set at a path, with the masks that its own files name."""
    if not path.exists():
        raise InputError(f"{path}: does not exist; a folder with posed photographs, a transforms.json or an .npz is needed")
    if path.is_file():
        if path.suffix == ".npz":
            return sfm_npz.load_npz(path)
        if path.suffix == ".json":
            return transforms.load_transforms(path)
        raise InputError(f"{path}: is no known data set; a folder, a transforms.json or an .npz is accepted")
    model = colmap.find_model(path)
    if model is not None:
        return colmap.load_colmap(path, model)
    if (path / "poses_bounds.npy").exists():
        return llff.load_llff(path)
    for name in ("transforms.json", "transforms_train.json"):
        if (path / name).exists():
            return transforms.load_transforms(path / name)
    raise InputError(f"{path}: has none of sparse/0/images.bin, poses_bounds.npy, transforms.json, transforms_train.json")


def cameras_beside_model(path: Path) -> tuple[Camera, ...]:
    """The cameras stored with a model: `cameras.json` of the INRIA trainer, or those of the data set in the same folder.

    Args:
        path: the model's folder or file. For a file in `point_cloud/iteration_*` the training folder above it is searched.

    Returns:
        The cameras; empty where there are none.

    Raises:
        InputError: there are cameras and they are malformed.
    """
    folder = path if path.is_dir() else path.parent
    if folder.parent.name == "point_cloud":
        folder = folder.parent.parent
    if (folder / transforms.CAMERAS).exists():
        return transforms.load_inria_cameras(folder / transforms.CAMERAS)
    sets = ("poses_bounds.npy", "transforms.json", "transforms_train.json")
    if path.is_dir() and (colmap.find_model(folder) or any((folder / name).exists() for name in sets)):
        return load_dataset(folder).cameras
    return ()
