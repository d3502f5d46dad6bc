"""A scene of cameras without photographs: the renders of a dense model take their place in training and in judging."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from golden.diff.gaussians import Gaussians
from golden.diff.render import render
from golden.scenes.camera import Camera
from golden.scenes.conventions import up_of_cameras
from golden.scenes.datasets import cameras_beside_model, load_dataset
from golden.scenes.pictures import to_bytes
from golden.training.scene import MIN_EDGE, TrainingScene, divided_scene
from spec.errors import InputError

MIN_VIEWS = 3
"""One view each to train, to validate and to test."""


def has_photographs(path: Path) -> bool:
    """Whether a scene has photographs. A cameras.json of the INRIA trainer, or a data set without images, has only cameras.

    Raises:
        InputError: as for `load_dataset`, if there are no cameras beside a model either.
    """
    try:
        return load_dataset(path).images is not None
    except InputError:
        if path.exists() and cameras_beside_model(path):
            return False
        raise


def teacher_scene(path: Path, size: tuple[int, int] | None, dense: Gaussians) -> TrainingScene:
    """The cameras at `path`, with the dense model's renders at 8 bits a channel in place of photographs.

    Args:
        path: a data set without images, or the folder or file of a model with cameras.json.
        size: (width, height) to train at; None for the first camera's. All cameras are brought to it.
        dense: the model that is rendered.

    Raises:
        InputError: there are fewer than three cameras, or the size is too small to train at.
    """
    name, cameras, up = _cameras(path)
    if len(cameras) < MIN_VIEWS:
        raise InputError(
            f"{path}: has {len(cameras)} cameras; at least {MIN_VIEWS} are needed, to train, to validate and to test")
    width, height = size or (cameras[0].width, cameras[0].height)
    if min(width, height) < MIN_EDGE:
        raise InputError(f"{path}: size {width}x{height} is not accepted: at least {MIN_EDGE} pixels an edge are")
    cameras = tuple(camera.resized(width, height) for camera in cameras)
    with torch.no_grad():
        images = np.stack([to_bytes(render(dense, camera).image.cpu().numpy()) for camera in cameras])
    nothing = np.zeros((0, 3))
    return divided_scene(name, up, cameras, images, nothing, nothing)


def _cameras(path: Path) -> tuple[str, tuple[Camera, ...], np.ndarray]:
    """Name, cameras and up direction of a scene that has cameras but no photographs."""
    try:
        data = load_dataset(path)
    except InputError:
        cameras = cameras_beside_model(path)
        folder = path if path.is_dir() else path.parent
        return folder.absolute().name, cameras, up_of_cameras(np.array([camera.rotation for camera in cameras]))
    return data.name, data.cameras, data.up
