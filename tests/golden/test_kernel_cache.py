"""The cache of compiled kernels: what makes it anew, and what happens when processes run side by side."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from numba.core import caching

from golden import kernels
from golden.msv2_ref import pipeline
from golden.scenes.embedded import textures
from golden.scenes.embedded.scene import embedded_cameras, embedded_model
from spec.paths import ROOT, cache_folder
from spec.sources import ROOMS, sources_of

WRITERS = 6

PROJECT = {
    "spec/__init__.py": "", "golden/__init__.py": "", "msv2/__init__.py": "", "msv2/report.py": "from golden import blend\n",
    "spec/constants.py": "LIMIT = 3\n",
    "spec/limits.py": "from spec.constants import LIMIT\n",
    "golden/blend.py": "from spec.limits import LIMIT\n",
    "golden/sort.py": "import numpy\n",
}
"""A small project: the kernels of golden/blend.py use a constant through another module, those of golden/sort.py none."""


@pytest.fixture()
def project(tmp_path):
    for name, text in PROJECT.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    return tmp_path


def folders(root: Path) -> dict[str, Path]:
    """Where the kernels of the small project are kept, as a new process finds it."""
    sources_of.cache_clear()
    return {name: kernels.kernel_folder.__wrapped__(name, root) for name in ("golden.blend", "golden.sort")}


def test_nobody_gets_what_another_has_compiled(tmp_path, monkeypatch):
    """Each adds a signature of the same kernel, having read the index before the others have written theirs."""
    read = caching.IndexDataCacheFile._load_index

    def read_early(self):
        index = read(self)
        time.sleep(0.02)
        return index

    def add(number):
        kernels.LockedFile(str(tmp_path), "kernel", "stamp").save(("signature", number), f"code {number}")

    monkeypatch.setattr(caching.IndexDataCacheFile, "_load_index", read_early)
    with ThreadPoolExecutor(WRITERS) as pool:
        list(pool.map(add, range(WRITERS)))
    cache = kernels.LockedFile(str(tmp_path), "kernel", "stamp")
    assert [cache.load(("signature", n)) for n in range(WRITERS)] == [f"code {n}" for n in range(WRITERS)]


def test_a_constant_makes_the_kernels_anew_that_use_it(project):
    before = folders(project)
    (project / "spec/constants.py").write_text("LIMIT = 4\n")
    after = folders(project)
    assert after["golden.blend"] != before["golden.blend"]
    assert after["golden.sort"] == before["golden.sort"]


def test_the_text_of_a_report_makes_nothing_anew(project):
    before = folders(project)
    (project / "msv2/report.py").write_text("from golden import blend  # now with a comment\n")
    assert folders(project) == before


def test_a_constant_of_the_project_reaches_its_kernels():
    """The real modules: what the renderer's kernels rest on has constants and formats in it, and no report and no RTL."""
    for module in ("golden.msv2_ref.array_kernel", "golden.msv2_ref.projection", "perf.render"):
        names = {str(path.relative_to(ROOT)) for path in sources_of(module, closed=kernels._TOOLS)}
        assert {"spec/constants.py", "golden/kernels.py"} <= names, module
        assert "spec/sources.py" not in names, module
        assert not {name for name in names if name.startswith(("msv2/studies", "rtl/", "golden/training"))}, module


def test_kernels_are_kept_in_the_users_cache_folder():
    assert Path(textures.dot.stats.cache_path).is_relative_to(cache_folder("kernels", "golden.scenes.embedded.textures"))


def test_every_kernel_has_the_decorator():
    """numba's own decorators keep code that an edit elsewhere makes stale, and write beside the sources."""
    for room in ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            assert path.name == "kernels.py" or ("njit(" not in text and "@njit" not in text and "numba.jit" not in text), path


def dot_in_a_process(cache: Path) -> tuple[float, float, str]:
    """A kernel called by a new process: its result, the seconds of compilation, what was said."""
    code = ("from golden.kernels import compile_seconds; from golden.scenes.embedded.textures import dot; "
            "print(dot((1.0, 2.0, 3.0), (4.0, 5.0, 6.0)), compile_seconds())")
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=os.environ | {"MSV2_CACHE": str(cache)},
                          capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    result, seconds = done.stdout.split()
    return float(result), float(seconds), done.stderr


def test_a_second_process_compiles_nothing_and_the_first_says_so(tmp_path):
    result, seconds, said = dot_in_a_process(tmp_path)
    assert (result, said.count("compiling kernels")) == (32.0, 1) and seconds > 0
    assert dot_in_a_process(tmp_path) == (32.0, 0.0, "")


def test_a_folder_that_cannot_be_written_costs_no_result(tmp_path):
    (tmp_path / "file").write_text("")
    assert dot_in_a_process(tmp_path / "file")[0] == 32.0


@pytest.fixture()
def new_kernel(tmp_path, monkeypatch):
    """A function that compiles a kernel and runs it: no cache has it."""
    def run() -> int:
        @kernels.compiled
        def summed(n):
            total = 0
            for i in range(n):
                total += i * i
            return total

        return summed(4)

    monkeypatch.setenv("MSV2_CACHE", str(tmp_path))
    kernels.kernel_folder.cache_clear()
    yield run
    kernels.kernel_folder.cache_clear()


def test_the_clock_of_work_stands_still_while_kernels_are_compiled(new_kernel):
    wall, work, before = time.perf_counter(), kernels.work_clock(), kernels.compile_seconds()
    assert new_kernel() == 14
    wall, work, spent = time.perf_counter() - wall, kernels.work_clock() - work, kernels.compile_seconds() - before
    assert spent > 0 and wall - work == pytest.approx(spent, abs=1e-4)


def test_a_stage_of_a_frame_does_not_count_what_it_compiled(new_kernel, monkeypatch):
    """The sort of a small frame compiles a kernel on the way."""
    def depth_order(*arguments):
        new_kernel()
        return sort(*arguments)

    model, camera = embedded_model(40), embedded_cameras()[0].resized(32, 32)
    pipeline.render(model, camera)  # whatever the frame itself needs is there now
    sort, before = pipeline.sort.depth_order, kernels.compile_seconds()
    monkeypatch.setattr(pipeline.sort, "depth_order", depth_order)
    frame = pipeline.render(model, camera)
    assert 0 < frame.seconds["sort"] < kernels.compile_seconds() - before


def test_states_that_are_not_used_any_more_go(tmp_path, monkeypatch):
    monkeypatch.setenv("MSV2_CACHE", str(tmp_path))
    module = tmp_path / "kernels" / "golden.scenes.embedded.textures"
    for age in range(12):
        (module / f"state{age}").mkdir(parents=True)
        day = time.time() - age * 12 * 3600
        os.utime(module / f"state{age}", (day, day))
    kernels.kernel_folder.cache_clear()
    locator = kernels._Locator.from_function(textures.dot.py_func, textures.__file__)
    locator.ensure_cache_path()
    kernels.kernel_folder.cache_clear()
    old = {path.name for path in module.iterdir()} - {Path(locator.get_cache_path()).name}
    assert old == {f"state{age}" for age in range(7)}  # the seven used last beside the new one
