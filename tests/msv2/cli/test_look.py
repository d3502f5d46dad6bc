"""The contact sheet: eight pictures, numbers that bring them back, and what is refused."""

import json

import numpy as np
import pytest
from PIL import Image

from golden.render import main as render
from golden.scenes.save import save_model
from msv2.cli.main import main
from spec.errors import InputError
from tests.helpers.standing_models import box_on_ground, sign


@pytest.fixture(scope="module")
def sheet(tmp_path_factory):
    """The folder of a sheet of a box on the ground, from a PLY that states no up."""
    folder = tmp_path_factory.mktemp("look")
    model = box_on_ground()
    model.sh_dc[:] = np.random.default_rng(1).normal(size=model.sh_dc.shape)
    save_model(model, folder / "box.ply")
    assert main(["look", str(folder / "box.ply"), "--size", "160x90", "--out", str(folder)]) == 0
    return folder


def picture(folder, index):
    """One picture of a sheet of 160x90."""
    x, y = index % 4 * 160, 44 + index // 4 * (90 + 38)
    return np.asarray(Image.open(folder / "look.png"))[y : y + 90, x : x + 160]


def test_eight_pictures_with_their_numbers(sheet):
    found = json.loads((sheet / "look.json").read_text())
    assert len(found["cameras"]) == 8 and found["orientation"]["axis"] == "+z"
    assert all(picture(sheet, i).std() > 5 for i in range(8))
    best = {camera["title"]: camera for camera in found["cameras"]}
    assert best["default"]["contained"] > 0.95 and best["whole"]["contained"] > 0.95
    assert all(camera["obstruction"] < 0.2 and camera["coverage"] > 0.2 for camera in found["cameras"])


@pytest.mark.parametrize("index", [0, 6])
def test_the_numbers_bring_a_picture_back(sheet, tmp_path, index):
    options = json.loads((sheet / "look.json").read_text())["cameras"][index]["options"].split()
    render([str(sheet / "box.ply"), "--size", "160x90", *options, "--out", str(tmp_path)])
    again = np.asarray(Image.open(tmp_path / "frame.png")).astype(float)
    assert np.abs(again - picture(sheet, index)).mean() < 2  # the numbers have five digits


def test_an_unsure_up_stands_on_the_sheet(tmp_path, capsys):
    save_model(sign(2, "ply"), tmp_path / "sign.ply")
    main(["look", str(tmp_path / "sign.ply"), "--size", "64x36", "--out", str(tmp_path)])
    assert "try --up" in capsys.readouterr().out
    main(["look", str(tmp_path / "sign.ply"), "--size", "64x36", "--up", "-x", "--out", str(tmp_path)])
    found = json.loads((tmp_path / "look.json").read_text())
    assert found["orientation"]["axis"] == "-x" and all("--up -x" in camera["options"] for camera in found["cameras"])


@pytest.mark.parametrize("argv", [["--camera", "3"], ["--orbit", "0,0,1"], ["--size", "8"], ["--up", "w"]])
def test_what_makes_no_sense_is_refused(argv):
    with pytest.raises(InputError, match="not accepted"):
        main(["look", "embedded", *argv])
