"""The study of proofs: its report, what it keeps between runs, and its exit status."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("pyosys", reason="needs the extra `synth`")

from msv2.cases.formal.bench import Bench
from msv2.cases.formal.proof import Proof
from msv2.cases.formal.registry import UNPROVEN, named
from msv2.studies.formal import study
from rtl.stream import Buffer
from spec.errors import InputError


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setattr(study, "FOLDER", tmp_path / "formal")
    monkeypatch.setattr(study, "PROOFS", named("RoundRobin"))
    return tmp_path


def test_a_report_is_written_and_its_verdicts_are_kept(folder, monkeypatch, capsys):
    assert study.main(["--out", str(folder / "formal.md")]) == 0
    report = json.loads((folder / "formal.json").read_text())
    assert (report["proven"], report["open"], report["fails"], report["empty"], report["units"]) == (2, 0, 0, 0, 1)
    assert report["unproven"] == UNPROVEN and report["provenance"]["modules"] == [study.__name__]
    (row,) = report["rows"]
    assert row["unit"] == "RoundRobin" and all(claim["canary"] is not None for claim in row["claims"])
    page = (folder / "formal.md").read_text()
    assert "2 claims of 1 units are proven, 0 are open" in page and "| RoundRobin (3 clients) | only a client that asks" in page
    assert "| Machine | `rtl.top.machine` |" in page
    monkeypatch.setattr(study, "judge", None)  # nothing has changed, so nobody is asked again
    assert study.main(["--out", str(folder / "formal.md")]) == 0
    assert "2 proven, 0 open, 0 fails, 0 empty" in capsys.readouterr().out


def test_a_claim_that_fails_is_told_and_ends_with_1(folder, monkeypatch, capsys):
    def wrong(bench: Bench) -> None:
        bench.never("an item", 1, when=bench.sources["source"].moves)

    monkeypatch.setattr(study, "PROOFS", (Proof(Buffer, lambda: Buffer(1), (wrong,)),))
    assert study.main(["--out", str(folder / "formal.md")]) == 1
    assert "Buffer: an item: fails at 2" in capsys.readouterr().out
    assert "| Buffer | an item | fails at 2 | 2 |" in (folder / "formal.md").read_text()


def test_an_unknown_unit_writes_nothing(folder):
    with pytest.raises(InputError, match="did you mean 'Buffer'"):
        study.main(["--unit", "Bufer"])
    assert not (folder / "formal").exists()
