"""The writer of reports: what a provenance says, and when a report is stale."""

from __future__ import annotations

import argparse
import json
import shlex
from pathlib import Path

import pytest

from msv2.studies import record
from spec import sources
from spec.config import PAPER
from spec.errors import InputError
from spec.paths import REPORTS, ROOT


@pytest.fixture
def project(tmp_path, monkeypatch) -> Path:
    """A checkout of two modules, with a scene outside."""
    root = tmp_path / "checkout"
    for name, text in (("spec/__init__.py", ""), ("spec/numbers.py", "VALUE = 1\n"),
                       ("msv2/__init__.py", ""), ("msv2/study.py", "from spec.numbers import VALUE\n")):
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    (tmp_path / "data" / "trained").mkdir(parents=True)
    (tmp_path / "data" / "trained" / "truck.splat").write_bytes(b"splats")
    monkeypatch.setenv("MSV2_DATA", str(tmp_path / "data"))
    monkeypatch.setattr(record, "sources_of", lambda *modules: sources.sources_of.__wrapped__(*modules, root=root))
    return root


def written(folder: Path, content: dict | None = None, **arguments) -> dict:
    path = folder / "report.json"
    record.write_report(path, content or {"rows": [1]}, ["msv2.study"], **arguments)
    return json.loads(path.read_text())


def test_a_report_ends_with_its_provenance(project, tmp_path):
    scene = tmp_path / "data" / "trained" / "truck.splat"
    arguments = argparse.Namespace(scene=str(scene), size="64x48", out=tmp_path, config="paper")
    report = written(tmp_path, configuration={"arguments": arguments, "machine": PAPER}, inputs=[scene, "embedded"])
    assert list(report) == ["rows", "provenance"] and report["rows"] == [1]
    made = report["provenance"]
    assert made["modules"] == ["msv2.study"] and len(made["sources"]) == 16
    assert made["configuration"]["arguments"] == {"scene": "MSV2_DATA/trained/truck.splat", "size": "64x48", "config": "paper"}
    assert made["configuration"]["machine"]["formats"]["colour"] == str(PAPER.formats.colour)
    assert list(made["inputs"]) == ["MSV2_DATA/trained/truck.splat"]
    assert made["machine"]["cores"] >= 1 and made["cpu_seconds"] >= 0 and made["date"].endswith("+00:00")
    assert str(tmp_path) not in json.dumps(made)


def test_what_a_report_rests_on_makes_it_stale(project, tmp_path):
    scene = tmp_path / "data" / "trained" / "truck.splat"
    made = written(tmp_path, inputs=[scene])["provenance"]
    assert record.state(made) == "current"
    (project / "spec" / "other.py").write_text("UNUSED = 1\n")
    assert record.state(made) == "current"
    scene.write_bytes(b"other splats")
    assert record.state(made) == "stale: changed MSV2_DATA/trained/truck.splat"
    scene.unlink()
    assert record.state(made) == "current"  # nothing is known of a scene that is not here
    (project / "spec" / "numbers.py").write_text("VALUE = 2\n")
    assert record.state(made) == "stale: changed sources"


def test_rows_that_an_earlier_command_wrote_keep_their_provenance(project, tmp_path):
    first = written(tmp_path)
    again = written(tmp_path, earlier=first)["provenance"]
    assert [old["sources"] for old in again["earlier"]] == [again["sources"]] and record.state(again) == "current"
    (project / "spec" / "numbers.py").write_text("VALUE = 2\n")
    third = written(tmp_path, earlier=written(tmp_path, earlier=first))["provenance"]
    assert len(third["earlier"]) == 2 and not any("earlier" in old for old in third["earlier"])
    assert record.state(third).startswith("stale: changed rows of")


def test_nothing_is_claimed_of_a_backfilled_report():
    assert record.state({"backfilled": True, "sources": None, "commit": "abc1234"}).startswith("unknown: backfilled")
    assert record.state(None) == "unknown: it has no provenance"


def test_a_module_that_is_gone_makes_a_report_stale(project, tmp_path):
    made = written(tmp_path)["provenance"]
    (project / "msv2" / "study.py").unlink()
    assert record.state(made) == "stale: changed sources"


def test_a_report_as_an_input_counts_without_its_provenance(tmp_path):
    path = REPORTS / "latencies.json"
    before, content = record.input_hash(path), json.loads(path.read_text())
    assert record.input_name(path) == "reports/latencies.json" and record.input_path("reports/latencies.json") == path
    content.pop("provenance")
    assert before == sources.fingerprint((), json.dumps(content, sort_keys=True))


def test_a_training_run_as_an_input_counts_without_its_checkpoints(tmp_path):
    for name in ("model.ply", "report.json", "other"):
        (tmp_path / name).write_text(name)
    before = record.input_hash(tmp_path)
    (tmp_path / "other").write_text("changed")
    assert record.input_hash(tmp_path) == before
    (tmp_path / "model.ply").write_text("changed")
    assert record.input_hash(tmp_path) != before


def test_a_command_names_no_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path))
    record.begin("effects", [str(tmp_path / "trained" / "a b.splat"), "--out", str(ROOT / "reports"), "/elsewhere/model.ply"])
    assert record.command() == 'msv2 study run effects "$MSV2_DATA/trained/a b.splat" --out reports model.ply'
    record.begin("effects", ["--knob", "support radius"])
    assert record.command() == f"msv2 study run effects --knob {shlex.quote('support radius')}"


def test_not_a_number_becomes_null_and_nothing_is_half_written(project, tmp_path):
    assert written(tmp_path, {"value": float("nan")})["value"] is None
    with pytest.raises(TypeError):
        record.write_report(tmp_path / "other.json", {"value": object()}, ["msv2.study"])
    assert [path.name for path in tmp_path.glob("*.json")] == ["report.json"]
    with pytest.raises(InputError, match="cannot be written"):
        record.write_report(tmp_path / "absent" / "report.json", {}, ["msv2.study"])
