"""The benchmark is only honest if its opponents draw the picture, and its report only useful if it is complete."""

import json
import sys

import numpy as np
import pytest

from golden import threads as parallel
from golden.metrics.image import psnr_vs
from golden.oracle.render import render as render_oracle
from golden.scenes.load import load_scene
from golden.scenes.save import save_model
from msv2.studies.speed import float32, study
from spec.errors import InputError

HONEST_DB = 50.0


@pytest.fixture(scope="module")
def scene():
    loaded = load_scene("embedded")
    camera = loaded.cameras[0].resized(100, 56)  # neither a multiple of 16: the last tiles are cut
    return loaded.model, camera, render_oracle(loaded.model, camera)


def test_float_renderer_draws_the_oracles_picture(scene):
    model, camera, oracle = scene
    frame = float32.render(float32.prepare(model), camera)
    assert psnr_vs(frame.image.astype(np.float64), oracle.image) >= HONEST_DB
    assert np.abs(frame.transmittance - oracle.transmittance).mean() < 1e-4
    depth = frame.depth_sum / np.maximum(1 - frame.transmittance, 0.5)
    valid = np.isfinite(oracle.depth)
    assert np.median(np.abs(depth[valid] / oracle.depth[valid] - 1)) < 1e-4


def test_float_renderer_shows_the_background(scene):
    model, camera, _ = scene
    few = model.select(np.arange(200))
    background = (0.25, 0.5, 0.75)
    oracle = render_oracle(few, camera, background=background)
    frame = float32.render(float32.prepare(few), camera, background)
    assert oracle.transmittance.mean() > 0.1
    assert psnr_vs(frame.image.astype(np.float64), oracle.image) >= HONEST_DB


def test_report_is_complete_and_repeatable_numbers_agree(tmp_path, capsys):
    pytest.importorskip("torch")
    few = tmp_path / "few.ply"
    save_model(load_scene("embedded").model.select(np.arange(0, 19000, 10)), few)
    study.main([str(few), "--size", "64x48", "--training-size", "48x32", "--repeat", "2", "--out", str(tmp_path)])
    result = json.loads((tmp_path / "bench.json").read_text())["scenes"][0]
    assert result["size"] == [64, 48] and result["entries"] > 0
    assert set(result["renderers"]) == {study.INTEGER, study.FLOAT, study.TORCH}
    for renderer in result["renderers"].values():
        assert len(renderer["rounds_s"]) == 2
        assert renderer["min_s"] <= renderer["median_s"] <= renderer["max_s"]
        assert renderer["psnr_vs_oracle_db"] >= HONEST_DB
    assert result["renderers"][study.INTEGER]["times_integer"] == 1.0
    report = (tmp_path / "bench.md").read_text()
    assert report in capsys.readouterr().out
    assert all(name in report for name in result["renderers"])

    training = result["training"]
    assert training["size"] == [48, 32] and training["entries"] > 0
    assert list(training["renderers"]) == ["numba renderer", "plain torch tiles"]
    for name, renderer in training["renderers"].items():
        assert name in report
        assert len(renderer["rounds_s"]) == 2
        assert renderer["min_s"] <= renderer["median_s"] <= renderer["max_s"]
        assert renderer["iterations_per_s"] == 1 / renderer["median_s"]
        assert renderer["threads"] in (1, parallel.threads)
        assert set(renderer["parts_s"]) == {"forward", "loss", "backward", "step"}
        assert renderer["psnr_vs_oracle_db"] >= HONEST_DB
    assert training["renderers"]["numba renderer"]["times_ours"] == 1.0


def test_both_trainings_do_the_same_work():
    torch = pytest.importorskip("torch")
    from golden.diff.gaussians import from_model
    from msv2.studies.speed import training as bench_training

    loaded = load_scene("embedded")
    gaussians, camera = from_model(loaded.model.select(np.arange(0, 19000, 10))), loaded.cameras[0].resized(48, 32)
    target = torch.rand(32, 48, 3, generator=torch.Generator().manual_seed(0))
    ours, plain = (bench_training.Training(module.render, 1, gaussians, camera, target)
                   for module in (bench_training.render, bench_training.reference))
    threads = torch.get_num_threads()
    for _ in range(4):
        ours.iterate()
        plain.iterate()
    torch.set_num_threads(threads)
    assert (ours.image - plain.image).abs().mean() < 1e-4  # Adam's first steps are signs: a rounding may turn one
    assert ours.image.shape == target.shape
    assert all(len(values) == 4 for values in ours.seconds.values())


def test_missing_torch_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match="torch, which is not installed"):
        study.main([])


def test_rounds_must_be_positive():
    with pytest.raises(InputError, match="repeat 0"):
        study.main(["--repeat", "0"])
