"""Shapes, rounding, pipelines and stream helpers of rtl/, exhaustively where small."""

from __future__ import annotations

import random

import pytest
from amaranth.hdl import Module, Signal, signed, unsigned
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out
from amaranth.sim import Simulator

from rtl.fixed import fits, modular, negated_round_shift, round_shift, saturate
from rtl.pipeline import Pipeline
from rtl.shapes import layout
from rtl.stream import Broadcast, Buffer, Fork
from spec.config import DEFAULT, TINY
from spec.formats import SQ, UQ
from spec.records import RECORDS, tile_group
from tests.helpers.rtl_streams import assert_rejected, exchange


@pytest.mark.parametrize("record", RECORDS)
@pytest.mark.parametrize("config", [DEFAULT, TINY], ids=lambda config: config.name)
def test_layouts_are_those_of_the_records(record, config):
    record = record(config)
    shape, offset = layout(record), 0
    assert shape.size == record.width
    for field in record.fields:
        assert (shape[field.name].offset, shape[field.name].width) == (offset, field.width)
        offset += field.width
    row = {f.name: [f.raw_range[0]] * f.count if f.count > 1 else f.raw_range[0] for f in record.fields}
    const = shape.from_bits(record.pack(row))
    for field in record.fields:
        assert (list(const[field.name]) if field.count > 1 else const[field.name]) == row[field.name]


def evaluate(shape, logic) -> dict[int, int]:
    """`logic` of every value of `shape`."""
    m, x, found = Module(), Signal(shape), {}
    result = logic(x)
    out = Signal(result.shape())
    m.d.comb += out.eq(result)

    async def bench(ctx):
        for bits in range(1 << len(x)):
            value = bits - (1 << len(x)) if shape.signed and bits >> (len(x) - 1) else bits
            ctx.set(x, value)
            found[value] = ctx.get(out)

    simulator = Simulator(m)
    simulator.add_testbench(bench)
    simulator.run()
    return found


@pytest.mark.parametrize("shape", [signed(7), unsigned(6)])
@pytest.mark.parametrize("n", [1, 2, 3, 6, 9])
def test_rounding(shape, n):
    assert all(y == (x + (1 << n - 1)) >> n for x, y in evaluate(shape, lambda x: round_shift(x, n)).items())
    assert all(y == -((x + (1 << n - 1)) >> n) for x, y in evaluate(shape, lambda x: negated_round_shift(x, n)).items())


@pytest.mark.parametrize("shape", [signed(7), unsigned(6)])
@pytest.mark.parametrize("number", [SQ(2, 1), SQ(3, 3), SQ(5, 4), UQ(2, 1), UQ(3, 3), UQ(4, 5)], ids=str)
def test_range(shape, number):
    low, high, size = number.raw_min, number.raw_max, 1 << number.width
    assert all(bool(y) == (low <= x <= high) for x, y in evaluate(shape, lambda x: fits(x, number)).items())
    assert all(y == min(max(x, low), high) for x, y in evaluate(shape, lambda x: saturate(x, number)).items())
    assert all(y == (x - low) % size + low for x, y in evaluate(shape, lambda x: modular(x, number)).items())


def test_bad_shifts_are_rejected():
    for wrong, error in ((-1, ValueError), (1.0, TypeError), (True, TypeError)):
        with pytest.raises(error, match=f"not {wrong!r}"):
            round_shift(Signal(4), wrong)
    with pytest.raises(ValueError, match="not 0"):
        negated_round_shift(Signal(4), 0)


@pytest.mark.parametrize("pauses", [0.0, 0.5])
def test_buffer_keeps_order_and_speed(pauses):
    buffer, words = Buffer(data.StructLayout({"value": 8})), [i * 7 % 256 for i in range(200)]
    found, cycles = exchange(buffer, {buffer.sink: words}, buffer.source, len(words), pauses=pauses)
    assert found == words
    if not pauses:
        assert cycles == list(range(1, 1 + len(words)))


