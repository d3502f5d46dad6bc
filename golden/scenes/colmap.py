"""Reads COLMAP models (text or binary, with or without rigs and frames) through pycolmap, in a process with limits."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np

from golden.scenes import limited
from golden.scenes.camera import Camera, checked
from golden.scenes.colmap_model import ColmapImage, ColmapModel
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

TABLES = ("cameras", "images", "points3D", "rigs", "frames")
"""The tables of a model; the last two only since COLMAP 3.12."""

SMALLEST_ROW = {"cameras": 24, "images": 73, "points3D": 51, "rigs": 8, "frames": 68}
"""Bytes of the smallest row of each binary table: one without parameters, keypoints, track, sensors or data."""


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
    require_package("pycolmap", f"reading {model}")
    tables = [model / f"{table}.{kind}" for table in TABLES for kind in ("bin", "txt")]
    tables = [table for table in tables if table.exists()]
    for table in tables:
        _check_count(table)
    size = sum(table.stat().st_size for table in tables)
    found: ColmapModel = limited.read("golden.scenes.colmap_model:read_model", model, size)
    if not found.images:
        raise InputError(f"{model}: has {found.total} images and none with a pose; at least one is needed")
    cameras = [_camera(model, image) for image in found.images]
    photographs = find_images(folder)
    images = None if photographs is None else [photographs / camera.name for camera in cameras]
    coefficients = [_distortion(model, image) for image in found.images]
    error = [_pose_error(image, camera, lens_of(camera, each))
             for image, camera, each in zip(found.images, cameras, coefficients, strict=True)]
    pinholes, lenses = without_distortion(cameras if images is None else fit_to_images(cameras, images), coefficients)
    return Dataset(
        cameras=pinholes, lenses=lenses,
        images=None if images is None else tuple(images),
        points=found.points, point_colours=found.colours,
        up=up_of_cameras(np.stack([camera.rotation for camera in cameras])), name=folder.absolute().name,
        pose_error=np.array(error),
    )


def _check_count(table: Path) -> None:
    """Refuses a binary table that is empty, or whose first number announces more rows than its bytes can hold.

    The structure of a row is the library's business; that a file of a kilobyte holds 2^40 rows is not possible in any.
    """
    if table.suffix != ".bin":
        return
    data = read_bytes(table)
    if len(data) < 8:
        raise InputError(f"{table}: {len(data)} bytes; a table begins with a count of 8 bytes (truncated?)")
    (count,) = struct.unpack_from("<Q", data)
    row = SMALLEST_ROW[table.stem]
    if count * row > len(data) - 8:
        raise InputError(f"{table}: {count} rows of at least {row} bytes are announced in {len(data)} bytes (truncated?)")


def find_images(folder: Path) -> Path | None:
    """The folder of photographs in a data set: `images`, or else the `images_N` with the smallest N, or else None."""
    if (folder / "images").is_dir():
        return folder / "images"
    reduced = [p for p in folder.glob("images_*") if p.is_dir() and p.name[7:].isdigit()]
    return min(reduced, key=lambda p: int(p.name[7:]), default=None)


def _distortion(model: Path, image: ColmapImage) -> dict[str, float]:
    """The distortion coefficients of an image's camera, by name."""
    if image.kind not in DISTORTION:
        raise InputError(f"{model}: camera of {image.name} is {image.kind}; {', '.join(DISTORTION)} are accepted "
                         "(colmap image_undistorter makes PINHOLE of any other)")
    first, names = DISTORTION[image.kind]
    return dict(zip(names, image.parameters[first:], strict=True))


def _camera(model: Path, image: ColmapImage) -> Camera:
    camera = Camera(
        rotation=np.ascontiguousarray(image.pose[:, :3]), translation=np.ascontiguousarray(image.pose[:, 3]),
        fx=image.focal[0], fy=image.focal[1], cx=image.centre[0], cy=image.centre[1],
        width=image.size[0], height=image.size[1], name=image.name)
    return checked(camera, f"{model}: {image.name}")


def _pose_error(image: ColmapImage, camera: Camera, lens: Lens | None) -> float:
    """Median distance in pixels between an image's keypoints and the projections of their 3D points; nan if it has none."""
    if not len(image.seen):
        return math.nan
    local = image.points @ camera.rotation.T + camera.translation
    with np.errstate(divide="ignore", invalid="ignore"):  # a point in the camera's plane has no projection, and no distance
        rays = local[:, :2] / local[:, 2:]
        projected = rays * (camera.fx, camera.fy) + (camera.cx, camera.cy) if lens is None else lens.project(rays)
        return float(np.median(np.linalg.norm(projected - image.seen, axis=1)))


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
