"""The model's chunk sorter beside the RTL's, cycle by cycle."""

from __future__ import annotations

import numpy as np
import pytest
from amaranth.sim import Simulator

from perf import chunks
from rtl.sort_tmu.chunk_sorter import ChunkSorter
from spec.config import TINY

CONFIG = TINY.with_(sort_buffer_bytes=512)


def lengths(rng: np.random.Generator, capacity: int) -> np.ndarray:
    """Chunks of every kind: of one entry, of one run of each stage, of an odd number of runs, full."""
    some = [1, 1, 2, 3, 1, 4, 5, 7, 8, 9, 15, 16, 17, capacity - 1, capacity, capacity, 1, 2, capacity]
    return np.array([*some, *rng.integers(1, capacity + 1, 12)])


@pytest.mark.parametrize(("comes", "leaves"), [(1.0, 1.0), (0.5, 1.0), (1.0, 0.4), (0.8, 0.7)])
def test_entries_come_and_leave_in_the_rtls_cycles(comes, leaves):
    rng = np.random.default_rng(round(100 * comes + leaves))
    sorter = ChunkSorter(CONFIG)
    counts = lengths(rng, sorter.capacity)
    ends = np.cumsum(counts)
    place = np.concatenate([end - count + rng.permutation(count) for end, count in zip(ends, counts, strict=True)])
    arrival, chunk_ends = np.append(place, 0).astype(np.int32), np.append(ends, 1 << 40)
    stages, keys = chunks.chunk_stages(sorter.capacity)
    chunks.begin_stages(stages, chunk_ends)

    async def bench(ctx):
        taken, gone, offered = 0, 0, False
        while gone < len(place):
            offered = taken < len(place) and (offered or rng.random() < comes)
            ready = rng.random() < leaves
            ctx.set(sorter.chunks.valid, offered)
            if offered:
                ctx.set(sorter.chunks.payload.index, int(place[taken]))
                ctx.set(sorter.chunks.payload.last, int(taken + 1 in ends))
            ctx.set(sorter.sorted.ready, ready)
            shows = ctx.get(sorter.sorted.valid)
            assert shows == chunks.chunk_offers(stages, gone)
            if shows and ready:
                assert ctx.get(sorter.sorted.payload.index) == gone
                gone += 1
            takes = chunks.step_stages(stages, keys, gone, offered, chunk_ends, arrival)
            assert not offered or takes == ctx.get(sorter.chunks.ready)
            taken, offered = taken + (offered and takes), offered and not takes
            await ctx.tick()

    simulator = Simulator(sorter)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
