"""The camera of `--camera FILE`."""

import json

import numpy as np
import pytest

from golden.scenes.camera_file import file_gaze, load_camera, save_camera
from golden.scenes.orbit import look_at
from spec.errors import InputError

CAMERA = look_at(np.array([1.0, 2, 3]), np.zeros(3), np.array([0.0, 0, 1]), 320, 200, 55.0, near=0.1, name="mine")


def test_round_trip_is_exact(tmp_path):
    save_camera(CAMERA, tmp_path / "camera.json")
    back = load_camera(tmp_path / "camera.json")
    for key, value in vars(CAMERA).items():
        np.testing.assert_array_equal(getattr(back, key), value, err_msg=key)
    assert [p.name for p in tmp_path.iterdir()] == ["camera.json"]


def test_a_file_may_hold_the_gaze(tmp_path):
    """In pixels of its own frame; it follows the frame's size and is no part of the camera."""
    path = tmp_path / "camera.json"
    save_camera(CAMERA, path, (80.0, 150.0))
    assert file_gaze(path, CAMERA) == (80.0, 150.0)
    assert file_gaze(path, CAMERA.resized(640, 100)) == (160.0, 75.0)
    assert (load_camera(path).rotation == CAMERA.rotation).all()
    save_camera(CAMERA, path)
    assert file_gaze(path, CAMERA) is None and file_gaze("orbit", CAMERA) is None and file_gaze("3", CAMERA) is None


@pytest.mark.parametrize("gaze", [5, [1, 2, 3], ["a", "b"], [1, float("nan")]])
def test_a_gaze_that_is_none_is_named(tmp_path, gaze):
    with pytest.raises(InputError, match="gaze"):
        file_gaze(write(tmp_path, gaze=gaze), CAMERA)


def write(tmp_path, **change):
    save_camera(CAMERA, tmp_path / "camera.json")
    entry = json.loads((tmp_path / "camera.json").read_text()) | change
    (tmp_path / "camera.json").write_text(json.dumps({k: v for k, v in entry.items() if v is not ...}, default=str))
    return tmp_path / "camera.json"


def test_defaults(tmp_path):
    path = write(tmp_path)
    entry = json.loads(path.read_text())
    for key in ("cx", "cy", "near", "name"):
        del entry[key]
    path.write_text(json.dumps(entry))
    camera = load_camera(path)
    assert (camera.cx, camera.cy, camera.near, camera.name) == (160, 100, 0.2, "camera")


@pytest.mark.parametrize(("key", "value"), [
    ("width", 0), ("width", -5), ("height", 1.5), ("width", "wide"), ("fx", 0), ("fx", float("inf")), ("fy", None),
    ("near", -1), ("near", 0), ("cx", float("nan")), ("rotation", None), ("rotation", [[1, 0, 0]]),
    ("rotation", (2 * np.eye(3)).tolist()),
    ("rotation", np.diag([1, 1, -1]).tolist()), ("translation", [1, 2]), ("translation", [1, 2, float("nan")]),
    ("translation", ["a", 2, 3]), ("focal", 3), ("width", True),
])
def test_bad_entries_are_named(tmp_path, key, value):
    with pytest.raises(InputError, match="frame size" if value in (0, -5, 1.5) and key in ("width", "height") else key):
        load_camera(write(tmp_path, **{key: value}))


@pytest.mark.parametrize("data", [b"", b"{", b"[1, 2]", b"\xff\xfe"])
def test_files_that_are_no_camera(tmp_path, data):
    (tmp_path / "camera.json").write_bytes(data)
    with pytest.raises(InputError, match=r"camera\.json"):
        load_camera(tmp_path / "camera.json")


def test_missing_and_unwritable(tmp_path):
    with pytest.raises(InputError, match="absent"):
        load_camera(tmp_path / "absent.json")
    with pytest.raises(InputError, match="cannot be written"):
        save_camera(CAMERA, tmp_path / "absent" / "camera.json")
