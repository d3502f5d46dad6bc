"""The threshold's table: what a pose says, what is picked, scenes and their scales, the command and what it refuses."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.helpers.golden_samples import random_model

torch = pytest.importorskip("torch")
pytest.importorskip("matplotlib")

from golden.diff.gaussians import to_model  # noqa: E402
from golden.host.quantise import quantise_model  # noqa: E402
from golden.metrics.binocular import BinocularReference  # noqa: E402
from golden.metrics.hvsq import FULL_WIDTH  # noqa: E402
from golden.msv2_ref.eyes import render_request, render_stereo  # noqa: E402
from golden.scenes.embedded.views import embedded_cameras  # noqa: E402
from golden.scenes.levels import spread_levels  # noqa: E402
from golden.scenes.orbit import orbit_camera  # noqa: E402
from golden.scenes.request import resolve  # noqa: E402
from golden.scenes.save import save_model  # noqa: E402
from golden.scenes.stereo import stereo_pair  # noqa: E402
from golden.training.checkpoint import Checkpoint, Checkpoints  # noqa: E402
from golden.training.recipe import RESULTS, Recipe, plan  # noqa: E402
from golden.training.scene import load_training_scene  # noqa: E402
from msv2.studies import rtl_frame  # noqa: E402
from msv2.studies.model import study as model_study  # noqa: E402
from msv2.studies.threshold import (  # noqa: E402
    measure,
    rtl,
    scales,
    scenes,
    study,
    summary,
    text,
    v1_model,
)
from spec.errors import InputError  # noqa: E402
from spec.paths import ROOT  # noqa: E402
from tests.helpers.training_samples import small_dense  # noqa: E402

THRESHOLDS = (0.0, 18.0, 180.0)


@pytest.fixture(scope="module")
def model():
    """Small, of one level, in front of its orbit."""
    return random_model(np.random.default_rng(5), 600)


@pytest.fixture(scope="module")
def camera(model):
    return orbit_camera(model, 0, 2, 96, 64)


@pytest.fixture(scope="module")
def words(model):
    torch.set_num_threads(1)
    leveled = spread_levels(model)
    return measure.TableWords(*(quantise_model(measure.CONFIG, m) for m in (leveled, model, replace(leveled))))


@pytest.fixture(scope="module")
def pose(words, camera):
    return measure.measure_pose(words, camera, THRESHOLDS, units_per_metre=1.0)


def test_a_threshold_is_the_frame_that_the_renderer_gives(words, camera):
    pair = stereo_pair(camera, ipd_metres=0.1)
    foveation = measure._foveation(words.ours, camera, (40.0, 30.0))
    whole = render_stereo(words.ours, pair, config=measure.CONFIG, foveation=foveation, threshold_deg=180)
    for threshold in (0.0, 25.0):
        wanted = render_stereo(words.ours, pair, config=measure.CONFIG, foveation=foveation, threshold_deg=threshold)
        found = measure.at_threshold(whole, words.ours, threshold)
        assert np.array_equal(found.target_pixels, wanted.target_pixels) and np.array_equal(found.origin, wanted.origin)
        assert np.array_equal(found.target.entries.start, wanted.target.entries.start)
        assert found.events == wanted.events and found.threshold_deg == threshold
        assert measure.stereo_cycles(found) == measure.stereo_cycles(wanted) and (threshold or not found.rendered.all())


def test_a_pose(pose, words, camera):
    none, middle, everything = pose["thresholds"]
    assert none["tiles"]["foveal"] == 0 and none["entries"]["floor_share"] == 0
    assert everything["tiles"] == {"all": 24, "foveal": 24, "holes": 0, "warped": 0}
    entries = everything["entries"]
    assert entries["target"] == entries["target_if_rendered"] == pose["rendered"]["entries"]["target"]
    assert everything["hvsq"]["rendered"]["mean"] == 0 and everything["hvsq"]["dense"] == pose["rendered"]["hvsq"]["dense"]
    assert 0 < middle["tiles"]["foveal"] < 24 and sum(middle["tiles"][k] for k in ("foveal", "holes", "warped")) == 24
    for row in pose["thresholds"]:
        e, c = row["entries"], row["cycles"]
        assert e["target"] == pytest.approx((e["floor_share"] + e["holes_share"]) * e["target_if_rendered"])
        assert c["total"] == c["source"] + c["target"] == c["geometry"] + c["render"]
        assert c["overhead"] == c["total"] / (c["geometry"] + c["busiest"]) >= 1 and c["busiest"] == max(c["stages"].values())
        assert c["of_two_eyes"] == pytest.approx(c["total"] / pose["rendered"]["cycles"]["total"])
        assert row["hvsq"]["rendered"]["source"] == 0 and row["hvsq"]["dense"]["source"] == middle["hvsq"]["dense"]["source"]
    assert none["hvsq"]["rendered"]["mean"] >= middle["hvsq"]["rendered"]["mean"] > 0 and none["tiles"]["warped"] > 0
    assert pose["v1"] == pose["rendered"]  # the same model stands for v1 here


def test_hvsq_is_the_binocular_metrics(pose, words, camera):
    pair = stereo_pair(camera)
    foveation = measure._foveation(words.ours, camera, (48.0, 32.0))
    frame = render_stereo(words.ours, pair, config=measure.CONFIG, foveation=foveation, threshold_deg=18)
    dense = measure._dense(words.dense, pair)
    wanted = BinocularReference(dense, frame.gaze)(measure.eyes_of(frame))
    found = pose["thresholds"][1]["hvsq"]["dense"]
    assert (found["source"], found["target"], found["mean"]) == pytest.approx((*wanted.eyes, wanted.mean))
    assert list(frame.gaze[1]) == pose["gaze"][1] and frame.gaze[1][0] < 48


def test_cycles_are_the_machines():
    """Within 0.2 % of the frame of two eyes in reports/."""
    rows = json.loads((ROOT / "reports" / "model_rtl.json").read_text())["rows"]
    measured = next(row for row in rows if "target_cycles" in row and row["size"] == [128, 128])
    args = model_study.request(measured, "embedded")
    frame = render_request(args, resolve(args), model_study.machine(measured))
    found = measure.stereo_cycles(frame)
    assert found["stages"]["sort"] == measured["entries"]
    total = sum(measured[f"{phase}_cycles"] for phase in ("table", "geometry", "render"))  # without clearing after the reset
    assert found["total"] == pytest.approx(total, rel=2e-3)
    assert found["target"] == pytest.approx(measured["target_cycles"], rel=2e-3)
    assert found["total"] == found["source"] + found["target"] == found["geometry"] + found["render"]


def test_a_page_says_what_gave_its_cycles(pose):
    def page(*poses):
        return text.markdown([{"scene": "s", "levels": "trained levels", "points": 7, "judged_by": "it", "poses": [each],
                               "units": scales.table_scale("bonsai", None)} for each in poses], "p.png")

    kept = {name: value for name, value in pose.items() if name != "cycles_by"}  # as version 0.1 wrote them
    model, estimate = "| cycles by the model, ideal memory |", "| cycles by the golden estimate of version 0.1 |"
    assert model in page(pose) and estimate not in page(pose) and "version 0.1" not in page(pose)
    assert estimate in page(kept) and model not in page(kept)
    assert model in page(pose, kept) and estimate in page(pose, kept)


def poses_of(hvsq: dict[float, float], v1: float | None):
    row = {"entries": {"source": 10, "target": 5, "target_if_rendered": 10, "floor_share": 0.2, "holes_share": 0.3},
           "tiles": {"all": 10, "foveal": 2, "holes": 3, "warped": 5}, "warnings": [],
           "cycles": {"total": 1000, "overhead": 1.02, "of_one_eye": 1.5, "of_two_eyes": 0.8}}
    both = ("rendered", "dense")
    rows = [{**row, "threshold_deg": threshold, "hvsq": {key: {"mean": h, "source": 0, "target": 2 * h} for key in both}}
            for threshold, h in hvsq.items()]
    both = {"hvsq": {"dense": {"mean": 1e-5}}, "entries": {"source": 10, "target": 10}, "cycles": {"total": 2000}}
    return [{"camera": "c", "size": [64, 48], "median_disparity_px": 3.0, "rendered": both, "thresholds": rows,
             "v1": None if v1 is None else {**both, "hvsq": {"dense": {"mean": v1}}}}]


@pytest.mark.parametrize(("v1", "threshold", "words"), [
    (2.5e-5, 18, "18 degrees"), (9e-5, 0, "0 degrees"), (2e-5, 27, "27 degrees"), (1e-5, None, "none: at best 2.00 times"),
    (None, None, "no v1 model")])
def test_the_lowest_threshold_as_good_as_v1_is_picked(v1, threshold, words):
    poses = poses_of({33.0: 2e-5, 0.0: 4e-5, 27.0: 2e-5, 18.0: 2.5e-5}, v1)
    found = summary.picked(poses)
    assert found["threshold_deg"] == threshold and words in found["verdict"] and found["target_hvsq"] == v1
    assert summary.over_poses(poses)[0]["fps"] == 1e6 and summary.over_poses(poses)[0]["target_entries_share"] == 0.5
    page = text.markdown([{"scene": "s", "levels": "trained levels", "points": 7, "judged_by": "it", "poses": poses,
                           "units": scales.table_scale("bonsai", None)}], "p.png")
    assert found["verdict"] in page and "wheel" in page and "By the RTL" not in page


def test_scales_say_where_they_come_from():
    assert scales.table_scale("embedded", None) == {"units_per_metre": 1.0, "scale": "known", "reason": None}
    assert scales.table_scale("truck", 3.0) == {"units_per_metre": 3.0, "scale": "given", "reason": None}
    for name, reason in (("truck", "bumper"), ("nowhere", "unknown")):
        found = scales.table_scale(name, None)
        assert found["scale"] == "assumed" and reason in found["reason"]


def finished_run(folder, model, totals=(("dense", 30), ("prune", 18))):
    """A finished run of the embedded scene, of some stages, whose levels are a given model's, and its dense Gaussians."""
    run, dense = folder / "room", small_dense(500)
    run.mkdir(parents=True)
    options = {"scene": "embedded", "variant": "H", "baseline": None, "opacity-enhancement": True, "size": "32x32",
               "iterations": 60, "max-points": 1500, "seed": 0, "from": None, "device": "cpu", "gate": "psnr",
               "pooling": "blocks", "pooling-width": FULL_WIDTH}
    (run / "report.json").write_text(json.dumps({"options": options}))
    (run / "log.jsonl").touch()
    save_model(model, run / "model.ply")
    last = Checkpoint(options, totals, {"dense": dense, "prune": dense, "finetune": dense}, len(totals), None, 60, {}, 1)
    Checkpoints(run / "checkpoints", RESULTS).save(last)
    return run, dense


