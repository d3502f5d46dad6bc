"""Area of a whole machine: nothing left out, nothing counted twice, memories by macros, sums that add up."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

pytest.importorskip("pyosys.libyosys", reason="needs the extra `synth`")

from msv2.studies.area import replaced, study
from msv2.studies.area.page import page
from rtl.top.machine import Machine
from spec.config import TINY, TINY_EYES_WARP, TINY_V3, AcceleratorConfig
from synth import area, machine, macros
from synth.design import Design, elaborate
from synth.liberty import ASAP7, PDK_VARIABLE
from synth.memories import Macro
from synth.scaling import TO_16NM, same_clock

pytestmark = pytest.mark.slow  # the first test of a process emits the machine, whichever that is

TWO_EYES = TINY.with_(stereo=True, order="spatial", chunks=True, records="compact")
"""The small machine with every unit of those with lists by tile."""

EVERY = {"two eyes": TWO_EYES, "super-tiles": TINY_V3, "joint": TINY_EYES_WARP}
"""Machines that have every unit between them."""


@cache
def emitted(config: AcceleratorConfig = TWO_EYES) -> Design:
    """A machine as it is emitted."""
    return elaborate(Machine(config), machine.TOP)


@cache
def cut(config: AcceleratorConfig = TWO_EYES) -> Design:
    return machine.cut(emitted(config))


def instances(design: Design) -> Counter[str]:
    """How often each module of the emitted machine is instantiated, by walking down from its top; names without `$N`."""
    texts = {found[1]: found[0] for text in design.texts.values()
             for found in re.finditer(r"(?ms)^module \\(\S+)\n.*?^end$", text)}
    counted: Counter[str] = Counter()
    waiting = [machine.TOP]
    while waiting:
        name = waiting.pop()
        counted[re.sub(r"\$\d+", "", name)] += 1
        waiting += [kind for kind in re.findall(r"(?m)^\s*cell \\(\S+) ", texts[name]) if kind in texts]
    return counted


def modules_in(text: str) -> list[str]:
    """Names of a text's modules, units' by their path as in the emission."""
    return [re.sub(r"\$\d+", "", name).replace("__", ".") for name in re.findall(r"(?m)^module \\(\S+)", text)]


@pytest.mark.parametrize("name", ["two eyes", "joint", pytest.param("super-tiles", marks=pytest.mark.long)])
def test_every_module_is_in_one_unit_as_often_as_in_the_machine(name: str) -> None:
    """The emitted hierarchy, walked instance by instance, against the units' texts and their counts of shared modules."""
    config = EVERY[name]
    design = cut(config)
    units = [machine.label(path) for path in machine.UNIT_GROUPS if machine.label(path) in design.texts]
    found: Counter[str] = Counter()
    for unit in units:
        counts = Counter({unit: 1}) + area.shared_in(design, unit)
        for name, count in counts.items():
            for module in modules_in(design.texts[name]):
                found[module] += count
    assert found == Counter({name.replace("__", "."): count for name, count in instances(emitted(config)).items()})
    assert found["batch_core" if config.supertiles else "pixel_core"] == TINY.cores_x * TINY.cores_y


@pytest.mark.slow  # where it is the first that asks for it, it elaborates a machine
def test_units_are_all_there() -> None:
    found = {name: {path for path in machine.UNIT_GROUPS if machine.label(path) in cut(config).texts}
             for name, config in EVERY.items()}
    assert set().union(*found.values()) == set(machine.UNIT_GROUPS)
    assert found["joint"] - found["super-tiles"] - found["two eyes"] == set(machine.JOINT_UNITS)
    assert found["super-tiles"] - found["two eyes"] == set(machine.SUPERTILE_UNITS)
    assert found["super-tiles"] > set(machine.CHUNK_UNITS)


@pytest.mark.long
def test_a_machine_for_one_eye_has_no_warp_unit() -> None:
    one = machine.cut(elaborate(Machine(TINY), machine.TOP))
    missing = {path for path in machine.UNIT_GROUPS if machine.label(path) not in one.texts}
    others = {*machine.CHUNK_UNITS, *machine.SUPERTILE_UNITS, *machine.JOINT_UNITS}
    assert missing > others
    missing -= others
    assert {machine.UNIT_GROUPS[path] for path in missing} == {machine.WARP} and len(missing) == 3


@pytest.mark.parametrize("path", ["render.extra", "geometry.extra.inner", "extra"])
def test_a_new_submodule_must_be_given_a_unit(path: str) -> None:
    text = emitted().texts[machine.TOP] + f"\nmodule \\{machine.TOP}.{path}\nend\n"
    with pytest.raises(ValueError, match=f"'{path}' of the machine must be one of the units"):
        machine.cut(replace(emitted(), texts={**emitted().texts, machine.TOP: text}))


def test_a_module_is_named_once() -> None:
    text = f"module \\{machine.TOP}.fork$1\nend\nmodule \\{machine.TOP}.fork$2\nend\n"
    with pytest.raises(ValueError, match="one module 'fork', not two"):
        machine.modules_of(text)


