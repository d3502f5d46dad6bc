"""The one list of scenes: where they are, and what is left out."""

from __future__ import annotations

import re

import pytest

from golden.scenes.captured import CAPTURED, captured_path, scene_argument
from msv2.studies import scenes
from msv2.studies.scenes import View
from spec.paths import ROOT, data_folder


@pytest.fixture
def data(tmp_path, monkeypatch):
    (tmp_path / "trained").mkdir()
    (tmp_path / "trained" / "truck.splat").write_bytes(b"x")
    monkeypatch.setenv("MSV2_DATA", str(tmp_path))
    return tmp_path


def test_scenes_are_found_by_their_names(data):
    assert data_folder() == data and captured_path("truck") == data / "trained" / "truck.splat"
    assert scene_argument("embedded") == "embedded" and scene_argument("rock_sh3") is None
    with pytest.raises(KeyError):
        scene_argument("truk")


def test_scenes_that_are_not_there_are_named_and_left_out(data, capsys):
    views = [View("embedded", "64x48"), View("truck", "64x48", "32,24"), View("garden_large", "64x48")]
    found = list(scenes.available(views))
    assert found == [(views[0], "embedded"), (views[1], str(data / "trained" / "truck.splat"))]
    assert capsys.readouterr().out == "skipped: garden_large (no such scene in MSV2_DATA)\n"
    assert scenes.places(views) == [str(data / "trained" / "truck.splat")]


def test_a_view_is_the_options_of_a_command():
    assert View("truck", "64x48").arguments == ("--size", "64x48")
    assert View("truck", "64x48", "3,4").arguments == (
        "--size", "64x48", "--gaze", "3,4", "--levels", "4", "--levels-from", "random")


def test_every_scene_of_every_list_is_known():
    lists = [value for name, value in vars(scenes).items() if name.isupper() and isinstance(value, tuple)]
    names = {item.scene if isinstance(item, View) else item for value in lists for item in value}
    assert names <= {"embedded", *CAPTURED, *scenes.TRAINED_HERE} and len(lists) > 8


def test_nobody_else_says_where_captured_scenes_are():
    """MSV2_DATA is read in one file."""
    rooms = ("spec", "golden", "rtl", "perf", "synth", "tb", "msv2")
    readers = [path.relative_to(ROOT).as_posix() for room in rooms for path in (ROOT / room).rglob("*.py")
               if re.search(r"environ(\.get)?[([]\s*\"MSV2_DATA", path.read_text())]
    assert readers == ["spec/paths.py"]
