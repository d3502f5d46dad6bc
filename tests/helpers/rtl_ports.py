"""Streams of several ports at once in Amaranth's simulator, cycle by cycle, and beats for those that read memory."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence

from amaranth.hdl import Elaboratable, Value
from amaranth.lib import stream, wiring
from amaranth.sim import Simulator

from spec.config import TINY
from spec.memory import BEAT_BYTES, WORDS, read_data

Moves = dict[str, list[tuple[int, int]]]
"""By port: the cycle of each transfer, and what moved."""


def play(
    dut: wiring.Component, feeds: Mapping[str, Sequence[int]], takes: Mapping[str, float], cycles: int, *, seed: int = 0,
    pauses: float = 0.0, setup: Mapping[str, int] | None = None, each: Callable | None = None,
    design: Elaboratable | None = None, late: int = 0,
) -> Moves:
    """Words into streams of `dut` and out of others, each output held back in a share of the cycles: what moved when.

    `each(ctx, cycle)` is called in every cycle, before it. Words of `data` answer one transfer of `reads` each, at least
    `late` cycles after it. Checks that what is offered stays as it is.
    """
    rng, moves, left = random.Random(seed), {name: [] for name in (*feeds, *takes)}, {n: list(w) for n, w in feeds.items()}

    async def bench(ctx):
        for name, value in (setup or {}).items():
            ctx.set(getattr(dut, name), value)
        offered, held = dict.fromkeys(feeds, False), {}
        for cycle in range(cycles):
            if each:
                each(ctx, cycle)
            for name, words in left.items():
                port = getattr(dut, name)
                asked = name != "data" or (
                    len(moves["reads"]) > len(moves["data"]) and moves["reads"][len(moves["data"])][0] + late < cycle)
                offered[name] = bool(words) and asked and (offered[name] or rng.random() >= pauses)
                ctx.set(port.valid, offered[name])
                if offered[name]:
                    ctx.set(Value.cast(port.payload), words[0])
            for name, share in takes.items():
                ctx.set(getattr(dut, name).ready, rng.random() >= share)
            await ctx.delay(1e-10)
            for name in moves:
                port: stream.Interface = getattr(dut, name)
                valid, ready, word = ctx.get(port.valid), ctx.get(port.ready), ctx.get(Value.cast(port.payload))
                if name in takes and name in held:
                    assert valid and held[name] == word, f"{name} must stay until it is taken"
                held.pop(name, None)
                if name in takes and valid and not ready:
                    held[name] = word
                if valid and ready:
                    moves[name].append((cycle, word))
                    if name in left:
                        left[name].pop(0)
                        offered[name] = False
            await ctx.tick()

    simulator = Simulator(design or dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    return moves


def words_of(moves: Moves, port: str) -> list[int]:
    return [word for _, word in moves[port]]


def cycles_of(moves: Moves, port: str) -> list[int]:
    return [cycle for cycle, _ in moves[port]]


def beats_of(words: Sequence[int], per_beat: int, error: Sequence[int] = ()) -> list[int]:
    """ReadData with several words of the same size each."""
    record, size = read_data(TINY), 8 * BEAT_BYTES // per_beat
    found = []
    for start in range(0, len(words), per_beat):
        bits = sum(word << size * i for i, word in enumerate(words[start : start + per_beat]))
        words_32 = [bits >> 32 * i & 0xFFFFFFFF for i in range(WORDS)]
        found.append(record.pack({"word": words_32, "error": start // per_beat in error}))
    return found
