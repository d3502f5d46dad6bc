"""The catalogue: every report is some study's, every JSON has a provenance, and every study can be run by its name."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest

from msv2.studies import catalogue, record
from msv2.studies.__main__ import main
from msv2.studies.catalogue import STUDIES
from spec.errors import InputError
from spec.paths import REPORTS, ROOT

REPORTED = [report for study in STUDIES for report in study.reports]
KINDS = (".json", ".md", ".png", ".csv", ".html")


def test_every_report_is_written_by_a_study():
    listed = [name for report in REPORTED for name in report.outputs if "/" not in name]
    assert len(listed) == len(set(listed))
    kept = {path.name for path in REPORTS.iterdir() if path.suffix in KINDS}
    assert kept == set(listed)


def test_every_picture_of_the_documents_is_written_by_a_study():
    listed = {ROOT / name for report in REPORTED for name in report.outputs if name.startswith("docs/images/")}
    assert listed == set((ROOT / "docs" / "images").iterdir())
    assert all(path.stat().st_size < 200 * 1024 for path in listed)


@pytest.mark.parametrize("path", sorted(REPORTS.glob("*.json")), ids=lambda path: path.name)
def test_every_json_has_a_provenance(path: Path):
    made = json.loads(path.read_text())[record.PROVENANCE]
    assert made["command"].startswith("msv2 study run ") and made["commit"] and made["date"]
    if made.get("backfilled"):
        assert made["sources"] is None  # no hash is claimed of what nobody hashed
    else:
        assert made["machine"] and made["modules"] and len(made["sources"]) == 16 and made["cpu_seconds"] >= 0
        for module in made["modules"]:
            assert importlib.util.find_spec(module), module


@pytest.mark.parametrize("path", sorted(REPORTS.glob("*.json")), ids=lambda path: path.name)
def test_a_provenance_names_no_folder_and_no_host(path: Path):
    text = json.dumps(json.loads(path.read_text())[record.PROVENANCE])
    assert '"/' not in text and " /" not in text and str(ROOT) not in text


def test_every_json_says_the_command_that_the_catalogue_says():
    """So that a command that is renamed is renamed in both."""
    for study in STUDIES:
        for report in study.reports:
            if report.provenance is not None:
                assert report.provenance["command"].startswith(f"msv2 study run {study.name}"), study.name


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.name)
def test_a_study_has_a_module_with_main(study):
    """Found without importing it: some need torch or the extra `synth`."""
    found = importlib.util.find_spec(study.module)
    assert "\ndef main(argv: Sequence[str] | None = None)" in Path(found.origin).read_text()
    assert study.about and all(report.minutes > 0 for report in study.reports)


def test_every_module_of_a_study_is_in_the_catalogue():
    folder = ROOT / "msv2" / "studies"
    modules = {".".join(path.relative_to(ROOT).with_suffix("").parts) for path in folder.glob("*/study.py")}
    assert modules <= {study.module for study in STUDIES}


def test_an_unknown_name_is_answered_with_the_nearest():
    for arguments in (["acuracy"], ["run", "acuracy"], ["list", "acuracy"]):
        with pytest.raises(InputError, match="did you mean 'accuracy'"):
            main(arguments)
    done = subprocess.run([sys.executable, "-m", "msv2.studies", "zzz"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.startswith("error: study 'zzz' is not accepted: choose one of accuracy,")


def test_no_name_is_answered_with_the_names():
    with pytest.raises(InputError, match="no study is named: choose one of accuracy"):
        main([])


def test_the_list_shows_costs_and_states(capsys):
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1 : 1 + len(STUDIES)]] == [study.name for study in STUDIES]
    assert main(["list", "--reports", "area"]) == 0
    shown = capsys.readouterr().out
    assert "msv2 study run area\n    writes area.json, area.md, area.png; ~120 CPU-minutes; needs liberty files" in shown


def test_a_study_is_run_by_its_name(monkeypatch, tmp_path):
    ran = []
    monkeypatch.setattr(catalogue.importlib, "import_module", lambda name: type("Module", (), {
        "main": staticmethod(lambda argv: ran.append((name, argv)))}))
    assert main(["run", "machine", "--unit", "x"]) == 0
    assert ran == [("msv2.studies.results.study", ["--only", "machine", "--unit", "x"])]
    assert record.command() == "msv2 study run machine --unit x"


def test_a_report_is_stale_as_soon_as_one_of_its_files_is_missing(monkeypatch, tmp_path):
    monkeypatch.setattr(catalogue, "REPORTS", tmp_path)
    report = catalogue.Report("", ("x.json", "x.md"), 1)
    assert report.state == "stale: x.json is missing"
    record.write_report(tmp_path / "x.json", {}, ["spec.config"])
    assert report.state == "stale: x.md is missing"
    (tmp_path / "x.md").write_text("page")
    assert catalogue.Report("", ("x.json", "x.md"), 1).state == "current"
    assert "~" not in catalogue.Report("", ("x.json",), 1).cost
