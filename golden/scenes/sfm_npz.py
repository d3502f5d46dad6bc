"""Reads gsplat's test data: cameras and SfM points in one .npz file, without photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from golden.scenes.camera import Camera, checked
from golden.scenes.conventions import up_of_cameras
from golden.scenes.dataset import Dataset
from spec.errors import InputError

SHAPES = {"means3d": (None, 3), "colors": (None, 3), "viewmats": (None, 4, 4), "Ks": (None, 3, 3), "width": (), "height": ()}


def load_npz(path: Path) -> Dataset:
    """Loads the set in a .npz with `means3d`, `colors` (uint8), `viewmats` (world to camera), `Ks`, `width` and `height`.

    Raises:
        InputError: the file is not a whole .npz, or an array is missing or of another shape.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {key: np.asarray(archive[key]) for key in archive.files}  # a member that is no array comes as bytes
    except Exception as error:  # numpy, zipfile and zlib raise nearly anything on a broken file
        raise InputError(f"{path}: is not a whole .npz ({error})") from error
    for key, shape in SHAPES.items():
        actual = arrays[key].shape if key in arrays else None
        fits = actual is not None and len(actual) == len(shape) and arrays[key].dtype.kind in "fiu"
        if not fits or any(want not in (None, have) for want, have in zip(shape, actual, strict=True)):
            kind = f" of {arrays[key].dtype}" if key in arrays else ""
            raise InputError(f"{path}: {key} has shape {actual}{kind}; numbers of shape {shape} are needed (None: any)")
    views, intrinsics = arrays["viewmats"].astype(np.float64), arrays["Ks"].astype(np.float64)
    if len(views) != len(intrinsics) or not len(views) or len(arrays["means3d"]) != len(arrays["colors"]):
        raise InputError(f"{path}: {len(views)} viewmats, {len(intrinsics)} Ks, {len(arrays['means3d'])} means3d, "
                         f"{len(arrays['colors'])} colors; as many of each pair are needed")
    cameras = tuple(
        checked(Camera(rotation=view[:3, :3], translation=view[:3, 3], fx=k[0, 0], fy=k[1, 1], cx=k[0, 2], cy=k[1, 2],
                       width=int(arrays["width"]), height=int(arrays["height"]), name=f"{path.stem}-{i}"),
                f"{path}: camera {i}")
        for i, (view, k) in enumerate(zip(views, intrinsics, strict=True))
    )
    return Dataset(
        cameras=cameras, images=None, points=arrays["means3d"].astype(np.float64),
        point_colours=arrays["colors"].astype(np.uint8),
        up=up_of_cameras(views[:, :3, :3]), name=path.stem,
    )
