"""Frames through the rendering array: the command, its files, its exit status."""

import json

import numpy as np
import pytest
from PIL import Image

from golden.msv2_ref import pipeline
from spec.config import PRESETS
from spec.errors import InputError
from tb.frame import __main__ as command


def frame(text, out):
    return command.main([*text.split(), "--part", "array", "--config", "tiny", "--out", str(out)])


def test_a_frame_is_bit_exact_and_reported(tmp_path, capfd):
    assert frame("embedded --size 40x24 --gaze 5,5 --levels 4 --levels-from random --background 0.2,0.4,0.6", tmp_path) == 0
    report = json.loads((tmp_path / "frame.json").read_text())
    assert report["bit_exact"] is True and report["mismatches"] == 0 and report["stream_errors"] == []
    assert report["pixels_checked"] == 40 * 24 and report["tiles"] == 6 and report["config"] == "tiny"
    assert report["entries"] > 100 and report["ops"] >= 16 * report["tiles"] and report["cycles"] >= report["ops"]
    assert report["wall_s"] > 0 and report["cycles_per_s"] > 0 and report["gaze"] == [5, 5] and report["levels"] == 4
    picture = np.asarray(Image.open(tmp_path / "frame.png"))
    assert picture.shape == (24, 40, 3) and picture.std() > 5
    assert "bit-exact" in capfd.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {"frame.json", "frame.png", "sim"}


def test_a_single_pixel_that_differs_fails(tmp_path, monkeypatch, capfd):
    render = pipeline.render

    def render_wrongly(*args, **kwargs):
        result = render(*args, **kwargs)
        result.pixels.colour[1, 2, 3, 0] += 1
        return result

    monkeypatch.setattr(pipeline, "render", render_wrongly)
    assert frame("embedded --size 32x16", tmp_path) == 1
    report = json.loads((tmp_path / "frame.json").read_text())
    assert report["bit_exact"] is False and report["mismatches"] == 1
    assert [report["first_mismatches"][0][key] for key in ("field", "x", "y")] == ["colour", 19, 2]
    assert "NOT bit-exact: 1 values differ" in capfd.readouterr().out


@pytest.mark.long
@pytest.mark.data
@pytest.mark.parametrize("gaze", [(), ("--gaze", "100,60", "--levels", "4", "--levels-from", "random")])
def test_truck_is_bit_exact_in_the_array_of_paper_small(data_dir, tmp_path, gaze):
    scene = str(data_dir / "trained" / "truck.splat")
    options = ["--size", "256x144", *gaze, "--part", "array", "--config", "paper_small", "--out", str(tmp_path)]
    assert command.main([scene, *options]) == 0
    report = json.loads((tmp_path / "frame.json").read_text())
    assert report["cycles"] < 1.5 * report["entries"] and report["cycles_per_s"] > 1000


@pytest.mark.long
@pytest.mark.parametrize("preset", PRESETS)
def test_presets_are_bit_exact(tmp_path, preset):
    options = ["--size", "64x64", "--gaze", "20,30", "--levels", "4", "--levels-from", "random", "--machine", "full",
               "--config", preset]
    assert command.main(["embedded", *options, "--out", str(tmp_path)]) == 0
    report = json.loads((tmp_path / "frame.json").read_text())
    assert report["bit_exact"] and report["counter_errors"] == report["stream_errors"] == [] and report["entries"] > 5000


@pytest.mark.long
@pytest.mark.data
def test_truck_is_bit_exact_on_a_preset(data_dir, tmp_path):
    scene = str(data_dir / "trained" / "truck.splat")
    assert command.main([scene, "--size", "128x72", "--machine", "full", "--config", "fast", "--out", str(tmp_path)]) == 0
    assert json.loads((tmp_path / "frame.json").read_text())["entries"] > 50_000


@pytest.mark.parametrize(("argv", "says"), [
    (["embedded", "--config", "huge"], r"'huge' is not accepted: choose one of tiny, default, paper, v3, precise, "),
    (["embedded", "--config", "tiny", "--size", "0x10"], "'0x10'"),
    (["embedded", "--config", "tiny", "--size", "600x10"], "600x10"),
    (["embedded", "--config", "tiny", "--wave-cycles", "a:b", "--waves"], "'a:b'"),
    (["embedded", "--part", "half"], "'half' is not accepted: choose one of machine, array"),
    (["embedded", "--pixels", "tall"], "pixels 'tall' is not accepted: choose one of wide, display"),
    (["embedded", "--pixels", "display", "--part", "array"], "pixels 'display' is not accepted with part 'array'"),
    (["embedded", "--stereo"], r"^two eyes are not accepted: the RTL of config 'default' has no joint frames; .*'v3_eyes'"),
    (["embedded", "--part", "array", "--config", "v3"], "part 'array' is not accepted: config 'v3' has lists by super-tile"),
    (["embedded", "--stereo", "--pixels", "wide"], "part 'machine', pixels 'wide' are not accepted with --stereo"),
    (["embedded", "--stereo", "--part", "array"], "part 'array', pixels 'display' are not accepted with --stereo"),
    (["embedded", "--ecc-thresh", "18"], "--ecc-thresh 18.0 is not accepted without --stereo"),
    (["embedded", "--stereo", "--source", "both"], "source eye 'both' is not accepted"),
    (["embedded", "--merge", "2"], "merge '2' is not accepted: 0 or 1 is"),
    (["embedded", "--pipeline", "yes"], "pipeline 'yes'"),
    (["embedded", "--beta", "-1"], r"beta '-1' is not accepted: 0..16777215 or 'auto' are"),
    (["embedded", "--bandwidth", "fast"], "bandwidth 'fast'"),
    (["embedded", "--bandwidth", "0"], "bandwidth '0'"),
    (["embedded", "--latency", "0"], "latency 0"),
    (["no/such/scene.ply", "--config", "tiny"], "no/such/scene.ply"),
])
def test_bad_requests_name_what_is_accepted(argv, says, tmp_path):
    with pytest.raises(InputError, match=says):
        command.main([*argv, "--out", str(tmp_path)])
    assert list(tmp_path.iterdir()) == []
