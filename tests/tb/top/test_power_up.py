"""Frames of a machine whose registers and memories hold anything before the first reset, as those of a chip do."""

from __future__ import annotations

import re

import pytest

from spec.config import TINY, TINY_V3
from tb.common.power_up import arguments, without_initial_values
from tb.top.device import machine
from tb.top.suite import good_plan, run_plan

SEEDS = (1, 2, 3)
"""Of the random values."""

VERILOG = """\
module unit(clk, a);
  reg [7:0] counter = 8'h05;
  output reg done = 1'h0;
  reg \\next$2  = 1'h1;
  reg [3:0] table [1:0];
  initial begin
    table[0] = 4'h1;
    table[1] = 4'h2;
  end
  reg [3:0] \\words$1  [1:0];
  initial begin
    \\words$1 [0] = 4'h0;
    \\words$1 [1] = 4'h0;
  end
  always @(posedge clk) begin
    if (a)
      \\words$1 [0] <= 4'h3;
  end
endmodule
"""


def test_tables_keep_their_contents_and_nothing_else_does():
    found = without_initial_values(VERILOG)
    assert "reg [7:0] counter ;" in found and "output reg done ;" in found and "reg \\next$2 ;" in found
    assert found.count("initial begin") == 1 and "table[1] = 4'h2;" in found and "\\words$1 [1] =" not in found
    assert "\\words$1 [0] <= 4'h3;" in found


@pytest.mark.parametrize("config", [TINY, TINY_V3], ids=lambda config: config.name)
def test_of_a_machine_only_tables_are_left(config):
    text = machine(config).verilog
    found = without_initial_values(text)
    assert re.search(r"(?m)^\s*reg .* = ", text) and not re.search(r"(?m)^\s*(output )?reg .* = ", found)
    assert 0 < found.count("initial begin") < text.count("initial begin")
    assert found.count("<=") == text.count("<=") and found.count("endmodule") == text.count("endmodule")


def test_a_seed_of_0_is_refused():
    with pytest.raises(ValueError, match="seed must be 1 or more, not 0"):
        arguments(0)


@pytest.mark.parametrize("config", [pytest.param(TINY, marks=pytest.mark.long), TINY_V3], ids=lambda config: config.name)
def test_frames_do_not_depend_on_what_registers_held(config, tmp_path):
    """The same cycles, too: nothing that lasts until the first frame is left in the machine."""
    plan = [item for item in good_plan(config, 0) if not item.error][:1]
    cycles = set()
    for seed in SEEDS:
        outcome = run_plan(config, plan, tmp_path / str(seed), seed=seed)
        assert outcome.failures == {} and outcome.runs == 1
        cycles.add(outcome.cycles)
    assert len(cycles) == 1
