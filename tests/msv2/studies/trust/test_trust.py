"""The page about what speaks for the RTL: numbers of other reports, of files that it spoils and of frames that it plays."""

from __future__ import annotations

import json

import pytest

from msv2.studies.trust import study
from spec.errors import InputError

PROVENANCE = {"command": "msv2 study run other --keep", "date": "2026-01-02T03:04:05+00:00"}
MUTANTS = {"drawn": 12, "equal": 2, "judged": 10, "killed": 9, "share": 0.9, "missing": ["b"], "rows": [
    {"unit": "a", "drawn": 12, "equal": 2, "killed": 9}], "provenance": PROVENANCE}
SOURCE_MUTANTS = {"provenance": PROVENANCE, "parts": {"spec": {
    "mutants": 5, "equal": 1, "judged": 4, "by_cases": 2, "by_tests": 1, "no_end": 0, "noticed": 3, "share": 0.75,
    "rows": []}}}
COVERED = {"bits": 2000, "covered": 1900, "ways": 8, "taken": 7, "lines": 3, "whole": 2}
COVERAGE = {**COVERED, "rows": [{"unit": "a", **COVERED, "holes": []}], "provenance": PROVENANCE}
FORMAL = {"proven": 2, "open": 1, "fails": 0, "empty": 0, "rows": [
    {"unit": "Buffer", "claims": [{"result": "proven"}, {"result": "open"}]},
    {"unit": "Buffer", "claims": [{"result": "proven"}]}], "provenance": PROVENANCE}
STABILITY = {"seeded_faults_caught": 1, "faults": [{"column": "rtl", "caught": True}, {"column": "rtl", "caught": False}],
             "provenance": PROVENANCE}


@pytest.fixture
def folders(tmp_path, monkeypatch):
    reports = tmp_path / "reports"
    reports.mkdir()
    for name, content in (
            ("mutants", MUTANTS), ("source_mutants", SOURCE_MUTANTS), ("coverage", COVERAGE), ("formal", FORMAL),
            ("stability", STABILITY)):
        (reports / f"{name}.json").write_text(json.dumps(content))
    monkeypatch.setattr(study, "REPORTS", reports)
    monkeypatch.setattr(study, "FOLDER", tmp_path / "trust")
    return tmp_path


def soak_of(differences):
    class Soaked:
        def __init__(self, folder, seed, machines):
            folder.mkdir(parents=True, exist_ok=True)
            self.file = folder / "soak.json"
            self.count = {"cycles": 0, "frames": 0, "differences": [], "by_end": {}, "by_machine": {}}

        def run(self, cycles):
            self.count = {"cycles": cycles + 5, "frames": 16, "differences": differences, "by_end": {"good": 12, "abort": 4},
                          "by_machine": {"tiny": {"frames": 16, "cycles": cycles + 5}}}
            self.file.write_text(json.dumps(self.count))

    return Soaked


@pytest.mark.parametrize(("differences", "status"), [([], 0), ([{"frame": 3}], 1)])
def test_the_report_has_every_part_with_its_command(folders, monkeypatch, differences, status):
    monkeypatch.setattr(study, "Soak", soak_of(differences))
    monkeypatch.setattr(study, "FORMATS", {"ply": study.FORMATS["ply"]})
    out = folders / "trust.md"
    assert study.main(["--cases", "3", "--cycles", "100", "--out", str(out)]) == status
    report, page = json.loads(out.with_suffix(".json").read_text()), out.read_text()
    assert (report["mutants"]["killed"], report["mutants"]["judged"]) == (9, 10)
    assert (report["source_mutants"]["noticed"], report["source_mutants"]["judged"]) == (3, 4)
    assert report["formal"]["units"] == {"Buffer": {"open": 1, "proven": 2}}
    assert (report["faults"]["seeded"], report["faults"]["caught"]) == (2, 1)
    assert (report["fuzz"]["cases"], report["fuzz"]["failures"]) == (3, 0)
    assert (report["soak"]["cycles"], report["soak"]["differences"]) == (105, len(differences))
    assert all({"command", "date", "units"} <= set(report[part]) for part in report if part != "provenance")
    assert report["coverage"]["units"] == {"a": COVERED} and "1,900 of 2,000 (95.0 %)" in page and "7 of 8 (87.5 %)" in page
    assert "9 of 10 (90.0 %)" in page
    assert "| mutants of Python in spec that cases or quick tests notice | 3 of 4 (75.0 %); goal 95 % |" in page
    assert "Not judged: b." in page and "4 abort, 12 good" in page
    assert set(report["provenance"]["inputs"]) and "2026-01-02" in page
    again = study.fuzzed(3)
    assert again == report["fuzz"]  # it was not run again


def test_mutants_of_python_may_be_missing(folders, monkeypatch):
    monkeypatch.setattr(study, "Soak", soak_of([]))
    monkeypatch.setattr(study, "FORMATS", {"ply": study.FORMATS["ply"]})
    (folders / "reports" / "source_mutants.json").unlink()
    assert study.main(["--cases", "3", "--cycles", "100", "--out", str(folders / "trust.md")]) == 0
    assert "Python" not in (folders / "trust.md").read_text()


def test_a_missing_report_is_named_with_its_command(folders):
    (folders / "reports" / "formal.json").unlink()
    with pytest.raises(InputError, match="msv2 study run formal --keep"):
        study.main(["--cases", "1"])


@pytest.mark.parametrize("argv", [["--cases", "0"], ["--cycles", "0"], ["--cycles", "nan"]])
def test_bad_requests_name_what_is_accepted(argv):
    with pytest.raises(InputError, match="is not accepted"):
        study.main(argv)
