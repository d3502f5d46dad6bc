"""Films: paths of camera and gaze, the strip of numbers, formats, and taking up an interrupted run."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from golden.scenes.camera_file import camera_text, save_camera
from golden.scenes.orbit import look_at
from msv2.video import command
from msv2.video.caption import captioned
from msv2.video.film import parse_formats, write_film
from msv2.video.path import camera_path, orbit_path, read_gazes, through, wandering_gaze
from spec.errors import InputError

UP = np.array([0.0, 0.0, 1.0])
FIRST = look_at(np.array([4.0, 0.0, 2.0]), np.zeros(3), UP, 64, 48, 60.0)
DISTANCE = float(np.linalg.norm(FIRST.position))


def test_an_orbit_keeps_its_distance_and_looks_at_its_middle():
    """A whole turn: every camera stays upright, as far from the middle, and at the same height; the first is the given one."""
    cameras = orbit_path(FIRST, UP, DISTANCE, 360, 8)
    assert np.allclose(cameras[0].rotation, FIRST.rotation) and np.allclose(cameras[0].position, FIRST.position)
    for number, camera in enumerate(cameras):
        assert np.isclose(np.linalg.norm(camera.position), DISTANCE) and np.isclose(camera.position[2], 2)
        assert np.allclose(camera.rotation @ -camera.position / DISTANCE, [0, 0, 1]) and (camera.rotation @ UP)[1] < 0
        angle = np.degrees(np.arctan2(camera.position[1], camera.position[0])) % 360
        assert np.isclose((angle - 45 * number + 180) % 360, 180)


def test_a_swing_comes_back():
    """A smaller angle goes to both sides by half of it and ends where it began."""
    angles = [np.degrees(np.arctan2(c.position[1], c.position[0])) for c in orbit_path(FIRST, UP, DISTANCE, 40, 8)]
    assert np.allclose(angles[0], 0) and np.isclose(max(angles), 20) and np.isclose(min(angles), -20)
    assert np.isclose(angles[1], -angles[-1])


def test_a_path_reaches_its_keys():
    """Keys are reached at even spaces of time with rotation, position and focal length; between them nothing overshoots."""
    keys = orbit_path(FIRST, UP, DISTANCE, 360, 5)[:3]
    keys[1] = replace(keys[1], fx=2 * keys[1].fx)
    cameras = through(keys, 9)
    for key, at in zip(keys, (0, 4, 8), strict=True):
        assert np.allclose(cameras[at].rotation, key.rotation) and np.allclose(cameras[at].position, key.position)
        assert np.isclose(cameras[at].fx, key.fx)
    assert all(keys[0].fx <= camera.fx <= keys[1].fx for camera in cameras)
    assert all(np.allclose(camera.rotation @ camera.rotation.T, np.eye(3)) for camera in cameras)
    assert through(keys[:1], 2) == [keys[0]] * 2


def test_cameras_and_gazes_of_a_file_and_of_a_folder(tmp_path):
    """A list in one file and a folder of exported files are the same path; gazes come along, scaled to the film's size."""
    keys = orbit_path(FIRST, UP, DISTANCE, 360, 4)[:2]
    gazes = [(8.0, 12.0), (32.0, 24.0)]
    for number, (key, gaze) in enumerate(zip(keys, gazes, strict=True)):
        (tmp_path / "cameras").mkdir(exist_ok=True)
        save_camera(key, tmp_path / "cameras" / f"{number}.json", gaze)
    entries = [json.loads(camera_text(key, gaze)) for key, gaze in zip(keys, gazes, strict=True)]
    (tmp_path / "path.json").write_text(json.dumps({"cameras": entries}))
    small = FIRST.resized(32, 24)
    listed, filed = (camera_path(str(tmp_path / name), 3, small, UP, DISTANCE, 0) for name in ("path.json", "cameras"))
    assert [step.gaze for step in listed] == [(4.0, 6.0), (10.0, 9.0), (16.0, 12.0)] == [step.gaze for step in filed]
    assert all(np.array_equal(a.camera.rotation, b.camera.rotation) for a, b in zip(listed, filed, strict=True))
    assert {(step.camera.width, step.camera.height) for step in listed} == {(32, 24)}


@pytest.mark.parametrize(("content", "part"), [
    ('{"cameras": []}', "has no camera"), ('{"views": []}', "is not a list of cameras"), ('{"cameras": [1]}', "is not a list"),
    ('{"cameras": [{"rotation": 1}]}', "rotation is 1")])
def test_bad_camera_paths_are_refused(tmp_path, content, part):
    """The message names the file and what is accepted."""
    (tmp_path / "path.json").write_text(content)
    with pytest.raises(InputError, match=part):
        camera_path(str(tmp_path / "path.json"), 3, FIRST, UP, DISTANCE, 0)


def test_a_gaze_path_is_interpolated(tmp_path):
    """Shares of frame and time become pixels and frames; the right edge stays inside the frame."""
    (tmp_path / "gaze.csv").write_text("time,x,y\n0,0,0\n0.5,1,0.5\n1,1,1\n")
    gazes = read_gazes(tmp_path / "gaze.csv", 100, 50, 5)
    assert np.allclose(gazes, [(0, 0), (50, 12.5), (100, 25), (100, 37.5), (100, 50)], atol=2e-3)
    assert all(x < 100 and y < 50 for x, y in gazes)
    assert all(0 <= x < 100 and 0 <= y < 50 for x, y in wandering_gaze(100, 50, 30))


