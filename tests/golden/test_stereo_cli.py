"""Two eyes as a user meets them: golden/render.py --stereo."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from golden.render import main
from golden.scenes.camera_file import save_camera
from golden.scenes.save import save_model
from spec.errors import InputError, run_command_line
from tests.helpers.golden_samples import random_model, splats, view

SHARES = {"rendered", "rerendered", "warped", "background", "filled", "tiles_foveal", "tiles_rerendered"}


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    """A small model, as PLY: its units are unknown."""
    path = tmp_path_factory.mktemp("scene") / "cloud.ply"
    save_model(random_model(np.random.default_rng(2), 500), path)
    return path


def render(*argv: object) -> None:
    main([str(a) for a in argv])


def picture(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path))


def test_files_and_statistics(tmp_path, capsys):
    render("embedded", "--stereo", "--ecc-thresh", 27, "--size", "96x54", "--out", tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {
        "left.png", "right.png", "right_source.png", "anaglyph.png", "depth.png", "levels.png", "stats.json"}
    left, right, both = (picture(tmp_path / f"{name}.png") for name in ("left", "right", "anaglyph"))
    assert left.shape == right.shape == (54, 96, 3) and not np.array_equal(left, right)
    assert np.array_equal(both[..., 0], left[..., 0]) and np.array_equal(both[..., 1:], right[..., 1:])
    stats = json.loads((tmp_path / "stats.json").read_text())["stereo"]
    assert set(stats["shares"]) == SHARES and stats["warnings"] == []  # the embedded scene is in metres
    assert sum(stats["shares"][name] for name in SHARES if not name.startswith("tiles")) == pytest.approx(1)
    assert stats["ipd_metres"] == 0.063 and stats["baseline"] == pytest.approx(0.063) and stats["ecc_thresh_deg"] == 27
    assert stats["gaze"]["left"] == [48, 27] and stats["gaze"]["right"][0] < 48
    rendered = stats["shares"]["tiles_foveal"] + stats["shares"]["tiles_rerendered"]
    assert stats["events"]["target_tiles"] == round(rendered * 24)
    assert "rerendered" in capsys.readouterr().out
    render("embedded", "--size", "96x54", "--out", tmp_path / "mono")
    assert np.array_equal(picture(tmp_path / "mono" / "frame.png"), left)


def test_the_right_eye_as_the_source(tmp_path):
    render("embedded", "--stereo", "--source", "right", "--size", "96x54", "--gaze", "20,20", "--gaze-right", "30,25",
           "--out", tmp_path)
    stats = json.loads((tmp_path / "stats.json").read_text())
    assert stats["stereo"]["gaze"] == {"left": [20, 20], "right": [30, 25]} and (tmp_path / "left_source.png").exists()
    render("embedded", "--size", "96x54", "--gaze", "30,25", "--out", tmp_path / "mono")
    assert np.array_equal(picture(tmp_path / "mono" / "frame.png"), picture(tmp_path / "right.png"))


def test_unknown_units_are_warned_of(scene, tmp_path, capsys):
    render(scene, "--stereo", "--size", "64x48", "--out", tmp_path)
    assert "1 unit per metre is assumed" in capsys.readouterr().err
    assert "unknown" in json.loads((tmp_path / "stats.json").read_text())["stereo"]["warnings"][0]
    render(scene, "--stereo", "--units-per-metre", 2.5, "--size", "64x48", "--out", tmp_path)
    assert "assumed" not in capsys.readouterr().err
    assert json.loads((tmp_path / "stats.json").read_text())["stereo"]["baseline"] == pytest.approx(2.5 * 0.063)


def test_a_gaze_that_leaves_the_other_eyes_frame_is_clamped_and_said(tmp_path, capsys):
    render("embedded", "--stereo", "--size", "96x54", "--gaze", "0,30", "--out", tmp_path)
    assert "off-screen in the target eye" in capsys.readouterr().err
    assert json.loads((tmp_path / "stats.json").read_text())["stereo"]["gaze"]["right"] == [0, 30]


@pytest.mark.parametrize(("z", "step", "scale", "opacity", "ipd", "warning"), [
    (4.0, 1.0, 0.9, 0.02, 0.063, "no pixel of the source eye has a depth"),
    (1.0, 0.25, 0.2, 0.99, 5, "have disparities wider than the frame's 64 pixels")])
def test_sources_that_nothing_can_be_warped_of_are_said(tmp_path, capsys, z, step, scale, opacity, ipd, warning):
    places = ((x * step, y * step, z) for x in range(-6, 7) for y in range(-5, 6))
    save_model(splats(*places, scale=scale, opacity=opacity), tmp_path / "wall.ply")
    save_camera(view(64, 48), tmp_path / "view.json")
    asked = (tmp_path / "wall.ply", "--camera", tmp_path / "view.json", "--out")
    render(*asked, tmp_path / "out", "--stereo", "--units-per-metre", 1, "--ipd", ipd, "--ecc-thresh", 0)
    assert warning in capsys.readouterr().err
    stats = json.loads((tmp_path / "out" / "stats.json").read_text())["stereo"]
    assert warning in "".join(stats["warnings"]) and stats["shares"]["tiles_rerendered"] == 1
    render(*asked, tmp_path / "mono")
    assert np.array_equal(picture(tmp_path / "mono" / "frame.png"), picture(tmp_path / "out" / "left.png"))


def test_bad_input_ends_with_status_2_and_a_line(scene, tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        run_command_line(lambda: render(scene, "--stereo", "--ipd", "0", "--out", tmp_path / "out"))
    assert end.value.code == 2 and capsys.readouterr().err == "error: IPD 0.0 is not accepted: a positive number is\n"


@pytest.mark.parametrize(("argv", "named"), [
    (["--ipd", "0"], "IPD 0.0"), (["--ipd", "-0.06"], "IPD -0.06"), (["--ipd", "nan"], "IPD nan"),
    (["--units-per-metre", "0"], "units per metre 0.0"), (["--units-per-metre", "inf"], "units per metre inf"),
    (["--ecc-thresh", "-1"], "-1.0"), (["--ecc-thresh", "181"], "181.0"), (["--source", "middle"], "'middle'"),
    (["--gaze-right", "65,5"], "gaze 65,5 of the right (target) eye is off-screen"), (["--gaze-right", "1"], "'1'"),
    (["--gaze", "65,5"], "65.0,5.0"), (["--source", "right", "--gaze", "99,5", "--gaze-right", "5,5"], "left (target)"),
])
def test_bad_requests_name_the_value_and_write_nothing(scene, tmp_path, argv, named):
    with pytest.raises(InputError) as error:
        render(scene, "--stereo", "--size", "64x48", *argv, "--out", tmp_path / "out")
    assert named in str(error.value) and not (tmp_path / "out").exists()


@pytest.mark.parametrize("argv", [["--ipd", "0.06"], ["--ecc-thresh", "20"], ["--source", "right"], ["--gaze-right", "3,3"],
                                  ["--units-per-metre", "1"]])
def test_options_of_two_eyes_need_stereo(scene, tmp_path, argv):
    with pytest.raises(InputError, match=f"^{argv[0]} .* is not accepted without --stereo$"):
        render(scene, "--size", "64x48", *argv, "--out", tmp_path / "out")


def test_both_eyes_of_a_machine_with_super_tiles(tmp_path, capsys):
    arguments = ("embedded", "--stereo", "--config", "v3", "--size", "96x54", "--gaze", "48,27", "--levels", 4)
    render(*arguments, "--out", tmp_path / "own")
    assert "the RTL of config 'v3' renders one eye" in capsys.readouterr().out
    assert {p.name for p in (tmp_path / "own").iterdir()} == {
        "left.png", "right.png", "anaglyph.png", "depth.png", "levels.png", "stats.json"}
    left, right, both = (picture(tmp_path / "own" / f"{name}.png") for name in ("left", "right", "anaglyph"))
    assert not np.array_equal(left, right)
    assert np.array_equal(both[..., 0], left[..., 0]) and np.array_equal(both[..., 1:], right[..., 1:])
    stats = json.loads((tmp_path / "own" / "stats.json").read_text())
    assert stats["stereo"]["joint"] and stats["stereo"]["gaze"]["right"][0] < 48 and stats["stereo"]["warnings"] == []
    assert stats["stereo"]["pairs"] > 0 and stats["effects"]["effects"]["stereo"]["state"] == "absent"
    render("embedded", "--config", "v3", "--size", "96x54", "--gaze", "48,27", "--levels", 4, "--out", tmp_path / "mono")
    assert np.array_equal(picture(tmp_path / "mono" / "frame.png"), left)
    render(*arguments, "--eye-colours", "shared", "--out", tmp_path / "one")
    assert np.array_equal(picture(tmp_path / "one" / "left.png"), left)
    assert not np.array_equal(picture(tmp_path / "one" / "right.png"), right)


def test_a_warped_eye_of_a_machine_with_super_tiles(tmp_path, capsys):
    arguments = ("embedded", "--stereo", "--size", "96x54", "--gaze", "48,27", "--levels", 4)
    for name, more in (("whole", ("--config", "v3_eyes")), ("warped", ("--config", "v3_eyes_warp", "--ecc-thresh", 10)),
                       ("holes", ("--config", "v3_eyes_warp", "--ecc-thresh", 10, "--second-sweep", "off"))):
        render(*arguments, *more, "--out", tmp_path / name)
    assert "holes " in capsys.readouterr().out
    assert {p.name for p in (tmp_path / "warped").iterdir()} == {
        "left.png", "right.png", "right_source.png", "anaglyph.png", "depth.png", "levels.png", "stats.json"}
    left, right = ({name: picture(tmp_path / name / f"{eye}.png") for name in ("whole", "warped", "holes")}
                   for eye in ("left", "right"))
    assert np.array_equal(left["whole"], left["warped"]) and np.array_equal(left["whole"], left["holes"])
    assert not np.array_equal(right["whole"], right["warped"]) and not np.array_equal(right["warped"], right["holes"])
    stats = {name: json.loads((tmp_path / name / "stats.json").read_text())["stereo"] for name in ("whole", "warped", "holes")}
    assert stats["warped"]["pairs"] == stats["whole"]["pairs"] == stats["holes"]["pairs"]
    assert stats["warped"]["shares"]["tiles_rerendered"] > 0 == stats["warped"]["shares"]["holes"]
    assert stats["holes"]["shares"]["holes"] > 0 == stats["holes"]["events"]["pairs_again"]
    assert stats["warped"]["events"]["pairs_again"] > 0 and stats["warped"]["ecc_thresh_deg"] == 10


@pytest.mark.parametrize(("arguments", "message"), [
    (("--config", "v3", "--ecc-thresh", 20), "--ecc-thresh 20 is not accepted: this machine renders both eyes whole; configs"),
    (("--config", "paper", "--eye-colours", "own"), "--eye-colours own is not accepted where the second eye is warped"),
    (("--config", "paper", "--second-sweep", "on"), "--second-sweep on is not accepted where no eye of a joint frame is"),
    (("--config", "v3_eyes", "--second-sweep", "off"), "--second-sweep off is not accepted where no eye of a joint frame"),
    (("--config", "v3_eyes_warp", "--second-sweep", "1"), "second sweep '1' is not accepted: choose one of on, off"),
    (("--config", "v3_eyes_warp", "--ecc-thresh", "-1"), "eccentricity threshold -1.0 is not accepted"),
    (("--config", "v3", "--eye-colours", "red"), "eye colours 'red' are not accepted: choose one of own, shared"),
])
def test_arguments_of_the_other_kind_of_frame_are_refused(tmp_path, arguments, message):
    with pytest.raises(InputError, match=message):
        render("embedded", "--stereo", *arguments, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()
