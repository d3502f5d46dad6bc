"""A scene in the viewer, without a browser: from a state to a picture, to the machine's numbers, and to a splat's record.

The model is loaded and quantised once for each number of levels. Pictures are those of `msv2 render`, and numbers those of
`msv2 perf`, for the same request.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace

import numpy as np

from golden.host.quantise import GaussianWords, quantise_model
from golden.host.run_options import RunOptions
from golden.metrics.image import max_abs_error, psnr_vs
from golden.msv2_ref.eyes import StereoFrame, render_stereo, stereo_warnings
from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.plan import Work, planned_machine, prepare_foveation, prepare_words
from golden.oracle.render import render as render_oracle
from golden.scenes.camera import Camera
from golden.scenes.camera_file import camera_text
from golden.scenes.camera_options import ORBIT_VIEWS
from golden.scenes.gaze import Display, FoveationMap, foveation_map, no_foveation
from golden.scenes.model import GaussianModel
from golden.scenes.probe import probe
from golden.scenes.request import Request, resolve
from golden.scenes.stereo import StereoPair, scene_scale, stereo_pair, target_gaze
from msv2.studies.speed import float32
from msv2.viewer import numbers, pictures, splat
from msv2.viewer.state import FLOAT, ONE, SIDE_BY_SIDE, State, fitted
from perf.model import MemoryModel
from spec.config import AcceleratorConfig
from spec.effects import EffectPlan, with_two_eyes
from spec.recent import Recent


@dataclass(frozen=True)
class Picture:
    """A drawn state.

    Attributes:
        image: (H, W, 3) uint8; two eyes side by side have twice the frame's width.
        state: what was drawn, at the size at which it was drawn.
        seconds: the time that drawing took, with overlays.
        notes: lines for the user: warnings, and the error where it was measured.
        kept: whether the golden frame was kept from before, so that `seconds` do not contain it.
    """

    image: np.ndarray
    state: State
    seconds: float
    notes: tuple[str, ...] = ()
    kept: bool = False


def up_of(request: Request) -> np.ndarray:
    """(3,) the direction that is up while the mouse turns the camera: what the request's camera was made for, else the mean of
    the scene's cameras, else the model's."""
    chosen = request.record.get("standpoint")
    if isinstance(chosen, dict) and "up" in chosen:
        return np.array(chosen["up"], np.float64)
    mean = -sum((camera.rotation[1] for camera in request.cameras), np.zeros(3))
    length = np.linalg.norm(mean)
    return mean / length if length > 0.5 * len(request.cameras) > 0 else request.model.up


class Session:
    """A scene, its quantised model and a machine.

    Args:
        args: the command line's arguments of a request and of two eyes, after `take_stereo_arguments`, with `effects`.
        config: the machine.
        options: how a frame runs on it.
        memory: the memory of the cycle model.
        clock_hz: the clock for energy and frame rate.

    Attributes:
        state: where the viewer begins.
        cameras: names of the scene's cameras, or of those of an orbit where it has none.
        up: (3,) the scene's up direction.
        most_levels: the largest number of levels that scene and machine have.

    Raises:
        InputError: as `golden.scenes.request.resolve`.
    """

    def __init__(
        self, args: argparse.Namespace, config: AcceleratorConfig, options: RunOptions, memory: MemoryModel,
        clock_hz: float = 1e9,
    ) -> None:
        self._args, self.options, self.memory, self.clock_hz = args, options, memory, clock_hz
        self.config = config if options.incremental is None else config.with_(incremental=options.incremental)
        self._models: Recent[tuple[GaussianModel, GaussianWords]] = Recent(2)
        self._plans: Recent[tuple[EffectPlan, AcceleratorConfig, GaussianWords]] = Recent(6)
        self._maps: Recent[FoveationMap] = Recent(4)
        self._frames: Recent[Frame | StereoFrame] = Recent(2)
        self._orbit: Recent[Camera] = Recent(ORBIT_VIEWS)
        self._floats: Recent[float32.FloatModel] = Recent(1)
        self._energies = numbers.energies()

        request = resolve(args)
        self._first = model = request.model
        self.most_levels = min(config.levels, model.levels if model.levels > 1 else config.levels)
        levels = min(args.levels or model.levels, self.most_levels)
        if levels == model.levels:
            self._models.get(levels, lambda: (model, quantise_model(self.config, model)))
        self.name, self.up, self.background = model.name, up_of(request), request.background
        size = self._size(request.camera)
        self.state = State(
            request.camera, request.foveation.gaze_xy, levels, args.effects, units_per_metre=args.units_per_metre,
            eyes=SIDE_BY_SIDE if args.stereo else ONE, overlay="depth" if args.depth else "none").resized(*size)
        self._stored = request.cameras
        named = [camera.name for camera in request.cameras] or [f"orbit {number}" for number in range(ORBIT_VIEWS)]
        self.cameras = tuple(f"{number}: {name}" for number, name in enumerate(named))

    def _size(self, camera: Camera) -> tuple[int, int]:
        kept = camera if self._args.size else fitted(camera)
        return kept.width, kept.height

    @property
    def has_cameras(self) -> bool:
        """Whether the scene has cameras of its own."""
        return bool(self._stored)

    def camera(self, name: str) -> Camera:
        """The camera of one of the names in `cameras`: what `--camera NUMBER` chooses."""
        number = self.cameras.index(name)
        if self._stored:
            camera = self._stored[number]
            return camera.resized(*self._size(camera))
        return self._orbit.get(number, lambda: resolve(self._asked(number, None)).camera)

    def _asked(self, camera: int, levels: int | None) -> argparse.Namespace:
        """The command line's arguments with one of the numbered cameras, another number of levels, and no gaze."""
        no_standpoint = dict.fromkeys(("orbit", "up", "look_at"))
        return argparse.Namespace(
            **{**vars(self._args), **no_standpoint, "camera": str(camera), "levels": levels, "gaze": "none"})

    def _model(self, levels: int) -> tuple[GaussianModel, GaussianWords]:
        def make() -> tuple[GaussianModel, GaussianWords]:
            model = resolve(self._asked(0, levels)).model
            return model, quantise_model(self.config, model)

        return self._models.get(levels, make)

    def _foveation(self, state: State, gaze: tuple[float, float] | None, levels: int) -> FoveationMap:
        display = Display(*state.size)
        make = (lambda: no_foveation(display)) if gaze is None else (lambda: foveation_map(display, gaze, levels))
        return self._maps.get((state.size, gaze, levels), make)

    def work(self, state: State) -> Work:
        """The request of a state with its plan, machine and prepared data, which frames share where they can.

        Raises:
            InputError: the gaze is off the frame, or the effects that the user wants leave out a needed one.
        """
        model, words = self._model(state.levels)
        foveation = self._foveation(state, state.gaze, min(state.levels, model.levels))
        record = {"scene": str(self._args.scene), "camera": state.camera.name, "size": list(state.size), "gaze": state.gaze,
                  "levels": state.levels, "background": list(self.background), "seed": self._args.seed}
        request = Request(model, state.camera, foveation, self.background, record)
        key = (state.levels, foveation.levels, int(foveation.tile_level.max(initial=0)), bool(foveation.blend.any()),
               state.effects, state.stereo, state.depth)
        plan, machine, prepared = self._plans.get(key, lambda: self._plan(state, request, words))
        return Work(request, plan, machine, prepared, prepare_foveation(plan, self.config, foveation), 0.0)

    def _plan(
        self, state: State, request: Request, words: GaussianWords,
    ) -> tuple[EffectPlan, AcceleratorConfig, GaussianWords]:
        plan = probe(request.model, request.foveation, effects=state.effects, stereo=state.stereo, depth=state.depth,
                     contention=self.memory.bytes_per_cycle is not None)
        machine = planned_machine(plan, self.config, full=self.options.full)
        return plan, machine, prepare_words(plan, self.config, words)

    def _pair(self, state: State) -> tuple[StereoPair, str | None]:
        units, assumed = scene_scale(self.name, state.units_per_metre)
        pair = stereo_pair(state.camera, ipd_metres=self._args.ipd, units_per_metre=units, source_eye=self._args.source)
        return pair, assumed

    def golden(self, state: State) -> Frame | StereoFrame:
        """The frame of the integer renderer; the last one is kept."""
        return self._frames.get(state.frame_key, lambda: self._render(state))

    def _render(self, state: State) -> Frame | StereoFrame:
        work = self.work(state)
        if not state.stereo:
            return work.render()
        return render_stereo(
            work.words, self._pair(state)[0], config=with_two_eyes(work.config), foveation=work.foveation,
            threshold_deg=self._args.ecc_thresh, background=self.background)

    def _float_images(self, state: State, exact: bool) -> list[np.ndarray]:
        """(H, W, 3) float images of the eyes, left first. With `exact`, always by the oracle; else by the float32 kernel where
        it can draw the state, that is, one level. Both eyes are drawn; nothing is warped."""
        model = self._model(state.levels)[0]
        foveation = self._foveation(state, state.gaze, min(state.levels, model.levels))
        if not exact and foveation.levels == 1 and not state.stereo:
            prepared = self._floats.get(state.levels, lambda: float32.prepare(model))
            return [float32.render(prepared, state.camera, self.background).image]

        def draw(camera: Camera, tiles: FoveationMap) -> tuple[np.ndarray, np.ndarray]:
            frame = render_oracle(model, camera, foveation=tiles, background=self.background, weights="plane",
                                  support_sigma=self.config.support_sigma)
            return frame.image, frame.depth

        source, depth = draw(state.camera, foveation)
        if not state.stereo:
            return [source]
        pair, tiles = self._pair(state)[0], foveation
        if state.gaze is not None:
            column, row = (min(int(place), edge - 1) for place, edge in zip(state.gaze, state.size, strict=True))
            gaze, _ = target_gaze(pair, state.gaze, float(depth[row, column]))
            tiles = self._foveation(state, gaze, foveation.levels)
        return list(pair.left_right(source, draw(pair.target, tiles)[0]))

    def picture(self, state: State, *, moving: bool = False, found: splat.Found | None = None) -> Picture:
        """Draws a state.

        Args:
            state: what to draw, at the size to draw it.
            moving: whether a faster renderer may stand in for the oracle.
            found: a splat whose tiles are to be marked.

        Raises:
            InputError: see `work`.
        """
        begin = time.perf_counter()
        error, notes, kept = state.overlay == "error", [], state.frame_key in self._frames
        floats = self._float_images(state, exact=not moving) if error or state.renderer == FLOAT else None
        golden = self.golden(state) if error or state.renderer != FLOAT or pictures.needs_golden(state) else None
        eyes = pictures.eyes_of(golden, self.work(state).request.foveation) if golden is not None else None
        images = floats if state.renderer == FLOAT else [eye.image for eye in eyes]
        if isinstance(golden, StereoFrame):
            notes += stereo_warnings(golden, self._pair(state)[1])
        if error:
            notes += [f"golden against float{side}: {psnr_vs(eye.image, exact):.1f} dB, "
                      f"largest error {max_abs_error(eye.image, exact):.4f}"
                      for side, eye, exact in zip((", left eye", ", right eye") if state.stereo else ("",), eyes, floats,
                                                  strict=True)]
        foveations = [eye.foveation for eye in eyes] if eyes else [self.work(state).request.foveation] * len(images)
        image = pictures.compose(state, images, eyes, floats, foveations, found)
        return Picture(image, state, time.perf_counter() - begin, tuple(notes), kept)

    def numbers(self, state: State) -> numbers.Numbers:
        """The machine's numbers of a state's golden frame, whatever renderer and overlay are shown."""
        work, golden = self.work(state), self.golden(state)
        if work.second_eye_forced and self.options.display:
            golden = work.add_eye(golden)
        return numbers.of_frame(golden, work, self.options, self.memory, self._energies, self.clock_hz)

    def splat_at(self, state: State, x: float, y: float) -> splat.Found | None:
        """The splat that contributes most to the pixel at (x, y) of the source eye's golden frame; None where none does."""
        golden = self.golden(state)
        return splat.find(golden.source if isinstance(golden, StereoFrame) else golden, int(x), int(y))

    def exported(self, state: State) -> str:
        """Camera and gaze as JSON, as `--camera FILE` takes them."""
        return camera_text(state.camera, state.gaze)

    def with_levels(self, state: State, levels: int) -> State:
        """The state with another number of levels, at most `most_levels`."""
        return replace(state, levels=max(1, min(levels, self.most_levels)))

    def focus_distance(self, camera: Camera) -> float:
        """Distance along the camera's axis to what is in the middle of its frame: the point that the mouse turns around.

        It is the median depth of the splats in the middle quarter of the frame, each counting by its opacity and by the area
        that it covers.
        """
        model = self._first
        points = model.means @ camera.rotation.T + camera.translation
        z = points[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            middle = (np.abs(points[:, 0] / z) < camera.width / 8 / camera.fx) & (
                np.abs(points[:, 1] / z) < camera.height / 8 / camera.fy) & (z > camera.near)
        if not middle.any():
            return max(float(np.linalg.norm(camera.position - np.median(model.means, axis=0))), 10 * camera.near)
        area = np.exp(np.sort(model.log_scales[middle], axis=1)[:, 1:].sum(axis=1))
        weight = np.minimum(model.opacity[middle, 0], 1) * area / z[middle] ** 2
        order = np.argsort(z[middle])
        total = np.cumsum(weight[order])
        return float(z[middle][order][np.searchsorted(total, total[-1] / 2)])
