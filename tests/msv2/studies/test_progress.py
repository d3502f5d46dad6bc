"""Progress of a study: a line a step, times that are kept, and an estimate where all that is left is known."""

from __future__ import annotations

import json

import pytest

from msv2.studies.progress import Progress


def steps(folder, *names: str) -> None:
    progress = Progress("x", ["one", "two", "three"], folder)
    for name in names:
        with progress.step(name):
            pass


def test_the_second_run_knows_what_is_left(tmp_path, capsys):
    steps(tmp_path, "one", "two", "three")
    first = capsys.readouterr().out
    assert first.splitlines()[0] == "[1/3] one" and "left" not in first and "the last time" not in first
    kept = json.loads((tmp_path / "x.json").read_text())
    assert set(kept) == {"one", "two", "three"}
    (tmp_path / "x.json").write_text(json.dumps(kept | {"two": 30.0, "three": 90.0}))
    steps(tmp_path, "one", "two")
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].endswith("about 2 min 0 s left") and lines[2] == "[2/3] two, 30 s the last time"
    assert lines[3].endswith("about 90 s left")


def test_a_damaged_file_of_times_is_no_error(tmp_path, capsys):
    (tmp_path / "x.json").write_text("[")
    steps(tmp_path, "two")
    assert "[2/3] two: 0.0 s" in capsys.readouterr().out


def test_a_step_that_fails_is_not_timed(tmp_path):
    progress = Progress("x", ["one"], tmp_path)
    with pytest.raises(KeyError), progress.step("one"):
        raise KeyError
    assert not (tmp_path / "x.json").exists()
