"""The scale of a scene against a metric depth map."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from golden.msv2_ref import pipeline
from golden.scenes.embedded.scene import cached_embedded_model, embedded_cameras
from msv2.studies.metric_scale import study
from spec.config import PAPER
from spec.errors import InputError


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
        study.main(["--size", "96x54", "--depth-map", str(tmp_path / name), "--out", str(out)])
        found = json.loads(capsys.readouterr().out)
        kept = json.loads(out.read_text())
        assert kept.pop("provenance")["modules"] == ["msv2.studies.metric_scale.study"] and found == kept
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
            study.main(["--size", "96x54", "--depth-map", str(tmp_path / name)])
