"""Reads a COLMAP model into plain arrays through pycolmap. `colmap` calls it in a process with limits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class ColmapImage:
    """A posed image of a COLMAP model.

    Attributes:
        name: the photograph's name below the folder of photographs.
        kind: the camera model, such as `PINHOLE`.
        parameters: the camera model's parameters, in its own order.
        focal: (2,) focal lengths in pixels.
        centre: (2,) principal point in pixels.
        size: width and height in pixels.
        pose: (3, 4) float64, world to camera.
        seen: (K, 2) float64 keypoints in pixels of which the model has the 3D point.
        points: (K, 3) float64 those points in world units.
    """

    name: str
    kind: str
    parameters: list[float]
    focal: tuple[float, float]
    centre: tuple[float, float]
    size: tuple[int, int]
    pose: np.ndarray
    seen: np.ndarray
    points: np.ndarray


@dataclass(frozen=True)
class ColmapModel:
    """A COLMAP model.

    Attributes:
        total: number of images, with or without a pose.
        images: those with a pose, in the order of their names.
        points: (P, 3) float64, world units.
        colours: (P, 3) uint8 RGB.
    """

    total: int
    images: list[ColmapImage]
    points: np.ndarray
    colours: np.ndarray


def read_model(folder: Path) -> ColmapModel:
    """The model in a folder.

    Raises:
        ValueError: the folder holds no whole model; libraries may raise other exceptions.
    """
    import pycolmap

    try:
        model = pycolmap.Reconstruction(str(folder))
        posed = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
        images = [_image(image, model) for image in posed]
        points = list(model.points3D.values())
    except Exception as error:  # pycolmap raises what its C++ threw
        raise ValueError(f"is not a whole COLMAP model ({(str(error) or repr(error)).splitlines()[0]})") from error
    return ColmapModel(
        len(model.images), images, np.array([point.xyz for point in points], np.float64).reshape(-1, 3),
        np.array([point.color for point in points], np.uint8).reshape(-1, 3))


def _image(image: object, model: object) -> ColmapImage:
    pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world  # a property before pycolmap 3.12
    camera = model.cameras[image.camera_id]
    seen = [point for point in image.points2D if point.has_point3D()]
    for point in seen:
        if point.point3D_id not in model.points3D:
            raise ValueError(f"image {image.name} names point {point.point3D_id}, which the model does not have")
    return ColmapImage(
        name=image.name, kind=camera.model.name, parameters=[float(value) for value in camera.params],
        focal=(float(camera.focal_length_x), float(camera.focal_length_y)),
        centre=(float(camera.principal_point_x), float(camera.principal_point_y)),
        size=(int(camera.width), int(camera.height)), pose=np.ascontiguousarray(pose.matrix()),
        seen=np.array([point.xy for point in seen], np.float64).reshape(-1, 2),
        points=np.array([model.points3D[point.point3D_id].xyz for point in seen], np.float64).reshape(-1, 3))
