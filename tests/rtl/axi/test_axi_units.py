"""What stands around the AXI ports, in Amaranth's simulator: read queue, arbiter, counters."""

from __future__ import annotations

import random
from collections import Counter, deque

import pytest
from amaranth.hdl import Module, ResetInserter, Signal
from amaranth.lib import wiring
from amaranth.sim import Simulator

from rtl.axi.arbiter import RoundRobin
from rtl.axi.bus import Response, axi_lite_slave_ports, join
from rtl.axi.counters import PerformanceCounters, StageCounters, count_in_halves
from rtl.axi.lite import LiteSlave
from rtl.axi.master import AxiMaster, id_bits
from rtl.axi.read_port import ReadQueue
from rtl.axi.registers import RegisterFile
from spec import registers
from spec.codes import Phase
from spec.config import TINY
from spec.host_settings import with_every_register
from tests.helpers.rtl_streams import assert_rejected


def simulate(dut, bench) -> None:
    """Runs `bench` as a testbench of the clocked `dut`."""
    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()


class QueueBench:
    """A unit, a read queue, and a memory that answers every request after so many cycles; word 0 of a beat is its address."""

    def __init__(self, depth: int, latency: int, pauses: float, seed: int = 0):
        self.dut, self.latency, self.pauses, self.rng = ReadQueue(TINY, depth), latency, pauses, random.Random(seed)
        self.flying: deque[tuple[int, int]] = deque()
        self.cycle = self.asked = 0
        self.got: list[int] = []
        self.most_inside = 0
        self._valid = False

    async def step(self, ctx, total: int) -> None:
        """One cycle: everything is driven, then looked at, then clocked."""
        dut, rng = self.dut, self.rng
        self._valid = self._valid or (self.asked < total and rng.random() >= self.pauses)
        ctx.set(dut.reads.valid, self._valid)
        ctx.set(dut.reads.payload.beat, self.asked)
        ctx.set(dut.requests.ready, rng.random() >= self.pauses)
        ctx.set(dut.data.ready, rng.random() >= self.pauses)
        due = self.flying and self.flying[0][0] <= self.cycle
        ctx.set(dut.beats.valid, bool(due))
        assert ctx.get(dut.beats.ready)
        if due:
            ctx.set(dut.beats.payload.word[0], self.flying.popleft()[1])
        if ctx.get(dut.requests.valid) and ctx.get(dut.requests.ready):
            self.flying.append((self.cycle + self.latency, ctx.get(dut.requests.payload.beat)))
        assert (self._valid and ctx.get(dut.reads.ready)) == (ctx.get(dut.requests.valid) and ctx.get(dut.requests.ready))
        if self._valid and ctx.get(dut.reads.ready):
            self.asked, self._valid = self.asked + 1, False
        self.most_inside = max(self.most_inside, self.asked - len(self.got))
        if ctx.get(dut.data.valid) and ctx.get(dut.data.ready):
            self.got.append(ctx.get(dut.data.payload.word[0]))
        await ctx.tick()
        self.cycle += 1

    def run(self, total: int, limit: int) -> None:
        """All beats must come, in order."""
        async def bench(ctx):
            while len(self.got) < total:
                assert self.cycle < limit, f"{len(self.got)} of {total} beats"
                await self.step(ctx, total)

        simulate(self.dut, bench)
        assert self.got == list(range(total))


@pytest.mark.parametrize("depth", [3, 4, 7, 16])
@pytest.mark.parametrize("latency", [1, 2, 5, 30])
def test_a_read_queue_loses_nothing(depth, latency):
    bench = QueueBench(depth, latency, 0.4, depth + latency)
    bench.run(120, 120 * (latency + 12))
    assert bench.most_inside <= depth


def test_a_full_read_queue_loses_nothing():
    """The unit takes nothing until all credits are spent."""
    for depth in (3, 4, 5, 8):
        bench = QueueBench(depth, 1, 0.0)

        async def body(ctx, bench=bench, depth=depth):
            ready = bench.dut.data.ready
            for cycle in range(4 * depth + 40):
                ctx.set(bench.dut.reads.valid, 1)
                ctx.set(bench.dut.reads.payload.beat, bench.asked)
                ctx.set(bench.dut.requests.ready, 1)
                ctx.set(ready, cycle >= depth + 10)
                ctx.set(bench.dut.beats.valid, bool(bench.flying))
                if bench.flying:
                    ctx.set(bench.dut.beats.payload.word[0], bench.flying.popleft()[1])
                if ctx.get(bench.dut.requests.valid):
                    bench.flying.append((0, bench.asked))
                    bench.asked += 1
                if cycle == depth + 9:
                    assert bench.asked == depth
                if ctx.get(bench.dut.data.valid) and ctx.get(ready):
                    bench.got.append(ctx.get(bench.dut.data.payload.word[0]))
                await ctx.tick()
            assert bench.got == list(range(len(bench.got))) and len(bench.got) > 3 * depth

        simulate(bench.dut, body)


