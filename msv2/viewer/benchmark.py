"""The viewer's frame time beside the integer renderer's own, along a camera path and without a browser."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO

import numpy as np
import viser

from golden import threads
from msv2.viewer import pictures
from msv2.viewer.session import Session
from msv2.viewer.state import State
from msv2.viewer.window import MOVING_QUALITY, QUALITY, SETTLED_S

TURN_DEG = 1.0
"""The camera turns by this much from frame to frame, around what is in its middle."""

ASPECT = 16 / 9
"""Of the window that the picture is made for."""


def path(session: Session, count: int) -> list[State]:
    """`count` states whose cameras turn around what is in the middle of the first."""
    start = session.state.camera
    focus = start.position + session.focus_distance(start) * start.rotation[2]
    states = []
    for number in range(count):
        turn = viser.transforms.SO3.exp(np.radians(TURN_DEG * number) * session.up).as_matrix()
        states.append(session.state.posed(start.rotation @ turn.T, focus + turn @ (start.position - focus)))
    return states


def benchmark(session: Session, count: int) -> dict[str, object]:
    """Times each frame of the path three ways: the integer renderer alone, the viewer's full frame, its moving frame.

    The viewer's frames include everything that its drawing thread does: the plan of effects, the foveation map, the picture in
    8 bits, overlays, bars, JPEG, and the message to the browser. The renderer's own time is that of `Work.render` on the same
    prepared model. The three take turns, so that a busy machine slows all of them alike.
    """
    with redirect_stdout(StringIO()):
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    seconds: dict[str, list[float]] = {"golden": [], "rest": [], "moving": []}

    def timed(kind: str, work: Callable[[], object]) -> None:
        begin = time.perf_counter()
        work()
        seconds[kind].append(time.perf_counter() - begin)

    def show(state: State, moving: bool) -> None:
        picture = session.picture(state.moving() if moving else state, moving=moving)
        server.scene.set_background_image(
            pictures.letterboxed(picture.image, ASPECT), format="jpeg", jpeg_quality=MOVING_QUALITY if moving else QUALITY)

    try:
        states = path(session, count + 2)
        for state in states[:2]:  # warm
            for moving in (False, True):
                show(state, moving)
        for state in states[2:]:
            plain = replace(state, eyes="one")
            work = session.work(plain)
            timed("golden", work.render)
            timed("rest", lambda state=state: show(state, False))
            timed("moving", lambda state=state: show(state, True))
        last = session.state
        begin, processor = time.perf_counter(), time.process_time()
        session.numbers(last)  # with the golden frame, which is none of the last that were drawn
        reckoned, worked = time.perf_counter() - begin, time.process_time() - processor
    finally:
        with redirect_stdout(StringIO()):
            server.stop()
    median = {kind: float(np.median(values)) for kind, values in seconds.items()}
    return {
        "scene": session.name, "size": list(last.size), "gaze": last.gaze, "levels": last.levels, "eyes": last.eyes,
        "frames": count, "median_s": median, "numbers_s": reckoned, "numbers_processor_s": worked,
        "numbers_after_rest_s": SETTLED_S + reckoned,
        "rest_times_golden": float(np.median(np.array(seconds["rest"]) / seconds["golden"])),
        "moving_times_golden": float(np.median(np.array(seconds["moving"]) / seconds["golden"])),
        "threads": threads.threads, "load_average": os.getloadavg()[0]}


def report(numbers: dict[str, object]) -> str:
    """The benchmark's numbers as text."""
    median, (width, height) = numbers["median_s"], numbers["size"]
    rest, moving = numbers["rest_times_golden"], numbers["moving_times_golden"]
    return (f"{numbers['scene']} {width}x{height}, medians of {numbers['frames']} frames, "
            f"{numbers['threads']} threads, load {numbers['load_average']:.1f}:\n"
            f"  integer renderer alone  {1e3 * median['golden']:7.1f} ms\n"
            f"  viewer at rest          {1e3 * median['rest']:7.1f} ms, {rest:.2f} times the renderer's\n"
            f"  viewer, moving camera   {1e3 * median['moving']:7.1f} ms, {moving:.2f} times\n"
            f"  numbers of the machine  {1e3 * numbers['numbers_s']:7.1f} ms with the frame, "
            f"{1e3 * numbers['numbers_processor_s']:.0f} ms of processor time; "
            f"{numbers['numbers_after_rest_s']:.2f} s after the camera stops")
