"""Sums rebuilt from full adders, proved equal to the sums they replace (Yosys' SAT solver)."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from math import inf
from pathlib import Path

import pytest

pytest.importorskip("pyosys.libyosys", reason="needs the extra `synth`")

from synth import flow
from synth.adders import map_adders
from synth.heap import Adder, Bit, add_up, choose_blocks
from synth.liberty import ASAP7, Technology

MODELS = """
module FAx1_ASAP7_75t_R(input A, B, CI, output CON, SN);
  assign CON = ~(A & B | CI & (A | B)), SN = ~(A ^ B ^ CI);
endmodule
module FAX1(input A, B, C, output YC, YS); assign YC = A & B | C & (A | B), YS = A ^ B ^ C; endmodule
module XOR2x2_ASAP7_75t_R(input A, B, output Y); assign Y = A ^ B; endmodule
module AND2x2_ASAP7_75t_R(input A, B, output Y); assign Y = A & B; endmodule
module AND3x1_ASAP7_75t_R(input A, B, C, output Y); assign Y = A & B & C; endmodule
module AND4x1_ASAP7_75t_R(input A, B, C, D, output Y); assign Y = A & B & C & D; endmodule
module AND5x1_ASAP7_75t_R(input A, B, C, D, E, output Y); assign Y = A & B & C & D & E; endmodule
module AO21x1_ASAP7_75t_R(input A1, A2, B, output Y); assign Y = A1 & A2 | B; endmodule
"""

TRUE = replace(ASAP7, full_adder=("FAX1", ("A", "B", "C", "YC", "YS")), adder_inverts=False, gates={})
"""A library whose adder has true outputs, and no gates for blocks."""

SUMS = {
    "multiply and accumulate": ("input [4:0] a, input [3:0] b, input [5:0] c, output [8:0] y",
                                "assign y = ({c, 3'b100} + a * b) >> 3;", (3, 2)),
    "all of a product": ("input [4:0] a, input [4:0] b, output [9:0] y", "assign y = a * b;", ()),
    "signed product": ("input signed [4:0] a, input signed [3:0] b, output signed [10:0] y", "assign y = a * b;", (3,)),
    "signed and unsigned": ("input signed [4:0] a, input [3:0] b, output signed [9:0] y",
                            "assign y = a * $signed({1'b0, b});", ()),
    "difference of products": ("input [3:0] a, input [3:0] b, input [7:0] c, output [9:0] y", "assign y = c - a * b;", ()),
    "signed product and addend": ("input signed [3:0] a, input signed [3:0] b, input signed [4:0] c, output signed [8:0] y",
                                  "assign y = a * b - c;", ()),
    "signed sum": ("input signed [7:0] a, input signed [4:0] b, output signed [7:0] y", "assign y = a + b;", (4,)),
    "difference": ("input [9:0] a, input [9:0] b, output [9:0] y", "assign y = a - b;", (3, 6)),
    "sum with a carry out": ("input [6:0] a, input [6:0] b, output [7:0] y", "assign y = a + b;", (7,)),
    "increment": ("input [9:0] a, input c, output [11:0] y", "assign y = a + c;", (4,)),
    "increment of two numbers": ("input [7:0] a, input c, output [11:0] y", "assign y = {a[7:5], 2'b00, a[4:0]} + c;", (8,)),
    "counter": ("input [9:0] a, output [9:0] y", "assign y = a + 1;", (5,)),
    "three addends": ("input [5:0] a, input [5:0] b, input [3:0] c, output [7:0] y", "assign y = a + b + c;", ()),
}


def rebuilt(
    path: Path, ports: str, body: str, blocks: tuple[int, ...], budget: float = inf, technology: Technology = ASAP7,
) -> tuple[str, dict]:
    """Verilog of the original, and the module rebuilt."""
    source, netlist = path / "source.v", path / "netlist.json"
    source.write_text(f"module gold({ports}); {body} endmodule\n")
    flow.run(f"read_verilog {source}", "hierarchy -top gold", "proc", "opt", "alumacc", "opt_clean", f"write_json {netlist}",
             log=path / "log")
    modules = json.loads(netlist.read_text())
    map_adders(modules["modules"]["gold"], technology, {"y": blocks} if budget == inf else {}, {"": budget})
    netlist.write_text(json.dumps(modules))
    return str(source), modules["modules"]["gold"]


def proved(path: Path, source: str) -> bool:
    """Whether no input tells the rebuilt module from the original. In a process of its own: Yosys ends it on failure."""
    (path / "models.v").write_text(MODELS)
    script = [f"read_verilog {path / 'models.v'}", f"read_json {path / 'netlist.json'}", "rename gold gate",
              f"read_verilog {source}", "proc", "miter -equiv -flatten -make_outputs gold gate miter", "flatten miter", "opt",
              "sat -verify -prove trigger 0 miter"]
    program = f"from pyosys import libyosys as y; d = y.Design(); [y.run_pass(c, d) for c in {script!r}]"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert "Solving problem" in done.stdout, done.stdout + done.stderr
    return done.returncode == 0


@pytest.mark.parametrize("name", SUMS)
def test_rebuilt_sums_are_equal(name: str, tmp_path: Path) -> None:
    """No $alu, $macc or $add is left, adders are there, and no input tells the two apart."""
    source, module = rebuilt(tmp_path, *SUMS[name])
    kinds = [cell["type"] for cell in module["cells"].values()]
    assert ASAP7.full_adder[0] in kinds
    assert not any(kind.startswith(("$alu", "$macc", "$add", "$sub", "$mul")) for kind in kinds)
    assert proved(tmp_path, source)


@pytest.mark.parametrize("name, budget", [("difference of products", inf), ("signed product", 1.0), ("increment", 1.0)])
def test_sums_of_adders_with_true_outputs_are_equal(name: str, budget: float, tmp_path: Path) -> None:
    source, module = rebuilt(tmp_path, *SUMS[name], budget, TRUE)
    assert "FAX1" in [cell["type"] for cell in module["cells"].values()] and proved(tmp_path, source)


@pytest.mark.parametrize(
    "name", ["multiply and accumulate", "all of a product", "signed product", "difference", "increment",
             "increment of two numbers", "counter", "three addends"])
def test_sums_with_chosen_blocks_are_equal(name: str, tmp_path: Path) -> None:
    """The fastest that is found, whatever its area."""
    source, module = rebuilt(tmp_path, *SUMS[name][:2], (), 1.0)
    assert any(cell["type"].startswith(("XOR2", "AO21")) for cell in module["cells"].values()) and proved(tmp_path, source)


def test_a_wrong_netlist_is_found(tmp_path: Path) -> None:
    """The proof can fail: one input of one full adder tied."""
    source, _ = rebuilt(tmp_path, *SUMS["difference"])
    modules = json.loads((tmp_path / "netlist.json").read_text())
    adder = next(cell for cell in modules["modules"]["gold"]["cells"].values() if cell["type"] == ASAP7.full_adder[0])
    adder["connections"]["A"] = ["0"]
    (tmp_path / "netlist.json").write_text(json.dumps(modules))
    assert not proved(tmp_path, source)


def test_a_full_adder_removes_a_bit() -> None:
    """A heap of n bits that sums to m bits has n - m full adders."""
    columns = [[Bit(net=10 * c + i) for i in range(4)] for c in range(5)] + [[] for _ in range(4)]
    results, nodes = add_up(columns)
    full = sum(isinstance(node, Adder) and len(node.inputs) == 3 for node in nodes)
    assert full == 4 * 5 - sum(bit is not None for bit in results)


def test_blocks_must_fit() -> None:
    with pytest.raises(ValueError, match=r"at most 2 bits, not \(3,\)"):
        add_up([[Bit(net=2)], [Bit(net=3)]], (3,))


def delay(width: int, blocks: tuple[int, ...], *, skips: bool = False) -> float:
    """Estimated time of a sum of two numbers."""
    results, _ = add_up([[Bit(net=2 * c), Bit(net=2 * c + 1)] for c in range(width)], blocks, skips=skips)
    return max(bit.time for bit in results if bit is not None)


@pytest.mark.parametrize("width", [8, 26, 52])
def test_blocks_are_chosen_by_width(width: int) -> None:
    """None where the ripple is fast enough; else as few bits as the budget allows; the fastest where it cannot be met."""
    columns = [[Bit(net=2 * c), Bit(net=2 * c + 1)] for c in range(width)]
    assert choose_blocks(columns, delay(width, ())).blocks == ()
    shorter = choose_blocks(columns, delay(width, ()) - 60).blocks
    assert 0 < sum(shorter) < width and delay(width, shorter) <= delay(width, ()) - 60
    fastest = choose_blocks(columns, 1.0).blocks
    assert delay(width, fastest) <= delay(width, shorter)


def test_a_carry_that_skips_blocks_is_faster() -> None:
    """It is chosen where blocks alone are too slow, and only there."""
    columns = [[Bit(net=2 * c), Bit(net=2 * c + 1)] for c in range(52)]
    fastest = choose_blocks(columns, 1.0)
    assert fastest.skips and delay(52, fastest.blocks, skips=True) <= delay(52, fastest.blocks) - 100
    assert not choose_blocks(columns, delay(52, ()) - 60).skips


def test_a_constant_carries_too() -> None:
    """A counter: its ripple begins at the one that is added."""
    columns = [[Bit(net=2), Bit(net="1")], *([Bit(net=3 + c)] for c in range(23))]
    assert choose_blocks(columns, inf).time > 20 * 36 and choose_blocks(columns, 400.0).blocks


def test_products_in_levels_are_faster() -> None:
    """A product's tree has a ripple through its low columns unless columns are reduced all at a time."""
    def columns() -> list[list[Bit]]:
        return [[Bit(product=(2, 3)) for _ in range(min(c + 1, 31 - c))] for c in range(32)]

    fastest = choose_blocks(columns(), 1.0)
    times = [max(bit.time for bit in add_up(columns(), *cut)[0] if bit) for cut in ((), fastest[1:])]
    assert fastest.in_levels and times[1] < 0.7 * times[0]
