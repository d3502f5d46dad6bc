"""The accuracy study: its rows, its budgets, and the kept report."""

import json

import pytest

from golden.scenes.load import TRAINED
from msv2.studies.accuracy import study
from msv2.studies.accuracy.study import (
    BUDGETS_DB,
    MACHINES,
    TRAINED_BUDGETS_DB,
    TRAINED_VIEWS,
    as_markdown,
    budget_db,
    of_scenes,
    worst_db,
)
from spec.paths import REPORTS

KEPT = json.loads((REPORTS / "accuracy.json").read_text())


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    out = tmp_path_factory.mktemp("accuracy")
    assert study.main(["embedded", "--size", "96x64", "--views", "0", "--out", str(out)]) in (0, 1)
    return json.loads((out / "accuracy.json").read_text())["rows"]


def test_every_view_has_a_row_per_machine(rows):
    embedded = [row for row in rows if row["scene"] == "embedded"]
    assert [(row["gaze"], row["machine"]) for row in embedded] == [
        (gaze, machine.name) for gaze in (False, True) for machine in MACHINES]
    wide, compact = (next(row for row in embedded if row["gaze"] and row["records"] == records) for records in BUDGETS_DB)
    assert wide["psnr_vs_oracle_db"] > compact["psnr_vs_oracle_db"] >= BUDGETS_DB["compact"]


def test_the_page_names_the_worst_of_each_format(rows):
    page = as_markdown(rows)
    assert page.count("| v3 |") == page.count("| paper |") == len(rows) // 2
    for trained, budgets in ((False, BUDGETS_DB), (True, TRAINED_BUDGETS_DB)):
        for records, budget in budgets.items():
            worst = worst_db(of_scenes(rows, trained=trained), records)
            assert f"{worst:.1f} dB with {records} records (budget {budget:.0f} dB)" in page
    assert TRAINED not in as_markdown(of_scenes(rows, trained=False))
    assert worst_db([], "wide") is None


@pytest.mark.parametrize("missed", BUDGETS_DB)
def test_a_missed_budget_is_an_exit_status(monkeypatch, tmp_path, missed):
    """Of either format."""
    row = {**KEPT["rows"][0], "psnr_vs_oracle_db": 59.0, "records": missed}
    good = {**KEPT["rows"][0], "psnr_vs_oracle_db": 90.0}
    monkeypatch.setattr(study, "measure", lambda *_: [good, row])
    wanted = int(BUDGETS_DB[missed] > 59.0)
    assert study.main(["embedded", "--size", "16x16", "--views", "0", "--out", str(tmp_path)]) == wanted
    assert wanted == (missed == "wide")


def test_the_kept_report_is_within_its_budgets():
    others, trained = (of_scenes(KEPT["rows"], trained=each) for each in (False, True))
    for records in BUDGETS_DB:
        assert sum(row["records"] == records for row in others) == 16
        assert sum(row["records"] == records for row in trained) == 2 * len(TRAINED_VIEWS.split(","))
    assert all(row["psnr_vs_oracle_db"] >= budget_db(row) for row in KEPT["rows"])
    assert max(abs(row["mean_error"]) for row in others) < 3e-4
