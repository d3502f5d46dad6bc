"""The AXI master and the register file in Verilator: on memories of every temper, and under a host."""

from __future__ import annotations

import re

import pytest

from rtl.units import emit
from spec.config import TINY
from tb.axi.suite import REGISTER_SCENARIOS, VARIANTS, Registers, full_plan, run_plan


@pytest.mark.parametrize(("unit", "variant"), [("master", "tiny"), ("registers", "tiny"), ("registers", "stereo"),
                                              ("registers", "memories")])
def test_every_scenario(unit, variant, tmp_path):
    config = VARIANTS[variant]
    plan = [item for item in full_plan(config, 1, 120) if isinstance(item, Registers) == (unit == "registers")]
    outcome = run_plan(config, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(plan)


def test_every_register_scenario_is_planned():
    from tb.axi import registers

    assert set(registers.SCENARIOS) == set(REGISTER_SCENARIOS)


@pytest.mark.long
@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("seed", [2, 3])
def test_whole_plan(variant, seed, tmp_path):
    config = VARIANTS[variant]
    outcome = run_plan(config, full_plan(config, seed, 1000), tmp_path)
    assert outcome.failures == {}


def test_ports_have_the_names_that_tools_look_for():
    master, registers = emit("axi_master", TINY), emit("register_file", TINY)
    for text, kind, prefix, width, names in (
        (master, "output", "m_axi", 32, ("awaddr", "araddr", "wstrb")), (master, "output", "m_axi", 256, ("wdata",)),
        (master, "input", "m_axi", 256, ("rdata",)), (master, "input", "m_axi", 3, ("rid", "bid")),
        (registers, "input", "s_axi", 12, ("awaddr", "araddr")), (registers, "input", "s_axi", 32, ("wdata",)),
        (registers, "output", "s_axi", 32, ("rdata",)),
    ):
        for name in names:
            assert re.search(rf"^  {kind} \[{width - 1}:0\] {prefix}_{name} ?;", text, re.MULTILINE), name
    for kind, names in (
        ("output", ("awvalid", "wvalid", "wlast", "arvalid", "bready", "rready")),
        ("input", ("awready", "wready", "arready", "rvalid", "bvalid")),
    ):
        assert all(re.search(rf"^  {kind} m_axi_{name} ?;", master, re.MULTILINE) for name in names)


def test_without_counters_there_is_no_port_for_them():
    for name, present in (("tiny", True), ("without_counters", False)):
        listed = re.search(r"\((.*?)\);", emit("register_file", VARIANTS[name]), re.DOTALL)[1]
        assert bool(re.search(r"\bcounters\b", listed)) == present
