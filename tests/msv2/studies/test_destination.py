"""Where reports go: to build/ unless the command line says otherwise, by one rule for all studies."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from msv2.studies import catalogue, destination
from msv2.studies.__main__ import main
from msv2.studies.catalogue import STUDIES
from msv2.studies.destination import newest, place
from msv2.studies.page import fill, write_page
from msv2.studies.record import write_report
from spec.errors import InputError
from spec.paths import DOCS, REPORTS, ROOT


@pytest.fixture(autouse=True)
def away(tmp_path, monkeypatch):
    """Reports that are not kept go to a folder of the test, and nothing has been said."""
    monkeypatch.setattr(destination, "AWAY", tmp_path / "away")
    yield tmp_path / "away"
    destination.tell(keep=False, named=False)


@pytest.fixture()
def kept(tmp_path, monkeypatch):
    """A folder in the place of reports/."""
    folder = tmp_path / "reports"
    folder.mkdir()
    monkeypatch.setattr(destination, "REPORTS", folder)
    return folder


@pytest.mark.parametrize("path", [REPORTS / "x.json", DOCS / "colour.md", DOCS / "images" / "x.png", ROOT / "README.md"])
def test_what_the_project_keeps_changes_only_when_told(away, path, capsys):
    assert place(path) == away / path.name and away.is_dir()
    assert "--keep writes them into reports/ and docs/" in capsys.readouterr().err
    for told in ({"keep": True, "named": False}, {"keep": False, "named": True}):
        destination.tell(**told)
        assert place(path) == path


@pytest.mark.parametrize("path", [ROOT / "build" / "tradeoff" / "tradeoff.md", Path("/elsewhere/x.json")])
def test_other_files_are_where_they_are(path, capsys):
    assert place(path) == path and capsys.readouterr().err == ""


def test_what_a_run_has_written_is_what_it_reads(away):
    assert newest(REPORTS / "x.json") == REPORTS / "x.json"
    place(REPORTS / "x.json")
    assert newest(REPORTS / "x.json") == away / "x.json"
    destination.tell(keep=True, named=False)
    assert newest(REPORTS / "x.json") == REPORTS / "x.json"


def test_writers_of_reports_and_pages_follow_the_rule(away, kept):
    write_report(kept / "x.json", {"rows": []}, ["spec.config"])
    write_page(kept / "x.md", "text")
    assert sorted(path.name for path in away.iterdir()) == ["x.json", "x.md"] and list(kept.iterdir()) == []
    destination.tell(keep=True, named=False)
    write_report(kept / "x.json", {"rows": []}, ["spec.config"])
    assert [path.name for path in kept.iterdir()] == ["x.json"]


def test_a_filled_page_of_the_docs_stays_as_it_was(away, tmp_path, monkeypatch):
    monkeypatch.setattr(destination, "DOCS", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("<!-- table:x -->\nold\n<!-- end -->\n")
    assert fill(page, {"x": lambda: "new"}) == 0
    assert "old" in page.read_text() and "new" in (away / "page.md").read_text()


@pytest.mark.parametrize(("words", "given", "folder"), [
    ([], [], "away"), (["--keep"], [], "reports"), (["--keep", "--size", "3x3"], ["--size", "3x3"], "reports"),
    (["--out", "x"], ["--out", "x"], "reports"),
])
def test_every_study_is_told_in_the_same_way(away, kept, monkeypatch, words, given, folder):
    seen = []

    class Module:
        @staticmethod
        def main(argv):
            seen.append(argv)
            write_report(kept / "x.json", {}, ["spec.config"])

    monkeypatch.setattr(catalogue.importlib, "import_module", lambda name: Module)
    assert main(["run", "accuracy", *words]) == 0
    assert seen == [given]
    assert ({"away": away, "reports": kept}[folder] / "x.json").is_file()
    assert json.loads(next(iter(kept.parent.rglob("x.json"))).read_text())["provenance"]["command"] == (
        " ".join(["msv2 study run accuracy", *words]))


def test_a_study_with_a_folder_of_its_own_is_told_the_reports(monkeypatch):
    seen = []
    module = type("Module", (), {"main": staticmethod(seen.append)})
    monkeypatch.setattr(catalogue.importlib, "import_module", lambda name: module)
    assert main(["run", "tradeoff", "--keep"]) == 0
    assert seen == [["--out", str(REPORTS)]]


def test_keep_and_out_contradict_each_other():
    with pytest.raises(InputError, match="--keep is not accepted together with --out"):
        main(["run", "accuracy", "--keep", "--out", "x"])


@pytest.mark.parametrize("report", [report for study in STUDIES for report in study.reports if study.name != "report"],
                         ids=lambda report: report.outputs[0])
def test_the_commands_of_kept_reports_say_so(report):
    assert "--keep" in report.arguments.split() and "--out" not in report.arguments


def test_the_help_of_every_study_tells_the_rule(capsys):
    with pytest.raises(SystemExit):
        main(["run", "latencies", "--help"])
    assert "every study: without --keep, reports and filled pages go to" in capsys.readouterr().out


def test_a_study_without_options_leaves_the_kept_reports_alone(away, capfd):
    before = {path: path.stat().st_mtime_ns for path in REPORTS.iterdir()}
    assert main(["run", "accuracy", "embedded", "--size", "32x24", "--views", "0"]) == 0
    assert {path: path.stat().st_mtime_ns for path in REPORTS.iterdir()} == before
    assert {"accuracy.json", "accuracy.md"} <= {path.name for path in away.iterdir()}


def test_a_second_run_of_a_study_waits_and_says_so(monkeypatch, tmp_path):
    """Unless `--out` names another folder."""
    monkeypatch.setattr(catalogue, "BUILD", tmp_path)
    code = ("import sys, pathlib; from msv2.studies import catalogue; catalogue.BUILD = pathlib.Path(sys.argv[1]); "
            "catalogue.importlib.import_module = lambda name: type('M', (), {'main': staticmethod(lambda argv: 0)}); "
            "sys.exit(catalogue.run_study(sys.argv[2:]))")

    def start(*words):
        command = [sys.executable, "-c", code, str(tmp_path), *words]
        return subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)

    with catalogue._alone("accuracy", ["--size", "3x3"]):
        waiting = start("accuracy")
        assert waiting.stderr.readline().startswith("waiting for another run of study accuracy")
        assert start("accuracy", "--out", "x").wait() == 0
        assert waiting.poll() is None
    assert waiting.wait() == 0
