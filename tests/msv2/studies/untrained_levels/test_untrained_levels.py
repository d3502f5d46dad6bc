"""The study of levels without training, and what the fitted levels have to reach."""

from __future__ import annotations

import json

import pytest

from golden.scenes import level_fit
from golden.scenes.level_fit import enhanced_levels
from golden.scenes.levels import spread_levels
from golden.scenes.load import load_model
from msv2.studies.page import marked_tables
from msv2.studies.untrained_levels import study
from spec.errors import InputError
from spec.paths import REPORTS

GOAL_DB = 20.0


def test_truck_looks_like_itself_with_fitted_levels(data_dir):
    model = load_model(data_dir / "trained" / "truck.splat")
    camera = study.camera_of(model, "orbit 0")
    full = study.full_frame(model, camera)
    fitted, intersections, _ = study.compare(full, enhanced_levels(model), camera)
    before, budget, _ = study.compare(full, spread_levels(model), camera)
    assert fitted >= GOAL_DB > before
    assert intersections <= budget


def test_the_kept_report_reaches_the_goal():
    rows = {(row["scene"], row["source"]): row for row in json.loads((REPORTS / "untrained_levels.json").read_text())["rows"]}
    for scene in ("truck", "rock_sh3", "garden_large"):
        fitted, spread = (rows[scene, source]["orbit 0"] for source in ("enhanced", "spread"))
        assert fitted["psnr_db"] >= GOAL_DB and fitted["intersections"] <= spread["intersections"]
        assert rows[scene, "enhanced"]["cpu_seconds"] < 60


def test_the_page_shows_the_kept_report():
    text, rows = study.PAGE.read_text(), json.loads((REPORTS / "untrained_levels.json").read_text())["rows"]
    assert marked_tables(text) == [study.TABLE] and study.table(rows) in text


def test_the_command_measures_a_scene(tmp_path, monkeypatch, capsys):
    for name, value in (("WIDTH", 64), ("HEIGHT", 36), ("VIEWS", 4), ("FEWEST_VIEWS", 4), ("STEPS", (3, 2, 2))):
        monkeypatch.setattr(level_fit, name, value)
    monkeypatch.setattr(study, "PICTURES", tmp_path / "pictures")
    assert study.main(["embedded", "--pictures", "--out", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "untrained_levels.json").read_text())["rows"]
    assert [row["source"] for row in rows] == ["random", "spread", "enhanced"]
    assert all(set(row) > set(study.CAMERAS) for row in rows)
    assert "| embedded | enhanced |" in capsys.readouterr().out
    assert (tmp_path / "pictures" / "embedded.png").stat().st_size > 10_000
    with pytest.raises(InputError, match=r"scene 'trck' is not accepted.*'truck'"):
        study.main(["trck"])
