"""The viewer's server, by viser."""

from __future__ import annotations

import threading
import time
from contextlib import redirect_stdout
from io import StringIO

import viser

from msv2.viewer.session import Session
from msv2.viewer.window import Window, pose_of


class Viewer:
    """A viser server that shows a session; every browser window has a state of its own.

    Args:
        session: the scene.
        host, port: where to listen; the next free port where this one is taken.

    Attributes:
        windows: the open windows, by viser's number of the client.
    """

    def __init__(self, session: Session, host: str, port: int) -> None:
        self.session, self.windows = session, dict[int, Window]()
        self._lock, self._ended = threading.Lock(), threading.Event()
        with redirect_stdout(StringIO()):  # viser prints a panel of its own
            self.server = viser.ViserServer(host=host, port=port, label="msv2", verbose=False)
        self.host = "127.0.0.1" if host == "0.0.0.0" else host
        gui, scene = self.server.gui, self.server.scene
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_width="large")
        gui.main_panel.dock_right()
        scene.set_up_direction(tuple(float(value) for value in session.up))
        start = self.server.initial_camera
        start.position, start.look_at, start.up = pose_of(session, session.state.camera)
        self.server.on_client_connect(self._joined)
        self.server.on_client_disconnect(self._left)

    @property
    def url(self) -> str:
        """Where a browser finds the viewer."""
        return f"http://{self.host}:{self.server.get_port()}"

    def wait(self) -> None:
        """Returns when `close` is called; Ctrl-C interrupts it."""
        while not self._ended.wait(0.5):
            pass

    def window(self, seconds: float) -> Window:
        """The window that was opened last; waits for one up to `seconds`. Raises TimeoutError."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            with self._lock:
                if self.windows:
                    return self.windows[max(self.windows)]
            time.sleep(0.05)
        raise TimeoutError(f"no browser has opened {self.url} within {seconds:g} s")

    def close(self) -> None:
        """Ends the server and all threads."""
        self._ended.set()
        with self._lock:
            windows, self.windows = list(self.windows.values()), {}
        for window in windows:
            window.close()
        with redirect_stdout(StringIO()):
            self.server.stop()

    def _joined(self, client: viser.ClientHandle) -> None:
        window = Window(client, self.session)
        with self._lock:
            self.windows[client.client_id] = window

    def _left(self, client: viser.ClientHandle) -> None:
        with self._lock:
            window = self.windows.pop(client.client_id, None)
        if window:
            window.close()
