"""Counters of saturated values: what counts, what must not, and what the golden renderer counts of the same records."""

from __future__ import annotations

import numpy as np
import pytest
from amaranth.sim import Simulator

from golden.msv2_ref.saturations import count_saturated
from rtl.culling import saturations
from rtl.culling.saturations import SaturationCounters
from spec.config import PAPER
from spec.saturations import STREAMS, WATCHED, limits
from tests.helpers.rtl_streams import assert_rejected

ROWS, LATENCY = 200, 3


def rows_of(rng, record):
    """(ROWS,) records in which every field holds its limits, their neighbours and 0 often, and any number else."""
    rows = np.zeros(ROWS, record.dtype)
    for f in record.fields:
        low, high = f.raw_range
        some = np.array([low, low + 1, high - 1, high, 0])
        any_number = rng.integers(low, high + 1, rows[f.name].shape)
        rows[f.name] = np.where(rng.random(rows[f.name].shape) < 0.2, rng.choice(some, rows[f.name].shape), any_number)
    return rows


def counted(config, rows, moves):
    """The counters a while after each stream's rows were offered, one a cycle, and those that `moves` says transferred."""
    dut, found = SaturationCounters(config), {}

    async def bench(ctx):
        for n in range(ROWS + LATENCY):
            for name, record in STREAMS.items():
                ctx.set(getattr(dut, f"{name}_move"), n < ROWS and bool(moves[name][n]))
                if n < ROWS:
                    ctx.set(getattr(dut, name).as_value(), record(config).pack(rows[name][n]))
            await ctx.tick()
        found["counts"] = {s.name: ctx.get(getattr(dut, s.name)) for s in WATCHED}
        ctx.set(dut.clear, 1)
        await ctx.tick()
        found["cleared"] = [ctx.get(getattr(dut, s.name)) for s in WATCHED]

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    assert not any(found["cleared"])
    return found["counts"]


@pytest.fixture(scope="module")
def drawn():
    rng = np.random.default_rng(0)
    rows = {name: rows_of(rng, record(PAPER)) for name, record in STREAMS.items()}
    moves = {name: rng.random(ROWS) < 0.5 for name in STREAMS}
    return rows, moves


def golden(rows, moves):
    return {s.name: count_saturated(PAPER, s, rows[s.stream][s.field][moves[s.stream]]) for s in WATCHED}


def test_what_is_transferred_is_counted_as_golden_counts_it(drawn):
    rows, moves = drawn
    wanted, all_of_them = golden(rows, moves), golden(rows, {name: np.ones(ROWS, bool) for name in STREAMS})
    assert counted(PAPER, rows, moves) == wanted
    assert all(0 < wanted[name] < all_of_them[name] < ROWS for name in wanted)


@pytest.mark.parametrize("forgotten", [0, -1])
def test_a_limit_that_is_forgotten_is_told(drawn, monkeypatch, forgotten):
    monkeypatch.setattr(saturations, "limits", lambda number: limits(number)[forgotten:][:1] if number.signed else (0,))
    got, wanted = counted(PAPER, *drawn), golden(*drawn)
    assert all(got[name] != wanted[name] for name in wanted)


def test_zero_is_no_limit_of_unsigned_numbers():
    n = PAPER.formats
    assert limits(n.mean2d) == (-(1 << 24), (1 << 24) - 1)
    assert limits(n.colour) == (1023,) and limits(n.depth) == (16383,) and limits(n.depth_key) == ((1 << 24) - 1,)


def test_a_wrong_config_is_refused():
    assert_rejected(lambda: SaturationCounters("paper"), TypeError, "paper")
