"""What settings are measured on: a model, its views, and what these should look like."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from golden.oracle.render import render as render_oracle
from golden.scenes.camera import Camera
from golden.scenes.files import atomic_output, read_json
from golden.scenes.levels import enhanced_levels
from golden.scenes.load import EMBEDDED, load_scene
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import orbit_camera
from golden.scenes.request import ORBIT_VIEWS, parse_size
from msv2.studies.kept import fingerprint
from spec.constants import MAX_LEVELS
from spec.errors import InputError

TEST_EVERY = 8


@dataclass(frozen=True)
class SceneRequest:
    """What names a scene, small enough to travel to a worker.

    Attributes:
        path: a model, the folder of a finished training run, or `embedded`.
        size: WxH.
        views: how many, evenly over the test views.
        variants: (name, path) of models of the same world.
        units_per_metre: of two eyes.
        work: folder of what is kept.
    """

    path: str
    size: str
    views: int
    variants: tuple[tuple[str, str], ...] = ()
    units_per_metre: float = 1.0
    work: str = "build/tradeoff"


@dataclass(frozen=True)
class TradeoffScene:
    """A loaded request.

    Attributes:
        request: it.
        leveled: the models with levels by variant; "" is the scene's.
        cameras: the views.
        photographs: (H, W, 3) float64 in 0..1 of each view; None: there are none.
        levels_named: whether levels are trained.
    """

    request: SceneRequest
    leveled: dict[str, GaussianModel]
    cameras: tuple[Camera, ...]
    photographs: tuple[np.ndarray, ...] | None
    levels_named: str

    def model(self, variant: str, levels: int, sh_degree: int | None) -> GaussianModel:
        """A variant as a setting wants it."""
        model = self.leveled[variant]
        if levels == 1:
            model = first_level(model)
        return model if sh_degree is None or sh_degree >= model.sh_degree else model.with_sh_degree(sh_degree)

    def identity(self, variant: str = "") -> str:
        """Of a variant's model, cameras and photographs."""
        return fingerprint((), self.leveled[variant], *self.cameras, *(p.tobytes() for p in self.photographs or ()))

    def ideal(self, camera: Camera, variant: str = "") -> np.ndarray:
        """(H, W, 3) float64: the float64 renderer's image of level 1, kept."""
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
        """The view's photograph; of another camera (a second eye) the embedded scene alone has one."""
        if self.photographs is None:
            return None
        if camera is self.cameras[view]:
            return self.photographs[view]
        return _traced(camera) if self.world == EMBEDDED else None

    @cached_property
    def world(self) -> str:
        """What the run was trained on, or the path itself."""
        return run_scene(self.request.path) or self.request.path


def first_level(model: GaussianModel) -> GaussianModel:
    """Level 1 alone."""
    if model.levels == 1:
        return model
    return replace(model, opacity=model.opacity[:, :1], sh_dc=model.sh_dc[:, :1], quality_bound=np.ones(len(model), np.uint8))


def run_scene(path: str) -> str | None:
    """The scene that a finished run in a folder was trained on."""
    report = Path(path) / "report.json"
    return str(read_json(report)["options"]["scene"]) if report.exists() and (Path(path) / "model.ply").exists() else None


def _traced(camera: Camera) -> np.ndarray:
    from golden.scenes.embedded.scene import render_reference

    return render_reference(camera)[0].astype(np.float64)


def _spread(count: int, wanted: int) -> list[int]:
    if not 1 <= wanted <= count:
        raise InputError(f"views {wanted} is not accepted: 1..{count} are")
    return [int(i) for i in np.arange(wanted) * count // wanted]


@cache
def load(request: SceneRequest) -> TradeoffScene:
    """The scene of a request, once a process.

    Raises:
        InputError: nothing that can be loaded, fewer views than asked for.
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
    leveled = {"": scene.model if trained else enhanced_levels(first_level(scene.model))}
    for name, path in request.variants:
        leveled[name] = load_scene(Path(path) / "model.ply" if Path(path).is_dir() else path).model
        if leveled[name].levels != MAX_LEVELS:
            raise InputError(f"variant {name} at {path} is not accepted: a model of {MAX_LEVELS} levels is")
    return TradeoffScene(request, leveled, cameras, photographs, "4, trained" if trained else "4, untrained")


def _of_data(world: str, size: tuple[int, int], count: int) -> tuple[tuple[Camera, ...], tuple[np.ndarray, ...]]:
    """Cameras and photographs of a data set's test views; needs the extra `train`."""
    try:
        from golden.training.scene import load_training_scene
    except ImportError as error:
        raise InputError(f"{world}: its photographs need torch ({error}): make setup") from error
    data = load_training_scene(world, size, points_needed=False)
    chosen = [data.test[i] for i in _spread(len(data.test), count)]
    return tuple(data.cameras[i] for i in chosen), tuple(data.images[i] / 255.0 for i in chosen)
