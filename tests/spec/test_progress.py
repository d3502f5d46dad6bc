"""What long silent phases say on a terminal, and what they say elsewhere: nothing."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from spec import progress
from spec.paths import ROOT, cache_folder
from tests.helpers.terminals import on_a_terminal

WAIT = """
import time
from spec.progress import phase
with phase("building the simulator x"):
    time.sleep({seconds})
"""

POOL = """
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from spec.progress import phase

def work(number):
    with phase(f"phase {number}"):
        return number

if __name__ == "__main__":
    with ProcessPoolExecutor(2, mp_context=get_context("fork")) as pool:
        assert list(pool.map(work, range(4))) == [0, 1, 2, 3]
"""

KERNEL_IN_POOL = """
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
import numpy as np

def work():
    from golden.msv2_ref import fetch
    fetch.find_misses(np.zeros(3, np.int64), np.zeros(3, np.int64), 4, 2, False, False)

if __name__ == "__main__":
    with ProcessPoolExecutor(1, mp_context=get_context("fork")) as pool:
        pool.submit(work).result()
"""

KERNEL = """
from golden.kernels import compiled
from golden.msv2_ref import fetch
import numpy as np
print(fetch.find_misses(np.zeros(3, np.int64), np.zeros(3, np.int64), 4, 2, False, False))
"""


@pytest.fixture()
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("MSV2_CACHE", str(tmp_path))
    return tmp_path


def durations():
    return json.loads(cache_folder("durations.json").read_text())


def test_a_phase_says_what_it_does_and_how_long_it_took_last_time(cache):
    command = (sys.executable, "-c", WAIT.format(seconds=0.3))
    status, first = on_a_terminal(*command)
    assert status == 0 and "building the simulator x: 0 s" in first and "last time" not in first
    progress.keep_seconds("building the simulator x", 73)
    status, second = on_a_terminal(*command)
    assert "building the simulator x: 0 s (1:13 min last time)" in second
    assert second.endswith("\r\x1b[K")  # nothing of a short phase stays
    assert durations()["building the simulator x"] < 2


def test_the_line_counts_seconds_and_a_long_phase_leaves_its_time(cache):
    _, text = on_a_terminal(sys.executable, "-c", WAIT.format(seconds=2.3))
    assert "x: 1 s\r" in text and "x: 2 s\r" in text
    assert text.rstrip().endswith("\x1b[K\r\x1b[Kbuilding the simulator x: 2 s")


def test_of_nested_phases_the_inner_one_is_shown_until_it_ends(cache):
    code = "from spec.progress import phase\nwith phase('outer'):\n    with phase('inner'): pass\n    print()"
    status, text = on_a_terminal(sys.executable, "-c", code)
    assert status == 0
    assert text.split("\r\x1b[K") == ["", "outer: 0 s", "inner: 0 s", "outer: 0 s", ""]


def test_elsewhere_nothing_is_said_but_the_time_is_kept(cache, capfd):
    with progress.phase("phase"):
        pass
    assert capfd.readouterr() == ("", "")
    assert durations()["phase"] < 1


def test_the_workers_of_a_pool_are_silent(cache, tmp_path):
    (tmp_path / "pool.py").write_text(POOL)
    status, text = on_a_terminal(sys.executable, str(tmp_path / "pool.py"), env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert (status, text) == (0, "")
    assert set(durations()) == {f"phase {number}" for number in range(4)}


def test_a_phase_that_fails_is_not_timed(cache):
    with pytest.raises(RuntimeError), progress.phase("phase"):
        raise RuntimeError
    assert progress.last_seconds("phase") is None


def test_the_oldest_times_go(cache, monkeypatch):
    monkeypatch.setattr(progress, "KEPT", 3)
    for name in "abcab":
        progress.keep_seconds(name, 1)
    progress.keep_seconds("d", 1)
    assert list(durations()) == ["a", "b", "d"]


def test_processes_add_their_times_at_once(cache):
    code = "import sys\nfrom spec.progress import keep_seconds\nfor i in range(20): keep_seconds(f'{sys.argv[1]} {i}', i)"
    running = [subprocess.Popen([sys.executable, "-c", code, str(number)], cwd=ROOT) for number in range(3)]
    assert [process.wait() for process in running] == [0] * 3
    assert len(durations()) == 60


@pytest.mark.parametrize("text", ["", "[]", "{", '{"phase": "x"}'])
def test_a_broken_file_means_no_time_and_is_replaced(cache, text):
    cache_folder("durations.json").write_text(text)
    assert progress.last_seconds("phase") is None
    progress.keep_seconds("phase", 3)
    assert progress.last_seconds("phase") == 3


def test_a_cache_that_cannot_be_written_costs_the_times_only(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("MSV2_CACHE", str(tmp_path / "file"))
    with progress.phase("phase"):
        pass
    assert progress.last_seconds("phase") is None


@pytest.mark.parametrize(("seconds", "text"), [(0.4, "0 s"), (59.4, "59 s"), (59.6, "1:00 min"), (65, "1:05 min")])
def test_times(seconds, text):
    assert progress.as_time(seconds) == text


def test_kernels_are_named_while_they_are_compiled(cache):
    name = "kernel golden.msv2_ref.fetch.find_misses"
    status, text = on_a_terminal(sys.executable, "-c", KERNEL)
    assert status == 0 and f"compiling {name}: 0 s; the first run after a change of their sources" in text
    progress.keep_seconds(name, 99)
    for path in cache.rglob("*.nbi"):
        path.unlink()
    assert f"compiling {name}: 0 s (1:39 min last time)" in on_a_terminal(sys.executable, "-c", KERNEL)[1]
    assert on_a_terminal(sys.executable, "-c", KERNEL) == (0, "")  # it is in the cache


def test_the_workers_of_a_pool_name_long_kernels_in_whole_lines(cache, tmp_path):
    """So that the first point of a sweep is not silent."""
    progress.keep_seconds("kernel golden.msv2_ref.fetch.find_misses", 99)
    (tmp_path / "pool.py").write_text(KERNEL_IN_POOL)
    status, text = on_a_terminal(sys.executable, str(tmp_path / "pool.py"), env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert status == 0
    assert text.splitlines() == ["compiling kernels: the first run after a change of their sources takes longer",
                                 "compiling kernel golden.msv2_ref.fetch.find_misses (1:39 min last time)"]
