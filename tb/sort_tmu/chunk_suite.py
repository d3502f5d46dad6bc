"""The chunk sorter's tests: every intersection must come out in its place, at the required speed."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache

import numpy as np

from golden.msv2_ref.sort import sort_chunks
from spec.config import PAPER, PAPER_SMALL, TINY, AcceleratorConfig
from spec.records import chunk_item
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, backpressure, every_pattern, planned, rate
from tb.common.playback import Playback, Stream
from tb.common.scenes import traced_frames, traced_size
from tb.sort_tmu.chunk_stimuli import ORDERS, bit_chunks, group_chunks, items_of, random_chunk, random_chunks

VARIANTS: dict[str, AcceleratorConfig] = {"tiny": TINY, "paper_small": PAPER_SMALL, "paper": PAPER}
"""Configurations that can be tested."""

DISTINCT = ("tiny", "paper")
"""Configurations with different units: chunks of 256 and of 4,096 intersections. PAPER_SMALL's are one bit shorter than
PAPER's."""

PORTS = ("chunks", "sorted")

LONG_CHUNK, LEAST_RATE = 256, 0.95
"""Chunks of at least LONG_CHUNK intersections must be sorted at LEAST_RATE intersections per cycle, including the change from
one chunk to the next."""


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The sorter of a configuration, emitted as Verilog, with a file at each stream."""
    record = chunk_item(config)
    return Playback(
        name=f"sort-{config.sort_chunk}", module="chunk_sorter",
        verilog=emitted("chunk_sorter", config),
        inputs=(Stream("chunks", record),), outputs=(Stream("sorted", record),), observed=(("busy", 1),))


def plan_of(config: AcceleratorConfig, name: str, chunks: Iterable[np.ndarray], **options: object) -> Planned:
    """The run that plays chunks; `options` are those of `planned`."""
    items = items_of(config, chunks)
    return planned(name, {"chunks": items}, {"sorted": sort_chunks(items)}, observed={"busy": 0}, **options)


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Lengths around powers of two in every order, heads that differ at each bit, patterns of pauses, runs cut off by resets,
    runs back to back, and chunks after which nothing follows."""
    rng, top = np.random.default_rng(seed), config.sort_chunk
    near = sorted({(1 << k) + d for k in range(top.bit_length()) for d in (-1, 0, 1)} - {top + 1})
    plan = []
    for order in ORDERS:
        chunks = [random_chunk(config, rng, length, order) for length in rng.permutation(near)]
        plan.append(plan_of(config, f"powers of two and next to them, {order}", chunks))
    mixed = {"short": rng.integers(0, 9, 600), "empty": [0] * 50, "long and short": [top, 0, 1, top, 2, top - 1, 1, 0, 0, top]}
    for name, lengths in mixed.items():
        plan.append(plan_of(config, f"{name} chunks", random_chunks(config, rng, lengths)))
    streams = random_chunks(config, rng, [*rng.integers(0, min(top, 300), 20), 0, 1, 2, 3])
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(config, name, streams, patterns=patterns, reset=False))
    short = random_chunks(config, rng, rng.integers(0, min(top, 60), 20 + 5 * top // 30))
    for name, patterns in backpressure(PORTS[:1], PORTS[1:], seed).items():
        plan.append(plan_of(config, name, short, patterns=patterns, reset=False))
    for cycles in (3, top // 2, 2 * top, 3 * top):
        plan.append(plan_of(config, f"cut off after {cycles} cycles", random_chunks(config, rng, [top] * 4), abort=cycles))
        plan.append(plan_of(config, f"chunks after a reset at {cycles}", streams))
    for k in range(3):
        chunks = random_chunks(config, rng, rng.integers(0, top // 4, 8))
        plan.append(plan_of(config, f"back to back {k}", chunks, reset=False, quiet=0))
    for stage in range(top.bit_length() - 1):
        chunks = bit_chunks(config, 1 << stage)
        plan.append(plan_of(config, f"heads of stage {stage} differ at each bit", chunks, quiet=20))
    return [*plan, *lone_plan(config, rng)]


def lone_plan(config: AcceleratorConfig, rng: np.random.Generator) -> list[Planned]:
    """A chunk that nothing follows, so that no stage learns from the next one that a run is alone: one to three whole runs of a
    stage with and without one more intersection, and the longest chunk in every order."""
    top, plan = config.sort_chunk, []
    lengths = sorted({count * run + more for run in (1 << k for k in range(top.bit_length() - 1))
                      for count in (1, 2, 3) for more in (0, 1) if count * run + more <= top})
    for number, length in enumerate(lengths):
        chunk = random_chunk(config, rng, length, ("random", "sorted", "reversed")[number % 3])
        plan.append(plan_of(config, f"{length} intersections alone", [chunk], reset=False, quiet=20))
    for order in ORDERS:
        chunk = random_chunk(config, rng, top, order)
        plan.append(plan_of(config, f"a full chunk alone, {order}", [chunk], reset=False, quiet=20))
    return plan


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Long chunks at full rate in every order."""
    rng, top = np.random.default_rng(seed), config.sort_chunk
    low = min(LONG_CHUNK, top // 2 + 1)
    plan = []
    for order in ORDERS:
        lengths = [*rng.integers(low, top + 1, 6), low, top, low, top]
        chunks = [random_chunk(config, rng, length, order) for length in lengths]
        plan.append(plan_of(config, f"rate, {order}", chunks, least_rate={"chunks": LEAST_RATE}))
    return plan


def traced_plan(config: AcceleratorConfig, size: str) -> list[Planned]:
    """The groups of real scenes' frames. Groups of at least LONG_CHUNK are also played alone, at the required rate."""
    plan, top = [], config.sort_chunk
    for name, frame in traced_frames(config, size).items():
        chunks = group_chunks(frame, top)
        plan.append(plan_of(config, f"traced {name}", chunks))
        long = [chunk for chunk in chunks if len(chunk) >= LONG_CHUNK]
        if long:
            plan.append(plan_of(
                config, f"traced {name}, groups of {LONG_CHUNK} and more", long, least_rate={"chunks": LEAST_RATE}))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [*unit_plan(config, seed), *rate_plan(config, seed), *traced_plan(config, traced_size(config, "640x360"))]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome):
        items = item.run.inputs["chunks"]
        entries, chunks = int((items["empty"] == 0).sum()), int(items["last"].sum())
        lines.append(
            f"{item.name}: {entries} entries in {chunks} chunks, {rate(recording, 'chunks'):.4f} entries a cycle, "
            f"{recording.cycles} cycles from the first entry in to the last out")
    return lines


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