def instances_of(modules: dict[str, str]) -> list[tuple[str, str, str]]:
    """(module, instance, port) of every connection to a module among them."""
    kinds = {machine._module_name(text) for text in modules.values()}
    return [(cell[1], cell[2], port) for text in modules.values()
            for cell in re.finditer(r"(?ms)^\s*cell \\(\S+) (\S+)\n(.*?)^\s*end$", text) if cell[1] in kinds
            for port in re.findall(r"(?m)^\s*connect (\S+) ", cell[3])]


def test_ports_without_a_name_are_numbered_by_their_module_alone() -> None:
    """Other numbers for the machine's nets change no module; every port is still connected to what it was."""
    before = machine.modules_of(emitted().texts[machine.TOP])
    number = re.compile(r"(?<=\\port\$)\d+")
    renumbered = {path: number.sub(lambda found: f"{7 * int(found[0]) + 1}", text) for path, text in before.items()}
    after = machine.steady(before)
    assert before != after == machine.steady(renumbered) == machine.steady(after)
    for path, text in before.items():
        names = machine._steady_ports(text)
        assert len(set(names.values())) == len(names)
        assert number.sub("", text) == number.sub("", after[path])
    ports = {machine._module_name(text): set(re.findall(r"(?m)^\s*wire .*(?:input|output) \d+\s+(\S+)$", text))
             for text in after.values()}
    found = instances_of(after)
    assert len(found) == len(instances_of(before)) > 1000 and all(port in ports[kind] for kind, _, port in found)


def result(name: str) -> dict:
    """A stand-in for what synthesis gives of a module: an area of its own, and the memories that its text declares."""
    stores = [{"name": memory, "words": int(words), "width": int(width), "reads": 1, "writes": 1,
               "made_as": "macro" if int(words) * int(width) > 1024 else "flip-flops: small"}
              for width, words, memory in re.findall(r"(?m)memory width (\d+) size (\d+) \\(\S+)", cut().texts[name])]
    return {"area": 100.0 + len(name), "slack_ps": -float(len(name)), "netlist": "", "stores": stores, "memories": [],
            "cells_by_type": {"NAND2x1": len(name), "DFFHQNx1": 2}}