@pytest.mark.parametrize("pauses", [0.0, 0.5])
def test_a_fork_gives_every_item_to_each_at_its_pace(pauses):
    dut, got = Fork(8, 3), [[], [], []]

    async def bench(ctx):
        rng, words = random.Random(2), list(range(200))
        for cycle in range(1000):
            ctx.set(dut.sink.valid, bool(words))
            ctx.set(dut.sink.payload, words[0] if words else 0)
            for source, share in zip(dut.sources, (0.0, pauses, pauses / 2), strict=True):
                ctx.set(source.ready, rng.random() >= share)
            await ctx.delay(1e-10)
            for source, found in zip(dut.sources, got, strict=True):
                if ctx.get(source.valid) and ctx.get(source.ready):
                    found.append((cycle, ctx.get(source.payload)))
            if words and ctx.get(dut.sink.ready):
                words.pop(0)
            assert max(map(len, got)) - min(map(len, got)) <= 2
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    assert all([word for _, word in found] == list(range(200)) for found in got)
    if not pauses:
        assert [cycle for cycle, _ in got[0]] == list(range(1, 201))


def test_a_fork_holds_back_no_consumer_for_another_beyond_two_items():
    dut = Fork(8)

    async def bench(ctx):
        ctx.set(dut.sink.valid, 1)
        ctx.set(dut.sources[0].ready, 1)
        taken = 0
        for _ in range(20):
            taken += ctx.get(dut.sources[0].valid)
            await ctx.tick()
        assert taken == 2

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()


@pytest.mark.parametrize("pauses", [0.0, 0.6])
@pytest.mark.parametrize("wanted", [1, 2, 5, 7])
def test_a_broadcast_gives_every_item_once_to_each_that_wants_it(wanted, pauses):
    dut, got, cycles = Broadcast(8, 3), [[], [], []], []

    async def bench(ctx):
        rng, words = random.Random(wanted), list(range(100))
        ctx.set(dut.wanted, wanted)
        for cycle in range(1000):
            offers = bool(words) and (ctx.get(dut.sink.valid) or rng.random() >= pauses / 2)
            ctx.set(dut.sink.valid, offers)
            ctx.set(dut.sink.payload, words[0] if words else 0)
            await ctx.delay(1e-10)
            before = [ctx.get(source.valid) for source in dut.sources]
            for source, share in zip(dut.sources, (pauses, pauses / 2, pauses), strict=True):
                ctx.set(source.ready, rng.random() >= share)
            await ctx.delay(1e-10)
            assert before == [ctx.get(source.valid) for source in dut.sources], "valid must not depend on ready"
            for source, found in zip(dut.sources, got, strict=True):
                if ctx.get(source.valid) and ctx.get(source.ready):
                    found.append(ctx.get(source.payload))
            if offers and ctx.get(dut.sink.ready):
                cycles.append(cycle)
                assert words.pop(0) == ctx.get(dut.sink.payload)
                assert {len(got[i]) for i in range(3) if wanted >> i & 1} == {100 - len(words)}
            await ctx.tick()

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    assert got == [list(range(100)) if wanted >> i & 1 else [] for i in range(3)]
    if not pauses:
        assert cycles == list(range(100))


def test_bad_forks_are_rejected():
    for make in (Fork, Broadcast):
        for count, error in ((0, ValueError), (True, TypeError), ("2", TypeError)):
            assert_rejected(lambda make=make, count=count: make(layout(tile_group(TINY)), count), error, count)


class Sum(wiring.Component):
    """x + 2 y where y comes two stages later, in a pipeline that advances and loads as told."""

    def __init__(self) -> None:
        inputs = {"x": In(8), "y": In(8), "load": In(1), "advance": In(1)}
        super().__init__({**inputs, "total": Out(10)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        p = Pipeline(m, load=self.load, advance=self.advance)
        twice = p.reg("twice", lambda y: y + y, p.data("y", self.y).to(2))
        total = p.reg("total", lambda x, y: x + y, p.data("x", self.x), twice)
        m.d.comb += self.total.eq(total.at(4))
        with pytest.raises(ValueError, match="not 3"):
            total.to(3)
        return m


def test_pipelines_align_stall_and_repeat():
    dut, rng = Sum(), random.Random(3)
    slots, held = [0] * 4, 0

    async def bench(ctx):
        nonlocal held
        for _ in range(500):
            x, y, load, advance = rng.getrandbits(8), rng.getrandbits(8), rng.random() < 0.7, rng.random() < 0.7
            for port, value in ((dut.x, x), (dut.y, y), (dut.load, load), (dut.advance, advance)):
                ctx.set(port, value)
            await ctx.tick()
            if advance:
                held = x + 2 * y if load else held
                slots.insert(0, held)
            assert ctx.get(dut.total) == slots[3]

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
