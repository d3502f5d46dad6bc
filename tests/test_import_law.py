"""Who may know whom: shared formats, arithmetic written twice, and a walk from file to pixel in one direction.

A room is a package or, where its packages have laws of their own, a package below it. Starting a process in another room counts
as an import.
"""

from __future__ import annotations

import ast
import re
import sys
from functools import cache
from pathlib import Path

import pytest

from spec.paths import ROOT
from spec.sources import ROOMS, imported_names, module_file, sources_of

LAW: dict[str, tuple[str, ...]] = {
    "spec": (),
    "golden.kernels": ("spec",),
    "golden.threads": ("spec",),
    "golden.scenes": ("golden.kernels",),
    "golden.metrics": ("golden.scenes",),
    "golden.oracle": ("golden.scenes",),
    "golden.host": ("golden.scenes",),
    "golden.msv2_ref": ("golden.host", "golden.threads"),
    "golden.diff": ("golden.oracle", "golden.threads"),
    "golden.training": ("golden.diff", "golden.msv2_ref", "golden.host", "golden.metrics", "golden.oracle"),
    "rtl": ("spec",),
    "synth": ("rtl", "golden.kernels"),
    "perf": ("golden.host", "golden.msv2_ref"),
    "tb": ("rtl", "golden.metrics", "golden.oracle", "golden.host", "golden.msv2_ref"),
    "msv2.document": ("rtl",),
    "msv2.verilog": ("rtl", "msv2.document"),
    "msv2.cases": ("tb", "golden.training"),
}
"""What each room may know, directly or through what it knows; every room knows `spec`."""

EVERYTHING = ("msv2.studies", "msv2.fpga", "msv2.sweep", "msv2.video", "msv2.viewer", "msv2.cli", "msv2.__main__",
              "golden.render", "golden.train")
"""Rooms that may know all others, and that none of those may know; golden/render.py and golden/train.py are command lines."""

OPEN = ("golden", "msv2")
"""Packages that hold rooms and know none of them."""

SPEC_MAY_USE = {"numpy"}
HEAVY = {"torch", "torchvision", "gsplat", "odak"}
HEAVY_ROOMS = ("golden.diff", "golden.training", "golden.metrics", "golden.train", "msv2.studies", "msv2.cases.gradients",
               "msv2.cases.fuzz.checkpoints")
"""Where torch may be imported; elsewhere neither a picture nor a hardware test may need it."""

LIGHT = ("tests/rtl/**/*.py", "tests/tb/**/*.py", "tests/golden/msv2_ref/*.py", "tests/spec/*.py", "tests/synth/*.py",
         "tb/**/*.py", "golden/render.py", "perf/**/*.py", "msv2/cli/*.py", "tests/golden/test_render_cli.py",
         "tests/golden/test_stereo_cli.py")
"""What must run without torch."""


def module_name(path: Path) -> str:
    """Dotted name of a file, relative to the root."""
    return ".".join(path.with_suffix("").parts).removesuffix(".__init__")


def room_of(name: str) -> str:
    """The room of a module; AssertionError where it is in none."""
    parts = name.split(".")
    for length in (2, 1):
        room = ".".join(parts[:length])
        if room in LAW or room in EVERYTHING:
            return room
    assert name in OPEN, f"{name} is in no room"
    return name


def known_to(room: str) -> set[str]:
    """All rooms that a room may know."""
    if room in EVERYTHING:
        return {*LAW, *EVERYTHING, *OPEN}
    found, todo = {room, "spec", *OPEN}, list(LAW.get(room, ()))
    while todo:
        other = todo.pop()
        if other not in found:
            found.add(other)
            todo += LAW[other]
    return found


def products() -> list[Path]:
    """Every Python file of the rooms, relative to the root."""
    return [path.relative_to(ROOT) for room in ROOMS for path in sorted((ROOT / room).rglob("*.py"))]


def started(path: Path) -> set[str]:
    """Modules of ours that a file starts as processes: by `-m` and a name, or by the path of a file."""
    text = (ROOT / path).read_text(encoding="utf-8")
    if "subprocess" not in text and "runpy" not in text:
        return set()
    tree = ast.parse(text, str(path))
    docstrings = {id(node.body[0].value) for node in ast.walk(tree)
                  if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef) and node.body
                  and isinstance(node.body[0], ast.Expr)}
    words = [node.value for node in ast.walk(tree)
             if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings]
    found = {word for word in words if re.fullmatch(rf"({'|'.join(ROOMS)})(\.\w+)+", word) and module_file(word)}
    if "-m" in words:
        found |= {word for word in words if word in ROOMS}
    return found | {module_name(Path(word)) for word in words if word.endswith(".py") and (ROOT / word).is_file()}


@cache
def knows(path: Path) -> frozenset[str]:
    """Our modules that a file imports or starts."""
    names = imported_names((ROOT / path).read_text(encoding="utf-8"))
    found = set()
    for name in {name for name in names if name.partition(".")[0] in ROOMS} | started(path):
        while name and module_file(name) is None:
            name = name.rpartition(".")[0]
        found.add(name)
    return frozenset(found - {"", module_name(path)})


@pytest.mark.parametrize("room", [*LAW, *OPEN])
def test_a_room_knows_only_what_the_law_allows(room):
    files = [path for path in products() if room_of(module_name(path)) == room]
    for path in files:
        foreign = {name for name in knows(path) if room_of(name) not in known_to(room)}
        assert not foreign, f"{path} knows {sorted(foreign)}; {room} may know {sorted(known_to(room))}"


def test_every_file_is_in_a_room():
    rooms = {room_of(module_name(path)) for path in products()}
    assert rooms <= {*LAW, *EVERYTHING, *OPEN} and {"golden.diff", "msv2.cases", "perf", "tb"} <= rooms