def test_scenes(tmp_path, model):
    leveled = spread_levels(model)
    run, dense = finished_run(tmp_path, leveled)
    found = scenes.table_scene(str(run), (64, 48), 3, None)
    assert found.name == "room" and found.levels == scenes.TRAINED and found.v1 is None and found.run == run
    assert len(found.reference) == len(dense) and found.model.levels == 4 and found.units["scale"] == "known"
    wanted = [embedded_cameras(64, 48)[i] for i in (0, 8, 16)]
    assert [c.name for c in found.cameras] == [c.name for c in wanted] and found.cameras[0].width == 64
    save_model(leveled, v1_model.make_folder(tmp_path / "room-v1") / "model.ply")
    assert scenes.table_scene(str(run / "model.ply"), (64, 48), 1, 2.0).v1 is not None
    with pytest.raises(InputError, match=r"poses 4 .* 3 views"):
        scenes.table_scene(str(run), (64, 48), 4, None)
    shutil.rmtree(run / "checkpoints")
    with pytest.raises(InputError, match="checkpoints are gone"):
        scenes.table_scene(str(run), (64, 48), 1, None)
    save_model(model, tmp_path / "truck.ply")
    plain = scenes.table_scene(str(tmp_path / "truck.ply"), (64, 48), 2, None)
    assert plain.levels == scenes.UNTRAINED and plain.model.levels == 4 and plain.reference.levels == 1
    assert plain.metres == 0.15 and len(plain.cameras) == 2 and plain.v1 is None
    assert scenes.named("a@b/c", "64x48") == ("a@b/c", (64, 48)) and scenes.named("c@80x40", "64x48") == ("c", (80, 40))


