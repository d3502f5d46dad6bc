"""The hard cases' command: what it writes and how it ends; the machine's part of it."""

from __future__ import annotations

import json

import pytest

from msv2.cases import check, registry, rtl, rtl_faults, streams
from msv2.cases import command as command
from msv2.cases.case import Case, CaseFailure
from msv2.cases.check import Cell
from msv2.cases.report import FaultRow, Result, Row, added, table
from msv2.studies.stability import study
from msv2.studies.stability.study import markdown
from spec.codes import ErrorCode
from spec.paths import ROOT
from tb.top.planned import PlannedFrame


def test_one_case_in_two_columns(tmp_path, capsys):
    assert command.main(["--case", "near-plane-ulp", "--columns", "oracle,golden", "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "stability.json").read_text())
    assert (found["cases"], found["failed"], found["seeded_faults"], found["seeded_faults_caught"]) == (1, 0, 0, 0)
    cells = found["results"]["03-near-plane-ulp"]["columns"]
    assert cells["oracle"]["outcome"] == cells["golden"]["outcome"] == "pass"
    assert "03-near-plane-ulp" in capsys.readouterr().out

def test_the_study_makes_a_page_of_the_results(tmp_path):
    arguments = ["--case", "near-plane-ulp", "--columns", "oracle", "--no-faults", "--out", str(tmp_path)]
    assert study.main(arguments) == 0
    assert "| 03-near-plane-ulp |" in (tmp_path / "stability.md").read_text()
    made = json.loads((tmp_path / "stability.json").read_text())["provenance"]
    assert "msv2.cases.command" in made["modules"] and made["configuration"]["cases"] == arguments[:-2]


@pytest.mark.parametrize("error", [CaseFailure("by design"), ZeroDivisionError("by accident")])
def test_a_failure_is_told_and_ends_with_1(tmp_path, capsys, monkeypatch, error):
    def fails():
        raise error

    case = Case(1, "broken", "a case", "nothing", checks={"oracle": fails})
    monkeypatch.setattr(command, "CASES", (case,))
    assert command.main(["--columns", "oracle", "--no-faults", "--out", str(tmp_path)]) == 1
    assert str(error) in capsys.readouterr().out
    assert json.loads((tmp_path / "stability.json").read_text())["failed"] == 1


def test_a_fault_that_nobody_notices_is_told():
    row = Row(registry.CASES[0], {"oracle": Cell("pass"), "rtl": Cell("-", words="why")})
    result = Result([row], [FaultRow("no guard", "oracle", row.case.id, False, "nothing fails")], 60.0)
    assert result.missed == 1 and result.record["seeded_faults_caught"] == 0
    assert any(line.startswith("not caught: no guard") for line in table(result))
    assert "| no guard | oracle | 01-point-at-the-camera | NO |" in markdown(result.record)


def test_columns_are_added_to_those_of_before(tmp_path):
    case = "near-plane-ulp"
    assert command.main(["--case", case, "--columns", "oracle", "--out", str(tmp_path)]) == 0
    assert command.main(["--case", case, "--columns", "golden", "--out", str(tmp_path), "--add"]) == 0
    found = json.loads((tmp_path / "stability.json").read_text())
    assert found["columns"] == ["oracle", "golden"] and found["cases"] == 1
    before = {**found, "faults": [{"name": "x", "column": "rtl", "case": case, "caught": True, "words": ""}]}
    again = added(command.CASES, before, Result([], [FaultRow("x", "rtl", case, False, "no")], 1.0))
    assert [fault.caught for fault in again.faults] == [False] and set(again.rows[0].cells) == {"oracle", "golden"}


def test_wrong_arguments_are_refused(tmp_path):
    for arguments, words in ((["--columns", "oracle,all"], "columns all"), (["--case", "99"], "case '99'")):
        with pytest.raises(command.InputError, match=words):
            command.main([*arguments, "--out", str(tmp_path)])


def test_every_number_of_the_list_is_there():
    assert {case.number for case in command.CASES} | {58} == set(range(1, 78))  # 58: the seeded faults themselves
    assert len({case.id for case in command.CASES}) == len(command.CASES)
    played = [case for case in command.CASES if isinstance(case, streams.MachineCase) or case.rtl]
    assert len(played) > 45
    assert all(case.absent.get("rtl") for case in registry.CASES if not case.rtl)


def test_cases_become_frames_of_the_machine():
    plan = rtl.frames_of(registry.case_named("needle-at-the-frustum"))
    assert list(plan) == ["one eye"] and len(plan["one eye"]) == 6
    assert list(rtl.frames_of(registry.case_named("at-infinity"))) == ["two eyes"]
    assert rtl.frames_of(registry.case_named("activated-already")) == {}
    assert all(isinstance(item, PlannedFrame) for item in plan["one eye"])


def test_cases_of_the_machine_alone():
    plans = {case.name: case.frames() for case in streams.CASES}
    errors = {item.error for item in plans["recoverable-errors"]}
    assert errors == {ErrorCode.NONE, ErrorCode.ENTRIES_FULL, ErrorCode.SPILL_FULL}
    assert sum(item.run.cut is not None for item in plans["reset-in-mid-frame"]) == 4
    assert not any(item.run.reset for item in plans["frames-back-to-back"])
    assert len({item.run.speed for item in plans["pauses-on-every-port"]}) == 5
    names = [item.name for plan in plans.values() for item in plan]
    assert len(set(names)) == len(names)


@pytest.mark.long
def test_the_machine_plays_cases_and_shows_faults():
    chosen = [case for case in command.CASES if case.number in (1, 3, 6, 16, 33, 36, 41, 54, 55)]
    found = command.machine(chosen, ROOT / "build" / "test-stability")
    assert {case: cell.words for case, cell in found.items() if cell.outcome == "FAIL"} == {}
    in_settings = [fault for fault in rtl_faults.FAULTS if fault.settings]
    caught = rtl_faults.settings_caught(in_settings, ROOT / "build" / "test-stability" / "faults")
    assert all(seen for seen, _ in caught), caught


@pytest.mark.long
@pytest.mark.parametrize(
    "fault", [fault for fault in rtl_faults.FAULTS if fault.part == "machine"], ids=lambda fault: fault.name)
def test_a_machine_without_a_guard_is_told(fault):
    seen, words = rtl_faults.machine_caught(fault, ROOT / "build" / "test-stability" / "machine-faults")
    assert seen, words


def test_a_machine_that_differs_fails_its_case(tmp_path, monkeypatch):
    class Outcome:
        failures, recordings = {"01-point-at-the-camera: shot": ["counter culled_near must be 2, not 0"]}, {}

    monkeypatch.setattr(rtl, "run_plan", lambda *plan, **options: Outcome)
    case = registry.case_named("point-at-the-camera")
    got = rtl.check({case.id: rtl.frames_of(case)}, tmp_path)[case.id]
    assert got.outcome == "FAIL" and "culled_near" in got.words


def test_cells_tell_what_is_missing():
    case = Case(1, "x", "", "", absent={"golden": "not here"})
    assert check.cell(case, "golden") == Cell("-", words="not here")
