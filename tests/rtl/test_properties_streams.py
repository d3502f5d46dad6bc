"""Streams under any timing: units between sorting and the array, in Amaranth's simulator, timing drawn by Hypothesis."""

from __future__ import annotations

import pytest
from amaranth.sim import Simulator
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rtl.shapes import layout
from rtl.sort_tmu.handover import DoubleBuffer, LineBuffer
from rtl.stream import Buffer, Skid
from spec.config import TINY
from spec.records import chunk_item

CONFIG = TINY.with_(sort_buffer_bytes=256, line_buffer_bytes=64)
RECORD = chunk_item(CONFIG)
QUICK = settings(max_examples=12, derandomize=True, deadline=None, database=None, suppress_health_check=[HealthCheck.too_slow])
LONG = settings(QUICK, max_examples=150)

TIMING = st.lists(st.booleans(), min_size=1, max_size=12).filter(any)
"""Cycles in which a side takes part, over and over again."""

GROUPS = st.lists(st.integers(1, 40), min_size=1, max_size=4)
"""Entries of each group."""


def items_of(groups: list[int]) -> list[int]:
    """Bit patterns of ChunkItem items, numbered, `last` at a group's end."""
    lasts = [n == count - 1 for count in groups for n in range(count)]
    return [RECORD.pack({"index": n, "depth_key": 3 * n, "tile": n % 7, "last": last, "empty": 0})
            for n, last in enumerate(lasts)]


def played(dut, sink, source, items: list[int], offers: list[bool], takes: list[bool]) -> list[int]:
    """What comes out; checks that what is offered stays until it is taken, and that nothing hangs."""
    found: list[int] = []

    async def process(ctx):
        sent, offering, waiting = 0, False, None
        for cycle in range(60 + 40 * (len(offers) + len(takes)) + 30 * len(items)):
            offering = offering or (sent < len(items) and offers[cycle % len(offers)])
            ctx.set(sink.valid, offering)
            if offering:
                ctx.set(sink.payload, sink.payload.shape().from_bits(items[sent]))
            ctx.set(source.ready, takes[cycle % len(takes)])
            _, _, taken, valid, payload = await ctx.tick().sample(sink.ready, source.valid, source.payload)
            word = payload.as_bits()
            assert waiting is None or (valid and word == waiting), "an item must hold until it is taken"
            waiting = word if valid and not takes[cycle % len(takes)] else None
            if valid and takes[cycle % len(takes)]:
                found.append(word)
            if offering and taken:
                sent, offering = sent + 1, False
            if len(found) == len(items):
                return

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(process)
    simulator.run()
    return found


def nothing_is_lost(unit: type, groups: list[int], offers: list[bool], takes: list[bool]) -> None:
    """All items come out, in order, each once, whatever the timing."""
    dut = unit(layout(RECORD)) if unit in (Buffer, Skid) else unit(CONFIG)
    items = items_of(groups)
    assert played(dut, dut.sink, dut.source, items, offers, takes) == items


@pytest.mark.parametrize("unit", [Buffer, Skid, LineBuffer, DoubleBuffer])
@QUICK
@given(groups=GROUPS, offers=TIMING, takes=TIMING)
def test_nothing_is_lost_under_any_timing(unit, groups, offers, takes):
    nothing_is_lost(unit, groups, offers, takes)


@pytest.mark.long
@pytest.mark.parametrize("unit", [Buffer, Skid, LineBuffer, DoubleBuffer])
@LONG
@given(groups=GROUPS, offers=TIMING, takes=TIMING)
def test_nothing_is_lost_under_many_timings(unit, groups, offers, takes):
    nothing_is_lost(unit, groups, offers, takes)
