"""The camera's options: what they choose, what they record, and what they refuse."""

import argparse
from dataclasses import replace

import numpy as np
import pytest

from golden.scenes.camera_file import save_camera
from golden.scenes.camera_options import add_camera_arguments, choose_camera, parse_orbit, parse_up
from golden.scenes.embedded.scene import cached_embedded_model
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.load import TRAINED, Scene, load_scene
from golden.scenes.orbit import orbit_camera
from golden.scenes.request import parse_request
from golden.scenes.standpoint import standpoint_of
from spec.errors import InputError
from tests.helpers.standing_models import box_on_ground, sign

SIZE = (64, 36)
PLAIN = Scene(box_on_ground())
PHOTOGRAPHED = Scene(PLAIN.model, tuple(
    replace(camera, name=f"images/DSC_{i:04}.JPG") for i, camera in enumerate(embedded_cameras(200, 100, 5))))


def chosen(scene, *argv, size=SIZE):
    parser = argparse.ArgumentParser()
    add_camera_arguments(parser)
    return choose_camera(parser.parse_args(argv), scene, size)


def same(a, b):
    return all(np.array_equal(getattr(a, key), value) for key, value in vars(b).items() if key != "name")


def test_without_a_name_the_scene_is_framed_and_the_record_brings_it_back():
    camera, record = chosen(PLAIN)
    assert record["orientation"]["axis"] == "+z" and 0 < record["orientation"]["confidence"] <= 1
    assert record["standpoint"]["seen"] > 0.5 and record["standpoint"]["obstruction"] < 0.1
    again, told = chosen(PLAIN, "--orbit", record["standpoint"]["orbit"])
    np.testing.assert_allclose(again.position, camera.position, atol=1e-3)
    np.testing.assert_allclose(again.rotation, camera.rotation, atol=1e-3)
    assert told["standpoint"]["orbit"] == record["standpoint"]["orbit"]


def test_the_benchmarks_orbit_keeps_its_cameras():
    for name, index in (("orbit", 0), ("0", 0), ("5", 5)):
        camera, record = chosen(PLAIN, "--camera", name)
        assert same(camera, orbit_camera(PLAIN.model, index, 8, *SIZE)) and record == {}


def test_programs_that_name_no_camera_get_the_orbit():
    assert parse_request("embedded").camera == "orbit"


def test_the_embedded_scene_keeps_its_own_first_camera():
    scene = Scene(cached_embedded_model(), tuple(embedded_cameras()))
    for argv in ((), ("--camera", "orbit"), ("--camera", "0")):
        assert same(chosen(scene, *argv)[0], embedded_cameras()[0].resized(*SIZE))


def test_the_trained_scene_shows_as_much_in_width_and_nothing_is_stretched():
    camera, _ = chosen(load_scene(TRAINED))
    wide = embedded_cameras(*SIZE)[0]
    assert same(camera, replace(wide, name=camera.name))
    assert camera.fx == camera.fy and same(chosen(load_scene(TRAINED), size=None)[0], embedded_cameras()[0])


def test_a_scene_with_cameras_shows_its_first_of_moderate_size():
    large = Scene(PLAIN.model, (embedded_cameras(4000, 3000, 1)[0],))
    assert (chosen(large, size=None)[0].width, chosen(large, size=None)[0].height) == (640, 480)
    camera, _ = chosen(PHOTOGRAPHED)
    assert camera.fx == camera.fy and np.array_equal(camera.rotation, PHOTOGRAPHED.cameras[0].rotation)


@pytest.mark.parametrize("name", ["images/DSC_0003.JPG", "DSC_0003.JPG", "dsc_0003"])
def test_names_of_photographs(name):
    assert same(chosen(PHOTOGRAPHED, "--camera", name)[0], PHOTOGRAPHED.cameras[3].resized(*SIZE))


def test_an_unknown_name_is_refused_with_the_nearest():
    with pytest.raises(InputError, match=r"camera 'DSD_0002.JPG' is not accepted: .*did you mean 'images/DSC_0002.JPG'"):
        chosen(PHOTOGRAPHED, "--camera", "DSD_0002.JPG")


def test_a_file_is_still_a_camera(tmp_path):
    camera = orbit_camera(PLAIN.model, 3, 8, *SIZE)
    save_camera(camera, tmp_path / "own.json")
    for scene in (PLAIN, PHOTOGRAPHED):
        assert same(chosen(scene, "--camera", str(tmp_path / "own.json"), size=None)[0], camera)


@pytest.mark.parametrize("up", ["-y", "+y", "y", "-z", "+x", "-x"])
def test_up_is_obeyed(up):
    camera, record = chosen(PLAIN, "--up", up, "--orbit", "-30,20,4")
    axis = parse_up(up)
    assert record["orientation"]["source"] == "option" and record["orientation"]["axis"].endswith(up[-1])
    assert camera.rotation[1] @ axis < -0.9 and abs(camera.rotation[0] @ axis) < 1e-9


def test_orbit_look_at_and_fov_are_obeyed():
    camera, _ = chosen(PLAIN, "--orbit", "-30,-10,4", "--look-at", "-1,0.5,0.25", "--fov", "90", "--up", "+z")
    point = standpoint_of(camera, np.array([-1, 0.5, 0.25]), np.array([0.0, 0, 1]))
    assert (point.azimuth_deg, point.elevation_deg, point.distance, point.fov_deg) == pytest.approx((330, -10, 4, 90))


def test_look_at_alone_frames_that_point():
    camera, _ = chosen(PLAIN, "--look-at", "1,0,0")
    np.testing.assert_allclose((camera.rotation @ [1, 0, 0] + camera.translation)[:2], 0, atol=1e-9)


def test_fov_changes_a_photographs_camera():
    camera, _ = chosen(PHOTOGRAPHED, "--camera", "1", "--fov", "90", size=None)
    assert camera.fx == pytest.approx(100)


def test_an_unsure_up_is_told(capsys):
    chosen(Scene(sign(2, "sog")))
    assert "confidence" in (text := capsys.readouterr().err) and "--up" in text
    chosen(PLAIN)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("argv", "says"), [
    (["--up", "up"], "up 'up' is not accepted: choose one of auto, +x, -x"), (["--up", "-w"], "up"),
    (["--orbit", "1,2"], "orbit '1,2' is not accepted"), (["--orbit", "0,91,1"], "-90..90"), (["--orbit", "0,0,0"], "above 0"),
    (["--orbit", "0,nan,1"], "3 numbers"), (["--look-at", "1,2,x"], "look-at '1,2,x'"), (["--fov", "0"], "fov 0"),
    (["--fov", "171"], "at most 170"), (["--camera", "99"], "camera 99 is not accepted: 0..7"),
    (["--camera", "orbit", "--up", "+z"], "--up is not accepted with --camera orbit"),
    (["--camera", "2", "--orbit", "0,0,1"], "--orbit is not accepted with --camera 2"),
])
def test_bad_values_are_named(argv, says):
    with pytest.raises((InputError, SystemExit)) as error:
        chosen(PLAIN, *argv)
    if isinstance(error.value, InputError):
        assert says in str(error.value)
    else:
        assert argv[1] == "-w"  # argparse takes it for an option


def test_orbits_are_three_numbers():
    assert parse_orbit("-30,20.5,1e-3") == (-30.0, 20.5, 1e-3)