@pytest.fixture
def report(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> area.AreaReport:
    """The small machine's report, of stand-ins."""
    monkeypatch.setattr(area.Settings, "check", lambda self: None)
    monkeypatch.setattr(area.Settings, "library", lambda self: (ASAP7, tmp_path))
    monkeypatch.setattr(area, "machine_design", lambda config, folder: cut())
    monkeypatch.setattr(area, "module_result", lambda design, name, below, settings, is_timed: result(name))
    monkeypatch.setattr(area, "timed", lambda name, parts, settings: {"slack_ps": -1.0, "worst_path": None})
    return area.machine_area(TWO_EYES, "asap7", folder=tmp_path, progress=lambda line: None)


def test_parts_sum_to_the_whole(report: area.AreaReport) -> None:
    """Rows, groups and modules times their counts are the same area; memories are the declared ones, each once."""
    counts = instances(emitted())
    whole = sum(row["count"] * row["area"] for row in report.modules.values())
    assert sum(row.logic_um2 for row in report.rows) == pytest.approx(whole)
    groups = report.groups()
    assert sum(sums["logic_um2"] for sums in groups.values()) == pytest.approx(whole)
    assert report.total_mm2_16nm(memories=False) == pytest.approx(whole * TO_16NM["asap7"].area / 1e6)
    held = sum(row.area_um2 for row in report.memories)
    assert report.total_mm2_16nm() == pytest.approx((whole + held) * TO_16NM["asap7"].area / 1e6)
    warp = sum(row.area_um2_16nm for row in report.memories if row.group == machine.WARP)
    assert warp > 0 and report.total_mm2_16nm() - report.total_mm2_16nm(warp_memories=False) == pytest.approx(warp / 1e6)
    declared = Counter()
    for name, text in cut().texts.items():
        for width, words in re.findall(r"memory width (\d+) size (\d+)", text):
            declared[int(words), int(width)] += counts[name] if name in counts else 1
    listed = Counter()
    for row in report.memories:
        listed[row.words, row.width] += row.count
    assert listed == declared
    assert all(row.factor == TO_16NM["asap7"].area and "Stillmaker" in row.factor_source for row in report.rows)
    assert sum(row.memory_um2 for row in report.rows) == pytest.approx(held)


@pytest.mark.skipif(not (study.REPORTS / "area.json").exists(), reason="make report-area has not been run")
def test_the_page_is_the_reports() -> None:
    kept = json.loads((study.REPORTS / "area.json").read_text())
    assert (study.REPORTS / "area.md").read_text() == page(kept), "run: make report-area"
    logic = kept["split"]["array"] + kept["split"]["other logic"]
    assert kept["builds"]["1ghz"]["mm2_16nm_logic"] == pytest.approx(logic, abs=2e-4)
    units = {row["unit"] for row in kept["rows"]}
    more = {*machine.CHUNK_UNITS, *machine.SUPERTILE_UNITS, *machine.JOINT_UNITS}
    assert units == {path or machine.TOP for path in machine.UNIT_GROUPS if path not in more}


@pytest.mark.skipif(not (study.REPORTS / "area.json").exists(), reason="make report-area has not been run")
def test_parts_of_both_machines_add_up_to_their_builds() -> None:
    """Every unit is in one part; those of the machine with lists by tile are of an array for two eyes, hence the tolerance."""
    kept = json.loads((study.REPORTS / "area.json").read_text())
    old, new = (sum(sum(row[side]) for row in replaced.parts(kept)) / 1e6 for side in (1, 2))
    assert new == pytest.approx(kept["builds"]["v3"]["mm2_16nm"], abs=2e-4)
    assert old == pytest.approx(kept["builds"]["mono"]["mm2_16nm"], rel=0.02)


@pytest.mark.skipif(not (study.REPORTS / "area.json").exists(), reason="make report-area has not been run")
def test_a_unit_without_a_part_is_named() -> None:
    kept = json.loads((study.REPORTS / "area.json").read_text())
    kept["builds"]["v3"]["units"][0]["unit"] = "render.other"
    with pytest.raises(ValueError, match=r"not .*render\.other.* besides"):
        replaced.parts(kept)


@pytest.fixture
def sizes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A table of three macros."""
    folder = tmp_path / macros.FOLDER
    folder.mkdir()
    for size, cost in (("64x32", 130.0), ("128x32", 250.0), ("256x64", 1000.0)):
        (folder / f"{macros.FAMILY}_{size}.lib").write_text(f"cell(a) {{\n    area : {cost};\n}}\n")
    monkeypatch.setenv(PDK_VARIABLE, str(tmp_path))
    return tmp_path


def test_memories_are_put_together_of_macros(sizes: Path) -> None:
    """Exactly one; two side by side; two upon another with a multiplexer; folded; a copy for a second read port."""
    name = "fakeram7_dp_"
    exact = macros.make(Macro(128, 32, 1, 1))
    assert exact.macros == {f"{name}128x32": 1} and exact.area_um2 == 250.0 and "liberty" in exact.source
    assert macros.make(Macro(120, 60, 1, 1)).macros == {f"{name}128x32": 2}
    stacked = macros.make(Macro(192, 32, 1, 1))
    assert stacked.macros == {f"{name}128x32": 1, f"{name}64x32": 1}
    assert stacked.area_um2 == pytest.approx(380.0 + 32 * macros.MUX_UM2)
    folded = macros.make(Macro(512, 8, 1, 1))
    assert folded.macros == {f"{name}128x32": 1} and folded.area_um2 == pytest.approx(250.0 + 3 * 8 * macros.MUX_UM2)
    twice = macros.make(Macro(128, 32, 2, 1))
    assert twice.macros == {f"{name}128x32": 2} and twice.area_um2 == 500.0
    assert macros.make(Macro(256, 64, 1, 1)).area_um2 <= 1000.0


def test_shallow_memories_are_flip_flops_where_that_is_smaller(sizes: Path) -> None:
    few = macros.make(Macro(2, 40, 1, 1))
    assert few.kind == "flip-flops" and not few.macros
    assert few.area_um2 == pytest.approx(80 * macros.FLOP_UM2 + 40 * macros.MUX_UM2 + 2 * macros.WORD_UM2)


@pytest.mark.parametrize("words, width", [(70, 40), (300, 17), (1000, 1), (4096, 65), (14400, 23)])
def test_macros_hold_every_bit(words: int, width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a table, by its density: never less area than the bits take, and more bits never take less."""
    monkeypatch.delenv(PDK_VARIABLE, raising=False)
    made = macros.make(Macro(words, width, 1, 1))
    held = sum(count * int(size[0]) * int(size[1]) for name, count in made.macros.items()
               for size in [name.rpartition("_")[2].split("x")])
    assert held >= words * width and made.area_um2 >= held * macros.DENSITY_UM2 - 1e-6
    assert macros.make(Macro(2 * words, width, 1, 1)).area_um2 > made.area_um2


def test_more_write_ports_than_a_macro_has_are_refused() -> None:
    with pytest.raises(ValueError, match="one write port or 2 ports in all"):
        macros.make(Macro(64, 32, 1, 2))


def test_clocks_scale_alike() -> None:
    """ASAP7's nanosecond, 2.08 ns at 16 nm, is 3.9 ns of 45 nm and 24.6 of 180 nm."""
    assert same_clock(1000.0, "asap7", "asap7") == 1000.0
    assert same_clock(1000.0, "asap7", "nangate45") == 3875.0 and same_clock(1000.0, "asap7", "osu018") == 24575.0
