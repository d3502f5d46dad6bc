"""The controls of a browser window, by viser: what the user changes there, and how they show a state."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from msv2.viewer.session import Session
from msv2.viewer.state import EYES, OVERLAYS, RENDERERS, State
from spec.effects import ALL, AUTO, NONE

HEIGHTS = (180, 270, 360, 540, 720, 1080)
"""Frame heights to choose from, as far as the machine has them."""

FREE = "free"
"""What the list of cameras shows when the camera is none of them."""

SETS_GAZE, SHOWS_SPLAT = "sets the gaze", "shows a splat"


class Controls:
    """All controls of a window.

    Args:
        gui: viser's handle of the window's controls.
        session: the scene.
        state: what they show at first.
    """

    def __init__(self, gui: viser.GuiApi, session: Session, state: State) -> None:
        least = session.config.row_width
        heights = sorted({*(height for height in HEIGHTS if height <= least), state.camera.height})
        made: dict[str, Any] = {"status": gui.add_markdown(""), "summary": gui.add_markdown("")}
        self._made, self._gui = made, gui
        tabs = gui.add_tab_group()
        with tabs.add_tab("Controls"):
            with gui.add_folder("Camera"):
                self._add_camera(session, state, heights)
            with gui.add_folder("Gaze and levels"):
                self._add_gaze(session, state)
            with gui.add_folder("Picture"):
                self._add_picture(session, state)
        with tabs.add_tab("Machine"):
            made["numbers"] = gui.add_markdown("The machine's numbers appear once the camera rests.")
        with tabs.add_tab("Splat"):
            made["splat"] = gui.add_markdown("Hold Shift and click on the picture.")
        self.show(state)

    def _add_camera(self, session: Session, state: State, heights: list[int]) -> None:
        made, gui = self._made, self._gui
        made["camera"] = gui.add_dropdown("camera", (FREE, *session.cameras), initial_value=FREE,
                                          hint="drag: turn; wheel: closer; right button: move; W A S D Q E: walk")
        made["fov"] = gui.add_slider("field of view", 10.0, 120.0, 0.5, fov_degrees(state), hint="vertical, in degrees")
        made["height"] = gui.add_dropdown("frame height", tuple(map(str, heights)), initial_value=str(state.camera.height))
        made["start"] = gui.add_button("back to the start")
        made["export"] = gui.add_button("export camera and gaze", hint="a JSON file for msv2 render --camera FILE")

    def _add_gaze(self, session: Session, state: State) -> None:
        made, gui = self._made, self._gui
        made["click"] = gui.add_dropdown("a click", (SETS_GAZE, SHOWS_SPLAT), initial_value=SETS_GAZE,
                                         hint="Shift and a click always shows a splat")
        made["foveated"] = gui.add_checkbox("foveated", state.gaze is not None)
        made["gaze_x"] = gui.add_slider("gaze x, %", 0.0, 100.0, 0.5, 50.0)
        made["gaze_y"] = gui.add_slider("gaze y, %", 0.0, 100.0, 0.5, 50.0)
        made["levels"] = gui.add_dropdown(
            "levels", tuple(str(n + 1) for n in range(session.most_levels)), initial_value=str(state.levels))
        made["marked"] = gui.add_checkbox("mark the gaze", state.marked)

    def _add_picture(self, session: Session, state: State) -> None:
        made, gui = self._made, self._gui
        made["eyes"] = gui.add_dropdown("eyes", EYES, initial_value=state.eyes)
        made["units_per_metre"] = gui.add_number("units per metre", state.units_per_metre or 0.0, min=0.0, step=0.01,
                                                 hint="scale of the scene for two eyes; 0: the scene's own, else 1")
        made["renderer"] = gui.add_dropdown("renderer", RENDERERS, initial_value=state.renderer,
                                            hint="golden: the hardware's pixels; float: the reference")
        made["overlay"] = gui.add_dropdown("overlay", OVERLAYS, initial_value=state.overlay)
        made["gain"] = gui.add_slider("error times", 1.0, 1024.0, 1.0, state.gain)
        made["effects"] = gui.add_dropdown(
            "effects", tuple(dict.fromkeys((AUTO, ALL, NONE, session.state.effects))), initial_value=state.effects,
            hint="auto: what the frame needs; all: every effect, on neutral data; none: refused where one is needed")

    @property
    def shows_splats(self) -> bool:
        """Whether a plain click shows a splat instead of setting the gaze."""
        return self._made["click"].value == SHOWS_SPLAT

    def on(self, name: str, react: Callable[[Any], None]) -> None:
        """Calls `react` with a control's value when the user changes it. Changes by this program have no client and do
        nothing."""
        def changed(event: viser.GuiEvent) -> None:
            if event.client_id is not None:
                react(event.target.value)

        control = self._made[name]
        (control.on_click if isinstance(control, viser.GuiButtonHandle) else control.on_update)(changed)

    def write(self, name: str, text: str) -> None:
        """Sets the text of "status", "summary", "numbers" or "splat", in Markdown."""
        self._made[name].content = text

    def free_camera(self) -> None:
        """Shows that the camera is none of the list."""
        self._made["camera"].value = FREE

    def gaze_place(self) -> tuple[float, float]:
        """Where the sliders of the gaze stand, in 0..1 of the frame."""
        return self._made["gaze_x"].value / 100, self._made["gaze_y"].value / 100

    def show(self, state: State) -> None:
        """Sets every control to a state, which a click, a drag or a program may have changed."""
        made = self._made
        for name in ("marked", "eyes", "renderer", "overlay", "effects", "gain"):
            made[name].value = getattr(state, name)
        made["levels"].value, made["foveated"].value = str(state.levels), state.gaze is not None
        made["units_per_metre"].value, made["fov"].value = state.units_per_metre or 0.0, fov_degrees(state)
        if str(state.camera.height) in made["height"].options:
            made["height"].value = str(state.camera.height)
        if state.gaze is not None:
            made["gaze_x"].value = 100 * state.gaze[0] / state.camera.width
            made["gaze_y"].value = 100 * state.gaze[1] / state.camera.height


def fov_degrees(state: State) -> float:
    """The vertical field of view in degrees as the slider takes it."""
    return float(np.clip(round(2 * math.degrees(state.vertical_fov)) / 2, 10.0, 120.0))
