"""Judges mutants of Python, each in a process that runs in a copy of the project."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
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
_SLACK, _SECONDS = 4, 120
"""A mutant may take _SLACK times as long as the project without a fault, and _SECONDS more, since kernels are compiled anew."""


@dataclass(frozen=True)
class Part:
    """A part of the project whose mutants are drawn.

    Attributes:
        name: its name.
        paths: the files.
        tests: folders of the quick tests that are run where no case notices a mutant.
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
        self._seconds = 3600.0
        self._run()  # compiles the kernels
        begin = time.monotonic()
        wrong = self._run()
        if wrong["by"]:
            raise RuntimeError(f"{part.name} fails without a mutant: {wrong['words']}")
        self._seconds = _SLACK * (time.monotonic() - begin) + _SECONDS

    def judge(self, mutant: SourceMutant) -> dict[str, str]:
        """`by`: "case" or "test", where one notices the mutant, "hang" or "crash", or "" where nothing does; `words`: what was
        wrong."""
        path = self._copy / mutant.path
        sound, states = path.read_text(), self._states()
        try:
            path.write_text(mutated(sound, mutant))
            return self._run()
        finally:
            path.write_text(sound)
            for state in self._states() - states:
                shutil.rmtree(state, ignore_errors=True)

    def _states(self) -> set[Path]:
        """The folders of compiled kernels."""
        return set((self._folder / "cache" / "kernels").glob("*/*"))

    def _run(self) -> dict[str, str]:
        result = self._folder / "result.json"
        result.unlink(missing_ok=True)
        process = subprocess.Popen(
            [sys.executable, "-m", WORKER, str(result), *self._part.first, "cases", *self._part.tests], cwd=self._copy,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True, preexec_fn=_limit,
            env=os.environ | {"PYTHONPATH": str(self._copy), "MSV2_CACHE": str(self._folder / "cache"),
                              "PYTHONDONTWRITEBYTECODE": "1"})
        try:
            process.wait(self._seconds)
        except subprocess.TimeoutExpired:
            return {"by": "hang", "words": f"no end in {self._seconds:.0f} s"}
        finally:
            _end(process)
        try:
            return dict(read_json(result))
        except (OSError, ValueError, json.JSONDecodeError):
            return {"by": "crash", "words": f"the process ended with {process.returncode}"}


def _limit() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ends what is left of a process and of those that it began."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        return
    process.wait()

