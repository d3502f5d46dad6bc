"""The controller of two frames in flight: their phases side by side, and every way out of them."""

from __future__ import annotations

import pytest

from rtl.top.overlap_controller import OverlapController
from spec.codes import ErrorCode, Phase
from spec.config import TINY_OVERLAP
from tests.rtl.top.test_controller import simulate

STROBES = ("clear", "start_table", "start_geometry", "hand_over", "start_render", "finished", "first_finished")
FIRST = (Phase.CLEAR, Phase.TABLE, Phase.GEOMETRY)


class Host:
    """Drives a controller cycle by cycle, and remembers its strobes, by the cycle."""

    def __init__(self, ctx, dut):
        self.ctx, self.dut, self.cycle, self.strobes = ctx, dut, 0, []
        for name in ("first_ready", "bus_quiet", "progress"):
            ctx.set(getattr(dut, name), 1)
        ctx.set(dut.width, 40)
        ctx.set(dut.height, 20)

    def get(self, name):
        return self.ctx.get(getattr(self.dut, name))

    async def tick(self, cycles=1, **inputs):
        for _ in range(cycles):
            for name, value in inputs.items():
                self.ctx.set(getattr(self.dut, name), value)
            self.strobes += [(name, self.cycle) for name in STROBES if self.get(name)]
            await self.ctx.tick()
            self.cycle += 1

    async def pulse(self, **inputs):
        await self.tick(**inputs)
        await self.tick(**dict.fromkeys(inputs, 0))

    async def first(self, phase):
        """Starts a frame and brings it into a phase of its first half, WAIT included."""
        await self.pulse(start=1)
        while self.get("first_phase") == Phase.CLEAR and phase != Phase.CLEAR:
            await self.tick()
        for done, after in (("table_done", Phase.TABLE), ("geometry_done", Phase.GEOMETRY)):
            if phase > after:
                await self.pulse(**{done: 1})

    async def second(self):
        """Brings a frame into its second phase."""
        await self.first(Phase.WAIT)
        await self.tick(6)
        assert (self.get("first_phase"), self.get("phase")) == (Phase.IDLE, Phase.RENDER)

    def names(self):
        return [name for name, _ in self.strobes]


def bench(test):
    dut = OverlapController(TINY_OVERLAP, watchdog_bits=6)

    async def run(ctx):
        await test(Host(ctx, dut))

    simulate(dut, run)


def test_a_frame_that_is_first_done_waits_for_the_one_before():
    async def test(host):
        await host.second()
        assert host.get("which") == 1 and host.get("busy") and not host.get("first_busy")
        host.ctx.set(host.dut.width, 70)
        await host.first(Phase.WAIT)
        await host.tick(9)
        assert host.get("first_phase") == Phase.WAIT and host.get("first_busy") and host.names().count("hand_over") == 1
        assert (host.get("tiles_x"), host.get("second_tiles_x"), host.get("second_tile_count")) == (5, 3, 6)
        await host.tick(render_done=1)
        await host.tick(6, render_done=0)
        times = {name: cycle for name, cycle in host.strobes if name in ("finished", "hand_over", "start_render")}
        assert times["hand_over"] == times["finished"] + 1 and times["start_render"] == times["hand_over"] + 4
        assert (host.get("which"), host.get("second_tiles_x"), host.get("phase")) == (0, 5, Phase.RENDER)
        await host.pulse(render_done=1)
        assert not host.get("busy") and host.names() == [*STROBES[:5], *STROBES[:3], "finished", *STROBES[3:5], "finished"]

    bench(test)


@pytest.mark.parametrize("phase", [*FIRST, Phase.WAIT], ids=lambda phase: phase.name)
@pytest.mark.parametrize(("inputs", "codes"), [
    ({"abort": 1}, (ErrorCode.ABORTED, ErrorCode.ABORTED)),
    ({"first_failure": ErrorCode.ENTRIES_FULL}, (ErrorCode.ABORTED, ErrorCode.ENTRIES_FULL)),
    ({"failure": ErrorCode.SPILL_FULL}, (ErrorCode.SPILL_FULL, ErrorCode.ABORTED)),
    ({"failure": ErrorCode.SPILL_FULL, "first_failure": ErrorCode.READ_ERROR, "abort": 1},
     (ErrorCode.SPILL_FULL, ErrorCode.READ_ERROR)),
    ({"failure": ErrorCode.WRITE_ERROR, "render_done": 1, "geometry_done": 1}, (ErrorCode.WRITE_ERROR, ErrorCode.ABORTED)),
], ids=["abort", "first", "second", "both", "at their ends"])
def test_both_frames_end_where_one_fails(phase, inputs, codes):
    async def test(host):
        await host.second()
        await host.first(phase)
        host.strobes.clear()
        await host.tick(bus_quiet=0, **inputs)
        await host.tick(3, **dict.fromkeys(inputs, 0))
        assert host.get("abort_bus") and host.get("phase") == host.get("first_phase") == Phase.DRAIN and host.names() == []
        await host.pulse(start=1)  # a start that comes now is kept
        await host.tick(bus_quiet=1)
        while not host.get("finished"):
            assert host.get("busy") and host.get("first_busy")
            await host.tick()
        assert host.get("reset_units") and (host.get("error"), host.get("first_error")) == codes
        await host.tick(2)
        assert host.names() == ["finished", "first_finished", "clear"] and host.get("first_phase") == Phase.CLEAR
        assert host.get("which") == 0 and host.get("phase") == Phase.IDLE

    bench(test)


def test_frames_alone_end_alone_and_the_watchdog_ends_both():
    async def test(host):
        await host.pulse(abort=1)
        assert not host.get("busy")
        await host.first(Phase.TABLE)
        await host.pulse(abort=1)
        while host.get("busy"):
            await host.tick()
        assert host.names()[-1] == "first_finished" and "finished" not in host.names()
        await host.second()
        await host.pulse(abort=1)
        while host.get("busy"):
            await host.tick()
        assert host.names()[-1] == "finished" and host.names().count("first_finished") == 1
        await host.second()
        await host.first(Phase.TABLE)
        await host.tick(progress=0)
        while not host.get("finished"):
            await host.tick()
        assert host.get("error") == host.get("first_error") == ErrorCode.WATCHDOG

    bench(test)


def test_what_is_refused():
    for bits, error in ((3, ValueError), (33, ValueError), (8.0, TypeError), (True, TypeError)):
        with pytest.raises(error, match="watchdog_bits must be"):
            OverlapController(TINY_OVERLAP, watchdog_bits=bits)
