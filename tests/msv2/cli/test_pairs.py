"""Two runs of a command at once: each has a folder of its own, and neither reads or overwrites what the other has."""

from __future__ import annotations

import fcntl
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from msv2.cli.main import main
from spec.errors import InputError
from spec.paths import ROOT
from spec.private import LOCK

RUN = """
import sys, importlib, pathlib
module = importlib.import_module(sys.argv[1])
module.BUILD = pathlib.Path(sys.argv[2])
sys.exit(module.main(sys.argv[3:]))
"""
"""A command whose default output folder lies in another `build`, so that the checkout's is left alone."""

HALT = """
import os, signal
from spec import private
claimed = private._claimed
def halting(place):
    private._claimed = claimed
    lock = claimed(place)
    os.kill(os.getpid(), signal.SIGSTOP)
    return lock
private._claimed = halting
"""
"""Halts a command when it has claimed its folder, however busy the machine is."""

SMALL = ("embedded", "--size", "32x24", "--levels", "4", "--gaze")


def started(module: str, build: Path, *arguments: str, before: str = "") -> subprocess.Popen:
    command = [sys.executable, "-c", before + RUN, module, str(build), *arguments]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def at_once(module: str, build: Path, first: tuple[str, ...], second: tuple[str, ...]) -> list[str]:
    """What two runs print that certainly overlap: the first one is halted in its folder until the second one has ended."""
    one = started(module, build, *first, before=HALT)
    os.waitid(os.P_PID, one.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
    assert one.poll() is None, one.communicate()[0]
    try:
        other = started(module, build, *second)
        said = other.communicate(timeout=600)[0]
    finally:
        os.kill(one.pid, signal.SIGCONT)
    texts = [one.communicate(timeout=600)[0], said]
    assert (one.returncode, other.returncode) == (0, 0), "\n".join(texts)
    return texts


@pytest.mark.parametrize(("module", "folder", "record", "options"), [
    ("golden.render", "render/embedded", "stats.json", ()),
    ("perf.__main__", "perf/frame", "perf.json", ("--no-cache",)),
    ("tb.frame.__main__", "frame", "frame.json", ("--part", "array", "--config", "tiny")),
])
def test_two_frames_at_once(tmp_path, module, folder, record, options):
    gazes = ("3,4", "20,10")
    at_once(module, tmp_path, *((*SMALL, gaze, *options) for gaze in gazes))
    for place, gaze in zip((folder, f"{folder}-2"), gazes, strict=True):
        written = json.loads((tmp_path / place / record).read_text())
        assert written["gaze"] == [float(part) for part in gaze.split(",")], place
        assert written.get("bit_exact", True)


def test_the_same_named_folder_is_refused_while_it_is_in_use(tmp_path):
    out = tmp_path / "mine"
    out.mkdir()
    with open(out / LOCK, "w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        for command in ("render", "perf", "frame"):
            with pytest.raises(InputError, match=r"output folder .*mine is not accepted while another run writes to it"):
                main([command, *SMALL, "3,4", "--out", str(out)])


def test_two_simulations_of_a_unit_at_once(tmp_path):
    """With other seeds these read each other's stimuli once: 20 of 48 runs were equal."""
    seeds = (("--seed", "3"), ("--seed", "4"))
    texts = at_once("tb.sim", tmp_path, *(("--test", "tmu", "--config", "tiny", *seed) for seed in seeds))
    for text, (_, seed) in zip(texts, seeds, strict=True):
        assert f"seed {seed}" in text
        equal, of = re.search(r"(\d+) of (\d+) runs equal", text).groups()
        assert equal == of and int(of) > 10
    assert {path.name for path in (tmp_path / "tmu").iterdir()} == {"tiny", "tiny-2"}


def test_two_syntheses_of_a_unit_at_once(tmp_path):
    """The second one waits for the first one's modules, so that each is made once."""
    pytest.importorskip("pyosys.libyosys", reason="needs the extra `synth`")
    pair = [started("synth.__main__", tmp_path, "--unit", "saturation_counters") for _ in range(2)]
    texts = [process.communicate(timeout=600)[0] for process in pair]
    assert [process.returncode for process in pair] == [0, 0], texts
    assert texts[0] == texts[1] and "NAND2 equivalents" in texts[0]
    logs = list((tmp_path / "synth").rglob("yosys.log"))
    assert logs and all(log.read_text().count("Executing ABC pass") == 1 for log in logs)
