"""Kernels kept by their contents: what changes a kernel's key, what does not, and that kept code is found again."""

from __future__ import annotations

import importlib.util
import itertools
import os
import subprocess
import sys
from pathlib import Path

import pytest

from msv2.cases.source_mutants import contents
from spec.paths import ROOT

HELPER = "STEP = 3\n\nclass Code:\n    pass\n"

MODULE = '''import numpy as np
import helper_of_kernels as helper
from numba import njit
from typing import NamedTuple

TABLE = np.arange(4)
SCALE, UNUSED = (1, 2.5), 7

class Constants(NamedTuple):
    low: int
    high: int

@njit
def called(x):
    return x + SCALE[0]

def kernel(x, k, most=9):
    if x > k.high:
        return called(x) * TABLE[0]
    return np.floor(x) - helper.STEP + most
'''

_numbers = itertools.count()


def key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str = MODULE, helper: str = HELPER) -> str:
    """The key of `kernel` in these modules, which stand for the project's."""
    monkeypatch.setattr(contents, "ROOT", tmp_path)
    found = []
    for name, body in (("helper_of_kernels", helper), (f"module{next(_numbers)}", text)):
        path = tmp_path / f"{name}.py"
        path.write_text(body)
        spec = importlib.util.spec_from_file_location(name, path)
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, name, module)
        exec(compile(body, path, "exec"), module.__dict__)  # without a .pyc, which could be that of the same second
        found.append(module)
    return contents.content(found[1].kernel)


def test_places_comments_and_what_is_not_used_change_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    first = key(tmp_path, monkeypatch)
    for old, new in (("import numpy", "# a comment\n\n\nimport numpy"), ("UNUSED = (1, 2.5), 7", "UNUSED = (1, 2.5), 8")):
        assert old in MODULE and key(tmp_path, monkeypatch, MODULE.replace(old, new)) == first
    assert key(tmp_path, monkeypatch, helper=HELPER + "OTHER = 2\n") == first


@pytest.mark.parametrize(("old", "new"), [
    ("x > k.high", "x >= k.high"), ("most=9", "most=8"), ("x + SCALE", "x - SCALE"), ("(1, 2.5)", "(2, 2.5)"),
    ("arange(4)", "arange(5)"), ("low: int\n    high: int", "high: int\n    low: int"), ("TABLE[0]", "TABLE[1]"),
    ("np.floor", "np.ceil"), ("@njit", "@njit(error_model='numpy')")])
def test_what_a_kernel_consists_of_changes_its_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str):
    assert MODULE.count(old) == 1
    assert key(tmp_path, monkeypatch, MODULE.replace(old, new)) != key(tmp_path, monkeypatch)


def test_values_of_other_modules_and_whole_files_of_what_is_opaque_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    assert key(tmp_path, monkeypatch, helper=HELPER.replace("3", "4")) != key(tmp_path, monkeypatch)
    opaque = MODULE.replace("helper.STEP", "helper.Code")
    changed = HELPER.replace("pass", "value = 1")
    assert key(tmp_path, monkeypatch, opaque, changed) != key(tmp_path, monkeypatch, opaque)


def test_kept_code_is_found_by_another_process_and_changed_code_is_not(tmp_path: Path):
    """A kernel of the project is compiled once; with another constant of its module it is compiled again."""
    code = """
import sys
from msv2.cases.source_mutants.contents import keep_by_content
keep_by_content()
import numpy as np
from golden.msv2_ref import fetch
from golden.kernels import compiled_kernels
if sys.argv[1:]:
    fetch.MAX_LEVELS = int(sys.argv[1])
zero = np.zeros(4, np.int64)
print(fetch.find_misses(zero, zero, 4, 2, False, False).sum(), compiled_kernels())
"""
    environment = os.environ | {"MSV2_CACHE": str(tmp_path), "PYTHONPATH": str(ROOT)}

    def run(*words: str) -> str:
        return subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True,
                              env=environment).stdout.strip()

    assert [run(), run(), run("8"), run("8")] == ["1 1", "1 0", "1 1", "1 0"]
