"""The scenes of the table: a foveated model, the poses from which it is seen, its reference, and the v1 model if there is
one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from golden.diff.gaussians import to_model
from golden.scenes.camera import Camera
from golden.scenes.datasets import load_dataset
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.files import read_json
from golden.scenes.levels import spread_levels
from golden.scenes.load import EMBEDDED, load_model, load_scene
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import orbit_camera
from golden.scenes.request import parse_size
from golden.training.finished_runs import FinishedRun
from golden.training.scene import doubtful_poses
from msv2.studies.threshold.scales import table_scale
from msv2.studies.threshold.v1_model import beside
from spec.errors import InputError

TRAINED, UNTRAINED = "trained levels", "untrained levels"


@dataclass(frozen=True)
class TableScene:
    """A scene of the table.
    Attributes:
        name: the name of its folder or file.
        model: the model with its levels.
        levels: TRAINED or UNTRAINED.
        reference: the dense model of one level, which is the reference of quality.
        judged_by: a description of the reference.
        v1: the v1 model, which has no opacity enhancement, or None.
        cameras: the poses of the source eye, at the frame's size.
        units: the result of `scales.table_scale`.
        run: the folder of the training run, or None.
    """

    name: str
    model: GaussianModel
    levels: str
    reference: GaussianModel
    judged_by: str
    v1: GaussianModel | None
    cameras: tuple[Camera, ...]
    units: dict[str, object]
    run: Path | None = None

    @cached_property
    def metres(self) -> float:
        """Units per metre."""
        return float(self.units["units_per_metre"])


def named(text: str, size: str) -> tuple[str, tuple[int, int]]:
    """Path and frame size of an argument `PATH` or `PATH@WxH`.

    Raises:
        InputError: the size is not valid.
    """
    path, at, own = text.rpartition("@")
    return (path, parse_size(own)) if at and own[:1].isdigit() else (text, parse_size(size))


def table_scene(path: str, size: tuple[int, int], poses: int, units: float | None, v1: str | None = None) -> TableScene:
    """A scene, from the path of a model, from the folder of a finished training run, or `embedded`.

    Args:
        path: the folder of a run, or its model.ply, gives trained levels, the run's dense model and the cameras of its test
            views. Any other model gets untrained levels if it has none. It is judged by itself without levels, and is seen from
            its own cameras or from an orbit.
        size: the size of the frames.
        poses: the number of poses, which are evenly spread over the views.
        units: units per metre, or None.
        v1: the file of the v1 model; None for RUN-v1/model.ply if it exists.

    Raises:
        InputError: nothing can be loaded from the path, or there are fewer views than poses.
    """
    if poses < 1:
        raise InputError(f"poses {poses} is not accepted: 1 or more is")
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    if path != EMBEDDED and (folder / "report.json").exists() and (folder / "model.ply").exists():
        return _of_run(folder, size, poses, units, v1)
    scene = load_scene(path)
    name = Path(path).name.split(".")[0]
    leveled = scene.model.levels > 1
    model = scene.model if leveled else spread_levels(scene.model)
    views = [camera.resized(*size) for camera in scene.cameras] if path != EMBEDDED else embedded_cameras(*size)
    cameras = [views[i] for i in spread(range(len(views)), poses)] if views else [
        orbit_camera(scene.model, i, poses, *size) for i in range(poses)]
    return TableScene(name, model, TRAINED if leveled else UNTRAINED, _first_level(scene.model),
                      "its own L1, rendered everywhere" if leveled else "the same model without levels",
                      load_model(v1) if v1 else None, tuple(cameras), table_scale(name, units))


def _of_run(folder: Path, size: tuple[int, int], poses: int, units: float | None, v1: str | None) -> TableScene:
    options = read_json(folder / "report.json")["options"]
    model = replace(load_model(folder / "model.ply"), name=folder.name)
    views = _test_views(str(options["scene"]), size)
    last = FinishedRun(folder, options).last()
    if last is None:
        raise InputError(f"{folder}: its checkpoints are gone, and with them the dense model that frames are judged by")
    dense = to_model(last.results["dense"], up=model.up, name=f"{folder.name}-dense")
    beside_it = Path(v1) if v1 else beside(folder / "model.ply")
    cameras = tuple(views[i] for i in spread(range(len(views)), poses))
    scale = table_scale(EMBEDDED if options["scene"] == EMBEDDED else folder.name, units)
    return TableScene(folder.name, model, TRAINED, dense, "the run's dense model",
                      load_model(beside_it) if v1 or beside_it.exists() else None, cameras, scale, folder)


def _test_views(scene: str, size: tuple[int, int]) -> list[Camera]:
    """The test views of a data set without those whose poses are doubtful, at a size."""
    if scene == EMBEDDED:
        return embedded_cameras(*size)[::8]
    data = load_dataset(scene)
    doubted = doubtful_poses(data.pose_error)
    return [data.cameras[i].resized(*size) for i in data.test_views if i not in doubted]


def spread(views: Sequence[int], count: int) -> list[int]:
    """`count` of the views, evenly spread and beginning with the first.

    Raises:
        InputError: there are fewer views.
    """
    if count > len(views):
        raise InputError(f"poses {count} is not accepted: the scene has {len(views)} views to take them from")
    return [views[int(i)] for i in np.arange(count) * len(views) // count]


def _first_level(model: GaussianModel) -> GaussianModel:
    return replace(model, opacity=model.opacity[:, :1], sh_dc=model.sh_dc[:, :1],
                   quality_bound=np.ones(len(model), np.uint8))
