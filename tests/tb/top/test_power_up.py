"""Frames of machines that begin with random bits in every register and memory: only the reset may be needed."""

from __future__ import annotations

import numpy as np
import pytest
from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from rtl.emit import to_rtlil, verilog_of
from spec.config import TINY, TINY_V3
from tb.top.planned import planned, problems
from tb.top.player import play_frames
from tb.top.power_up import powered_up, without_initial_values
from tb.top.stimuli import case, cloud


@pytest.mark.parametrize("config", [
    pytest.param(TINY_V3, id="tiny_v3"), pytest.param(TINY, id="tiny", marks=pytest.mark.long)])
def test_a_reset_is_enough(config, tmp_path):
    """Three starts; after each a frame, and another one without a reset."""
    rng = np.random.default_rng(5)
    scene = case(config, "scene", cloud(rng, 120, levels=config.levels, sh=1), (48, 33), gaze=(10, 8))
    plan = [planned(scene, "after the reset"), planned(scene, "the next", reset=False, poison=False)]
    for seed in (1, 2, 3):
        results = play_frames(powered_up(config), [item.run for item in plan], tmp_path / str(seed), start=seed)
        assert [problems(item, result) for item, result in zip(plan, results, strict=True)] == [[], []], seed


class Holder(wiring.Component):
    """A register and a memory with initial values."""

    def __init__(self):
        super().__init__({"place": In(2), "value": Out(8, init=5)})

    def elaborate(self, platform):
        m = Module()
        m.submodules.kept = kept = Memory(shape=8, depth=4, init=[1, 2, 3, 4])
        read, write = kept.read_port(domain="comb"), kept.write_port()
        m.d.comb += [read.addr.eq(self.place), write.addr.eq(self.place), write.data.eq(self.value), write.en.eq(1)]
        m.d.sync += self.value.eq(read.data)
        return m


def test_initial_values_are_removed():
    text = to_rtlil(Holder(), "holder")
    bare = without_initial_values(text)
    assert "initial" in verilog_of(text) and "8'h05" in verilog_of(text)
    assert "initial" not in bare and "kept" in bare and "reg [7:0] value;" in bare
