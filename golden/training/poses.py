"""Interpolated poses: cameras between the training cameras, with a dense model's renders in place of photographs.

The gates of levels 2 to 4 look at these beside the validation photographs, which may be few and unlike the test views.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.spatial.transform import Rotation, Slerp

from golden.diff.gaussians import Gaussians
from golden.diff.render import render
from golden.scenes.camera import Camera
from golden.scenes.pictures import to_bytes
from golden.training.scene import TrainingScene
from spec.constants import ALPHA_MAX_L1

WIDEST_TURN_DEG = 45.0
"""Cameras whose directions differ by more than this have no pose between them, because it would look elsewhere than both."""


def between(first: Camera, second: Camera) -> Camera:
    """The camera half-way: the mean position, the rotation half-way along the shorter arc, and the first one's lens."""
    turn = Slerp([0.0, 1.0], Rotation.from_matrix(np.stack([first.rotation, second.rotation])))
    rotation = turn(0.5).as_matrix()
    position = (first.position + second.position) / 2
    return replace(first, rotation=rotation, translation=-rotation @ position, name="interpolated")


def interpolated_cameras(cameras: Sequence[Camera], count: int) -> tuple[Camera, ...]:
    """Up to `count` poses, each between one of the cameras, evenly spread over them, and the nearest other that looks about the
    same way. Pairs that come twice give one pose; a camera without such a neighbour gives none."""
    positions = np.array([camera.position for camera in cameras])
    axes = np.array([camera.rotation[2] for camera in cameras])
    pairs: dict[tuple[int, int], None] = {}
    for place in np.unique(np.linspace(0, len(cameras) - 1, count).round().astype(int)):
        distance = np.linalg.norm(positions - positions[place], axis=1)
        distance[axes @ axes[place] < np.cos(np.radians(WIDEST_TURN_DEG))] = np.inf
        distance[place] = np.inf
        nearest = int(distance.argmin())
        if np.isfinite(distance[nearest]):
            pairs[min(place, nearest), max(place, nearest)] = None
    return tuple(between(cameras[one], cameras[other]) for one, other in pairs)


def with_poses(scene: TrainingScene, dense: Gaussians, count: int) -> tuple[TrainingScene, tuple[int, ...]]:
    """The scene with interpolated poses as further views, and their indices.

    Args:
        scene: its training cameras are interpolated.
        dense: the model whose renders, at 8 bits a channel as photographs have, are the poses' pictures.
        count: the largest number of poses; there are fewer where the training cameras have fewer pairs of neighbours.
    """
    cameras = interpolated_cameras([scene.cameras[view] for view in scene.train], count)
    if not cameras:
        return scene, ()
    with torch.no_grad():
        images = np.stack([to_bytes(render(dense, camera, alpha_max=ALPHA_MAX_L1).image.cpu().numpy()) for camera in cameras])
    return scene.with_views(cameras, images), tuple(range(len(scene), len(scene) + len(cameras)))