@pytest.mark.long
def test_v1s_levels_are_trained_from_the_runs_l1(tmp_path, model):
    stages = plan(Recipe("H", None, True, 60, 1500, 0), load_training_scene("embedded", (32, 32)), "cpu")
    run, dense = finished_run(tmp_path, spread_levels(model), tuple((stage.name, stage.total) for stage in stages))
    out = v1_model.train_v1(run / "model.ply", tmp_path / "work")
    assert out == tmp_path / "room-v1" / "model.ply"
    v1 = scenes.table_scene(str(run), (64, 48), 1, None).v1
    first = to_model(dense, up=v1.up, name="l1")
    assert v1.levels == 4 and len(v1) == len(dense) and np.allclose(v1.means, first.means)
    assert v1.opacity.max() <= 1 and (v1.quality_bound > 1).any()
    before = out.stat().st_mtime_ns
    assert v1_model.train_v1(run / "model.ply", tmp_path / "work") == out and out.stat().st_mtime_ns == before


def test_the_command_writes_and_goes_on(tmp_path, model, monkeypatch, capsys):
    save_model(model, tmp_path / "truck.ply")
    arguments = [str(tmp_path / "truck.ply"), "--size", "96x64", "--poses", "2", "--thresholds", "18,0", "--work",
                 str(tmp_path / "kept"), "--out", str(tmp_path / "out"), "--name", "table"]
    made = []

    def simulated(model, camera, gazes, threshold, folder, **options):
        made.append((camera.name, gazes, threshold, options["units_per_metre"]))
        eye = {"cycles": 1000}
        assert options["alone"]
        return {"stereo": {"cycles": 1800, "stereo_overhead": 1.06}, "source": eye, "target": eye}

    monkeypatch.setattr(rtl, "rtl_pose", simulated)
    assert study.main([*arguments, "--rtl", "truck", "--rtl-eyes"]) == 0
    out = capsys.readouterr()
    assert "0.15 units per metre are assumed: front bumper" in out.err and "2 of 2 poses" in out.err
    record, = json.loads((tmp_path / "out" / "table.json").read_text())["scenes"]
    assert record["units"]["scale"] == "assumed" and record["picked"]["threshold_deg"] is None and len(record["poses"]) == 2
    assert [row["threshold_deg"] for row in record["means"]] == [0, 18] and record["v1_rendered"] is None
    assert made[0][1:] == (tuple(map(tuple, record["poses"][0]["gaze"])), 18.0, 0.15)
    page = (tmp_path / "out" / "table.md").read_text()
    assert "| 1.060 | missed |" in page and "| 1.800 (RTL) | 0.900 (RTL) |" in page and page in out.out
    assert (tmp_path / "out" / "table.png").stat().st_size > 5000
    monkeypatch.setattr(measure, "measure_pose", lambda *a, **k: pytest.fail("measured again"))
    assert study.main(arguments) == 0
    again, = json.loads((tmp_path / "out" / "table.json").read_text())["scenes"]
    assert again["poses"] == record["poses"]
    monkeypatch.setattr(measure, "measure_pose", lambda *a, **k: (_ for _ in ()).throw(KeyboardInterrupt))
    assert study.main([*arguments, "--ipd", "0.07"]) == 130 and "goes on" in capsys.readouterr().err


