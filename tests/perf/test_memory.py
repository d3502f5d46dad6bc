"""The cycle model's memory over phases: what one leaves to the next, the order of answers, and where regions lie."""

from __future__ import annotations

import random

import numpy as np
import pytest

from golden.host.memory_image import memory_image
from golden.msv2_ref import pipeline
from perf import bus, dram
from perf.geometry import idle_phase
from perf.geometry import layout as geometry_layout
from perf.model import MemoryModel
from perf.phases import LastingMemory
from perf.plan import memory_map
from perf.supertiles_plan import steady_bounds, super_plan
from perf.supertiles_trace import super_trace
from perf.trace import trace_of
from spec.config import PAPER, V3, V3_RECORDS
from tests.helpers.golden_samples import random_model, turned_view

LPDDR3 = MemoryModel("lpddr3")
CHANNEL_BEATS = 512
"""Beats of a row of all channels: the next one is in another bank."""


def new_state() -> np.record:
    return LastingMemory(LPDDR3).begin(geometry_layout)


def steps(s, begin, cycles, asked):
    """Steps the memory; `asked` has (cycle, kind, client, beat). Returns (cycle, kind, client) of every answer."""
    found = []
    wanted = {(cycle, kind): rest for cycle, kind, *rest in asked}
    for t in range(cycles):
        s.read_new = s.write_new = 0
        for kind, send in (("read", bus.read), ("write", bus.write)):
            if (begin + t, kind) in wanted:
                send(s, *wanted[begin + t, kind])
        before = s.reads.copy(), s.written.copy()
        dram.end_cycle(s, t)
        for kind, old, new in zip(("read", "write"), before, (s.reads, s.written), strict=True):
            found += [(begin + t, kind, client) for client in np.flatnonzero(new - old).tolist()]
    return found


def random_requests(cycles, rng):
    """Of every 1,000 cycles the last 500 have no requests."""
    rows = [rng.randrange(1 << 18) for _ in range(12)]
    return [(t, kind, rng.randrange(3), rng.choice(rows) + rng.randrange(64)) for t in range(cycles) if t % 1000 < 500
            for kind in ("read", "write") if rng.random() < 0.3]


def test_a_client_is_answered_in_order_and_others_do_not_wait_for_it():
    """The second write goes to an open row, the first must open its own; a third one is another client's."""
    s = new_state()
    asked = [(0, "write", 1, 8), (200, "write", 0, 16 * CHANNEL_BEATS), (201, "write", 0, 8), (202, "write", 1, 2)]
    found = steps(s, 0, 400, asked)
    first, other, *own = found
    assert [client for _, _, client in found] == [1, 1, 0, 0]
    assert first[0] < 200 < other[0] < own[0][0] and own[1][0] == own[0][0] + 1


def test_a_write_is_answered_in_a_cycle_even_where_several_are_done():
    s = new_state()
    found = steps(s, 0, 400, [(t, "write", t % 2, t) for t in range(16)])
    cycles = [t for t, *_ in found]
    assert len(cycles) == len(set(cycles)) == 16


@pytest.mark.parametrize("cycles", (1, 999, 12_345))
def test_channels_without_requests_are_refreshed(cycles):
    s, device = new_state(), dram.Lpddr3()
    idle_phase(s, cycles)
    firsts = [device.refi * (channel + 1) / dram.CHANNELS for channel in range(dram.CHANNELS)]
    assert s.dram_refreshes == sum(len(np.arange(first, cycles + 1e-6, device.refi)) for first in firsts)


def test_a_phase_goes_on_where_the_one_before_ended():
    """Requests in three phases are answered as they are in one."""
    asked = random_requests(6000, random.Random(5))
    whole = new_state()
    wanted = steps(whole, 0, 6000, asked)
    memory, found, activates = LastingMemory(LPDDR3), [], 0
    for begin, cycles in ((0, 1000), (1000, 3000), (4000, 2000)):
        s = memory.begin(geometry_layout)
        found += steps(s, begin, cycles, asked)
        activates += int(s.dram_activates_given)
        memory.end(cycles)
    assert len(wanted) == len(asked) and found == wanted and activates == whole.dram_activates_given


def test_waiting_is_a_phase_without_requests():
    asked = random_requests(500, random.Random(6))
    shifted = [(t + 5000, *rest) for t, *rest in asked]
    late = steps(LastingMemory(LPDDR3, 5000).begin(geometry_layout), 5000, 1000, shifted)
    assert late == steps(new_state(), 0, 6000, shifted)
    assert [t - 5000 for t, *_ in late] != [t for t, *_ in steps(new_state(), 0, 1000, asked)]


@pytest.mark.parametrize("config", (PAPER, V3_RECORDS, V3), ids=lambda config: config.name)
@pytest.mark.parametrize("display", (True, False))
def test_regions_lie_where_the_host_puts_them(config, display):
    frame = pipeline.render(random_model(np.random.default_rng(3), 300, sh=1), turned_view(80, 48), config=config)
    if config.supertiles:
        trace = super_trace(frame)
        plan = super_plan(trace, config, steady_bounds(trace, config), None, display)
        found, beats = plan.where, {"entries_beats": plan.lists.beats, "spill_beats": plan.sorting.spill_beats}
    else:
        beats = {"entries_beats": 1000, "spill_beats": 200}
        found = memory_map(trace_of(frame), config, display, *beats.values())
    image = memory_image(config, frame.words, frame.registers, display=display, **beats)
    assert {name: region.base for name, region in image.regions.items()} == {
        name: base for name, base in vars(found).items() if base}
