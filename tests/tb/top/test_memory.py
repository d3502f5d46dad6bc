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


def test_sizes_and_errors():
    assert [memory_beats(beats) for beats in (1, 1 << 18, (1 << 18) + 1, 1 << 20)] == [1 << 18, 1 << 18, 1 << 19, 1 << 20]
    assert broken_rules(5) == (ERRORS[1], ERRORS[4]) and broken_rules(0) == ()