@pytest.mark.parametrize(("content", "part"), [
    ("time,x\n0,1\n", "has the header time,x,y"), ("time,x,y\n", "one row or more"), ("time,x,y\n0,2,0\n", "line 2"),
    ("time,x,y\n0,0,0\n0,1,1\n", "line 3: time 0 does not rise"), ("time,x,y\n0,a,0\n", "three numbers in 0..1")])
def test_bad_gaze_paths_are_refused(tmp_path, content, part):
    """The message names the line."""
    (tmp_path / "gaze.csv").write_text(content)
    with pytest.raises(InputError, match=part):
        read_gazes(tmp_path / "gaze.csv", 10, 10, 3)


@pytest.mark.parametrize("width", (64, 191, 640, 1280))
def test_the_strip_leaves_the_picture_as_it_is(width):
    """The frame's pixels are unchanged, the strip holds letters, and the size is even in both directions."""
    image = np.random.default_rng(0).integers(0, 256, (37, width, 3), np.uint8)
    picture = captioned(image, [("1/48", "frame"), ("123,456", "intersections"), ("9,999", "frames/s")])
    assert np.array_equal(picture[:37, :width], image)
    assert picture.shape[0] % 2 == 0 == picture.shape[1] % 2 and picture[40:].max() > 200


def test_formats(monkeypatch):
    """Unknown formats and MP4 without ffmpeg are refused; without a choice, MP4 comes where ffmpeg is found."""
    assert parse_formats("GIF,webp,gif") == ("gif", "webp")
    with pytest.raises(InputError, match="'avi' is not accepted"):
        parse_formats("avi")
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert parse_formats(None) == ("webp",)
    with pytest.raises(InputError, match="apt install ffmpeg"):
        parse_formats("webp,mp4")
    monkeypatch.setattr(shutil, "which", lambda name: "/usr/bin/" + name)
    assert parse_formats(None) == ("webp", "mp4")


@pytest.mark.parametrize("form", ("gif", "webp", "mp4"))
def test_a_film_holds_its_pictures(tmp_path, form):
    """As many frames as pictures, in their order, at the frame rate."""
    if form == "mp4" and not shutil.which("ffmpeg"):
        pytest.skip("ffmpeg is missing: apt install ffmpeg")
    for number in range(3):
        Image.fromarray(np.full((32, 48, 3), 40 + 80 * number, np.uint8)).save(tmp_path / f"{number}.png")
    write_film(tmp_path / f"film.{form}", [tmp_path / f"{number}.png" for number in range(3)], 10, 90)
    if form == "mp4":
        assert b"ftyp" in (tmp_path / "film.mp4").read_bytes()[:16]
        return
    film = Image.open(tmp_path / f"film.{form}")
    assert film.n_frames == 3
    for number in range(3):
        film.seek(number)
        assert np.abs(np.asarray(film.convert("RGB"), int) - (40 + 80 * number)).max() < 6
        assert film.info["duration"] == 100


def test_a_film_is_taken_up_where_it_stopped(tmp_path, capsys):
    """Frames of the same request stay, a missing one is drawn anew to the same bytes, and another request draws all of them."""
    arguments = ["embedded", "--size", "64x48", "--frames", "3", "--levels", "4", "--gaze-path", "wander", "--format", "webp",
                 "--out", str(tmp_path)]
    command.main(arguments)
    pictures = sorted((tmp_path / "frames").glob("*.png"))
    told = json.loads((tmp_path / "film.json").read_text())
    assert len(pictures) == 3 == len(told["frames"]) and Image.open(tmp_path / "film.webp").n_frames == 3
    assert len({picture.read_bytes() for picture in pictures}) == 3
    assert all(row["cycles"] > 0 and row["energy_mj"] > 0 and row["intersections"] > 0 for row in told["frames"])
    kept, drawn = pictures[0].stat().st_mtime_ns, pictures[1].read_bytes()
    pictures[1].with_suffix(".json").unlink()  # as an interrupted run leaves it
    command.main(arguments)
    assert pictures[0].stat().st_mtime_ns == kept and pictures[1].read_bytes() == drawn
    assert json.loads((tmp_path / "film.json").read_text())["frames"] == told["frames"]
    command.main([*arguments, "--background", "1,0,0"])
    assert pictures[0].stat().st_mtime_ns != kept


def test_files_of_something_else_are_not_touched(tmp_path):
    """A folder of frames that no film has left is refused and stays as it is."""
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "holiday.png").write_bytes(b"mine")
    with pytest.raises(InputError, match="it holds files of something else"):
        command.main(["embedded", "--size", "64x48", "--frames", "1", "--out", str(tmp_path)])
    assert (tmp_path / "frames" / "holiday.png").read_bytes() == b"mine"


@pytest.mark.parametrize(("option", "part"), [
    (("--frames", "0"), "frames 0"), (("--fps", "0"), "fps 0"), (("--sweep", "400"), "sweep 400"),
    (("--show", "level"), "levels"),
    (("--quality", "0"), "quality 0"), (("--memory", "ddr"), "memory 'ddr'")])
def test_bad_options_are_refused(option, part):
    """The message names the value, before any frame is drawn."""
    with pytest.raises(InputError, match=part):
        command.main(["embedded", "--size", "64x48", *option])
