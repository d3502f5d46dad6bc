"""The trained model that ships as scene `embedded_trained`: its file, its record, and what a newcomer sees."""

import subprocess
import sys

import numpy as np
import pytest

from golden.metrics.image import psnr_vs
from golden.msv2_ref import pipeline
from golden.scenes.embedded import trained
from golden.scenes.embedded.scene import embedded_cameras, render_reference
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.levels import smfr_levels
from golden.scenes.load import TRAINED, load_scene
from golden.scenes.request import parse_request, resolve
from spec.config import DEFAULT
from spec.errors import InputError
from spec.paths import ROOT
from tests.helpers.golden_samples import random_model


def test_the_record_is_that_of_the_file():
    record = trained.record()
    assert record["bytes"] == trained.FILE.stat().st_size <= 2_000_000
    assert record["sha256"] == trained.sha256(trained.FILE) and record["licence"] == "Apache-2.0"
    assert record["command"] == "msv2 train embedded --ship" and record["seed"] == record["options"]["seed"] == 0
    model = trained.load_trained()
    points = [int((model.quality_bound > level).sum()) for level in range(model.levels)]
    assert [row["points"] for row in record["levels"]] == points == sorted(points, reverse=True)
    assert len(points) == 4 and 0 < points[3] < 0.7 * points[0]
    for row in record["levels"]:
        assert abs(row["psnr"] - row["psnr_before_compression"]) < 0.2 and row["ssim"] > 0.8


def test_a_record_of_another_file_is_refused(tmp_path, monkeypatch):
    other = tmp_path / "trained.npz"
    other.write_bytes(trained.FILE.read_bytes() + b"x")
    monkeypatch.setattr(trained, "FILE", other)
    with pytest.raises(InputError, match=r"sha256 is not that of trained\.npz"):
        trained.record()


def test_levels_are_versions_of_their_own():
    model = load_scene(TRAINED).model
    shown = model.quality_bound == 4
    assert (model.opacity[shown, 3] > 1).any() and (model.opacity[shown, 3] != model.opacity[shown, 0]).any()
    assert (model.sh_dc[shown, 3] != model.sh_dc[shown, 0]).any()
    assert model.name == TRAINED and model.up.tolist() == [0, 0, 1] and model.sh_degree == 3


def test_a_newcomer_sees_the_room_and_no_holes():
    model, camera = load_scene(TRAINED).model, embedded_cameras()[0]
    photo = render_reference(camera)[0].astype(np.float64)
    full = pipeline.render(model, camera, config=DEFAULT)
    foveation = foveation_map(Display(256, 256), (128.0, 128.0))
    levels = pipeline.render(model, camera, config=DEFAULT, foveation=foveation)
    random = pipeline.render(smfr_levels(model), camera, config=DEFAULT, foveation=foveation)
    assert psnr_vs(full.image, photo) > 27 and psnr_vs(levels.image, photo) > 25
    assert psnr_vs(levels.image, full.image) > max(25, psnr_vs(random.image, full.image) + 5)
    assert len(levels.entries.splat) < 0.9 * len(full.entries.splat)


def test_the_scene_has_the_embedded_cameras_and_its_own_levels():
    request = resolve(parse_request(TRAINED, "--gaze", "20,20"))
    assert request.camera.name == "embedded_00" and request.record["levels"] == 4
    assert resolve(parse_request(TRAINED, "--camera", "5")).camera.name == "embedded_05"
    assert (resolve(parse_request(TRAINED, "--levels", "2", "--gaze", "20,20")).foveation.tile_level < 2).all()


def test_reading_takes_numpy_alone():
    code = (f"import sys; from golden.scenes.load import load_scene; print(len(load_scene({TRAINED!r}).model)); "
            "print(sorted({'torch', 'gsply', 'numba', 'scipy', 'pycolmap', 'matplotlib'} & set(sys.modules)))")
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split("\n", 1)[1].strip() == "[]"


def test_packing_keeps_a_model_within_its_bits(tmp_path):
    model = random_model(np.random.default_rng(3), 300, levels=4, sh=3)
    path = tmp_path / "model.npz"
    path.write_bytes(trained.packed(model))
    got = trained.load_trained(path)
    assert np.array_equal(got.quality_bound, model.quality_bound)
    np.testing.assert_allclose(got.means, model.means, atol=1e-3)
    np.testing.assert_allclose(got.opacity, model.opacity, rtol=0.03, atol=1e-4)
    for name, bits in (("log_scales", 10), ("sh_rest", 8)):
        values = getattr(model, name)
        assert np.abs(getattr(got, name) - values).max() <= np.ptp(values) / (2**bits - 1), name
    np.testing.assert_allclose(got.sh_dc, model.sh_dc, atol=4 * np.ptp(model.sh_dc) / 1023)  # errors of four steps add up
    quats = model.quats / np.linalg.norm(model.quats, axis=1, keepdims=True)
    assert np.abs(np.abs((got.quats * quats).sum(axis=1)) - 1).max() < 0.01


@pytest.mark.parametrize("spoil", [lambda data: b"", lambda data: data[:500], lambda data: b"nonsense"])
def test_a_broken_file_is_named(tmp_path, spoil):
    path = tmp_path / "trained.npz"
    path.write_bytes(spoil(trained.FILE.read_bytes()))
    with pytest.raises(InputError, match=r"trained\.npz: is not the whole model of the scene 'embedded_trained'"):
        trained.load_trained(path)
