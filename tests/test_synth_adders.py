"""Sums rebuilt from full adders, proved equal to the sums they replace (Yosys' SAT solver)."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pyosys.libyosys", reason="needs the extra `synth`")

from synth import flow
from synth.adders import map_adders
from synth.heap import Adder, Bit, add_up
from synth.liberty import ASAP7

MODELS = """
module FAx1_ASAP7_75t_R(input A, B, CI, output CON, SN);
  assign CON = ~(A & B | CI & (A | B)), SN = ~(A ^ B ^ CI);
endmodule
module XOR2x2_ASAP7_75t_R(input A, B, output Y); assign Y = A ^ B; endmodule
module AND2x2_ASAP7_75t_R(input A, B, output Y); assign Y = A & B; endmodule
module AND3x1_ASAP7_75t_R(input A, B, C, output Y); assign Y = A & B & C; endmodule
module AND4x1_ASAP7_75t_R(input A, B, C, D, output Y); assign Y = A & B & C & D; endmodule
module AND5x1_ASAP7_75t_R(input A, B, C, D, E, output Y); assign Y = A & B & C & D & E; endmodule
module AO21x1_ASAP7_75t_R(input A1, A2, B, output Y); assign Y = A1 & A2 | B; endmodule
"""

SUMS = {
    "multiply and accumulate": ("input [4:0] a, input [3:0] b, input [5:0] c, output [8:0] y",
                                "assign y = ({c, 3'b100} + a * b) >> 3;", (3, 2)),
    "all of a product": ("input [4:0] a, input [4:0] b, output [9:0] y", "assign y = a * b;", ()),
    "signed sum": ("input signed [7:0] a, input signed [4:0] b, output signed [7:0] y", "assign y = a + b;", (4,)),
    "difference": ("input [9:0] a, input [9:0] b, output [9:0] y", "assign y = a - b;", (3, 6)),
    "sum with a carry out": ("input [6:0] a, input [6:0] b, output [7:0] y", "assign y = a + b;", (7,)),
    "three addends": ("input [5:0] a, input [5:0] b, input [3:0] c, output [7:0] y", "assign y = a + b + c;", ()),
}


def rebuilt(path: Path, ports: str, body: str, blocks: tuple[int, ...]) -> tuple[str, dict]:
    """Verilog of the original, and the module rebuilt."""
    source, netlist = path / "source.v", path / "netlist.json"
    source.write_text(f"module gold({ports}); {body} endmodule\n")
    flow.run(f"read_verilog {source}", "hierarchy -top gold", "proc", "opt", "alumacc", "opt_clean", f"write_json {netlist}",
             log=path / "log")
    modules = json.loads(netlist.read_text())
    map_adders(modules["modules"]["gold"], ASAP7, {"y": blocks})
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
    assert ASAP7.full_adder in kinds and not any(kind.startswith(("$alu", "$macc", "$add", "$sub", "$mul")) for kind in kinds)
    assert proved(tmp_path, source)


def test_a_wrong_netlist_is_found(tmp_path: Path) -> None:
    """The proof can fail: one input of one full adder tied."""
    source, _ = rebuilt(tmp_path, *SUMS["difference"])
    modules = json.loads((tmp_path / "netlist.json").read_text())
    adder = next(cell for cell in modules["modules"]["gold"]["cells"].values() if cell["type"] == ASAP7.full_adder)
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
