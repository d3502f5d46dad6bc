"""The Verilog memory on its own, against independent AXI models."""

import pytest

pytest.importorskip("cocotbext.axi")

from tb.common.runner import simulate
from tb.top.memory import ERRORS, MemorySpeed, broken_rules, memory_beats, plusargs
from tb.top.memory_check import BEATS, memory_design


def test_memory_keeps_its_word(tmp_path):
    simulate(memory_design(), "tb.top.memory_check", tmp_path, plusargs=plusargs(tmp_path, BEATS))


def test_bandwidth_becomes_credits():
    assert [MemorySpeed(bytes_per_cycle=rate).signals["gain"] for rate in (25.6, 3.2, 32, None)] == [128, 16, 32, 0]
    assert [MemorySpeed(bytes_per_cycle=rate).signals["cost"] for rate in (25.6, 3.2, 32, None)] == [160, 160, 32, 0]


def test_both_kinds_are_settings_of_one_memory():
    plain, dram = MemorySpeed(), MemorySpeed(kind="lpddr3", clock_ns=0.8)
    assert [(s.signals["lpddr3"], s.signals["clock_ps"]) for s in (plain, dram)] == [(0, 1000), (1, 800)]
    assert plain.record == {"memory": "ideal", "latency": 100, "bytes_per_cycle": 25.6}
    assert dram.record == {"memory": "lpddr3", "latency": None, "bytes_per_cycle": None}
    for wrong in ({"kind": "ddr5"}, {"clock_ns": 0}, {"clock_ns": float("nan")}):
        with pytest.raises(ValueError, match="not "):
            MemorySpeed(**wrong)
    assert {"+lpddr3_refi=3900000", "+lpddr3_clock=1250", "+lpddr3_window=16"} <= set(plusargs("folder", 1))


def test_sizes_and_errors():
    assert [memory_beats(beats) for beats in (1, 1 << 18, (1 << 18) + 1, 1 << 20)] == [1 << 18, 1 << 18, 1 << 19, 1 << 20]
    assert broken_rules(5) == (ERRORS[1], ERRORS[4]) and broken_rules(0) == ()
