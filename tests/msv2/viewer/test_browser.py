"""The viewer in a headless Chromium, used by mouse: frames follow, overlays show, the console stays empty."""

import json
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from golden.scenes.save import save_model
from spec.paths import ROOT
from tests.helpers.golden_samples import ball

pytest.importorskip("viser", reason="no viser: make setup EXTRAS=viewer")

from msv2.studies.web.browser import HINT, find_chromium
from msv2.viewer import screenshots
from msv2.viewer.command import main, make_session, parse_arguments, warm_up
from msv2.viewer.server import Viewer
from msv2.viewer.state import SIDE_BY_SIDE

pytestmark = pytest.mark.slow  # a browser takes seconds, of which few are its processor's

needs_chromium = pytest.mark.skipif(find_chromium() is None, reason=f"no Chromium: {HINT}")


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("scene") / "ball.ply"
    save_model(ball(), path)
    return str(path)


@pytest.fixture(scope="module")
def page(scene):
    """A browser with the viewer open, and its window on our side."""
    session = make_session(parse_arguments([scene, "--size", "192x128"]))
    warm_up(session)
    with screenshots.opened(session) as opened:
        yield opened


def frame_change(before: np.ndarray, after: np.ndarray) -> float:
    """The share of pixels that differ by more than JPEG does."""
    return float((np.abs(before.astype(int) - after).max(2) > 40).mean())


@needs_chromium
def test_frames_and_overlays_follow_the_mouse(page):
    """One page for all of it, as a user has: the drag, the click, every overlay, the splat, an empty console."""
    browser, window = page
    x, y = screenshots.middle(browser, screenshots.CANVAS)
    start, state = screenshots.settled(browser, window), window.state
    assert state.camera is window.session.state.camera  # what the browser reports does not replace it
    assert (start.max(2) > 100).mean() > 0.02  # the ball is there
    assert window.shown.state == state and window.shown.state.size == (192, 128)  # full size at rest

    window.seconds.clear()
    browser.drag((x, y), (x + 150, y + 30))
    time.sleep(0.3)
    moved = screenshots.settled(browser, window)
    assert frame_change(start, moved) > 0.02
    assert np.linalg.norm(window.state.camera.position - state.camera.position) > 0.1
    assert any(moving for _, moving in window.seconds) and not window.seconds[-1][1]  # small while moving, then full

    browser.click(x - 100, y)
    time.sleep(0.3)
    gazed = screenshots.settled(browser, window)
    assert window.state.gaze is not None and window.state.levels == 4
    height, width = moved.shape[:2]
    shown = max(192 / width, 128 / height)  # pixels of the frame in a pixel of the page
    assert abs(window.state.gaze[0] - (96 - 100 * shown)) < 2 and abs(window.state.gaze[1] - 64) < 2
    assert frame_change(moved, gazed) > 0.005

    for changes in ({"overlay": "levels"}, {"overlay": "error", "gain": 1024.0}, {"overlay": "intersections"},
                    {"overlay": "depth"}, {"overlay": "none", "eyes": SIDE_BY_SIDE}):
        window.change(**changes)
        assert frame_change(gazed, screenshots.settled(browser, window)) > 0.02, changes
    window.change(eyes="one")
    assert frame_change(gazed, screenshots.settled(browser, window)) < 0.002

    browser.click(x, y, shift=True)
    time.sleep(0.3)
    marked = screenshots.settled(browser, window)
    assert ((marked[..., 0] > 200) & (marked[..., 1] > 200) & (marked[..., 2] < 90)).mean() > 0.001  # yellow tiles
    screenshots.show_tab(browser, "Splat")
    text = browser.run("document.body.innerText")
    assert re.search(r"Splat [\d,]+ has [\d.]+% of pixel", text) and "log2_opacity" in text
    screenshots.show_tab(browser, "Machine")
    numbers = window.session.numbers(window.state)
    text = browser.run("document.body.innerText")
    assert f"{numbers.cycles.entries:,} intersections" in text and f"{numbers.cycles.total:,}" in text
    assert browser.complaints(screenshots.OWN_WORDS) == []


@needs_chromium
def test_the_list_of_cameras_moves_the_browsers_camera(page):
    browser, window = page
    before = screenshots.canvas(browser)
    name = window.session.cameras[4]
    window.show_camera(name)
    after = screenshots.settled(browser, window)
    time.sleep(0.5)
    camera = window.session.camera(name)
    assert (window.state.camera.rotation == camera.rotation).all()  # what the browser reports does not replace it
    assert np.allclose(window.client.camera.position, camera.position, atol=1e-3)
    assert frame_change(before, after) > 0.02
    assert browser.complaints(screenshots.OWN_WORDS) == []


@needs_chromium
def test_what_cannot_be_drawn_is_said_and_the_viewer_goes_on(page):
    browser, window = page
    window.change(effects="none")
    time.sleep(1.0)
    assert "this frame calls for more" in browser.run("document.body.innerText")
    window.change(effects="auto")
    screenshots.settled(browser, window)
    assert "not drawn" not in browser.run("document.body.innerText")


def test_a_page_without_a_browser_is_missed(scene):
    viewer = Viewer(make_session(parse_arguments([scene, "--size", "64x48"])), "127.0.0.1", 0)
    with pytest.raises(TimeoutError, match=r"no browser has opened http://127\.0\.0\.1:\d+ within"):
        viewer.window(0.1)
    viewer.close()


def test_the_benchmark_measures_the_viewer_beside_the_renderer(scene, tmp_path, capsys):
    assert main([scene, "--size", "96x64", "--benchmark", "--frames", "4", "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "benchmark.json").read_text())
    assert found["frames"] == 4 and set(found["median_s"]) == {"golden", "rest", "moving"}
    assert all(seconds > 0 for seconds in (*found["median_s"].values(), found["numbers_s"]))
    said = capsys.readouterr().out
    assert f"{found['rest_times_golden']:.2f} times the renderer's" in said and "96x64, medians of 4 frames" in said


def test_ctrl_c_ends_it_at_once_and_without_a_traceback(scene):
    process = subprocess.Popen(
        [sys.executable, "-m", "msv2", "view", scene, "--size", "64x48", "--port", "0"], cwd=ROOT, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=os.environ | {"PYTHONUNBUFFERED": "1"},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))  # a shell ignores it for what runs in the background
    for line in process.stdout:
        if "in a browser" in line:
            break
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0 and out.endswith("viewer ended\n") and "Traceback" not in err