@pytest.mark.parametrize(("argv", "named"), [
    (["--thresholds", "18,x"], "18,x"), (["--thresholds", "-1"], "-1"), (["--thresholds", "181"], "181"),
    (["--thresholds", "nan"], "nan"), (["--poses", "0"], "poses 0"), (["--ipd", "0"], "IPD 0.0"), (["--ipd", "nan"], "IPD nan"),
    (["--units-per-metre", "-1"], "units per metre -1.0"), (["--size", "0x3"], "0x3"), (["--v1", "m.ply"], "0 scenes"),
    (["--thresholds", "0", "--rtl", "all"], "without the threshold 18"), (["nowhere.ply"], "nowhere.ply")])
def test_bad_requests_name_the_value(tmp_path, argv, named):
    with pytest.raises(InputError) as error:
        study.main([*argv, "--out", str(tmp_path / "out"), "--work", str(tmp_path / "kept")])
    assert named in str(error.value)


def test_poses_go_through_the_machine_once(tmp_path, model, camera, monkeypatch):
    calls = []

    def run(command, **options):
        out = command[command.index("--out") + 1]
        calls.append(command)
        with open(f"{out}/frame.json", "w") as file:
            json.dump({"cycles": 100 + len(calls), "bit_exact": True, "wall_s": 3, "counter_errors": []}, file)
        return SimpleNamespace(returncode=0, stderr="", stdout="")

    monkeypatch.setattr(rtl_frame.subprocess, "run", run)
    given = {"units_per_metre": 2.0, "ipd_metres": 0.06, "alone": True}
    first = rtl.rtl_pose(model, camera, ((48.0, 32.0), (40.5, 32.0)), 18.0, tmp_path, **given)
    assert first == {name: {"cycles": 101 + i, "bit_exact": True} for i, name in enumerate(("stereo", "source", "target"))}
    stereo, source, target = map(" ".join, calls)
    assert "--gaze 48.0,32.0" in stereo and "--gaze-right 40.5,32.0" in stereo and "--units-per-metre 2.0" in stereo
    assert "--stereo" not in source and "--gaze 48.0,32.0" in source and "--gaze 40.5,32.0" in target and "display" in target
    assert rtl.rtl_pose(model, camera, ((48.0, 32.0), (40.5, 32.0)), 18.0, tmp_path, **given) == first and len(calls) == 3
    failed = SimpleNamespace(returncode=2, stderr="error: no", stdout="")
    monkeypatch.setattr(rtl_frame.subprocess, "run", lambda *a, **k: failed)
    with pytest.raises(InputError, match="exit status 2: error: no"):
        rtl.rtl_pose(model, camera, ((48.0, 32.0), (41.0, 32.0)), 18.0, tmp_path, **given)
