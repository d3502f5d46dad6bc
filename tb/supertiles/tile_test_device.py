"""The tile test of machines with super-tiles in a test bench that leads it through the phases of frames."""

from __future__ import annotations

from functools import cache

from amaranth.hdl import Module

from rtl.emit import to_verilog
from rtl.supertiles.tile_test import SuperTileTest
from spec.config import AcceleratorConfig
from spec.memory import frame_settings
from spec.queues import COUNTER_BITS
from spec.records import projected_splat, surviving_splat, tile_level
from spec.supertiles import supertile_pair
from tb.common.bench import Bench
from tb.common.emission import emitted
from tb.common.playback import Playback

_COUNTS = ("touched", "filtered", "entries", "survivors_count")


class SuperTileTestBench(Bench):
    """The unit, and a controller: `rendering` rises once the splats of the first phase have left; an item with `end` also ends
    the second phase, but does not enter the unit; `clear` comes with the next frame's table.

    Parameters:
        config: the machine's configuration.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        self._unit = SuperTileTest(config)
        widths = {f.name: f.width for f in frame_settings(config).fields}
        super().__init__(
            {"splats": projected_splat(config), "table": tile_level(config)},
            {"pairs": supertile_pair(config), "survivors": surviving_splat(config)},
            {name: widths[name] for name in ("width", "height", "obb", *(("joint", "shift") if config.joint else ()))},
            {**dict.fromkeys(_COUNTS, COUNTER_BITS), "filled": 1, "busy": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = self._unit
        self.join(m, unit, apart=("splats",))
        m.d.comb += unit.splats.payload.eq(self.splats.payload)
        with m.FSM():
            with m.State("FIRST"):
                m.d.comb += [unit.splats.valid.eq(self.splats.valid), self.splats.ready.eq(unit.splats.ready)]
                with m.If(self.splats.valid & self.splats.ready & self.splats.payload.end):
                    m.next = "TURN"
            with m.State("TURN"), m.If(~unit.busy):
                m.next = "SECOND"
            with m.State("SECOND"):
                ends = self.splats.payload.end
                m.d.comb += [unit.rendering.eq(1), unit.splats.valid.eq(self.splats.valid & ~ends),
                             self.splats.ready.eq(~ends & unit.splats.ready | ends & ~unit.busy)]
                with m.If(self.splats.valid & ends & ~unit.busy):
                    m.next = "OVER"
            with m.State("OVER"), m.If(self.table.valid):
                m.d.comb += unit.clear.eq(1)
                m.next = "FIRST"
        return m


def _emit(config: AcceleratorConfig) -> str:
    return to_verilog(SuperTileTestBench(config), "super_tile_test_bench")


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    return SuperTileTestBench(config).playback(
        f"supertile-test-{config.row_width}-{config.point_interval}-{config.streams}{'-joint' * config.joint}",
        "super_tile_test_bench",
        emitted("supertile-test-bench", config, _emit))
