"""Folders of runs side by side."""

from __future__ import annotations

import subprocess
import sys
from contextlib import ExitStack

import pytest

from spec.errors import InputError
from spec.paths import ROOT
from spec.private import locked, output_folder, private_folder

HOLD = """
import sys
from pathlib import Path
from spec.private import private_folder
with private_folder(Path(sys.argv[1])) as folder:
    print(folder.name, flush=True)
    sys.stdin.readline()
"""

RACE = """
import sys
from pathlib import Path
from spec.private import private_folder
for _ in range(200):
    with private_folder(Path(sys.argv[1])) as folder:
        mine = folder / "mine"
        mine.touch(exist_ok=False)
        mine.unlink()
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
        with pytest.raises(RuntimeError), private_folder(tmp_path / "work") as folder:
            assert folder.name == "work"
            raise RuntimeError


def test_nothing_stays_but_outputs(tmp_path):
    with private_folder(tmp_path / "empty"):
        pass
    with private_folder(tmp_path / "used") as folder:
        (folder / "result").touch()
    with output_folder(tmp_path / "given", tmp_path / "default") as folder:
        (folder / "result").touch()
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == [
        "given", "given/result", "used", "used/result"]


def test_runs_that_begin_and_end_at_once_never_share_a_folder(tmp_path):
    """Each makes a file that must not exist in its folder; locks and folders come and go under the others' hands."""
    command = [sys.executable, "-c", RACE, str(tmp_path / "work")]
    running = [subprocess.Popen(command, cwd=ROOT) for _ in range(4)]
    assert [process.wait() for process in running] == [0] * 4


def test_without_a_name_the_default_is_taken_or_one_beside_it(tmp_path):
    with ExitStack() as held:
        names = [held.enter_context(output_folder(None, tmp_path / "frame")).name for _ in range(3)]
    assert names == ["frame", "frame-2", "frame-3"]


def test_a_named_folder_that_another_run_uses_is_refused(tmp_path):
    with output_folder(str(tmp_path / "mine"), tmp_path / "default") as folder:
        assert folder == tmp_path / "mine"
        with pytest.raises(InputError, match=r"output folder .*mine is not accepted while another run writes to it"):
            output_folder(folder, tmp_path / "default").__enter__()
    with output_folder(folder, tmp_path / "default"):
        pass


def test_a_place_that_is_none_is_refused(tmp_path):
    (tmp_path / "file").touch()
    for given, default in ((tmp_path / "file", tmp_path), (None, tmp_path / "file" / "below")):
        with pytest.raises(InputError, match="a writable place is"):
            output_folder(given, default).__enter__()


def test_a_lock_is_waited_for(tmp_path):
    code = f"import spec.private, pathlib\nwith spec.private.locked(pathlib.Path({str(tmp_path / 'lock')!r})): print('in')"
    with locked(tmp_path / "lock"):
        waiting = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, text=True)
        with pytest.raises(subprocess.TimeoutExpired):
            waiting.wait(1)
    assert waiting.communicate()[0] == "in\n"
