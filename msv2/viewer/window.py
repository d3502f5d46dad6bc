"""A browser window, by viser: its state, its picture and its threads."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from dataclasses import replace

import numpy as np
import viser

from golden.scenes.camera import Camera
from msv2.viewer import pictures
from msv2.viewer.controls import FREE, Controls
from msv2.viewer.session import Picture, Session
from msv2.viewer.splat import Found
from msv2.viewer.state import SIDE_BY_SIDE, State
from msv2.viewer.worker import NewestFirst

SETTLED_S = 0.15
"""Seconds without a new camera after which the camera rests."""

QUALITY, MOVING_QUALITY = 92, 80
"""JPEG quality at rest and while the camera moves."""

PATIENCE_S = 1.0
"""Seconds of drawing after which the window says that it is still at it."""

SLOW = "drawing … The first picture of its kind takes longer: levels are made, or kernels are compiled."

ARRIVAL_S = 3.0
"""Seconds within which the browser's camera arrives where it is sent. What the browser reports on its way is ignored."""


def pose_of(session: Session, camera: Camera) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Position, point looked at, and up direction of a camera. Up is the scene's unless the camera is tilted sideways."""
    position = camera.position
    target = position + session.focus_distance(camera) * camera.rotation[2]
    level = abs(float(camera.rotation[0] @ session.up)) < 1e-3 and float(-camera.rotation[1] @ session.up) > 1e-3
    up = session.up if level else -camera.rotation[1]
    return tuple(map(tuple, (position.tolist(), target.tolist(), up.tolist())))


