"""The results' commands: what the frames that they keep depend on, no more and no less."""

from __future__ import annotations

import sys

from msv2.studies.results import study
from msv2.studies.results.study import frame_sources
from spec.paths import ROOT
from spec.sources import sources_of


def names() -> set[str]:
    return {path.relative_to(ROOT).as_posix() for path in frame_sources()}


def test_a_frame_is_made_anew_when_what_it_imports_changes() -> None:
    """Of what the command imports for its arguments alone, the other units' benches, no frame is made."""
    machine = {path.relative_to(ROOT).as_posix() for path in sources_of("tb.frame.whole")}
    assert not machine - names() and len(names()) > 60
    assert {"tb/top/memory.sv", "tb/frame/__main__.py", "tb/frame/whole.py", "golden/msv2_ref/plan.py"} <= names()


def test_a_frame_stays_when_what_it_does_not_import_changes() -> None:
    """Training, measures of quality, renderers' benchmarks: whatever else grows."""
    assert {name.partition("/")[0] for name in names()} == {"golden", "rtl", "spec", "tb"}
    assert not {"tb/sort_tmu/chunk_suite.py", "tb/sim.py", "golden/training/chain.py", "golden/metrics/hvsq.py"} & names()


def test_training_is_made_on_request_of_the_scenes_that_are_there(tmp_path, monkeypatch) -> None:
    commands, fern = [], tmp_path / "posed" / "fern"
    monkeypatch.setattr(study, "run", lambda *command: commands.append(command))
    monkeypatch.setattr(study, "REPORTS", tmp_path / "reports")
    monkeypatch.setattr(study, "fill_readme", lambda *arguments, check: 0)
    monkeypatch.setenv("MSV2_DATA", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["results.py", "--only", "training"])
    assert study.main() == 0
    fern.mkdir(parents=True)
    assert study.main() == 0
    written = ("--out", str(tmp_path / "reports"), "--name", "training")
    assert commands == [("-m", "msv2.studies", "training", "embedded", *written),
                        ("-m", "msv2.studies", "training", "embedded", str(fern), *written)]
    assert "training" not in study.PARTS
