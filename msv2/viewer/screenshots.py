"""Pictures of the viewer itself, taken by a headless Chromium that uses it with the mouse as a user would."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

from golden.scenes.files import atomic_output
from msv2.studies.web.browser import Browser, browser
from msv2.viewer.pictures import letterboxed
from msv2.viewer.server import Viewer
from msv2.viewer.session import Session
from msv2.viewer.state import ANAGLYPH, FLOAT, GOLDEN, ONE, SIDE_BY_SIDE
from msv2.viewer.window import Window
from spec.errors import InputError

SIZE = (1280, 800)
OPEN_S, SETTLE_S, SHOWN_S = 60.0, 120.0, 20.0
"""How long the page may take to open, a state to be drawn and reckoned, and a picture to appear in the page, in seconds."""

ALIKE = 4.0
"""Largest mean difference, of 255, between what was drawn and what the page shows, both in small."""

OWN_WORDS = ("THREE.Clock: This module has been deprecated",)
"""What viser's page says on the console, whatever is shown."""

CANVAS = "document.querySelector('canvas')"
"""The element of the page with the picture."""


@contextmanager
def opened(session: Session) -> Iterator[tuple[Browser, Window]]:
    """A browser with the viewer open and its first picture drawn.

    Raises:
        InputError: there is no Chromium, or it does not open the viewer.
    """
    with browser() as page:
        viewer = Viewer(session, "127.0.0.1", 0)
        try:
            page.open(viewer.url, *SIZE)
            try:
                window = viewer.window(OPEN_S)
            except TimeoutError as error:
                raise InputError(f"{error}; does the browser have WebGL?") from error
            settled(page, window)
            page.run("document.querySelectorAll('.mantine-Notification-closeButton').forEach(each => each.click())")
            yield page, window
        finally:
            viewer.close()


def canvas(page: Browser) -> np.ndarray:
    """(H, W, 3) uint8: the picture in the page, without the controls."""
    box = json.loads(page.run(f"JSON.stringify({CANVAS}.getBoundingClientRect())"))
    x, y, width, height = (round(box[name]) for name in ("x", "y", "width", "height"))
    return np.asarray(Image.open(BytesIO(page.screenshot())).convert("RGB"))[y : y + height, x : x + width]


def settled(page: Browser, window: Window) -> np.ndarray:
    """Waits until the window's state is drawn and reckoned and the page shows it; returns `canvas`. Raises TimeoutError."""
    if not window.settle(SETTLE_S):
        raise TimeoutError(f"the state must be drawn within {SETTLE_S:g} s")
    end = time.monotonic() + SHOWN_S
    while time.monotonic() < end:
        seen = canvas(page)
        expected = letterboxed(window.shown.image, seen.shape[1] / seen.shape[0])
        small = (np.asarray(Image.fromarray(image).resize((64, 48), Image.Resampling.BOX), float) for image in (seen, expected))
        if np.abs(np.subtract(*small)).mean() < ALIKE:
            return seen
        time.sleep(0.2)
    raise TimeoutError(f"the page must show the picture within {SHOWN_S:g} s")


def middle(page: Browser, element: str) -> tuple[float, float]:
    """The middle of an element of the page, which a JavaScript expression names."""
    box = f"{element}.getBoundingClientRect()"
    return tuple(page.run(f"{box}.{edge} + {box}.{length} / 2") for edge, length in (("x", "width"), ("y", "height")))


def show_tab(page: Browser, name: str) -> None:
    """Opens one of the tabs with controls."""
    page.click(*middle(page, f"[...document.querySelectorAll('[role=tab]')].find(tab => tab.innerText == {name!r})"))
    time.sleep(0.3)


def take(session: Session, folder: Path) -> list[Path]:
    """Uses the viewer and takes a picture of every step; returns the files.

    Raises:
        InputError: see `opened`.
    """
    files = []
    with opened(session) as (page, window):
        def shot(name: str, tab: str = "Controls", **changes: object) -> None:
            if changes:
                window.change(**changes)
            settled(page, window)
            show_tab(page, tab)
            files.append(folder / f"{name}.png")
            with atomic_output(files[-1]) as file:
                file.write(page.screenshot())

        x, y = middle(page, CANVAS)
        shot("start")
        shot("machine", "Machine")
        page.drag((x, y), (x + 50, y + 10))
        time.sleep(0.5)
        shot("camera")
        page.click(x - 60, y)
        time.sleep(0.5)
        shot("gaze")
        shot("levels", overlay="levels")
        shot("error", overlay="error")
        shot("depth", overlay="depth")
        shot("intersections", overlay="intersections")
        shot("float", overlay="none", renderer=FLOAT)
        shot("side_by_side", renderer=GOLDEN, eyes=SIDE_BY_SIDE)
        shot("warp", overlay="warp")
        shot("anaglyph", overlay="none", eyes=ANAGLYPH)
        window.change(eyes=ONE)
        settled(page, window)
        page.click(x, y, shift=True)
        time.sleep(0.5)
        shot("splat", "Splat")
        complaints = page.complaints(OWN_WORDS)
    if complaints:
        print("in the browser's console:", *complaints, sep="\n  ")
    return files
