"""Every example runs, and says that all is well only where it is."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from golden.msv2_ref.tile_merge import tile_groups
from spec.config import TINY
from spec.paths import ROOT

needs_iverilog = pytest.mark.skipif(shutil.which("iverilog") is None, reason="needs Icarus Verilog: apt-get install iverilog")
EXAMPLES = ROOT / "examples"


def run(command: list[str], out: Path) -> subprocess.CompletedProcess:
    environment = os.environ | {"PYTHON": sys.executable, "OUT": str(out), "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment, cwd=ROOT)


@needs_iverilog
def test_one_unit_in_a_plain_testbench(tmp_path: Path) -> None:
    """It passes, and its groups are those of the golden renderer."""
    done = run([str(EXAMPLES / "tile_merge_unit" / "run.sh")], tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split() for line in done.stdout.splitlines() if line.startswith("tile ")]
    counts, groups = (np.array([int(row[column]) for row in rows]) for column in (3, 5))
    golden = tile_groups(TINY, counts, 6, 8)
    assert counts.sum() == 40 and groups.tolist() == golden["group"].tolist()
    assert [row[-1] == "last" for row in rows] == [bool(last) for last in golden["last"]]


@needs_iverilog
def test_the_plain_testbench_finds_a_fault(tmp_path: Path) -> None:
    """With a memory that forgets the lowest bit, the testbench fails."""
    assert run([str(EXAMPLES / "tile_merge_unit" / "run.sh")], tmp_path).returncode == 0
    model, = (tmp_path / "memories").glob("*.v")
    model.write_text(model.read_text().replace("<= wr_data;", "<= wr_data & ~24'd1;"))
    sources = ["-f", "tiny_tile_merge_unit.f", str(EXAMPLES / "tile_merge_unit" / "testbench.v")]
    subprocess.run(["iverilog", "-g2005", "-o", "faulty.vvp", *sources], cwd=tmp_path, check=True)
    said = subprocess.run(["vvp", "-n", "faulty.vvp"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    assert "FAIL" in said and "PASS" not in said


@needs_iverilog
@pytest.mark.long
def test_a_frame_behind_an_interconnect(tmp_path: Path) -> None:
    """Minutes: Icarus runs the whole machine, whose memories begin unknown."""
    done = run([sys.executable, str(EXAMPLES / "axi_system" / "frame.py"), "--out", str(tmp_path)], tmp_path)
    assert done.returncode == 0 and "0 values differ" in done.stdout, done.stdout + done.stderr


@needs_iverilog
def test_the_interconnect_compiles_for_itself() -> None:
    sources = [str(EXAMPLES / "axi_system" / name) for name in ("axi_interconnect.v", "axi_memory.v")]
    done = subprocess.run(["iverilog", "-g2005", "-Wall", "-t", "null", *sources], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "error" not in done.stderr


@pytest.mark.long
def test_one_frame_in_twenty_lines() -> None:
    """Minutes: a simulator of the machine is built."""
    text = (EXAMPLES / "one_frame.py").read_text()
    assert len([line for line in text.partition("\"\"\"\n\n")[2].splitlines() if line]) <= 20
    done = run([sys.executable, str(EXAMPLES / "one_frame.py"), "32"], ROOT)
    assert done.returncode == 0 and "equal in every bit" in done.stdout, done.stdout + done.stderr
