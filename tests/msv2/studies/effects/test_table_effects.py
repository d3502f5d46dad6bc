"""The effects' table: what areas are compared, what the command writes with them and without, what it refuses."""

from __future__ import annotations

import json
import os

import pytest

from msv2.studies.effects import study
from msv2.studies.effects.area import ONE_EYE, PAIRS, EffectArea, effect_areas, machine_of, measure_in
from msv2.studies.results.report_tables import effect_areas_table, effects_table
from spec.config import PAPER, PAPER_SMALL, TINY, V3_RECORDS
from spec.errors import InputError
from spec.paths import ROOT
from synth import report
from synth.design import Design
from synth.liberty import PDK_VARIABLE
from synth.settings import MOST_RUNS, Settings

OWN = {"sh": 1.0, "levels": 2.0, "blend": 4.0, "depth": 8.0, "stereo": 16.0}


def stand_in(config):
    """mm^2 of a machine in which every effect has an area of its own."""
    assert config.fine_depth == (config.depth and not config.stereo) and (config.levels > 1 or not config.blend)
    there = {"sh": config.sh_degree > 0, "levels": config.levels > 1, "blend": config.blend, "depth": config.depth,
             "stereo": config.stereo}
    return 100.0 + sum(OWN[name] * has for name, has in there.items())


@pytest.mark.parametrize("config", (TINY, PAPER_SMALL, PAPER, V3_RECORDS), ids=lambda config: config.name)
def test_an_effects_area_is_that_of_nothing_else(config):
    areas = effect_areas(config, stand_in)
    assert {name: area.mm2 for name, area in areas.items()} == OWN
    assert areas["sh"] == EffectArea(115.0, 114.0) and areas["levels"] == EffectArea(111.0, 109.0)
    assert areas["stereo"].share == 16 / 131
    assert machine_of(config, ONE_EYE) == config.with_(fine_depth=True)
    assert machine_of(config, frozenset()) == config.with_(sh_degree=0, levels=1, blend=False, depth=False)


def run(tmp_path, *options):
    study.main(["embedded", "embedded@centre", "--size", "64x48", "--runs", "1", "--out", str(tmp_path), *options])
    return json.loads((tmp_path / "effects.json").read_text()), (tmp_path / "effects.md").read_text()


def cells_of(text, label):
    line = next(line for line in text.splitlines() if line.startswith(f"| {label} |"))
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_areas_stand_beside_the_frames(tmp_path, monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(study, "measure_in", lambda folder: lambda config: asked.append(config) or stand_in(config))
    found, text = run(tmp_path, "--area")
    plain, foveated = found["rows"]
    assert {config.name for config in asked} == {"paper"} == {found["area_config"], plain["area_config"]}
    assert plain["area_mm2"] == 101.0 and plain["area_most_mm2"] == 115.0 and plain["area_ratio"] == 115 / 101
    assert foveated["area_mm2"] == 107.0 and foveated["area_ratio"] == 115 / 107  # harmonics, levels, blending
    assert found["areas"]["blend"] == {"with_mm2": 115.0, "without_mm2": 111.0, "mm2": 4.0}
    assert cells_of(text, "embedded, no gaze")[-5:] == ["-", "-", "-", "1.14x", "101.000"]
    assert cells_of(text, "stereo") == ["stereo", "131.000", "115.000", "16.000", "12.2%"]
    assert text.splitlines()[-1] in capsys.readouterr().out
    tables = effects_table({"effects": found}), effect_areas_table({"effects": found})
    assert "| simulation | area |" in tables[0] and "| 12.2% |" in tables[1]


def test_without_areas_the_columns_are_empty(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "measure_in", lambda folder: pytest.fail("nothing is to be synthesised"))
    found, text = run(tmp_path)
    assert set(found) == {"rows", "provenance"} and not any(key.startswith("area") for row in found["rows"] for key in row)
    assert cells_of(text, "embedded, gaze")[-5:] == ["-"] * 5 and "| effect |" not in text
    assert effects_table({"effects": found}).splitlines()[0].endswith("| simulation |")
    assert effect_areas_table({"effects": found}) is None


def test_what_cannot_be_measured_is_refused(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="config 'huge' is not accepted"):
        run(tmp_path, "--area", "--area-config", "huge")
    pytest.importorskip("pyosys.libyosys", reason="needs the extra `synth`")
    monkeypatch.delenv(PDK_VARIABLE, raising=False)
    with pytest.raises(InputError, match=PDK_VARIABLE):
        run(tmp_path, "--area")
    assert not list(tmp_path.iterdir())


def test_areas_that_are_compared_took_as_many_runs(tmp_path, monkeypatch):
    """A result that took more runs is smaller, and will do unless it is to be compared with one that took fewer."""
    pytest.importorskip("pyosys.libyosys", reason="needs the extra `synth`")
    monkeypatch.setattr(report, "_in_fresh_process", lambda run, module, *others: {"area": others[5].runs})
    design = Design("unit", {"unit": "module \\unit\nend\n"}, {"unit": {}})
    for options, wanted in (({}, MOST_RUNS), ({"runs": 1}, MOST_RUNS), ({"runs": 1, "exact": True}, 1)):
        assert report.module_result(design, "unit", [], Settings("generic", 1000.0, tmp_path, **options))["area"] == wanted


@pytest.mark.long
@pytest.mark.skipif(not os.environ.get(PDK_VARIABLE), reason=f"{PDK_VARIABLE} names no folder of liberty files")
def test_effects_have_area_in_cells(monkeypatch):
    """Harmonics and blending of the small machine: more of it than without them, less than all of it."""
    pytest.importorskip("pyosys.libyosys", reason="needs the extra `synth`")
    monkeypatch.setattr("msv2.studies.effects.area.PAIRS", {name: PAIRS[name] for name in ("sh", "blend")})
    areas = effect_areas(TINY, measure_in(ROOT / "build" / "synth", progress=lambda line: None))
    assert list(areas) == ["sh", "blend"] and all(0.005 < area.share < 0.5 for area in areas.values()), areas
    assert areas["sh"].with_mm2 == areas["blend"].with_mm2
