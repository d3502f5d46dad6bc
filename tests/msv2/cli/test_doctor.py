"""`msv2 doctor`: what is missing, who needs it, how to get it."""

import json
import os
import shutil
import tomllib

import pytest

from msv2.cli import doctor
from spec.extras import EXTRAS
from spec.paths import ROOT
from tests.helpers.processes import python


def ask(capsys) -> tuple[int, dict]:
    status = doctor.main(["--json"])
    return status, json.loads(capsys.readouterr().out)


def named(report: dict, name: str) -> dict:
    return next(finding for finding in report["findings"] if finding["name"] == name)


def test_a_program_that_is_not_there_is_missing(monkeypatch, capsys):
    monkeypatch.setattr(doctor.shutil, "which", lambda name: None if name == "g++" else f"/bin/{name}")
    status, report = ask(capsys)
    assert status == 1 and report["ready"] is False
    missing = named(report, "g++")
    assert missing["base"] and not missing["found"] and missing["remedy"] == "apt-get install g++"
    assert named(report, "make")["found"] and named(report, "make")["detail"] == "/bin/make"


def test_what_single_commands_need_does_not_spoil_the_base(monkeypatch, capsys):
    monkeypatch.setattr(doctor.shutil, "which", lambda name: f"/bin/{name}" if name in ("g++", "make", "perl") else None)
    monkeypatch.setattr(doctor, "find_spec", lambda name: name if name in doctor.BASE_PACKAGES else None)
    status, report = ask(capsys)
    assert status == 0 and report["ready"] is True
    assert {"sta", "iverilog", "torch", "gsply"} <= {f["name"] for f in report["findings"] if not f["found"]}
    assert "EXTRAS=train" in named(report, "torch")["remedy"]


def test_the_table_says_who_needs_it_and_how_to_get_it(monkeypatch, capsys):
    monkeypatch.setattr(doctor.shutil, "which", lambda name: None)
    assert doctor.main([]) == 1
    text = capsys.readouterr().out
    lines = text.splitlines()
    at = next(i for i, line in enumerate(lines) if "MISSING  sta" in line)
    assert "needed by   synth" in lines[at + 1] and "apt-get install opensta" in lines[at + 2]
    assert lines[-1] == "the base is not complete: g++, make, perl missing"


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    assert "file" in doctor.unwritable(tmp_path / "file" / "folder")
    assert doctor.unwritable(tmp_path / "new") is None and list((tmp_path / "new").iterdir()) == []


@pytest.mark.parametrize(("variable", "name"), [("MSV2_PDK", "liberty files"), ("MSV2_DATA", "captured scenes")])
def test_folders_are_found_by_their_variable(tmp_path, monkeypatch, capsys, variable, name):
    monkeypatch.setattr(doctor, "find_spec", lambda name: None)
    monkeypatch.setenv(variable, str(tmp_path))
    assert named(ask(capsys)[1], name)["found"]
    monkeypatch.setenv(variable, str(tmp_path / "nothing"))
    assert not named(ask(capsys)[1], name)["found"]


def test_it_runs_where_nothing_is_installed(tmp_path):
    """Without site-packages: it reports, and does not fail on an import."""
    done = python("-S", "-m", "msv2", "doctor", "--json", env={**os.environ, "PYTHONPATH": ""})
    report = json.loads(done.stdout)
    assert done.returncode == 1 and not named(report, "numpy")["found"] and named(report, "python")["found"]
    assert named(report, "perl")["found"] == (shutil.which("perl") is not None)


def test_extras_are_those_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert {EXTRAS[name] for name, _ in doctor.OPTIONAL_PACKAGES} <= set(project["optional-dependencies"])