class Window:
    """A browser window: what its user has set, its controls and its picture.

    Args:
        client: viser's handle of the window.
        session: the scene.

    Attributes:
        state: what is shown.
        seconds: of the last frames, what drawing and encoding took, and whether the camera moved.
        reckoned: the state whose numbers are shown, and the seconds from its last change to them.
    """

    def __init__(self, client: viser.ClientHandle, session: Session) -> None:
        self.client, self.session, self.state = client, session, session.state
        self.seconds: deque[tuple[float, bool]] = deque(maxlen=1000)
        self.reckoned: tuple[State, float] | None = None
        self.shown: Picture | None = None
        self._found: Found | None = None
        self._lock = threading.RLock()
        self._changed_at, self._aspect, self._closed = time.monotonic(), float(client.camera.aspect), False
        self._drawing = NewestFirst[tuple[State, bool]](self._draw, self._failed, "drawing")
        self._reckoning = NewestFirst[State](self._reckon, self._failed, "reckoning")
        self._controls = Controls(client.gui, session, self.state)
        self._connect()
        self._pose, self._arrives_by = self.look_from(self.state.camera)
        client.camera.on_update(self._moved)
        client.scene.on_click()(self._clicked)
        client.scene.on_click(modifier="shift")(self._clicked_with_shift)
        self._drawing.put((self.state, False))

    def change(self, *, moving: bool = False, **fields: object) -> None:
        """Changes fields of the state and draws it.

        Args:
            moving: whether more changes are expected at once, so that a smaller frame is drawn first.
            fields: of `State`; also `size`, a pair.
        """
        with self._lock:
            size = fields.pop("size", self.state.size)
            state = replace(self.state, **fields).resized(*size)
            if "gaze" in fields and fields["gaze"] is not None and state.levels == 1:
                state = self.session.with_levels(state, self.session.most_levels)
            self._set(state, moving)

    def _set(self, state: State, moving: bool) -> None:
        """Takes a state over, shows it in the controls and has it drawn."""
        with self._lock:
            if state.frame_key != self.state.frame_key:
                self._found = None
            self.state, self._changed_at = state, time.monotonic()
            self._controls.show(state)
            self._drawing.put((state, moving))

    def look_from(self, camera: Camera) -> tuple[tuple[np.ndarray, np.ndarray], float]:
        """Moves the browser's camera to a camera. Returns the rotation and position that it will report, and by when."""
        position, target, up = pose_of(self.session, camera)
        handle = self.client.camera
        with self.client.atomic():
            handle.position = position
            handle.look_at = target
            handle.up_direction = up
            handle.fov = self._window_fov()
        return (camera.rotation, camera.position), time.monotonic() + ARRIVAL_S

    def show_camera(self, name: str) -> None:
        """Goes to one of the session's cameras."""
        camera = self.session.camera(name)
        with self._lock:
            shaped = self.state.resized(camera.width, camera.height)
            self._set(replace(shaped, camera=camera), False)
            self._pose, self._arrives_by = self.look_from(camera)

    def show_splat(self, x: float, y: float) -> Found | None:
        """Shows the splat that contributes most to a pixel of the source eye, and marks its tiles."""
        found = self.session.splat_at(self.state, x, y)
        with self._lock:
            self._found = found
            self._controls.write("splat", found.markdown() if found else f"No splat reaches pixel {int(x)}, {int(y)}.")
            self._drawing.put((self.state, False))
        return found

    async def _moved(self, camera: viser.CameraHandle) -> None:
        """Takes over what the browser reports: the camera, and the window's shape. Runs in viser's loop, in order."""
        with self._lock:
            if self._closed:
                return
            if abs(camera.aspect - self._aspect) > 1e-6:
                self._aspect = float(camera.aspect)
                camera.fov = self._window_fov()
                self._drawing.put((self.state, False))
            rotation = viser.transforms.SO3(camera.wxyz).as_matrix().T
            position = np.asarray(camera.position, np.float64)
            reach = 1e-4 * max(1.0, float(np.linalg.norm(camera.look_at - camera.position)))
            if np.allclose(rotation, self._pose[0], atol=1e-4) and np.allclose(position, self._pose[1], atol=reach):
                self._arrives_by = 0.0
                return  # the browser reports the camera that it was given, in float32
            if time.monotonic() < self._arrives_by:
                return
            self._pose = rotation, position
            self._controls.free_camera()
            self._set(self.state.posed(rotation, position), True)

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        place = self._pixel(event.screen_pos)
        if place is None:
            return
        if self._controls.shows_splats:
            self.show_splat(*place)
        else:
            self.change(gaze=place)

    def _clicked_with_shift(self, event: viser.SceneClickEvent) -> None:
        place = self._pixel(event.screen_pos)
        if place is not None:
            self.show_splat(*place)

    def _pixel(self, place: tuple[float, float]) -> tuple[float, float] | None:
        """The pixel of the frame at a place in the window; side by side, the same pixel in either half."""
        width, height = self.state.size
        across = 2 * width if self.state.eyes == SIDE_BY_SIDE else width
        found = pictures.place_in_picture(place, self._aspect, across, height)
        return found and (found[0] % width, found[1])

    def _window_fov(self) -> float:
        """The vertical field of view of the whole window, in radians, in which the frame has its own."""
        width, height = self.state.size
        across = (2 if self.state.eyes == SIDE_BY_SIDE else 1) * width
        return 2 * math.atan(math.tan(self.state.vertical_fov / 2) * max(1.0, across / height / self._aspect))

    def _draw(self, job: tuple[State, bool]) -> None:
        state, moving = job
        begin, waiting = time.perf_counter(), threading.Timer(PATIENCE_S, self._controls.write, ("status", SLOW))
        waiting.start()
        try:
            picture = self.session.picture(
                state.moving() if moving else state, moving=moving, found=None if moving else self._found)
        finally:
            waiting.cancel()
        image = pictures.letterboxed(picture.image, self._aspect)
        self.client.scene.set_background_image(image, format="jpeg", jpeg_quality=MOVING_QUALITY if moving else QUALITY)
        self.client.flush()
        self.seconds.append((time.perf_counter() - begin, moving))
        self.shown = picture
        if moving:
            if not self._drawing.newer(SETTLED_S):
                self._draw((state, False))
            return
        self._controls.write("status", self._status(picture))
        if not self._drawing.newer():
            self._reckoning.put(state)

    def _status(self, picture: Picture) -> str:
        width, height = picture.state.size
        gaze = "no gaze" if picture.state.gaze is None else (
            f"gaze {picture.state.gaze[0]:.0f}, {picture.state.gaze[1]:.0f}, {picture.state.levels} levels")
        notes = "".join(f"\n\n{note}" for note in picture.notes)
        splat = f"\n\nsplat {self._found.index:,}: {self._found.weight:.0%} of its pixel; see *Splat*" if self._found else ""
        drawn = "" if picture.kept else f"; drawn in {1e3 * picture.seconds:.0f} ms"
        return f"{self.session.name}, {width}x{height}, {gaze}{drawn}{notes}{splat}"

    def _reckon(self, state: State) -> None:
        if state is not self.state:
            return
        numbers = self.session.numbers(state)
        if state is self.state and not self._closed:
            after = time.monotonic() - self._changed_at
            self._controls.write("summary", numbers.summary())
            self._controls.write("numbers", f"{numbers.markdown()}\n\nReckoned {after:.1f} s after the last change.")
            self.reckoned = state, after

    def _failed(self, error: Exception) -> None:
        if not self._closed:
            self.client.add_notification("This cannot be drawn", str(error), color="red", auto_close_seconds=10.0)
            self._controls.write("status", f"**not drawn**: {error}")

    def settle(self, seconds: float) -> bool:
        """Whether the present state is drawn in full and reckoned within `seconds`."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            state = self.state
            if self._drawing.idle(0.2) and self._reckoning.idle(0.2) and self.reckoned and self.reckoned[0] is state:
                return True
            time.sleep(0.02)
        return False

    def close(self) -> None:
        """Ends the window's threads."""
        self._closed = True
        self._drawing.close()
        self._reckoning.close()

    def _connect(self) -> None:
        on = self._controls.on
        for name in ("marked", "eyes", "renderer", "overlay", "effects", "gain"):
            on(name, lambda value, name=name: self.change(**{name: value}))
        on("camera", lambda value: self.show_camera(value) if value != FREE else None)
        on("fov", lambda value: self._zoom(math.radians(value)))
        on("height", lambda value: self.change(size=self._size_of_height(int(value))))
        on("levels", lambda value: self.change(levels=int(value)))
        on("units_per_metre", lambda value: self.change(units_per_metre=value or None))
        on("foveated", lambda value: self.change(gaze=self._place(0.5, 0.5) if value else None))
        on("gaze_x", lambda _: self.change(moving=True, gaze=self._place(*self._controls.gaze_place())))
        on("gaze_y", lambda _: self.change(moving=True, gaze=self._place(*self._controls.gaze_place())))
        on("start", lambda _: self._back())
        on("export", lambda _: self._export())

    def _place(self, x: float, y: float) -> tuple[float, float]:
        return x * self.state.camera.width, y * self.state.camera.height

    def _zoom(self, fov: float) -> None:
        with self._lock:
            self._set(self.state.zoomed(fov), True)
            self.client.camera.fov = self._window_fov()

    def _back(self) -> None:
        with self._lock:
            start = self.session.state
            self._set(replace(start, units_per_metre=self.state.units_per_metre), False)
            self._pose, self._arrives_by = self.look_from(start.camera)
            self._controls.free_camera()

    def _export(self) -> None:
        self.client.send_file_download("camera.json", self.session.exported(self.state).encode(), save_immediately=True)
        levels = f" --levels {self.state.levels}" if self.state.gaze is not None else ""
        self.client.add_notification(
            "camera.json", f"msv2 render SCENE --camera camera.json{levels} draws this frame", auto_close_seconds=15.0)

    def _size_of_height(self, height: int) -> tuple[int, int]:
        width, now = self.state.size
        return min(round(width * height / now), self.session.config.row_width), height
