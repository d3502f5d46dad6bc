"""Which way is up: right for every axis and format where things stand on a ground, unsure where nothing tells."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from golden.scenes.embedded.scene import cached_embedded_model
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.load import load_model
from golden.scenes.orientation import AXES, LOW, axis_name, axis_vector, find_orientation
from golden.scenes.save import save_model
from tests.helpers.standing_models import box_on_ground, sign, turned


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


def to(axis: str) -> Rotation:
    """The rotation that brings +z to an axis."""
    return Rotation.align_vectors(axis_vector(axis)[None], [[0.0, 0.0, 1.0]])[0]


@pytest.mark.parametrize("source", ["ply", "spz", "sog", "splat"])
@pytest.mark.parametrize("axis", AXES)
def test_a_ground_tells_up_whatever_the_format_is_used_to(axis, source):
    """Among these is an SPZ that is not y up."""
    found = find_orientation(turned(box_on_ground(source), to(axis)))
    assert angle(found.up, axis_vector(axis)) < 5
    assert found.source == "model" and 0 < found.confidence <= 1


@pytest.mark.parametrize("seed", range(3))
def test_up_need_not_be_an_axis(seed):
    rotation = Rotation.random(random_state=seed)
    assert angle(find_orientation(turned(box_on_ground(seed=seed), rotation)).up, rotation.apply([0, 0, 1])) < 5


@pytest.mark.parametrize("source", ["ply", "spz", "sog"])
def test_a_room_whose_up_is_z(source):
    model = replace(cached_embedded_model(), up=np.array([0.0, -1.0, 0.0]), up_source=source)
    found = find_orientation(model)
    assert axis_name(found.up) == "+z" and found.confidence > LOW


@pytest.mark.parametrize("source", ["ply", "spz", "sog"])
@pytest.mark.parametrize("normal", range(3))
def test_a_sign_is_no_ground(source, normal):
    """Only the habit of the format is left, so the answer is the habit's and it is unsure."""
    found = find_orientation(sign(normal, source))
    assert axis_name(found.up) == ("+y" if source == "spz" else "-y")
    assert found.confidence < LOW and found.evidence["flat"] is True
    assert found.runner_up is not None


def test_a_ball_is_unsure():
    points = np.random.default_rng(2).normal(size=(4000, 3))
    model = replace(box_on_ground().select(np.arange(4000)), means=points)
    assert find_orientation(model).confidence < 0.9
    assert axis_name(find_orientation(model).up) == "-y"


def test_what_was_stated_counts(tmp_path):
    model = replace(turned(box_on_ground(), to("+x")), up=np.array([0.0, 1.0, 0.0]), up_source="given")
    save_model(model, tmp_path / "stated.ply")
    found = find_orientation(load_model(tmp_path / "stated.ply"))
    assert axis_name(found.up) == "+y" and found.source == "file"


def test_a_habit_stays_a_habit_in_a_copy(tmp_path):
    """An SPZ that becomes a PLY states its up with the format's name, and so is still judged."""
    model = replace(turned(box_on_ground("spz"), to("+z")), up=np.array([0.0, 1.0, 0.0]))
    save_model(model, tmp_path / "copy.ply")
    copy = load_model(tmp_path / "copy.ply")
    assert copy.up_source == "spz" and copy.up.tolist() == [0, 1, 0]
    assert axis_name(find_orientation(copy).up) == "+z"


def test_cameras_beside_the_model_decide():
    model = replace(box_on_ground("spz"), up=np.array([0.0, 1.0, 0.0]))
    found = find_orientation(model, embedded_cameras())
    assert angle(found.up, np.array([0.0, 0, 1])) < 5 and found.source == "cameras"


def test_cameras_that_look_down_and_turn_say_nothing():
    def down(azimuth):
        turn = Rotation.from_euler("z", azimuth).as_matrix()
        return replace(embedded_cameras()[0], rotation=np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]]) @ turn)

    cameras = [down(a) for a in np.linspace(0, 2 * np.pi, 9)[:-1]]
    assert find_orientation(box_on_ground(), cameras).source == "model"


def test_the_same_model_gives_the_same_answer():
    a, b = (find_orientation(box_on_ground()) for _ in range(2))
    assert a.record == b.record


def test_record_is_json_and_names_the_axis():
    record = find_orientation(turned(box_on_ground("spz"), to("-y"))).record
    assert record["axis"].startswith("-y") and record["evidence"]["format"] == "spz"


@pytest.mark.parametrize("n", [1, 2, 5])
def test_tiny_models_have_an_up(n):
    with np.errstate(all="raise", under="ignore"):
        found = find_orientation(box_on_ground().select(np.arange(n)))
    assert np.isfinite(found.up).all() and np.isfinite(found.confidence)


@pytest.mark.data
@pytest.mark.parametrize("source", ["ply", "spz", "sog"])
@pytest.mark.parametrize(("name", "up"), [("truck.splat", "-y"), ("rock_sh3", "-y"), ("garden_large", "+z")])
def test_captures(data_dir, name, up, source):
    if not name.endswith(".splat"):
        pytest.importorskip("imagecodecs")
    found = find_orientation(replace(load_model(data_dir / "trained" / name), up_source=source))
    assert angle(found.up, axis_vector(up)) < 10
