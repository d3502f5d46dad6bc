"""What an installed wheel has in it, and what its commands need of it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import pytest

from msv2.studies.energy.table import TABLE
from msv2.studies.performance.area import REPORT
from spec.paths import BUILD, REPORTS, ROOT, cache_folder, short_path
from spec.sources import ROOMS, imported_names

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
SETUPTOOLS = PROJECT["tool"]["setuptools"]

IMPORTED_AS = {"pillow": "PIL", "scikit-image": "skimage", "warp-lang": "warp", "amaranth": "amaranth",
               "cocotbext-axi": "cocotbext", "systemrdl-compiler": "systemrdl", "mkdocs-material": "mkdocs",
               "pytest-xdist": "xdist"}
"""Names of packages that are imported under another."""

BROUGHT = {"cocotb_tools": "cocotb", "llvmlite": "numba"}
"""Packages that a declared one brings, and which are used only together with it."""


def distributions(requirements: list[str]) -> set[str]:
    """Names of what the requirements ask for, as they are imported."""
    names = set()
    for each in requirements:
        name = each.split("[")[0].split(">")[0].split("=")[0].split("<")[0].strip()
        names.add(IMPORTED_AS.get(name, name.replace("-", "_")))
    return names


def test_the_list_of_packages_is_that_of_the_tree():
    found = {".".join(path.parent.relative_to(ROOT).parts) for room in ROOMS for path in (ROOT / room).rglob("__init__.py")}
    assert {*SETUPTOOLS["packages"]} == found | {"msv2.reports"}


def test_every_file_of_the_packages_is_shipped():
    """Files that are no modules are package data."""
    for room in ROOMS:
        for path in (ROOT / room).rglob("*"):
            if path.is_file() and path.suffix not in (".py", ".pyc", ".tmp"):
                package = ".".join(path.parent.relative_to(ROOT).parts)
                patterns = SETUPTOOLS["package-data"].get(package, [])
                assert any(path.match(pattern) for pattern in patterns), f"{path.relative_to(ROOT)} is in no package data"


def test_numbers_that_commands_read_are_shipped():
    shipped = {path for pattern in SETUPTOOLS["package-data"]["msv2.reports"]
               for path in (ROOT / SETUPTOOLS["package-dir"]["msv2.reports"]).glob(pattern)}
    assert {TABLE, REPORT, REPORTS / "machine.json", REPORTS / "model.json"} <= shipped


def test_everything_that_is_imported_is_declared():
    """By the project or by one of its extras: what another package happens to bring is not relied on."""
    extras = PROJECT["project"]["optional-dependencies"]
    declared = distributions([*PROJECT["project"]["dependencies"], *chain.from_iterable(extras.values())])
    ours = {*ROOMS, "tests"}
    for room in ROOMS:
        for path in (ROOT / room).rglob("*.py"):
            names = {name.partition(".")[0] for name in imported_names(path.read_text(encoding="utf-8"))}
            others = names - sys.stdlib_module_names - ours - declared - {*BROUGHT, ""}
            others = {name for name in others if find_spec(name) is not None}  # words of a docstring are no packages
            assert not others, f"{path.relative_to(ROOT)} imports {others}"


@pytest.mark.parametrize(("variables", "folder"), [
    ({"MSV2_CACHE": "/a/b"}, "/a/b"),
    ({"MSV2_CACHE": "/a/b", "XDG_CACHE_HOME": "/c"}, "/a/b"),
    ({"XDG_CACHE_HOME": "/c"}, "/c/msv2"),
    ({"XDG_CACHE_HOME": "relative"}, "~/.cache/msv2"),
    ({}, "~/.cache/msv2"),
])
def test_the_cache_folder_is_the_users(monkeypatch, variables, folder):
    for name in ("MSV2_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert cache_folder("kernels") == Path(folder).expanduser() / "kernels"


def test_paths_are_shown_from_where_one_stands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert short_path(tmp_path / "build" / "x") == short_path(Path("build/x")) == str(Path("build/x"))
    assert short_path(BUILD) == str(BUILD)


@pytest.mark.long
def test_an_installed_wheel_renders(tmp_path):
    """The wheel alone, on the packages that are here, away from the checkout: a picture, and cycles by the model."""
    sources = tmp_path / "sources"  # a copy: setuptools would ship what earlier builds left in build/lib
    shutil.copytree(ROOT, sources, ignore=shutil.ignore_patterns("build", ".*", "*.egg-info", "__pycache__", "docs", "tests"))
    run(tmp_path, sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation", "-w", tmp_path, sources)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        tops = {name.split("/")[0] for name in archive.namelist()}
        assert {name for name in tops if not name.endswith(".dist-info")} == set(ROOMS)
        archive.extractall(tmp_path / "site")
    away = tmp_path / "away"
    away.mkdir()
    said = run(away, sys.executable, "-m", "golden.render", "--size", "64x64", site=tmp_path / "site")
    assert "build/render/embedded_trained: splats" in said and (away / "build/render/embedded_trained/frame.png").is_file()
    run(away, sys.executable, "-m", "perf", "--size", "64x64", site=tmp_path / "site")
    assert (away / "build/perf/frame/perf.json").is_file()
    run(away, sys.executable, "-m", "msv2.studies", "energy", "--size", "64x64", "--out", "out", site=tmp_path / "site")
    assert not list((tmp_path / "site").rglob("build"))


def run(folder: Path, *command: object, site: Path | None = None) -> str:
    """Output of a process in a folder, which finds our packages in `site`."""
    environment = os.environ | ({"PYTHONPATH": str(site)} if site else {})
    done = subprocess.run([str(each) for each in command], cwd=folder, env=environment, capture_output=True, text=True,
                          check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout
