"""The frame controller: phases in order, and every way out of them."""

import pytest
from amaranth.sim import Simulator

from rtl.top.controller import FrameController
from spec.codes import ErrorCode, Phase
from spec.config import PAPER, TINY
from tests.helpers.rtl_streams import assert_rejected

PHASES = (Phase.TABLE, Phase.GEOMETRY, Phase.RENDER)
DONE = {Phase.TABLE: "table_done", Phase.GEOMETRY: "geometry_done", Phase.RENDER: "render_done"}
STARTS = ("clear", "start_table", "start_geometry", "start_render", "finished")


def simulate(dut, bench):
    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()


class Host:
    """Drives a controller cycle by cycle; remembers its strobes, by the cycle, and its phases."""

    def __init__(self, ctx, dut):
        self.ctx, self.dut, self.cycle, self.strobes, self.phases = ctx, dut, 0, [], []
        ctx.set(dut.units_ready, 1)
        ctx.set(dut.bus_quiet, 1)
        ctx.set(dut.progress, 1)

    async def tick(self, **inputs):
        for name, value in inputs.items():
            self.ctx.set(getattr(self.dut, name), value)
        strobes = ("next_pass", *STARTS) if self.dut.config.stereo else STARTS
        self.strobes += [(name, self.cycle) for name in strobes if self.ctx.get(getattr(self.dut, name))]
        phase = Phase(self.ctx.get(self.dut.phase))
        if not self.phases or self.phases[-1] != phase:
            self.phases.append(phase)
        await self.ctx.tick()
        self.cycle += 1

    async def start(self, width, height):
        await self.tick(width=width, height=height, start=1)
        await self.tick(start=0)

    async def until(self, phase, most=1000):
        for _ in range(most):
            if self.ctx.get(self.dut.phase) == phase:
                return
            await self.tick()
        raise AssertionError(phase)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (16, 16), (17, 33), (512, 512)])
def test_a_frame_goes_through_its_phases(width, height):
    dut = FrameController(TINY)

    async def bench(ctx):
        host = Host(ctx, dut)
        for _ in range(2):
            await host.start(width, height)
            for phase in PHASES:
                await host.until(phase)
                for _ in range(3):
                    await host.tick()
                await host.tick(**{DONE[phase]: 1})
                await host.tick(**{DONE[phase]: 0})
            assert not ctx.get(dut.busy) and ctx.get(dut.error) == ErrorCode.NONE
            assert ctx.get(dut.tiles_x) == -(-width // 16) and ctx.get(dut.tile_count) == -(-width // 16) * -(-height // 16)
        assert [name for name, _ in host.strobes] == list(STARTS) * 2
        assert host.phases == [Phase.IDLE, Phase.CLEAR, *PHASES] * 2 + [Phase.IDLE]
        table, begun = (next(cycle for name, cycle in host.strobes if name == wanted) for wanted in ("start_table", "clear"))
        assert table - begun == -(-height // 16) + 1

    simulate(dut, bench)


@pytest.mark.parametrize("phase", [Phase.CLEAR, *PHASES])
@pytest.mark.parametrize(("inputs", "error"), [
    ({"failure": ErrorCode.SPILL_FULL}, ErrorCode.SPILL_FULL), ({"abort": 1}, ErrorCode.ABORTED),
    ({"abort": 1, "failure": ErrorCode.READ_ERROR}, ErrorCode.READ_ERROR), ({"progress": 0}, ErrorCode.WATCHDOG),
    ({"abort": 1, **dict.fromkeys(DONE.values(), 1)}, ErrorCode.ABORTED)], ids=str)
def test_a_frame_that_fails_is_cleared_away(phase, inputs, error):
    dut = FrameController(TINY, watchdog_bits=5)

    async def bench(ctx):
        host = Host(ctx, dut)
        ctx.set(dut.bus_quiet, 0)
        ctx.set(dut.units_ready, phase != Phase.CLEAR)
        await host.start(64, 48)
        for before in PHASES[: max(phase - Phase.TABLE, 0)]:
            await host.until(before)
            await host.tick(**{DONE[before]: 1})
            await host.tick(**{DONE[before]: 0})
        await host.until(phase)
        await host.tick(**inputs)
        if error != ErrorCode.WATCHDOG:
            await host.tick(**dict.fromkeys(inputs, 0))
        await host.until(Phase.DRAIN, 40)
        ctx.set(dut.progress, 1)
        for _ in range(10):
            assert ctx.get(dut.abort_bus) and not ctx.get(dut.reset_units)
            await host.tick()
        await host.tick(bus_quiet=1)
        resets = 0
        while ctx.get(dut.busy):
            resets += ctx.get(dut.reset_units)
            assert ctx.get(dut.abort_bus)
            await host.tick()
        assert resets >= 2 and host.strobes[-1][0] == "finished" and ctx.get(dut.error) == error
        assert [name for name, _ in host.strobes].count("finished") == 1
        ctx.set(dut.units_ready, 1)
        await host.start(16, 16)
        await host.until(Phase.TABLE)
        assert ctx.get(dut.error) == ErrorCode.NONE

    simulate(dut, bench)


STEREO = TINY.with_(stereo=True)
PASS = ("clear", "start_table", "start_geometry", "start_render")


async def passes(host, count):
    """So many passes, to their ends."""
    for phase in PHASES * count:
        await host.until(phase)
        await host.tick()
        await host.tick(**{DONE[phase]: 1})
        await host.tick(**{DONE[phase]: 0})


def test_a_frame_of_two_eyes_goes_through_its_phases_twice():
    """And ordinary ones before, between and behind as ever."""
    dut = FrameController(STEREO)

    async def bench(ctx):
        host = Host(ctx, dut)
        for stereo in (0, 1, 1, 0):
            begun, targets = len(host.strobes), []
            ctx.set(dut.stereo, stereo)
            await host.start(100, 40)
            for _ in range(1 + stereo):
                await host.until(Phase.TABLE)
                targets.append(ctx.get(dut.target))
                assert ctx.get(dut.tiles_x) == 7 and ctx.get(dut.tile_count) == 21
                await passes(host, 1)
            assert targets == [0, 1][: 1 + stereo]
            assert not ctx.get(dut.busy) and ctx.get(dut.error) == ErrorCode.NONE
            strobes = [name for name, _ in host.strobes[begun:]]
            assert strobes == ["clear", *PASS[1:], *(("next_pass", *PASS) if stereo else ()), "finished"]
        tables = [cycle for name, cycle in host.strobes if name == "start_table"]
        assert [t - max(c for name, c in host.strobes if name == "clear" and c < t) for t in tables] == [4] * len(tables)

    simulate(dut, bench)


@pytest.mark.parametrize("phase", [Phase.CLEAR, *PHASES])
@pytest.mark.parametrize(("inputs", "error"), [
    ({"failure": ErrorCode.WRITE_ERROR}, ErrorCode.WRITE_ERROR), ({"abort": 1}, ErrorCode.ABORTED),
    ({"abort": 1, **dict.fromkeys(DONE.values(), 1)}, ErrorCode.ABORTED)], ids=str)
@pytest.mark.parametrize("target", [0, 1])
def test_a_frame_of_two_eyes_that_fails_is_over(target, phase, inputs, error):
    dut = FrameController(STEREO)

    async def bench(ctx):
        host = Host(ctx, dut)
        ctx.set(dut.stereo, 1)
        await host.start(64, 48)
        await passes(host, target)
        for before in PHASES[: max(phase - Phase.TABLE, 0)]:
            await host.until(before)
            await host.tick(**{DONE[before]: 1})
            await host.tick(**{DONE[before]: 0})
        await host.until(phase)
        assert ctx.get(dut.target) == target
        await host.tick(**inputs)
        await host.tick(**dict.fromkeys(inputs, 0))
        await host.until(Phase.IDLE, 40)
        assert host.strobes[-1][0] == "finished" and ctx.get(dut.error) == error
        assert [name for name, _ in host.strobes].count("next_pass") == target
        begun = len(host.strobes)
        ctx.set(dut.stereo, 0)
        await host.start(16, 16)
        await passes(host, 1)
        assert [name for name, _ in host.strobes[begun:]] == list(STARTS) and not ctx.get(dut.target)
        assert ctx.get(dut.error) == ErrorCode.NONE

    simulate(dut, bench)


def test_an_idle_machine_is_left_alone():
    dut = FrameController(PAPER, watchdog_bits=4)

    async def bench(ctx):
        host = Host(ctx, dut)
        for inputs in ({"abort": 1}, {"abort": 0, "failure": 3}, {"failure": 0, "progress": 0}, *[{}] * 40):
            await host.tick(**inputs)
        assert host.phases == [Phase.IDLE] and host.strobes == []

    simulate(dut, bench)


@pytest.mark.parametrize(("bits", "error"), [(3, ValueError), (33, ValueError), ("8", TypeError), (True, TypeError)])
def test_bad_parameters(bits, error):
    assert_rejected(lambda: FrameController(TINY, watchdog_bits=bits), error, bits)
    assert_rejected(lambda: FrameController(bits), TypeError, bits)
