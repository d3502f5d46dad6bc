"""`--levels-from`: what each source gives, what is kept, and what is refused."""

from __future__ import annotations

import argparse
import re
from dataclasses import replace

import numpy as np
import pytest

from golden.scenes import level_fit, level_source
from golden.scenes.level_source import ENHANCED, LEVELS_FROM, RANDOM, SPREAD, kept_enhanced, leveled
from golden.scenes.levels import smfr_levels, spread_levels
from golden.scenes.model import GaussianModel
from golden.scenes.request import add_request_arguments, parse_request, resolve
from golden.scenes.save import save_model
from spec.errors import InputError
from spec.paths import ROOT
from tests.golden.scenes.test_level_fit import ball, few_pictures


@pytest.fixture
def made(monkeypatch) -> list[GaussianModel]:
    """The models to which levels were fitted; the fit itself is left out."""
    found: list[GaussianModel] = []

    def fit(model: GaussianModel, levels: int, seed: int, _: object) -> GaussianModel:
        found.append(model)
        spread = spread_levels(model, levels)
        opacity = np.where(np.arange(levels) > 0, spread.opacity / 3 + seed, spread.opacity)
        return replace(spread, opacity=np.where(spread.quality_bound[:, None] > 1, opacity, model.opacity))

    monkeypatch.setattr(level_fit, "enhanced_levels", fit)
    return found


def asked(levels: int | None, source: str, seed: int = 0) -> argparse.Namespace:
    return argparse.Namespace(levels=levels, levels_from=source, seed=seed)


def equal(a: GaussianModel, b: GaussianModel) -> bool:
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("quality_bound", "opacity", "sh_dc"))


def test_each_source_gives_its_levels(made, monkeypatch, tmp_path):
    monkeypatch.setenv("MSV2_CACHE", str(tmp_path))
    model = ball(200)
    found = {source: leveled(model, asked(3, source, 7)) for source in LEVELS_FROM}
    assert all(record == {"levels_from": source} for source, (_, record) in found.items())
    assert equal(found[RANDOM][0], smfr_levels(model, 3, 7))
    assert equal(found[SPREAD][0], spread_levels(model, 3))
    assert len(made) == 1 and found[ENHANCED][0].opacity.max() > 7
    default, _ = leveled(model, argparse.Namespace(levels=3, seed=7))
    assert equal(default, found[ENHANCED][0])


def test_nothing_is_made_that_is_not_asked_for(made):
    model = ball(50)
    trained = smfr_levels(model)
    assert leveled(model, asked(None, ENHANCED)) == (model, {}) and leveled(model, asked(1, ENHANCED)) == (model, {})
    assert leveled(trained, asked(4, ENHANCED)) == (trained, {}) and not made
    with pytest.raises(InputError, match=r"levels-from 'enhnced' is not accepted.*did you mean 'enhanced'"):
        leveled(model, asked(None, "enhnced"))


def test_fitted_levels_are_kept(made, tmp_path):
    model = ball(200)
    first, again = kept_enhanced(model, 4, folder=tmp_path), kept_enhanced(model, 4, folder=tmp_path)
    assert len(made) == 1 and equal(first, again)
    path = next(tmp_path.glob("*.npz"))
    path.write_bytes(path.read_bytes()[:100])  # a broken file is made again
    assert equal(kept_enhanced(model, 4, folder=tmp_path), first) and len(made) == 2
    kept_enhanced(model, 3, folder=tmp_path)
    kept_enhanced(model, 4, 1, folder=tmp_path)
    kept_enhanced(replace(model, sh_dc=model.sh_dc + 1), 4, folder=tmp_path)
    assert len(made) == 5 and len(list(tmp_path.glob("*.npz"))) == 4


def test_what_is_kept_is_what_was_fitted(tmp_path, monkeypatch):
    few_pictures(monkeypatch)
    model = ball(150)
    fitted = level_fit.enhanced_levels(model)
    first, again = kept_enhanced(model, 4, folder=tmp_path), kept_enhanced(model, 4, folder=tmp_path)
    assert len(list(tmp_path.glob("*.npz"))) == 1
    assert equal(first, fitted) and equal(again, fitted)


def test_only_the_last_models_stay(made, tmp_path, monkeypatch):
    monkeypatch.setattr(level_source, "KEPT", 2)
    for seed in range(4):
        kept_enhanced(ball(50), 2, seed, folder=tmp_path)
    assert len(list(tmp_path.glob("*.npz"))) == 2


def test_a_folder_that_cannot_be_written_costs_no_result(made, tmp_path):
    place = tmp_path / "file"
    place.write_text("not a folder")
    assert kept_enhanced(ball(50), 2, folder=place).levels == 2


def test_requests_have_the_option(made, tmp_path, monkeypatch):
    monkeypatch.setenv("MSV2_CACHE", str(tmp_path / "cache"))
    scene = tmp_path / "ball.ply"
    save_model(ball(200), scene)

    def record_of(*argv: str) -> dict[str, object]:
        return resolve(parse_request(str(scene), "--size", "64x64", "--gaze", "9,9", *argv)).record

    parser = argparse.ArgumentParser()
    add_request_arguments(parser)
    assert parser.parse_args([]).levels_from == ENHANCED
    assert record_of("--levels", "4", "--levels-from", "enhanced")["levels_from"] == ENHANCED and len(made) == 1
    assert record_of("--levels", "4")["levels_from"] == RANDOM and len(made) == 1  # programs, whose numbers were measured so
    assert "levels_from" not in record_of()


def test_studies_and_suites_name_their_source():
    """A request of levels in the project's own measurements never takes the default, so that their numbers stay."""
    found = 0
    for folder in ("msv2/studies", "msv2/cases", "synth", "tb/common", "tests/tb"):
        for path in (ROOT / folder).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            asking = [line for line in text.splitlines() if re.search(r'--levels( \d|",)', line)]
            pinned = "parse_request(" in text  # which takes random levels
            if not pinned and path != ROOT / "msv2/studies/threshold/rtl.py":  # its models have levels
                assert all("--levels-from" in line or line.endswith('"--levels", "4",') for line in asking), (path, asking)
            if "add_request_arguments(" in text:
                assert "levels_from=RANDOM" in text, path
            found += len(asking)
    assert found > 10