def circles(edges: dict[str, frozenset[str]]) -> list[list[str]]:
    """Circles of a graph: sets of nodes that reach each other, by Tarjan's algorithm."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(node: str) -> None:
        order[node] = low[node] = len(order)
        stack.append(node)
        for other in edges.get(node, ()):
            if other not in order:
                visit(other)
            if other in stack:
                low[node] = min(low[node], low[other])
        if low[node] == order[node]:
            at = stack.index(node)
            if len(stack) - at > 1:
                found.append(stack[at:])
            del stack[at:]

    for node in edges:
        if node not in order:
            visit(node)
    return found


def test_no_file_imports_in_a_circle():
    names = {module_name(path): path for path in products()}
    edges = {name: frozenset(other for other in knows(path) if other in names) for name, path in names.items()}
    assert not circles(edges)


def test_circles_are_found():
    assert circles({"a": frozenset("b"), "b": frozenset("c"), "c": frozenset("b")}) == [["b", "c"]]


def reached(roots: set[str]) -> set[str]:
    """The modules of rtl that some of them import, however indirectly, with themselves."""
    names, todo, found = {module_name(path): path for path in products()}, list(roots), set()
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += [other for other in knows(names[name]) if other in names and other.startswith("rtl.")]
    return found


def test_the_frozen_files_are_those_of_machines_with_lists_by_tile_alone():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    listed = re.findall(r"`([^`]+)`", re.search(r"<!-- frozen -->(.*?)<!-- end -->", text, flags=re.S)[1])
    written = [path for name in listed for path in (
        sorted((ROOT / "rtl" / name).rglob("*.py")) if name.endswith("/") else [ROOT / "rtl" / name])]
    both = ("geometry", "render"), ("bin", "gather")
    by_tile, by_supertile = ({f"rtl.top.{name}_phase" for name in names} for names in both)
    phases = by_tile | by_supertile
    shared = {name for name in knows(Path("rtl/top/machine.py")) if name.startswith("rtl.") and name not in phases}
    own = reached(by_tile) - reached(by_supertile | shared)
    packages = {module_name(path.relative_to(ROOT)) for path in written if path.name == "__init__.py"}
    assert {module_name(path.relative_to(ROOT)) for path in written} - packages == own - packages


def test_no_product_file_is_long():
    for path in products():
        lines = (ROOT / path).read_text(encoding="utf-8").count("\n")
        assert lines <= 400, f"{path} has {lines} lines"


def test_spec_needs_numpy_only():
    for path in (path for path in products() if path.parts[0] == "spec"):
        tops = {name.partition(".")[0] for name in imported_names((ROOT / path).read_text(encoding="utf-8"))}
        others = tops - sys.stdlib_module_names - SPEC_MAY_USE - {"spec"}
        assert not others, f"{path} imports {others}"


def heavy(path: Path) -> set[str]:
    """Of the packages that few may import, those that a file does."""
    return {name.partition(".")[0] for name in imported_names((ROOT / path).read_text(encoding="utf-8"))} & HEAVY


def test_torch_stays_where_it_is_needed():
    for path in products():
        name = module_name(path)
        allowed = any(name == room or name.startswith(f"{room}.") for room in HEAVY_ROOMS)
        assert allowed or not heavy(path), f"{path} imports {heavy(path)}"


@pytest.mark.parametrize("pattern", LIGHT)
def test_hardware_and_the_renderer_need_no_torch(pattern):
    starts = [path.relative_to(ROOT) for path in sorted(ROOT.glob(pattern))]
    assert starts, pattern
    for start in starts:
        names = [name for name in imported_names((ROOT / start).read_text(encoding="utf-8")) if module_file(name)]
        reached = sources_of(*(name for name in names if name.partition(".")[0] in ROOMS))
        for path in (start, *(path.relative_to(ROOT) for path in reached)):
            assert not heavy(path), f"{start} reaches {path}, which imports {heavy(path)}"


def test_no_path_leads_out_of_the_project():
    """Apart from the default folder of test data, no file knows where the project lies or what lies beside it."""
    outside = re.compile(r"\.\." r"/shared(?!/data)|/wor" r"k/|/hom" r"e/|/roo" r"t/")
    pages = [path.relative_to(ROOT) for pattern in ("*.md", "docs/*.md", "Makefile", "pyproject.toml", ".ci/*")
             for path in ROOT.glob(pattern) if path.is_file()]
    tests = [path.relative_to(ROOT) for path in sorted((ROOT / "tests").rglob("*.py"))]
    for path in (*products(), *tests, *pages):
        text = (ROOT / path).read_text(encoding="utf-8")
        assert not outside.search(text), f"{path}: {outside.search(text)[0]}"
        for line in re.findall(r'.*/ "share' r'd".*', text):
            assert line.count('"data"') == 1, f"{path}: {line}"


def test_no_module_of_golden_bears_a_standard_name():
    """`python golden/train.py` puts golden/ itself first on the import path."""
    names = {p.stem for p in (ROOT / "golden").iterdir() if p.suffix == ".py" or p.is_dir()}
    assert not names & set(sys.stdlib_module_names)


def test_the_reader_of_imports_sees_every_form(tmp_path):
    text = ("import rtl.a as b, os\nfrom spec import c\nfrom tb.x import (\n    d,  # why\n    e as f,\n)\n"
            "def g():\n    from golden.h import i\n    import torch\n")
    assert imported_names(text) >= {"rtl.a", "os", "spec.c", "tb.x.d", "tb.x.e", "golden.h.i", "torch"}


def test_started_processes_are_seen():
    assert "tb.frame" in started(Path("msv2/studies/rtl_frame.py"))
