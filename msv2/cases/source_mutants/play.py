"""Judges mutants of Python, each in a process that runs in a copy of the project."""

from __future__ import annotations

import ast
import json
import math
import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from golden.scenes.files import read_json
from msv2.cases.source_mutants.draw import SourceMutant, mutated
from spec.paths import ROOT
from spec.sources import ROOMS

WORKER = "msv2.cases.source_mutants.worker"

_BESIDE = ("tests", "docs", "examples", "reports")
"""Folders that tests read."""

_MEMORY = 8 << 30
_SLACK = 1.5
"""A mutant may take _SLACK times the processor time of the project without a fault and without compiled kernels. Time on the
wall depends on what else the machine does, so it is bounded much more loosely."""

_WALL = 12
"""Seconds on the wall that a mutant may take for each second of its limit of processor time."""


@dataclass(frozen=True)
class Part:
    """A part of the project whose mutants are drawn.

    Attributes:
        name: its name.
        paths: the files.
        tests: folders of the quick tests that are run where no case notices a mutant; those that import its module first.
        first: those that are run before the cases.
    """

    name: str
    paths: tuple[str, ...]
    tests: tuple[str, ...]
    first: tuple[str, ...] = ()


_SPEC = ("chunks", "codes", "compact", "constants", "formats", "guard_band", "harmonics", "joint", "joint_warp", "memory",
         "number_formats", "packed", "packing", "records", "saturations", "stereo", "supertiles", "tables")
_HOST = ("chunks", "compact", "joint_registers", "memory_image", "order", "packed_frame", "quantise", "registers", "rounding",
         "stereo_registers", "two_frames")
_TESTS = ("tests/golden/msv2_ref", "tests/golden/host")

PARTS = {part.name: part for part in (
    Part("spec", tuple(f"spec/{name}.py" for name in _SPEC), _TESTS, ("tests/spec",)),
    Part("golden", (*(f"golden/host/{name}.py" for name in _HOST),
                    *sorted(f"golden/msv2_ref/{path.name}" for path in (ROOT / "golden" / "msv2_ref").glob("*.py"))), _TESTS))}
"""What golden and RTL share, by modules that say what is computed and where it lies in memory; and the integer renderer."""


class Judge:
    """Judges mutants in a copy of the project.

    Parameters:
        part: the part whose tests are run.
        folder: for the copy, with a cache of its own; what is there is replaced.

    Raises:
        RuntimeError: a case or a test fails without a mutant.
    """

    def __init__(self, part: Part, folder: Path):
        self._part, self._folder = part, folder.resolve()
        self._copy = self._folder / "copy"
        shutil.rmtree(self._copy, ignore_errors=True)
        ignored = shutil.ignore_patterns("__pycache__")
        for name in (*ROOMS, *_BESIDE):
            shutil.copytree(ROOT / name, self._copy / name, ignore=ignored)
        for path in ROOT.iterdir():
            if path.is_file():
                shutil.copy2(path, self._copy)
        shutil.rmtree(self._folder / "cache", ignore_errors=True)
        self._seconds = 3600.0
        before = _processor_seconds()
        wrong = self._run(list(part.first), list(part.tests))
        if wrong["by"]:
            raise RuntimeError(f"{part.name} fails without a mutant: {wrong['words']}")
        self._seconds = _SLACK * (_processor_seconds() - before)

    def judge(self, mutant: SourceMutant) -> dict[str, str]:
        """`by`: "case" or "test", where one notices the mutant, "hang" or "crash", or "" where nothing does; `words`: what was
        wrong."""
        path = self._copy / mutant.path
        sound = path.read_text()
        try:
            path.write_text(mutated(sound, mutant))
            steps = self._part.first, self._part.tests
            return self._run(*(importing_first(mutant.path, folders, self._copy) for folders in steps))
        finally:
            path.write_text(sound)

    def _run(self, first: list[str], after: list[str]) -> dict[str, str]:
        result = self._folder / "result.json"
        result.unlink(missing_ok=True)
        seconds = math.ceil(self._seconds)
        process = subprocess.Popen(
            [sys.executable, "-m", WORKER, str(result), *first, "cases", *after], cwd=self._copy,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True, preexec_fn=lambda: _limit(seconds),
            env=os.environ | {"PYTHONPATH": str(self._copy), "MSV2_CACHE": str(self._folder / "cache"),
                              "PYTHONDONTWRITEBYTECODE": "1"})
        try:
            process.wait(_WALL * seconds)
        except subprocess.TimeoutExpired:
            return {"by": "hang", "words": f"no end in {_WALL * seconds} s"}
        finally:
            _end(process)
        if process.returncode == -signal.SIGXCPU:
            return {"by": "hang", "words": f"no end in {seconds} s of processor time"}
        try:
            return dict(read_json(result))
        except (OSError, ValueError, json.JSONDecodeError):
            return {"by": "crash", "words": f"the process ended with {process.returncode}"}


def _limit(seconds: int) -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))


def _processor_seconds() -> float:
    """Processor time of all processes that were begun here and have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def importing_first(path: str, folders: Sequence[str], root: Path) -> list[str]:
    """The test files of some folders, from `root` on; first those that import the module of a path, which are the likeliest to
    notice a fault in it."""
    tests = [file for folder in folders for file in sorted((root / folder).glob("test_*.py"))]
    module = path.removesuffix(".py").replace("/", ".")
    return [str(file.relative_to(root)) for file in sorted(tests, key=lambda file: module not in _imports(file))]


def _imports(file: Path) -> set[str]:
    """The dotted names of all modules that a file may import, and of what it takes from them."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ends what is left of a process and of those that it began."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        return
    process.wait()

