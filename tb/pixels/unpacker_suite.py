"""The block unpacker's tests: every row of whole and of damaged blocks must be the golden unpacker's."""

from __future__ import annotations

from functools import cache

import numpy as np

from golden.host.packed_frame import by_block, unpack_blocks
from rtl.emit import to_verilog
from rtl.pixels.block_unpacker import BlockUnpacker
from spec.config import DEFAULT, TINY, AcceleratorConfig
from spec.memory import BEAT_BYTES, read_data
from spec.packed import (
    BLOCK_HEIGHT,
    CHECK_BITS,
    ENTRY_BITS,
    SLOT_BEATS,
    PackedError,
    display_row,
    listed_block,
    table_beat,
)
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.playback import Playback, Stream
from tb.pixels.packer_stimuli import graded_pixels, packed_pixels, uneven_pixels, uniform_pixels
from tb.vrc_array.pixel_writer_stimuli import random_pixels

VARIANTS: dict[str, AcceleratorConfig] = {"tiny": TINY, "default": DEFAULT}
"""Configurations that can be tested."""

DISTINCT = ("tiny",)
"""Configurations with different units: no parameter changes this one."""

PORTS = ("blocks", "beats", "rows")

SETTLING = 12

WIDTH, HEIGHT = 160, 32
"""Size of the frames, of whole tiles."""


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The unit, emitted as Verilog, with a file at each stream."""
    return Playback(
        name="block-unpacker", module="block_unpacker",
        verilog=emitted("block-unpacker", config, lambda config: to_verilog(BlockUnpacker(config), "block_unpacker")),
        inputs=(Stream("blocks", listed_block(config)), Stream("beats", read_data(config))),
        outputs=(Stream("rows", display_row(config)),), observed=(("busy", 1),))


def unpacked(
    config: AcceleratorConfig, name: str, data: np.ndarray, failed: float = 0.0, seed: int = 0, **options: object,
) -> Planned:
    """The run that unpacks all blocks of a frame of WIDTH by HEIGHT pixels in memory, uint8. Of its beats a share `failed`
    comes with an error of the memory."""
    pixels, errors = unpack_blocks(data, WIDTH, HEIGHT)
    table = BEAT_BYTES * table_beat(WIDTH, HEIGHT)
    entries = data[table:].view("<u2")[: len(errors)].astype(np.int64)
    blocks = np.zeros(len(errors), listed_block(config).dtype)
    blocks["size"], blocks["block"] = entries & (1 << ENTRY_BITS - CHECK_BITS) - 1, np.arange(len(errors))
    blocks["check"] = entries >> ENTRY_BITS - CHECK_BITS
    counts = np.where(blocks["size"] <= SLOT_BEATS, blocks["size"], 0)
    used = np.arange(SLOT_BEATS) < counts[:, None]
    beats = np.zeros(int(used.sum()), read_data(config).dtype)
    beats["word"] = data[:table].view("<u4").reshape(-1, SLOT_BEATS, BEAT_BYTES // 4)[used]
    beats["error"] = np.random.default_rng(seed).random(len(beats)) < failed
    owner = np.repeat(np.arange(len(errors)), counts)
    errors[np.setdiff1d(owner[beats["error"] > 0], np.flatnonzero(errors))] = PackedError.CHECK
    rows = np.zeros(BLOCK_HEIGHT * len(errors), display_row(config).dtype)
    rows["pixel"] = by_block(pixels).reshape(len(rows), -1)
    rows["error"][BLOCK_HEIGHT - 1 :: BLOCK_HEIGHT] = errors
    return planned(name, {"blocks": blocks, "beats": beats}, {"rows": rows}, observed={"busy": 0}, **options)


def damaged(rng: np.random.Generator, data: np.ndarray) -> np.ndarray:
    """A frame in memory with a wrong bit in every other block and a wrong size in some."""
    out, table = data.copy(), BEAT_BYTES * table_beat(WIDTH, HEIGHT)
    count = table // (BEAT_BYTES * SLOT_BEATS)
    for block in range(0, count, 2):  # bits of the header, of which most are codes, or of what follows
        out[BEAT_BYTES * SLOT_BEATS * block + rng.integers(0, (16, 40)[block // 2 % 2])] ^= 1 << rng.integers(0, 8)
    for block in range(1, count, 3):
        out[table + 2 * block] = out[table + 2 * block] & 0xF0 | rng.integers(0, 16)
    return out


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Whole and damaged frames, patterns of pauses, resets, and full rate."""
    rng = np.random.default_rng(seed)

    def region(make: object, *more: float) -> np.ndarray:
        return packed_pixels(config, make(config, rng, WIDTH, HEIGHT, *more)).region().reshape(-1)

    plan = []
    whole = {"graded": region(graded_pixels), "noise": region(random_pixels), "one colour": region(uniform_pixels),
             "smooth": region(graded_pixels, 1.0)}
    for name, data in whole.items():
        sizes = data[BEAT_BYTES * table_beat(WIDTH, HEIGHT) :].view("<u2")[: WIDTH * HEIGHT // 64] & 15
        plan.append(unpacked(config, f"rate, {name}", data,
                             most_cycles=int(np.maximum(6, sizes.astype(int) + 3).sum()) + SETTLING))
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(unpacked(config, name, damaged(rng, region(graded_pixels)), patterns=patterns, reset=False))
        plan.append(unpacked(config, f"{name}, uneven rows", region(uneven_pixels), patterns=patterns, reset=False))
    plan += [unpacked(config, f"damaged {k}", damaged(rng, region(graded_pixels))) for k in range(6)]
    plan.append(unpacked(config, "errors of the memory", damaged(rng, region(graded_pixels)), failed=0.2, seed=seed))
    for cycles in (2, 9, 40):
        plan.append(unpacked(config, f"cut off after {cycles} cycles", region(graded_pixels), abort=cycles))
        plan.append(unpacked(config, f"after a reset at {cycles}", region(graded_pixels)))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return unit_plan(config, seed)


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    return [f"{item.name}: {len(item.run.inputs['blocks'])} blocks of {len(item.run.inputs['beats'])} beats in "
            f"{recording.cycles} cycles" for item, recording in exact.at_full_rate(plan, outcome, "rate")]


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
