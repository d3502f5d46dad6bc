"""The memory behind the bus: the test bench's memory, or LPDDR3 channels."""

from __future__ import annotations

from perf import bus, dram
from perf.kernel import step

layout = dram.layout


@step
def end_cycle(s, t):
    """Steps the memory over the clock edge at the end of cycle t."""
    if s.kind == bus.COMPUTED:
        bus.compute_answers(s, t)
    elif s.kind == bus.LPDDR3:
        dram.end_cycle(s, t)
    else:
        bus.step_memory(s, t)