@pytest.mark.parametrize("latency", [1, 28])
def test_a_read_queue_moves_a_beat_a_cycle(latency):
    bench = QueueBench(latency + 4, latency, 0.0)
    bench.run(100, 100 + latency + 4)


def test_a_read_queue_forgets_what_was_inside_when_it_is_reset():
    bench, reset = QueueBench(8, 3, 0.0), Signal()

    async def body(ctx):
        for _ in range(9):
            await bench.step(ctx, 100)
        ctx.set(reset, 1)
        ctx.set(bench.dut.beats.valid, 0)
        await ctx.tick()
        ctx.set(reset, 0)
        bench.flying.clear()
        bench.got, bench.asked = [], 0
        while len(bench.got) < 40:
            assert bench.cycle < 80
            await bench.step(ctx, 40)
        assert bench.got == list(range(40))

    simulate(ResetInserter(reset)(bench.dut), body)


@pytest.mark.parametrize("count", [1, 2, 5, 8])
def test_round_robin_is_fair(count):
    rng, dut = random.Random(count), RoundRobin(count)

    async def bench(ctx):
        waiting = Counter()
        for _ in range(400):
            asking = rng.getrandbits(count)
            served = bool(asking) and rng.random() < 0.7
            ctx.set(dut.asking, asking)
            ctx.set(dut.served, served)
            chosen = ctx.get(dut.chosen)
            assert not asking or asking >> chosen & 1
            if served:
                for i in range(count):
                    waiting[i] = waiting[i] + 1 if asking >> i & 1 and i != chosen else 0
                assert max(waiting.values()) < count
            await ctx.tick()

    simulate(dut, bench)


def test_stage_counters_add_up():
    rng, dut = random.Random(1), StageCounters(3)

    async def bench(ctx):
        wanted = {name: [0] * 3 for name in ("busy", "starved", "blocked")}
        cycles = 0
        for step in range(500):
            valid, ready, active, clear = rng.getrandbits(3), rng.getrandbits(3), rng.random() < 0.8, step in (150, 151, 400)
            for port, value in ((dut.valid, valid), (dut.ready, ready), (dut.active, active), (dut.clear, clear)):
                ctx.set(port, value)
            await ctx.tick()
            cycles = 0 if clear else cycles + active
            for i in range(3):
                v, r = valid >> i & 1, ready >> i & 1
                for name, happened in (("busy", v & r), ("starved", 1 - v), ("blocked", v & (1 - r))):
                    wanted[name][i] = 0 if clear else wanted[name][i] + (active and happened)
                    assert ctx.get(getattr(dut, name)[i]) == wanted[name][i]
                assert sum(wanted[name][i] for name in wanted) == cycles

    simulate(dut, bench)


@pytest.mark.parametrize("config", [TINY, TINY.with_(stereo=True), *with_every_register(TINY)],
                         ids=["tiny", "stereo", "chunks and stereo", "super-tiles", "joint frames", "warped joint frames"])
def test_performance_counters_count_what_their_names_say(config):
    rng, dut = random.Random(2), PerformanceCounters(config)
    readers = registers.read_clients(config)
    stages, writers, names_of_events = registers.stages(config), registers.write_clients(config), registers.events(config)

    async def bench(ctx):
        wanted = Counter()
        for step in range(300):
            phase = rng.choice(list(Phase))
            valid, ready = rng.getrandbits(len(stages)), rng.getrandbits(len(stages))
            reader, writer = rng.randrange(len(readers) + 1), rng.randrange(len(writers) + 1)
            if config.stereo or step % 3 != 1:  # those of a frame stay in the cycle after it, those of a pass need not
                events = {name: rng.getrandbits(16) for name in names_of_events}
            ctx.set(dut.phase, phase)
            ctx.set(dut.stage_valid, valid)
            ctx.set(dut.stage_ready, ready)
            ctx.set(dut.read_beats, 1 << reader >> 1)
            ctx.set(dut.write_beats, 1 << writer >> 1)
            ctx.set(dut.events, events)
            ctx.set(dut.finished, step % 3 == 0)
            ctx.set(dut.clear, step == 100)
            if config.stereo:
                ctx.set(dut.target, step % 7 < 3)
            active, first_phase, first_finished = phase != Phase.IDLE, Phase.IDLE, False
            if config.overlap:
                active, first_phase, first_finished = rng.random() < 0.8, rng.choice(list(Phase)), rng.random() < 0.1
                ctx.set(dut.busy, active)
                ctx.set(dut.first_phase, first_phase)
                ctx.set(dut.first_finished, first_finished)
            await ctx.tick()
            wanted.update({"cycles_target": active} if config.stereo and step % 7 < 3 else {})
            wanted.update(events if step % 3 == 0 else {})
            wanted.update({"cycles_total": active, "frames": (step % 3 == 0) + first_finished})
            shown = {phase} if not config.overlap else {first_phase} - {Phase.RENDER} | {phase} & {Phase.RENDER}
            wanted.update(f"cycles_{one.name.lower()}" for one in shown)
            for i, stage in enumerate(stages):
                what = "starved" if not valid >> i & 1 else "busy" if ready >> i & 1 else "blocked"
                wanted[f"{stage}_{what}"] += active
            for total, names, client in (("read_beats", readers, reader), ("write_beats", writers, writer)):
                if client:
                    wanted.update([total, f"{total}_{names[client - 1]}"])
            if step == 100:
                wanted.clear()
        await ctx.tick()  # counted is what was registered in the cycle before
        for name in dut.counters.shape().members:
            assert ctx.get(dut.counters[name]) == wanted[name], name

    simulate(dut, bench)


