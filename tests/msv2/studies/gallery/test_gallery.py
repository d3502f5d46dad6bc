"""The pictures of the README: what they show, and that they are small and made anew without a difference."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from golden.scenes.save import save_model
from msv2.studies.gallery import pages, pictures, study
from msv2.studies.web.check import markdown_problems, problems
from spec.errors import InputError
from spec.paths import DOCS
from tests.helpers.golden_samples import random_model

NAMES = ["plain", "foveated", "levels", "depth", "stereo", "error"]


def test_pictures_are_written(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "PANEL", (64, 48))
    monkeypatch.setattr(study, "write_document", lambda *_: None)
    monkeypatch.setattr(study, "BUILD", tmp_path / "build")
    monkeypatch.setattr(study, "FILM", ("--size", "64x36", "--frames", "2", "--levels", "4", "--format", "webp"))
    assert study.main(["--size", "96x54", "--out", str(tmp_path / "new")]) == 0
    foveated = np.asarray(Image.open(tmp_path / "new" / "foveated.png").convert("RGB"))
    panel = np.asarray(Image.open(tmp_path / "new" / "renderers.png").convert("RGB"))
    assert foveated.shape == (54 + 18, 2 * 96, 3) and panel.shape == (2 * (48 + 18), 4 * 64, 3)
    assert Image.open(tmp_path / "new" / "film.webp").n_frames == 2 and Image.open(tmp_path / "new" / "film.png").width == 64
    frame, levels = foveated[18:, :96], foveated[18:, 96:]
    assert frame.std() > 20 and not np.array_equal(frame, levels)


def test_the_gallery_of_the_documents_is_small_and_whole():
    places = sorted((DOCS / "images").glob("gallery_*"))
    assert {place.stem.removeprefix("gallery_") for place in places} == set(NAMES)
    assert sum(place.stat().st_size for place in places) <= pages.MOST_BYTES
    page = DOCS / "gallery.md"
    text = page.read_text()
    assert markdown_problems(page) == [] and [text.index(f"gallery_{name}.jpg") for name in NAMES] == sorted(
        text.index(f"gallery_{name}.jpg") for name in NAMES)


@pytest.fixture(scope="module")
def small():
    return pictures.load_subject(study.SHOWN, "96x64", "auto")


def test_pictures_show_what_they_are_named(small):
    made = {one.name: one for one in pictures.pictures(small)}
    assert list(made) == NAMES and made["stereo"].image.shape == (64, 192, 3)
    left, right = np.split(made["stereo"].image, 2, axis=1)
    plain, foveated = made["plain"].image, made["foveated"].image
    assert np.abs(left - plain).max() < 1 / 128  # the left eye is the same camera, rounded to a byte
    assert 0.01 < np.abs(left - right).mean() < 0.3 and np.abs(foveated - plain).mean() > 0.005
    assert "trained with the model" in made["foveated"].caption and small.trained
    assert 0 < made["error"].image.mean() < 1 and "dB" in made["error"].caption


def test_another_scene_is_drawn_into_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "BUILD", tmp_path / "build")
    model = random_model(np.random.default_rng(3), 80, levels=4)
    save_model(model, tmp_path / "ball.ply")
    assert study.main([str(tmp_path / "ball.ply"), "--size", "64x48"]) == 0
    out = tmp_path / "build" / "gallery" / "ball"
    assert problems(out / "gallery.html") == [] and markdown_problems(out / "gallery.md") == []
    assert sorted(path.stem for path in out.glob("*.jpg")) == sorted(NAMES)
    assert "trained with the model" in (out / "gallery.md").read_text()
    assert str(tmp_path) not in (out / "gallery.html").read_text()


def test_a_model_without_levels_gets_fitted_ones(tmp_path):
    save_model(random_model(np.random.default_rng(3), 80), tmp_path / "ball.ply")
    subject = pictures.load_subject(str(tmp_path / "ball.ply"), "64x48", "auto")
    assert subject.model.levels == 4 and not subject.trained
    foveated = next(one for one in pictures.pictures(subject) if one.name == "foveated")
    assert "fitted to the model's own pictures" in foveated.caption


def test_pictures_that_are_too_large_for_the_documents_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(pages, "MOST_BYTES", 1000)
    monkeypatch.setattr(study, "pictures", lambda subject: iter([
        pictures.Shown("plain", np.random.default_rng(1).random((64, 64, 3)), "noise", "")]))
    with pytest.raises(InputError, match="size '96x54' is not accepted: the pictures take"):
        study.write_document("96x54", tmp_path / "gallery.md", tmp_path)
