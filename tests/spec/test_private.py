"""Work folders of runs side by side."""

from __future__ import annotations

import subprocess
import sys

from spec.paths import ROOT
from spec.private import private_folder

HOLD = """
import sys
from pathlib import Path
from spec.private import private_folder
with private_folder(Path(sys.argv[1])) as folder:
    print(folder.name, flush=True)
    sys.stdin.readline()
"""


def test_runs_side_by_side_have_folders_of_their_own(tmp_path):
    command = [sys.executable, "-c", HOLD, str(tmp_path / "work")]
    running = []
    for expected in ("work", "work-2"):
        running.append(subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True))
        assert running[-1].stdout.readline().strip() == expected
    with private_folder(tmp_path / "work") as folder:
        assert folder.name == "work-3"
    for process in running:
        process.communicate("\n")
    with private_folder(tmp_path / "work") as folder:
        assert folder.name == "work"


def test_a_failed_run_frees_its_folder(tmp_path):
    for _ in range(2):
        try:
            with private_folder(tmp_path / "work") as folder:
                assert folder.name == "work"
                raise RuntimeError
        except RuntimeError:
            pass