@pytest.mark.parametrize("width", [2, 4, 8])
def test_a_counter_in_halves_is_one_number_in_every_cycle(width):
    """Over all its values, with cycles between that do not count, and set to 0 in the middle and on its lower half's edge."""
    module, counter, step, clear, rng = Module(), Signal(width), Signal(), Signal(), random.Random(width)
    count_in_halves(module, counter, step, clear)
    edge = (1 << width // 2) - 1

    async def bench(ctx):
        wanted, met = 0, set()
        for cycle in range(8 << width):
            steps, clears = rng.random() < 0.7, cycle < 3 << width and rng.random() < (0.2 if wanted & edge == edge else 0.01)
            ctx.set(step, steps)
            ctx.set(clear, clears)
            await ctx.tick()
            wanted = 0 if clears else (wanted + steps) % (1 << width)
            met.add(wanted)
            assert ctx.get(counter) == wanted
        assert met == set(range(1 << width))

    simulate(module, bench)


class Outer(wiring.Component):
    """A slave under another prefix; a register's value is its number."""

    def __init__(self) -> None:
        super().__init__(axi_lite_slave_ports("s_other"))

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.slave = slave = LiteSlave()
        join(m, self, slave, "s_axi", "s_other")
        m.d.comb += [slave.read_data.eq(slave.read_index), slave.read_refused.eq(slave.read_index[0])]
        return m


def test_a_bus_may_bear_another_prefix_outside():
    dut = Outer()

    async def bench(ctx):
        ctx.set(dut.s_other_rready, 1)
        for index in (0, 5, 1023, 6):
            ctx.set(dut.s_other_araddr, 4 * index)
            ctx.set(dut.s_other_arvalid, 1)
            assert ctx.get(dut.s_other_arready)
            await ctx.tick()
            ctx.set(dut.s_other_arvalid, 0)
            assert not ctx.get(dut.s_other_rvalid)
            await ctx.tick()
            answer = (1, index, Response.SLVERR if index % 2 else Response.OKAY)
            assert (ctx.get(dut.s_other_rvalid), ctx.get(dut.s_other_rdata), ctx.get(dut.s_other_rresp)) == answer
            await ctx.tick()
            assert not ctx.get(dut.s_other_rvalid)

    simulate(dut, bench)


def test_bad_parameters_are_rejected():
    for depth, error in ((2, ValueError), (0, ValueError), (True, TypeError), (4.0, TypeError)):
        assert_rejected(lambda depth=depth: ReadQueue(TINY, depth), error, depth)
    for count, error in ((0, ValueError), (True, TypeError), ("3", TypeError)):
        assert_rejected(lambda count=count: RoundRobin(count), error, count)
        assert_rejected(lambda count=count: StageCounters(count), error, count)
        assert_rejected(lambda count=count: AxiMaster(TINY, count, 2), error, count)
        assert_rejected(lambda count=count: AxiMaster(TINY, 2, count), error, count)
    for in_flight, error in ((0, ValueError), (48, ValueError), (2.0, TypeError)):
        assert_rejected(lambda in_flight=in_flight: AxiMaster(TINY, 2, 2, in_flight), error, in_flight)
    assert_rejected(lambda: AxiMaster(TINY, 17, 2), ValueError, 17)
    assert_rejected(lambda: RegisterFile("tiny"), TypeError, "tiny")
    assert_rejected(lambda: count_in_halves(Module(), Signal(8), Signal(3), Signal()), ValueError, 3)
    assert_rejected(lambda: join(Module(), LiteSlave(), LiteSlave(), "m_axi"), ValueError, "m_axi")


def test_ids_are_wide_enough():
    assert [id_bits(*pair) for pair in ((1, 1), (2, 1), (1, 3), (6, 4), (16, 16))] == [1, 1, 2, 3, 4]
