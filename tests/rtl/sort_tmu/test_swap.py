"""The paper's baseline: no stage begins a group before all stages have done theirs, and nothing stands still for good."""

from __future__ import annotations

from collections import deque

import pytest
from amaranth.sim import Simulator

from rtl.sort_tmu.swap import GATES, SwapTogether
from spec.config import PAPER_BASE, TINY

BASE = TINY.with_(incremental=False, lockstep=True)
BUFFER = 8
"""Items that the model of the double buffer holds."""


async def _frame(ctx, dut, lengths: list[int], trail: list[tuple[str, int, int, int]]) -> None:
    """Plays tiles with so many items, each a group of its own if it has any; notes (gate, item's group, groups that have
    left the sorter, groups that were rendered) for every item that passes a gate."""
    ctx.set(dut.clear, 1)
    await ctx.tick()
    ctx.set(dut.clear, 0)
    groups = [length for length in lengths if length]
    reading = deque((group, place == length - 1) for group, length in enumerate(groups) for place in range(length))
    sorting, shown, rendered, tiles, announced = deque(), deque(), 0, deque(lengths), deque()
    left = 0
    for cycle in range(400 + 12 * sum(lengths)):
        ctx.set(dut.tile_moves, bool(tiles))
        if tiles:
            announced.append(tiles[0])
            ctx.set(dut.tile, {"tile": 0, "count": tiles.popleft(), "group": 0, "last": announced[-1] > 0})
        complete = any(last for _, last in sorting)
        offered = {"groups": reading[0] if reading else None, "sorted": sorting[0] if complete else None,
                   "shown": shown[0] if shown and (any(last for _, last in shown) or len(shown) == BUFFER) else None}
        ready = {"groups": True, "sorted": len(shown) < BUFFER, "shown": cycle % 3 != 0}
        for name in GATES:
            source, sink = getattr(dut, f"{name}_in"), getattr(dut, f"{name}_out")
            ctx.set(source.valid, offered[name] is not None)
            ctx.set(source.payload.last, bool(offered[name] and offered[name][1]))
            ctx.set(sink.ready, ready[name])
        ends = bool(announced) and (announced[0] == 0 or rendered > 0) and cycle % 5 == 4
        ctx.set(dut.row_ends, ends)
        moved = {name: ctx.get(getattr(dut, f"{name}_out").valid) and ready[name] for name in GATES}
        for name, (taken_from, given_to) in zip(GATES, ((reading, sorting), (sorting, shown), (shown, None)), strict=True):
            if moved[name]:
                group, last = taken_from.popleft()
                trail.append((name, group, left, len([1 for t in trail if t[0] == "drawn"])))
                if given_to is not None:
                    given_to.append((group, last))
                left += name == "sorted" and last
                rendered += name == "shown" and last
        if ends and announced.popleft():
            rendered -= 1
            trail.append(("drawn", 0, 0, 0))
        await ctx.tick()


@pytest.mark.parametrize("lengths", ([3, 5, 2, 2, 7, 1, 4], [0, 4, 0, 0, 6, 0], [5, 40, 3, 25, 2], [0, 0], [1] * 30))
def test_groups_keep_in_step(lengths: list[int]) -> None:
    dut, trail = SwapTogether(BASE), []

    async def bench(ctx) -> None:
        for _ in range(2):
            done = len(trail)
            part: list[tuple[str, int, int, int]] = []
            await _frame(ctx, dut, lengths, part)
            trail.extend(part)
            assert len(trail) > done or not any(lengths)

    simulator = Simulator(dut)
    simulator.add_clock(1e-6)
    simulator.add_testbench(bench)
    simulator.run()
    for name in GATES:
        assert sum(t[0] == name for t in trail) == 2 * sum(lengths)
    assert sum(t[0] == "drawn" for t in trail) == 2 * sum(length > 0 for length in lengths)
    for name, group, left, drawn in trail:
        if name == "groups":
            assert left >= group - 1 and drawn >= group - 2
        if name == "sorted":
            assert drawn >= group - 1
        if name == "shown" and lengths[-1] != 2:  # with [5, 40, ...] a group larger than the buffer is shown before it has left
            assert left > group


def test_only_machines_with_double_buffers_and_one_eye_swap_together() -> None:
    assert PAPER_BASE.lockstep and not PAPER_BASE.incremental
    for changes in ({"incremental": True}, {"stereo": True}):
        with pytest.raises(ValueError, match=r"^lockstep must be False where"):
            PAPER_BASE.with_(**changes)
    with pytest.raises(TypeError, match="config must be an AcceleratorConfig"):
        SwapTogether(None)
