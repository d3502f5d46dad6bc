"""Who may import whom: shared formats, arithmetic written twice.

spec imports nothing of ours; golden and rtl import only spec, never each other; perf reads spec and golden's traces;
synth reads spec and rtl; tb may all. torch stays in training and in the bench: neither a picture nor a hardware test
needs it.
"""

from __future__ import annotations

import ast
import re
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAW = {
    "spec": {"spec"},
    "golden": {"golden", "spec"},
    "rtl": {"rtl", "spec"},
    "perf": {"perf", "golden", "spec"},
    "synth": {"synth", "rtl", "spec"},
    "tb": {"tb", "perf", "synth", "rtl", "golden", "spec"},
}
SPEC_MAY_USE = {"numpy"}
HEAVY = {"torch", "torchvision", "gsplat", "odak"}
HEAVY_PLACES = re.compile(
    r"^(golden/training/|golden/train\.py$|golden/stereo_rules\.py$|golden/stereo_tables/|golden/metrics/(ssim|banded|pyramid|pooling|hvsq|lpips|binocular)\.py$|bench/|[a-z]+/bench[^/]*"
    r"|tests/(test_(training|bench|metrics_)|training_)|tests/tools/)")
LIGHT = ("tests/test_rtl_*.py", "tests/test_tb_*.py", "tests/test_golden_*.py", "tests/test_spec_*.py", "tests/test_synth*.py",
         "tb/**/*.py", "golden/render.py")


def sources(*folders: str) -> list[Path]:
    """Every Python file of the folders, relative to the root."""
    found = [path.relative_to(ROOT) for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]
    assert found, folders
    return found


@cache
def imports(path: Path) -> frozenset[str]:
    """Dotted names of what the file imports, anywhere in it, by statement or by importlib with a literal."""
    names = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"), str(path))):
        match node:
            case ast.Import(names=aliases):
                names |= {alias.name for alias in aliases}
            case ast.ImportFrom(module=module, names=aliases, level=level):
                parts = path.parent.parts[: len(path.parent.parts) - level + 1] if level else ()
                module = ".".join([*parts, *([module] if module else [])])
                names |= {module} | {f"{module}.{alias.name}" for alias in aliases}
            case ast.Call(
                func=ast.Name(id="__import__") | ast.Attribute(attr="import_module"), args=[ast.Constant(value=str(name)), *_]
            ):
                names.add(name)
    return frozenset(names)


def tops(names: frozenset[str]) -> set[str]:
    return {name.partition(".")[0] for name in names}


@pytest.mark.parametrize("package", LAW)
def test_packages_import_only_what_the_law_allows(package):
    if not (ROOT / package).is_dir() or not any((ROOT / package).rglob("*.py")):
        pytest.skip(f"{package}/ holds no Python yet")
    for path in sources(package):
        foreign = tops(imports(path)) & set(LAW) - LAW[package]
        assert not foreign, f"{path} imports {foreign}; {package} may import {LAW[package]}"


def test_spec_needs_numpy_only():
    for path in sources("spec"):
        others = tops(imports(path)) - sys.stdlib_module_names - SPEC_MAY_USE - {"spec"}
        assert not others, f"{path} imports {others}"


def test_oracle_and_integer_renderer_are_independent():
    for path in sources("golden/oracle"):
        assert not any(name.startswith("golden.msv2_ref") for name in imports(path)), path
    for path in sources("golden/msv2_ref"):
        assert not any(name.startswith("golden.oracle") for name in imports(path)), path


def test_torch_stays_in_training_and_bench():
    for path in sources(*(p for p in (*LAW, "tests") if (ROOT / p).is_dir() and any((ROOT / p).rglob("*.py")))):
        heavy = tops(imports(path)) & HEAVY
        assert not heavy or HEAVY_PLACES.match(path.as_posix()), f"{path} imports {heavy}"


def reached(start: Path) -> set[Path]:
    """Our files that importing `start` runs or may run."""
    todo, seen = [start], set()
    while todo:
        path = todo.pop()
        if path in seen:
            continue
        seen.add(path)
        for name in imports(path):
            base = Path(*name.split("."))
            todo += [p for p in (base.with_suffix(".py"), base / "__init__.py", "tests" / base.with_suffix(".py"))
                     if (ROOT / p).is_file()]
    return seen


@pytest.mark.parametrize("pattern", LIGHT)
def test_hardware_tests_and_the_renderer_need_no_torch(pattern):
    for start in sorted(ROOT.glob(pattern)):
        for path in reached(start.relative_to(ROOT)):
            assert not tops(imports(path)) & HEAVY, f"{start} reaches {path}, which imports torch"


def test_no_path_leads_out_of_the_project():
    """Apart from the default folder of test data, no file knows where the project lies or what lies beside it."""
    outside = re.compile(r"\.\." r"/shared(?!/data)|/wor" r"k/|/hom" r"e/|/roo" r"t/")
    files = [*sources(*(p for p in LAW if any((ROOT / p).rglob("*.py")))), *sources("tests")]
    files += [p.relative_to(ROOT) for p in (*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("Makefile"),
                                            *ROOT.glob("pyproject.toml"), *ROOT.glob(".ci/*")) if p.is_file()]
    for path in files:
        text = (ROOT / path).read_text(encoding="utf-8")
        assert not outside.search(text), f"{path}: {outside.search(text)[0]}"
        for line in re.findall(r'.*"share' r'd".*', text):
            assert line.count('"data"') == 1, f"{path}: {line}"


def test_no_module_of_golden_bears_a_standard_name():
    """`python golden/train.py` puts golden/ itself first on the import path."""
    names = {p.stem for p in (ROOT / "golden").iterdir() if p.suffix == ".py" or p.is_dir()}
    assert not names & set(sys.stdlib_module_names)


def test_the_reader_of_imports_sees_every_form(tmp_path, monkeypatch):
    monkeypatch.setattr("test_import_law.ROOT", tmp_path)
    path = Path("golden/sub/probe.py")
    (tmp_path / path).parent.mkdir(parents=True)
    (tmp_path / path).write_text(
        "import rtl.a as b\nfrom spec import c\nfrom . import d\nfrom ..e import f\n"
        "def g():\n    import torch\n    import importlib\n    importlib.import_module('tb.h')\n")
    assert imports(path) >= {"rtl.a", "spec.c", "golden.sub.d", "golden.e.f", "torch", "tb.h"}
