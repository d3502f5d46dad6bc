"""The Verilog memory on its own, against independent AXI models."""

import pytest

pytest.importorskip("cocotbext.axi")

from tb.common.runner import simulate
from tb.top.memory import ERRORS, MemorySpeed, beats_log2, broken_rules
from tb.top.memory_check import memory_design


def test_memory_keeps_its_word(tmp_path):
    simulate(memory_design(), "tb.top.memory_check", tmp_path)


def test_bandwidth_becomes_credits():
    assert [MemorySpeed(bytes_per_cycle=rate).signals["gain"] for rate in (25.6, 3.2, 32, None)] == [128, 16, 32, 0]
    assert [MemorySpeed(bytes_per_cycle=rate).signals["cost"] for rate in (25.6, 3.2, 32, None)] == [160, 160, 32, 0]


def test_sizes_and_errors():
    assert [beats_log2(beats) for beats in (1, 1 << 18, (1 << 18) + 1, 1 << 20)] == [18, 18, 19, 20]
    assert broken_rules(5) == (ERRORS[1], ERRORS[4]) and broken_rules(0) == ()
