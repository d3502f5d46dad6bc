"""`msv2 setup --warm`: afterwards nothing is compiled for the first frame."""

from __future__ import annotations

import json
import subprocess
import tomllib

import pytest

from msv2.cli import setup_environment
from spec.paths import ROOT
from tests.helpers.processes import python


@pytest.mark.long
def test_nothing_is_left_to_compile(tmp_path):
    assert python("-m", "msv2.cli.warm").returncode == 0
    again = python("-m", "msv2.cli.warm")
    assert again.returncode == 0 and again.stdout == "all kernels are in the cache already\n" and again.stderr == ""
    for number, options in enumerate((
        ("--gaze", "10,10", "--levels", "3", "--set", "splat_cache_lines=64"),
        ("--stereo", "--pixels", "display", "--camera", "3", "--config", "tiny"),
        ("--memory", "ideal", "--effects", "all", "--merge", "0", "--config", "paper"),
    )):
        out = tmp_path / str(number)
        done = python("-m", "perf", "embedded", "--size", "80x48", "--no-cache", "--out", str(out), *options)
        assert done.returncode == 0, done.stderr
        assert json.loads((out / "perf.json").read_text())["compile_seconds"] == 0, (options, done.stderr)
        assert "compiling" not in done.stderr


@pytest.fixture()
def environment(tmp_path, monkeypatch):
    """An environment that has what is asked for, and the processes that the set-up would start in it."""
    ran = []

    def run(command, **options):
        ran.append([str(word) for word in command])
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(setup_environment, "ENVIRONMENT", tmp_path)
    monkeypatch.setattr(setup_environment, "STAMP", tmp_path / "installed.json")
    (tmp_path / "installed.json").write_text(json.dumps(setup_environment.wanted_state(set())))
    monkeypatch.setattr(setup_environment.subprocess, "run", run)
    return tmp_path, ran


def test_set_up_warms_only_when_asked(environment):
    folder, ran = environment
    setup_environment.main(["--extras", "none"])
    assert ran == []
    with pytest.raises(SystemExit) as left:
        setup_environment.main(["--extras", "none", "--warm"])
    assert left.value.code == 0
    assert ran == [[str(folder / "bin" / "python"), "-m", "msv2.cli.warm"]]


@pytest.mark.parametrize(("asked", "nearest"), [
    ("modles", "models"), ("plot", "plots"), ("jugde", "judge"), ("veiwer", "viewer"), ("syth", "synth")])
def test_an_unknown_extra_lists_all_and_names_the_nearest(environment, asked, nearest):
    known = ", ".join(sorted(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]))
    with pytest.raises(SystemExit) as left:
        setup_environment.main(["--extras", f"models,{asked}"])
    assert left.value.code == f"error: extra {asked!r} is not accepted: choose of {known}; did you mean {nearest!r}?"
    assert environment[1] == []


def test_blanks_in_the_list_of_extras_are_no_part_of_a_name(environment):
    with pytest.raises(SystemExit, match="extra 'xyz'"):
        setup_environment.main(["--extras", "models, xyz"])
