"""The benchmark is only honest if its opponents draw the picture, and its report only useful if it is complete."""

import json
import sys

import numpy as np
import pytest

from golden import bench, bench_float, bench_torch
from golden.metrics.image import psnr_vs
from golden.oracle.render import render as render_oracle
from golden.scenes.load import load_scene
from spec.errors import InputError

HONEST_DB = 50.0


@pytest.fixture(scope="module")
def scene():
    loaded = load_scene("embedded")
    camera = loaded.cameras[0].resized(100, 56)  # neither a multiple of 16: the last tiles are cut
    return loaded.model, camera, render_oracle(loaded.model, camera)


def test_float_renderer_draws_the_oracles_picture(scene):
    model, camera, oracle = scene
    frame = bench_float.render(bench_float.prepare(model), camera)
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
    frame = bench_float.render(bench_float.prepare(few), camera, background)
    assert oracle.transmittance.mean() > 0.1
    assert psnr_vs(frame.image.astype(np.float64), oracle.image) >= HONEST_DB


def test_torch_renderer_draws_the_oracles_picture(scene):
    pytest.importorskip("torch")
    model, camera, oracle = scene
    image = bench_torch.render(bench_torch.prepare(model), camera)
    assert psnr_vs(image.astype(np.float64), oracle.image) >= HONEST_DB


def test_report_is_complete_and_repeatable_numbers_agree(tmp_path, capsys):
    pytest.importorskip("torch")
    bench.main(["--size", "64x48", "--repeat", "2", "--out", str(tmp_path)])
    result = json.loads((tmp_path / "bench.json").read_text())["scenes"][0]
    assert result["size"] == [64, 48] and result["entries"] > 0
    assert set(result["renderers"]) == {bench.INTEGER, bench.FLOAT, bench.TORCH}
    for renderer in result["renderers"].values():
        assert len(renderer["rounds_s"]) == 2
        assert renderer["min_s"] <= renderer["median_s"] <= renderer["max_s"]
        assert renderer["psnr_vs_oracle_db"] >= HONEST_DB
    assert result["renderers"][bench.INTEGER]["times_integer"] == 1.0
    report = (tmp_path / "bench.md").read_text()
    assert report in capsys.readouterr().out
    assert all(name in report for name in result["renderers"])


def test_missing_torch_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match="torch is not installed"):
        bench.main([])


def test_rounds_must_be_positive():
    with pytest.raises(InputError, match="repeat 0"):
        bench.main(["--repeat", "0"])
