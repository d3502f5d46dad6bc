"""Reads COLMAP models (text or binary, with or without rigs and frames) through pycolmap."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.conventions import up_of_cameras
from golden.scenes.dataset import Dataset, fit_to_images
from golden.scenes.files import read_bytes, require_package
from golden.scenes.lens import COEFFICIENTS, Lens, lens_of, without_distortion
from spec.errors import InputError

DISTORTION = {
    "SIMPLE_PINHOLE": (3, ()), "PINHOLE": (4, ()), "SIMPLE_RADIAL": (3, ("k1",)), "RADIAL": (3, ("k1", "k2")),
    "OPENCV": (4, ("k1", "k2", "p1", "p2")), "FULL_OPENCV": (4, COEFFICIENTS),
}
"""The accepted camera models. Of each: the number of parameters before those of the distortion, and the names of these."""


def find_model(folder: Path) -> Path | None:
    """The folder inside a data set that holds its COLMAP model, or None."""
    for part in ("sparse/0", "sparse", "colmap/sparse/0", "."):
        if any(all((folder / part / f"{table}.{kind}").exists() for table in ("cameras", "images")) for kind in ("bin", "txt")):
            return folder / part
    return None


def load_colmap(folder: Path, model: Path) -> Dataset:
    """Loads the data set whose photographs lie in `folder` and whose COLMAP model lies in `model`.

    Photographs come from the subfolder `images`, or else from the `images_N` with the smallest reduction N. Without either, the
    set has no photographs.

    Raises:
        InputError: the model is broken, a camera is of a model that is not in DISTORTION, a photograph is missing, or the
            extra `models` is not installed.
    """
    pycolmap = require_package("pycolmap", f"reading {model}")
    try:
        reconstruction = pycolmap.Reconstruction(str(model))
    except Exception as error:  # pycolmap raises what its C++ threw
        raise InputError(f"{model}: is not a whole COLMAP model ({str(error).splitlines()[0]})") from error
    posed = sorted((image for image in reconstruction.images.values() if image.has_pose), key=lambda image: image.name)
    if not posed:
        raise InputError(f"{model}: has {len(reconstruction.images)} images and none with a pose; at least one is needed")
    cameras = [_camera(image, reconstruction.cameras[image.camera_id]) for image in posed]
    photographs = find_images(folder)
    images = None if photographs is None else [photographs / camera.name for camera in cameras]
    coefficients = [_distortion(model, image, reconstruction.cameras[image.camera_id]) for image in posed]
    error = [_pose_error(image, camera, lens_of(camera, each), reconstruction)
             for image, camera, each in zip(posed, cameras, coefficients, strict=True)]
    pinholes, lenses = without_distortion(cameras if images is None else fit_to_images(cameras, images), coefficients)
    points = list(reconstruction.points3D.values())
    return Dataset(
        cameras=pinholes, lenses=lenses,
        images=None if images is None else tuple(images),
        points=np.array([point.xyz for point in points], np.float64).reshape(-1, 3),
        point_colours=np.array([point.color for point in points], np.uint8).reshape(-1, 3),
        up=up_of_cameras(np.stack([camera.rotation for camera in cameras])), name=folder.absolute().name,
        pose_error=np.array(error),
    )


def find_images(folder: Path) -> Path | None:
    """The folder of photographs in a data set: `images`, or else the `images_N` with the smallest N, or else None."""
    if (folder / "images").is_dir():
        return folder / "images"
    reduced = [p for p in folder.glob("images_*") if p.is_dir() and p.name[7:].isdigit()]
    return min(reduced, key=lambda p: int(p.name[7:]), default=None)


def _distortion(model: Path, image: object, intrinsics: object) -> dict[str, float]:
    """The distortion coefficients of an image's camera, by name."""
    kind, parameters = intrinsics.model.name, intrinsics.params
    if kind not in DISTORTION:
        raise InputError(f"{model}: camera of {image.name} is {kind}; {', '.join(DISTORTION)} are accepted "
                         "(colmap image_undistorter makes PINHOLE of any other)")
    first, names = DISTORTION[kind]
    return dict(zip(names, map(float, parameters[first:]), strict=True))


def _camera(image: object, intrinsics: object) -> Camera:
    pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world  # a property before pycolmap 3.12
    matrix = pose.matrix()
    return Camera(
        rotation=np.ascontiguousarray(matrix[:, :3]), translation=np.ascontiguousarray(matrix[:, 3]),
        fx=float(intrinsics.focal_length_x), fy=float(intrinsics.focal_length_y),
        cx=float(intrinsics.principal_point_x), cy=float(intrinsics.principal_point_y),
        width=int(intrinsics.width), height=int(intrinsics.height), name=image.name,
    )


def _pose_error(image: object, camera: Camera, lens: Lens | None, reconstruction: object) -> float:
    """Median distance in pixels between an image's keypoints and the projections of their 3D points; nan if it has none."""
    seen = [point for point in image.points2D if point.has_point3D()]
    if not seen:
        return math.nan
    points = np.array([reconstruction.points3D[point.point3D_id].xyz for point in seen])
    local = points @ camera.rotation.T + camera.translation
    rays = local[:, :2] / local[:, 2:]
    projected = rays * (camera.fx, camera.fy) + (camera.cx, camera.cy) if lens is None else lens.project(rays)
    return float(np.median(np.linalg.norm(projected - [point.xy for point in seen], axis=1)))


def read_points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Reads a points3D.bin that stands alone; pycolmap would need the whole model.

    Returns:
        (P, 3) float64 positions and (P, 3) uint8 colours.

    Raises:
        InputError: the file is missing or truncated.
    """
    data = read_bytes(path)
    try:
        (count,) = struct.unpack_from("<Q", data)
        rows, offset = [], 8
        for _ in range(count):
            row = struct.unpack_from("<Q3d3BdQ", data, offset)  # id, xyz, rgb, error, length of the track
            rows.append(row[1:7])
            offset += struct.calcsize("<Q3d3BdQ") + 8 * row[8]
        if offset > len(data):
            raise struct.error(f"the last track ends at byte {offset} of {len(data)}")
    except (struct.error, OverflowError) as error:
        raise InputError(f"{path}: is not a whole points3D.bin ({error})") from error
    table = np.array(rows, np.float64).reshape(-1, 6)
    return table[:, :3].copy(), table[:, 3:].astype(np.uint8)
