"""The scene on which settings are measured: a model, its cameras, and the images that the frames should show."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from golden.oracle.render import render as render_oracle
from golden.scenes.camera import Camera
from golden.scenes.camera_options import ORBIT_VIEWS
from golden.scenes.files import atomic_output, read_json
from golden.scenes.levels import spread_levels
from golden.scenes.load import EMBEDDED, load_scene
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import orbit_camera
from golden.scenes.request import parse_size
from msv2.studies.kept import fingerprint
from spec.constants import MAX_LEVELS
from spec.errors import InputError

TEST_EVERY = 8


@dataclass(frozen=True)
class SceneRequest:
    """The name of a scene with its parameters, small enough to be sent to a worker.

    Attributes:
        path: a model, the folder of a finished training run, or `embedded`.
        size: the frame size, WxH.
        views: the number of cameras, evenly spread over the test views.
        variants: (name, path) of further models of the same world.
        units_per_metre: the scale, for frames of two eyes.
        work: the folder of kept results.
    """

    path: str
    size: str
    views: int
    variants: tuple[tuple[str, str], ...] = ()
    units_per_metre: float = 1.0
    work: str = "build/tradeoff"


@dataclass(frozen=True)
class TradeoffScene:
    """A loaded scene.

    Attributes:
        request: the request that names it.
        leveled: the models with levels, by variant; "" is the scene's own.
        cameras: the cameras.
        photographs: (H, W, 3) float64 in 0..1 for each camera; None if there are none.
        levels_named: a description of the levels, which tells whether they are trained.
    """

    request: SceneRequest
    leveled: dict[str, GaussianModel]
    cameras: tuple[Camera, ...]
    photographs: tuple[np.ndarray, ...] | None
    levels_named: str

    def model(self, variant: str, levels: int, sh_degree: int | None) -> GaussianModel:
        """The model of a variant with the levels and the SH degree of a setting."""
        model = self.leveled[variant]
        if levels == 1:
            model = first_level(model)
        return model if sh_degree is None or sh_degree >= model.sh_degree else model.with_sh_degree(sh_degree)

    def identity(self, variant: str = "") -> str:
        """A hash of a variant's model, the cameras and the photographs."""
        return fingerprint((), self.leveled[variant], *self.cameras, *(p.tobytes() for p in self.photographs or ()))

    def ideal(self, camera: Camera, variant: str = "") -> np.ndarray:
        """(H, W, 3) float64 the float64 renderer's image of level 1, which is kept."""
        model = self.model(variant, 1, None)
        folder = Path(self.request.work) / "oracle"
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{fingerprint([render_oracle.__module__], model, camera)}.npy"
        if not path.exists():
            image = render_oracle(model, camera).image
            with atomic_output(path) as file:
                np.save(file, image)
        return np.load(path)

    def photograph(self, view: int, camera: Camera) -> np.ndarray | None:
        """The photograph of a view. For another camera, such as a second eye's, only the embedded scene has one."""
        if self.photographs is None:
            return None
        if camera is self.cameras[view]:
            return self.photographs[view]
        return _traced(camera) if self.world == EMBEDDED else None

    @cached_property
    def world(self) -> str:
        """The scene on which the run was trained, or the path itself."""
        return run_scene(self.request.path) or self.request.path


def first_level(model: GaussianModel) -> GaussianModel:
    """The model reduced to level 1."""
    if model.levels == 1:
        return model
    return replace(model, opacity=model.opacity[:, :1], sh_dc=model.sh_dc[:, :1], quality_bound=np.ones(len(model), np.uint8))


def run_scene(path: str) -> str | None:
    """The scene on which the finished run in a folder was trained; None if there is no finished run."""
    report = Path(path) / "report.json"
    return str(read_json(report)["options"]["scene"]) if report.exists() and (Path(path) / "model.ply").exists() else None


def _traced(camera: Camera) -> np.ndarray:
    from golden.scenes.embedded.scene import render_photograph

    return render_photograph(camera).astype(np.float64)


def _spread(count: int, wanted: int) -> list[int]:
    if not 1 <= wanted <= count:
        raise InputError(f"views {wanted} is not accepted: 1..{count} are")
    return [int(i) for i in np.arange(wanted) * count // wanted]


@cache
def load(request: SceneRequest) -> TradeoffScene:
    """The scene of a request; each process loads it once.

    Raises:
        InputError: nothing can be loaded from the path, or there are fewer views than requested.
    """
    world, size = run_scene(request.path), parse_size(request.size)
    photographs = None
    scene = load_scene(Path(request.path) / "model.ply" if world else request.path)
    if EMBEDDED in (world, request.path):
        from golden.scenes.embedded.scene import embedded_cameras

        views = embedded_cameras(*size)[::TEST_EVERY]
        cameras = tuple(views[i] for i in _spread(len(views), request.views))
        photographs = tuple(_traced(camera) for camera in cameras)
    elif world:
        cameras, photographs = _of_data(world, size, request.views)
    elif scene.cameras:
        cameras = tuple(scene.cameras[i].resized(*size) for i in _spread(len(scene.cameras), request.views))
    else:
        chosen = _spread(ORBIT_VIEWS, request.views)
        cameras = tuple(orbit_camera(scene.model, i, ORBIT_VIEWS, *size) for i in chosen)
    trained = scene.model.levels == MAX_LEVELS
    leveled = {"": scene.model if trained else spread_levels(first_level(scene.model))}
    for name, path in request.variants:
        leveled[name] = load_scene(Path(path) / "model.ply" if Path(path).is_dir() else path).model
        if leveled[name].levels != MAX_LEVELS:
            raise InputError(f"variant {name} at {path} is not accepted: a model of {MAX_LEVELS} levels is")
    return TradeoffScene(request, leveled, cameras, photographs, "4, trained" if trained else "4, untrained")


def _of_data(world: str, size: tuple[int, int], count: int) -> tuple[tuple[Camera, ...], tuple[np.ndarray, ...]]:
    """Cameras and photographs of a data set's test views. This needs the extra `train`."""
    try:
        from golden.training.scene import load_training_scene
    except ImportError as error:
        raise InputError(f"{world}: its photographs need torch ({error}): make setup") from error
    data = load_training_scene(world, size, points_needed=False)
    chosen = [data.test[i] for i in _spread(len(data.test), count)]
    return tuple(data.cameras[i] for i in chosen), tuple(data.images[i] / 255.0 for i in chosen)
