"""The registers in SystemRDL and CMSIS-SVD: read by other programs, they say what the one table says."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

from msv2.document.registers import MAKERS
from msv2.document.registers_map import (
    EVERY_MACHINE,
    JOINT_MACHINE,
    SUPERTILE_MACHINE,
    WARP_MACHINE,
    register_list,
    words_of,
)
from spec.config import TINY, TINY_V3, AcceleratorConfig
from spec.register_fields import Access, Register
from spec.registers import register_map

MACHINES = {"tiny": TINY, "without_counters": TINY.with_(counters=False), "super_tiles": TINY_V3,
            "every": EVERY_MACHINE}


def registers_of(config: AcceleratorConfig) -> dict[str, Register]:
    """The registers by name; EVERY_MACHINE stands for all machines."""
    others = (WARP_MACHINE, JOINT_MACHINE, SUPERTILE_MACHINE) if config == EVERY_MACHINE else ()
    more = tuple(register for machine in others for register in register_map(machine))
    return {r.name: r for r in (*more, *register_map(config))}


def table_of(config: AcceleratorConfig) -> dict[str, tuple[int, dict[str, tuple[int, int]]]]:
    """Address and bits (low, width) of every register; a register without bits is one number of 32."""
    return {name: (r.offset, {b.name: (b.low, b.width) for b in r.bits} or {"value": (0, 32)})
            for name, r in registers_of(config).items()}


@pytest.mark.parametrize("name", MACHINES)
def test_systemrdl_compiles_and_agrees_with_the_table(name: str, tmp_path: Path) -> None:
    systemrdl = pytest.importorskip("systemrdl", reason="needs systemrdl-compiler, of the extra `dev`")
    config, path = MACHINES[name], tmp_path / "msv2.rdl"
    path.write_text(MAKERS["msv2_registers.rdl"](config), encoding="utf-8")
    compiler = systemrdl.RDLCompiler()
    compiler.compile_file(str(path))
    registers = list(compiler.elaborate().top.registers())
    assert {r.inst_name: (r.absolute_address, {f.inst_name: (f.low, f.width) for f in r.fields()})
            for r in registers} == table_of(config)
    access = {name: r.access for name, r in registers_of(config).items()}
    for register in registers:
        assert register.get_property("regwidth") == 32
        for field in register.fields():
            strobe = field.get_property("singlepulse")
            assert field.is_sw_writable == (access[register.inst_name] is not Access.READ_ONLY)
            assert field.is_sw_readable == (not strobe)
            assert (field.get_property("onwrite") is not None) == (access[register.inst_name] is Access.CLEARING)
    status, = (r for r in registers if r.inst_name == "status")
    phase = status.get_child_by_name("phase").get_property("encode")
    assert {member.name: member.value for member in phase} == {"IDLE": 0, "CLEAR": 1, "TABLE": 2, "GEOMETRY": 3, "RENDER": 4,
                                                               "DRAIN": 5, "RESET": 6, "WAIT": 7}


@pytest.mark.parametrize("name", MACHINES)
def test_svd_agrees_with_the_table(name: str) -> None:
    config = MACHINES[name]
    device = ElementTree.fromstring(MAKERS["msv2_registers.svd"](config).encode())
    found = {}
    for item in device.iterfind("peripherals/peripheral/registers/register"):
        bits = {f.findtext("name"): (int(f.findtext("bitOffset")), int(f.findtext("bitWidth")))
                for f in item.iterfind("fields/field")}
        found[item.findtext("name")] = int(item.findtext("addressOffset"), 16), bits or {"value": (0, 32)}
    assert found == table_of(config)
    words = {item.findtext("name"): item.findtext("description") for item in device.iter("register")}
    assert words == {r.name: words_of(r) for r in register_list(config)}
    strobes = [f.findtext("name") for f in device.iter("field") if f.findtext("access") == "write-only"]
    assert strobes == [b.name for r in register_map(config) for b in r.bits if b.strobe]
    clearing = {f.findtext("name") for f in device.iter("field") if f.findtext("modifiedWriteValues") == "oneToClear"}
    assert clearing == {"done", "error"}
    codes = {v.findtext("name"): int(v.findtext("value")) for v in device.iter("enumeratedValue")}
    assert codes["WATCHDOG"] == 8 and codes["RENDER"] == 4


def test_documents_of_a_machine_name_only_its_registers() -> None:
    for make in MAKERS.values():
        assert "target_position" not in make(TINY).lower() and "target_position" in make(EVERY_MACHINE).lower()
        assert "batch_busy" not in make(TINY).lower() and "batch_busy" in make(EVERY_MACHINE).lower()
        for what in ("only with chunks", "only with stereo", "only with super-tiles", "not with super-tiles"):
            assert what not in make(TINY) and what in make(EVERY_MACHINE)
