"""The behavioural models of memories do what Amaranth's own memories do, cycle by cycle, in Icarus Verilog."""

from __future__ import annotations

import random
import shutil
import subprocess
from pathlib import Path

import pytest
from amaranth.hdl import Module
from amaranth.lib import data, memory, wiring
from amaranth.lib.wiring import In, Out
from amaranth.sim import Simulator

from msv2.verilog import memories
from msv2.verilog.memories import Shape
from msv2.verilog.rtlil import parse
from rtl.emit import to_rtlil

needs_iverilog = pytest.mark.skipif(shutil.which("iverilog") is None, reason="needs Icarus Verilog: apt-get install iverilog")
SHAPES = [Shape(5, 7, 1, False), Shape(8, 12, 4, False), Shape(6, 9, 1, True), Shape(1, 3, 1, False)]


class Store(wiring.Component):
    """A memory of a shape with all its ports."""

    def __init__(self, shape: Shape):
        self.shape = shape
        super().__init__({
            "wr_en": In(shape.lanes), "wr_addr": In(shape.address_bits), "wr_data": In(shape.width),
            "rd_en": In(1), "rd_addr": In(shape.address_bits), "rd_data": Out(shape.width)})

    def elaborate(self, platform: object) -> Module:
        m, shape = Module(), self.shape
        lanes = data.ArrayLayout(shape.width // shape.lanes, shape.lanes)
        m.submodules.rows = rows = memory.Memory(shape=lanes, depth=shape.words, init=[])
        write = rows.write_port(granularity=1 if shape.lanes > 1 else None)
        read = rows.read_port(transparent_for=(write,) if shape.through else ())
        m.d.comb += [
            write.en.eq(self.wr_en), write.addr.eq(self.wr_addr), write.data.as_value().eq(self.wr_data),
            read.en.eq(self.rd_en), read.addr.eq(self.rd_addr), self.rd_data.eq(read.data)]
        return m


def traffic(shape: Shape, cycles: int) -> list[dict[str, int]]:
    """Every row is written whole first; then reads and writes at random, often of the same row."""
    rng, everything = random.Random(5), (1 << shape.lanes) - 1
    steps = [{"wr_en": everything, "wr_addr": row, "wr_data": rng.getrandbits(shape.width), "rd_en": 0, "rd_addr": 0}
             for row in range(shape.words)]
    for _ in range(cycles):
        row = rng.randrange(shape.words)
        steps.append({"wr_en": rng.getrandbits(shape.lanes), "wr_addr": row, "wr_data": rng.getrandbits(shape.width),
                      "rd_en": rng.random() < 0.8, "rd_addr": row if rng.random() < 0.5 else rng.randrange(shape.words)})
    return steps


def amaranth_says(shape: Shape, steps: list[dict[str, int]]) -> list[int]:
    found, store = [], Store(shape)

    async def bench(ctx):
        for step in steps:
            for name, value in step.items():
                ctx.set(getattr(store, name), value)
            await ctx.tick()
            found.append(ctx.get(store.rd_data))

    simulator = Simulator(store)
    simulator.add_clock(1e-6)
    simulator.add_testbench(bench)
    simulator.run()
    return found


@needs_iverilog
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.module)
def test_the_model_is_amaranths_memory(shape: Shape, tmp_path: Path) -> None:
    steps, lines = traffic(shape, 300), []
    for step in steps:
        lines += [f"    {name} = {int(value)};" for name, value in step.items()]
        lines.append("    #1 clk = 1; #1 $display(\"%b\", rd_data); clk = 0; #1;")
    ports = (f"reg [{shape.lanes - 1}:0] wr_en; reg [{shape.address_bits - 1}:0] wr_addr, rd_addr; "
             f"reg [{shape.width - 1}:0] wr_data;")
    (tmp_path / "tb.v").write_text("\n".join([
        memories.model(shape, "x_"), "module tb;", f"  {ports}", f"  reg rd_en, clk = 0; wire [{shape.width - 1}:0] rd_data;",
        f"  x_{shape.module} dut (.clk(clk), .wr_en(wr_en), .wr_addr(wr_addr), .wr_data(wr_data), .rd_en(rd_en),",
        "    .rd_addr(rd_addr), .rd_data(rd_data));", "  initial begin", *lines, "  end", "endmodule", ""]))
    subprocess.run(["iverilog", "-g2005", "-o", "tb.vvp", "tb.v"], cwd=tmp_path, check=True)
    said = subprocess.run(["vvp", "-n", "tb.vvp"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout.split()
    wanted, read = amaranth_says(shape, steps), False
    for step, got, want in zip(steps, said, wanted, strict=True):
        read |= bool(step["rd_en"])
        assert set(got) == {"x"} if not read else int(got, 2) == want
    assert len(set(wanted)) > 3


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.module)
def test_a_memory_is_taken_out_with_its_shape(shape: Shape) -> None:
    module, = parse(to_rtlil(Store(shape), "store"))
    placed, = memories.take_out(module, "x_")
    assert (placed.instance, placed.shape) == ("\\rows", shape)
    assert [cell.kind for cell in module.cells() if "mem" in cell.kind or cell.kind.startswith("\\")] == [f"\\x_{shape.module}"]
    assert memories.take_out(module, "x_") == []


def test_other_memories_are_refused() -> None:
    class Rom(wiring.Component):
        def __init__(self):
            super().__init__({"found": Out(8), "place": In(2)})

        def elaborate(self, platform: object) -> Module:
            m = Module()
            m.submodules.rows = rows = memory.Memory(shape=8, depth=4, init=[1, 2, 3, 4])
            read = rows.read_port()
            m.d.comb += [read.addr.eq(self.place), self.found.eq(read.data)]
            return m

    module, = parse(to_rtlil(Rom(), "rom"))
    with pytest.raises(ValueError, match=r"memory \\rows must have one read port and one write port"):
        memories.take_out(module, "x_")
