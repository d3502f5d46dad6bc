"""Every unit of the machine through the generic flow; memories out of the logic; shared modules once and added up."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest
from amaranth.hdl import Module
from amaranth.lib import memory, wiring
from amaranth.lib.wiring import In, Out

pytest.importorskip("pyosys.libyosys", reason="needs the extra `synth`")

from rtl.culling.near import NearTest
from rtl.float.add import FloatAdd
from rtl.float.multiply import FloatMul
from rtl.float.unit import FloatUnit
from rtl.units import UNITS
from spec.config import TINY
from spec.formats import SmallFloat
from synth import timing
from synth.design import elaborate
from synth.hints import SYNTHESISED
from synth.liberty import PDK_VARIABLE
from synth.report import Settings, synthesise

needs_timing = pytest.mark.skipif(
    not os.environ.get(PDK_VARIABLE) or not timing.available(), reason=f"needs {PDK_VARIABLE} and sta (package opensta)")

QUICK = ("block_sequencer", "fixed_to_float", "float_to_fixed", "geometry_reader", "line_buffer")
SMALL = SmallFloat(sig_bits=5, exp_bits=4, bias=7)


@pytest.mark.parametrize("name", SYNTHESISED)
def test_every_unit_elaborates(name: str) -> None:
    """Modules below it are there once, however often they are used, and pixel cores are as many as the machine's."""
    design = elaborate(UNITS[name].make(TINY), name)
    assert list(design.texts)[-1] == name and design.counts()[name] == 1
    assert all(design.counts()[module] >= 1 for module in design.texts)
    if name == "vrc_array":
        assert design.counts()["pixel_core"] == TINY.cores_x * TINY.cores_y and len(design.texts) == 3


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=() if name in QUICK else (pytest.mark.long,)) for name in SYNTHESISED])
def test_every_unit_is_synthesised(name: str, tmp_path: Path) -> None:
    """To gates, for the small machine: no memory larger than the limit is among the flip-flops, and none is lost."""
    component = UNITS[name].make(TINY)
    found = synthesise(component, name, Settings("generic", 1000.0, tmp_path))
    texts = elaborate(component, name).texts.values()
    declared = sorted(int(width) * int(words) for text in texts for width, words in re.findall(
        r"memory width (\d+) size (\d+)", text) if int(width) * int(words) > 1024)
    taken = sorted(row["words"] * row["width"] for row in found["memories"] for _ in range(row["count"]))
    assert taken == declared and found["memory_bits"] == sum(declared)
    assert found["nand2_equivalents"] > 0


class Store(wiring.Component):
    """A memory, a written word and a read one, of `words` rows."""

    def __init__(self, words: int, width: int = 8, clocked: bool = True, writes: bool = True):
        self._words, self._clocked, self._writes = words, clocked, writes
        super().__init__({"address": In(range(words)), "data": In(width), "write": In(1), "found": Out(width)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        contents = [37 * row % 256 for row in range(self._words)]
        m.submodules.rows = rows = memory.Memory(shape=len(self.data), depth=self._words, init=contents)
        read = rows.read_port(domain="sync" if self._clocked else "comb")
        m.d.comb += [read.addr.eq(self.address), self.found.eq(read.data)]
        if self._writes:
            port = rows.write_port()
            m.d.comb += [port.addr.eq(self.address), port.data.eq(self.data), port.en.eq(self.write)]
        return m


@pytest.mark.parametrize("words, options, taken, flops", [
    (256, {}, True, 0), (128, {}, False, 128 * 8 + 8), (256, {"clocked": False}, False, 256 * 8),
    (256, {"writes": False}, False, 8)])
def test_large_memories_are_not_flip_flops(
    words: int, options: dict[str, bool], taken: bool, flops: int, tmp_path: Path,
) -> None:
    """More than 1,024 bits, written, and read by the clock: listed instead."""
    found = synthesise(Store(words, **options), "store", Settings("generic", 1000.0, tmp_path))
    assert found["flip_flops"] == flops
    assert found["memories"] == ([{"count": 1, "words": 256, "width": 8, "reads": 1, "writes": 1}] if taken else [])
    assert found["memory_bits"] == (2048 if taken else 0)


def test_the_limit_can_be_lower(tmp_path: Path) -> None:
    found = synthesise(Store(4), "store", Settings("generic", 1000.0, tmp_path, memory_limit=0))
    assert found["memory_bits"] == 32 and found["flip_flops"] == 0


@needs_timing
def test_memory_pins_are_timed(tmp_path: Path) -> None:
    """A memory's data go straight to the output: what is left of the clock follows from the shares of both."""
    found = synthesise(Store(256), "store", Settings("asap7", 1000.0, tmp_path))
    assert found["memory_bits"] == 2048 and found["flip_flops"] == 0
    spent = 1000 * (timing.MEMORY_READ + timing.OUTPUT_DELAY)
    assert 1000 - spent - 60 < found["slack_ps"] < 1000 - spent


def test_operators_are_synthesised_once_and_added_up(tmp_path: Path) -> None:
    found = synthesise(NearTest(TINY.with_(culling_units=4)), "near_test", Settings("generic", 1000.0, tmp_path))
    below = found["modules_below"]
    total = found["without_modules_below"] + sum(row["count"] * row["area"] for row in below.values())
    assert found["nand2_equivalents"] == pytest.approx(total, abs=sum(row["count"] for row in below.values()))
    assert sum(row["count"] for row in below.values()) > len(below) > 2
    assert len(list(tmp_path.glob("cache/*/result.json"))) == len(below) + 1
    netlists = [json.loads(path.read_text()) for path in tmp_path.glob("cache/near_test-*/result.json")]
    assert not [kind for netlist in netlists for kind in netlist["cells_by_type"] if kind in below]


@needs_timing
@pytest.mark.parametrize("kind", [FloatAdd, FloatMul])
def test_blocks_are_chosen_until_the_clock_is_met(kind: type[FloatUnit], tmp_path: Path) -> None:
    """No sum is cut where the clock is slow; where it is so fast that ripples do not fit, some are, and time is won."""
    slow, fast = (synthesise(kind(a=SMALL, b=SMALL, result=SMALL), "unit", Settings("asap7", clock, tmp_path))
                  for clock in (2000.0, 350.0))
    assert slow["sums"] == {} and slow["slack_ps"] > 0
    assert fast["sums"] and fast["zero_slack_ps"] < slow["zero_slack_ps"]
