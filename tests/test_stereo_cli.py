"""Two eyes as a user meets them: golden/render.py --stereo and golden/metric_scale.py."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from golden_samples import random_model, splats, view
from PIL import Image

from golden import accuracy_stereo, metric_scale, stereo_rules
from golden.msv2_ref import pipeline
from golden.render import main
from golden.scenes.camera_file import save_camera
from golden.scenes.embedded import cached_embedded_model, embedded_cameras
from golden.scenes.save import save_model
from spec.config import PAPER
from spec.errors import InputError, run_command_line

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
    render("--stereo", "--ecc-thresh", 27, "--size", "96x54", "--out", tmp_path)
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
    render("--size", "96x54", "--out", tmp_path / "mono")
    assert np.array_equal(picture(tmp_path / "mono" / "frame.png"), left)


def test_the_right_eye_as_the_source(tmp_path):
    render("--stereo", "--source", "right", "--size", "96x54", "--gaze", "20,20", "--gaze-right", "30,25", "--out", tmp_path)
    stats = json.loads((tmp_path / "stats.json").read_text())
    assert stats["stereo"]["gaze"] == {"left": [20, 20], "right": [30, 25]} and (tmp_path / "left_source.png").exists()
    render("--size", "96x54", "--gaze", "30,25", "--out", tmp_path / "mono")
    assert np.array_equal(picture(tmp_path / "mono" / "frame.png"), picture(tmp_path / "right.png"))


def test_unknown_units_are_warned_of(scene, tmp_path, capsys):
    render(scene, "--stereo", "--size", "64x48", "--out", tmp_path)
    assert "1 unit per metre is assumed" in capsys.readouterr().err
    assert "unknown" in json.loads((tmp_path / "stats.json").read_text())["stereo"]["warnings"][0]
    render(scene, "--stereo", "--units-per-metre", 2.5, "--size", "64x48", "--out", tmp_path)
    assert "assumed" not in capsys.readouterr().err
    assert json.loads((tmp_path / "stats.json").read_text())["stereo"]["baseline"] == pytest.approx(2.5 * 0.063)


def test_a_gaze_that_leaves_the_other_eyes_frame_is_clamped_and_said(tmp_path, capsys):
    render("--stereo", "--size", "96x54", "--gaze", "0,30", "--out", tmp_path)
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


def test_metric_scale_is_found_from_either_kind_of_map(tmp_path, capsys):
    """A map of the embedded scene in a world 2.5 times as fine, with holes, an outlier and another resolution."""
    camera = embedded_cameras()[0].resized(96, 54)
    metric = pipeline.render(cached_embedded_model(), camera, config=PAPER).depth / 2.5
    metric = np.where(np.isfinite(metric), metric, np.nan).repeat(2, 0).repeat(2, 1)
    metric[:10] = np.nan
    metric[20, 20] = 1e6
    np.save(tmp_path / "depth.npy", metric.astype(np.float32))
    Image.fromarray(np.clip(np.nan_to_num(metric) * 1000, 0, 65535).astype(np.uint16)).save(tmp_path / "depth.png")
    for name, tolerance in (("depth.npy", 1e-6), ("depth.png", 1e-3)):
        out = tmp_path / f"{name}.json"
        metric_scale.main(["--size", "96x54", "--depth-map", str(tmp_path / name), "--out", str(out)])
        found = json.loads(capsys.readouterr().out)
        assert found == json.loads(out.read_text())
        assert found["units_per_metre"] == pytest.approx(2.5, rel=tolerance)
        assert found["metres_per_unit"] == pytest.approx(0.4, rel=tolerance) and found["pixels"] > 1000


def test_bad_depth_maps(tmp_path):
    files = {
        "flat.npy": np.zeros((54, 96)), "tall.npy": np.ones((96, 54)), "colours.npy": np.ones((54, 96, 3)),
        "words.npy": np.full((54, 96), "a"), "eight.png": np.zeros((54, 96), np.uint8)}
    for name, content in files.items():
        np.save(tmp_path / name, content) if name.endswith("npy") else Image.fromarray(content).save(tmp_path / name)
    (tmp_path / "torn.npy").write_bytes(b"no array")
    for name, words in (
        ("flat.npy", "too few"), ("tall.npy", "54x96"), ("colours.npy", "one plane"), ("words.npy", "one plane"),
        ("eight.png", "8 bits"), ("torn.npy", "cannot be read"), ("absent.npy", "cannot be read"), ("map.txt", "map.txt"),
    ):
        with pytest.raises(InputError, match=words):
            metric_scale.main(["--size", "96x54", "--depth-map", str(tmp_path / name)])


def test_the_report_of_depths(tmp_path):
    accuracy_stereo.main([str(a) for a in ("embedded", "--size", "128x72", "--views", "3", "--out", tmp_path)][1:])
    rows = json.loads((tmp_path / "accuracy_stereo.json").read_text())["rows"]
    mine = [r for r in rows if r["scene"] == "embedded"]
    assert [r["levels"] for r in mine] == [1, 4]
    assert all(0.99 < r["within_budget"] <= 1 and 0.5 < r["depth_within"] <= 1 for r in mine)
    assert (tmp_path / "accuracy_stereo.md").read_text().count("| embedded, embedded_03 |") == 2


def test_the_report_of_rules(tmp_path, monkeypatch):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path))
    monkeypatch.setattr(stereo_rules, "TRAINED", ())
    stereo_rules.main(["--size", "128x72", "--views", "3", "--out", str(tmp_path)])
    rows = json.loads((tmp_path / "stereo_rules.json").read_text())["rows"]
    assert [r["levels"] for r in rows] == [1, 4]
    for r in rows:
        again, rules = r["shares"]["tiles_rerendered"], r["rules"]
        built = rules[PAPER.warp_fill]
        assert built["rerendered"] == again <= rules["interior"]["rerendered"]
        assert rules["majority, veiled"]["rerendered"] <= again and built["filled"] == pytest.approx(r["shares"]["filled"])
        assert (built["psnr_warped_db"] is None) == (again + r["shares"]["tiles_foveal"] == 1)
        for shares in r["causes"].values():
            assert all(0 <= cause["alone"] <= cause["any"] <= 1 for cause in shares.values())
            assert sum(cause["any"] for cause in shares.values()) >= 1 >= sum(cause["alone"] for cause in shares.values())
    whole = rows[0]["rules"]
    assert whole["majority"]["rerendered"] < whole["interior"]["rerendered"]
    assert whole["rendered"]["hvsq_level_1"] == 0 < whole["majority"]["hvsq_pair"] == whole["majority"]["hvsq_level_1"]
    assert whole["majority"]["psnr_target_db"] > whole["majority"]["psnr_warped_db"] > 20
    assert rows[1]["rules"]["majority"]["hvsq_pair"] < rows[1]["rules"]["rendered"]["hvsq_level_1"]
    assert (tmp_path / "stereo_rules.md").read_text().count("| embedded, embedded_03 |") == 6
