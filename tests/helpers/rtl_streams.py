"""Tools of the RTL tests: streams in Amaranth's simulator, and the rejection of bad parameters."""

from __future__ import annotations

import gc
import random
import re
import warnings
from collections.abc import Callable, Mapping, Sequence

import pytest
from amaranth.hdl import Elaboratable, UnusedElaboratable
from amaranth.lib import stream
from amaranth.sim import Simulator


def exchange(
    dut: Elaboratable, sources: Mapping[stream.Interface, Sequence[int]], sink: stream.Interface, count: int, *,
    pauses: float = 0.0, seed: int = 0, limit: int = 20_000, setup=None,
) -> tuple[list[int], list[int]]:
    """Feed each source its words and take `count` words from `sink`: (words, cycles of their transfers).

    Each side pauses in a share `pauses` of the cycles. Checks on the way that a payload holds until its transfer. `setup(ctx)`
    drives what is constant. AssertionError if `limit` cycles do not suffice.
    """
    rng, words, cycles = random.Random(seed), [], []

    def feed(port: stream.Interface, values: Sequence[int], mine: random.Random):
        async def process(ctx):
            for value in values:
                while mine.random() < pauses:
                    await ctx.tick()
                ctx.set(port.payload, port.payload.shape().from_bits(value))
                ctx.set(port.valid, 1)
                while True:
                    _, _, ready = await ctx.tick().sample(port.ready)
                    if ready:
                        break
                ctx.set(port.valid, 0)
        return process

    async def take(ctx):
        if setup:
            setup(ctx)
        waiting = None
        for cycle in range(limit):
            ctx.set(sink.ready, rng.random() >= pauses)
            _, _, valid, ready, payload = await ctx.tick().sample(sink.valid, sink.ready, sink.payload)
            word = payload.as_bits() if valid else None
            assert waiting is None or word == waiting, "a payload must hold until it is taken"
            waiting = word if valid and not ready else None
            if valid and ready:
                words.append(word)
                cycles.append(cycle)
            if len(words) == count:
                return
        raise AssertionError(f"{len(words)} of {count} words after {limit} cycles")

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    for i, (port, values) in enumerate(sources.items()):
        simulator.add_process(feed(port, values, random.Random(f"{seed} {i}")))
    simulator.add_testbench(take)
    simulator.run()
    return words, cycles


def assert_rejected(make: Callable[[], object], error: type[Exception], value: object) -> None:
    """`make()` raises `error` naming `value`; Amaranth's complaint about the half-made component is silenced."""
    gc.freeze()  # what is there already: to look through all that a long run holds takes a second
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UnusedElaboratable)
            with pytest.raises(error, match=re.escape(f"not {value!r}")):
                make()
            gc.collect()
    finally:
        gc.unfreeze()
