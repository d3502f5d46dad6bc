"""Fixtures that several areas share, the markers that follow from what a test imports, and what a run of tests prints.

    torch   reaches a module that imports torch
    rtl     reaches the runner of Verilator, lies in tests/rtl or tests/tb, or starts a simulation as a process
    data    takes the fixture `data_dir`
    slow    has taken more processor time than `allowed_seconds`, by tests/slow.json, which `--record-slow` writes; tests of the
            project's structure never are

`make check` runs the tests that have none of these markers, and no `long`.
"""

from __future__ import annotations

import gc
import json
import math
import os
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from spec.paths import ROOT
from spec.sources import ROOMS, imported_names, module_file, sources_of

DEFAULT_DATA = Path(__file__).parents[2] / "shared" / "data"

SLOW_SECONDS = 0.7
"""Processor time of a test function with all its parameters from which on `make check` leaves it out."""

NOTICING = ("tests/spec/", "tests/golden/host/", "tests/golden/msv2_ref/")
"""Folders whose tests notice mutants of spec and golden, for which only quick tests are run..."""

NOTICING_SECONDS = 7.0
"""... and which are therefore left out from a longer time on."""

SLOW = Path(__file__).parent / "slow.json"

ALWAYS = ("test_import_law.py", "test_packaging.py")
"""Tests of the project's structure, which `make check` runs however long they take."""

SIMULATIONS = re.compile(r"""["'](tb\.(frame|sim)|msv2\.cases|frame|sim|demo)["']""")
"""Processes that build simulators."""

if "PYTEST_XDIST_WORKER" in os.environ:  # a process a core: more threads would wait for each other
    os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--record-slow", action="store_true", help="write the processor times of slow tests to tests/slow.json")


def pytest_collection_finish() -> None:
    """All modules are in memory, and stay: collections of garbage need not look through them (an eighth of units' tests)."""
    gc.freeze()


@cache
def reached(path: Path) -> frozenset[Path]:
    """A test's file, the shared test code that it imports, and all modules of ours that these import."""
    names = imported_names(path.read_text(encoding="utf-8"))
    found = {path}
    for name in names:
        if name.startswith("tests.") and (file := module_file(name)) and file != path:
            found |= reached(file)
    return frozenset(found.union(sources_of(*(n for n in names if n.partition(".")[0] in ROOMS and module_file(n)))))


@cache
def imports_torch(path: Path) -> bool:
    text = path.read_text(encoding="utf-8")
    return 'importorskip("torch' in text or any(name.partition(".")[0] == "torch" for name in imported_names(text))


@cache
def markers_of(path: Path) -> tuple[str, ...]:
    """The markers that a file's contents call for."""
    files, place = reached(path), path.relative_to(ROOT / "tests").parts[0]
    text = path.read_text(encoding="utf-8")
    simulates = (place in ("rtl", "tb", "examples") or "verilator" in text or ROOT / "tb" / "common" / "runner.py" in files
                 or ("sys.executable" in text and SIMULATIONS.search(text)))
    return (*(["torch"] if any(imports_torch(file) for file in files) else []), *(["rtl"] if simulates else []))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Files are not even imported whose markers a run leaves out as a whole: torch alone takes seconds."""
    left_out = re.fullmatch(r"not \((.*)\)", config.option.markexpr)
    if left_out and collection_path.suffix == ".py" and collection_path.name.startswith("test_"):
        return bool({*markers_of(collection_path)} & {*left_out[1].split(" or ")}) or None
    return None


def function_of(nodeid: str) -> str:
    """A test without its parameters."""
    return nodeid.partition("[")[0]


def allowed_seconds(name: str) -> float:
    """Processor time from which on a test function is slow."""
    return NOTICING_SECONDS if name.startswith(NOTICING) else SLOW_SECONDS


def pytest_collection_modifyitems(items: list[pytest.Function]) -> None:
    slow = json.loads(SLOW.read_text())["seconds"] if SLOW.exists() else {}
    for item in items:
        for name in markers_of(item.path):
            item.add_marker(name)
        if "data_dir" in item.fixturenames:
            item.add_marker("data")
        if function_of(item.nodeid) in slow and item.path.name not in ALWAYS:
            item.add_marker("slow")


def processor_seconds() -> float:
    """Of this process and of those that it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def compile_seconds() -> float:
    kernels = sys.modules.get("golden.kernels")
    return kernels.compile_seconds() if kernels else 0.0


def measured(item: pytest.Item) -> Iterator[None]:
    """Notes what a phase of a test took; one that compiled kernels is not measured, as the next run will not compile them."""
    begin, compiled = processor_seconds(), compile_seconds()
    yield
    item.user_properties.append(
        ("processor_s", processor_seconds() - begin if compile_seconds() == compiled else float("nan")))


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    yield from measured(item)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    yield from measured(item)


class Reporter:
    """Names failures at once, and keeps the time of each test."""

    def __init__(self, config: pytest.Config) -> None:
        self.config, self.seconds = config, {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        terminal = self.config.pluginmanager.get_plugin("terminalreporter")
        if report.failed and terminal:
            crash = getattr(report.longrepr, "reprcrash", None)
            why = crash.message.splitlines()[0][:160] if crash else report.when
            terminal.write(f"\nFAILED {report.nodeid}: {why}\n", red=True)
        if report.when == "call":
            spent = sum(value for name, value in report.user_properties if name == "processor_s")
            name = function_of(report.nodeid)
            self.seconds[name] = self.seconds.get(name, 0.0) + spent  # NaN stays NaN

    def pytest_sessionfinish(self) -> None:
        if self.config.option.record_slow:
            kept = json.loads(SLOW.read_text())["seconds"] if SLOW.exists() else {}
            known = {name: value for name, value in self.seconds.items() if not math.isnan(value)}
            kept = {name: value for name, value in kept.items() if name not in known}
            kept |= {name: round(value, 1) for name, value in known.items() if value > allowed_seconds(name)}
            text = {"command": "python -m pytest --record-slow", "seconds": dict(sorted(kept.items()))}
            SLOW.write_text(json.dumps(text, indent=1) + "\n")


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):  # of the processes of a run, the one that reports
        config.pluginmanager.register(Reporter(config))


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real scenes; the test is skipped where it is absent."""
    folder = Path(os.environ.get("MSV2_DATA", DEFAULT_DATA))
    if not folder.is_dir():
        pytest.skip(f"no real scenes at {folder}: set MSV2_DATA to their folder")
    return folder
