"""The frame packer's tests: every beat of a packed frame and of its table must be right, at the required speed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from golden.msv2_ref.frame_memory import frame_pixels
from spec.config import DEFAULT, PAPER, TINY, AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BITS
from spec.packed import BLOCK_HEIGHT, BLOCK_WIDTH, BLOCKS
from tb.common import exact
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.scenes import traced_frames
from tb.pixels.packer_device import playback
from tb.pixels.packer_stimuli import (
    graded_pixels,
    half_pixels,
    packed_pixels,
    packed_writes,
    shuffled_tiles,
    tile_order,
    uneven_pixels,
    uniform_pixels,
)
from tb.vrc_array.pixel_writer_stimuli import every_value, random_pixels, rows_of

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny": TINY, "tiny-2-wide": TINY.with_(cores_x=2), "tiny-8-wide": TINY.with_(cores_x=8, cores_y=8, depth=False),
    "default": DEFAULT, "paper": PAPER}
"""Configurations that can be tested."""

DISTINCT = ("tiny", "tiny-2-wide", "tiny-8-wide", "paper")
"""Configurations with different units: every width of a pixel row."""

PORTS = ("rows", "writes")

SIZES = ((1, 1), (15, 17), (16, 16), (17, 3), (31, 33), (70, 5), (97, 20))
"""Sizes of frames: one pixel more or less than tiles and blocks, tiles with blocks beyond the frame, and tables of beats that
rows of tiles share."""

SETTLING = 30
"""Most cycles of a run in addition to those of its rows or its beats."""

Maker = Callable[[AcceleratorConfig, np.random.Generator, int, int], np.ndarray]

KINDS: dict[str, Maker] = {
    "graded": graded_pixels, "noise": random_pixels, "one colour": uniform_pixels, "half": half_pixels, "uneven": uneven_pixels}
"""What frames hold."""


class Plan:
    """Runs of the frame packer; each has a new frame number, as the bench starts a frame when that number changes.

    Attributes:
        runs: the runs added so far.
    """

    def __init__(self, config: AcceleratorConfig, seed: int):
        self.runs: list[Planned] = []
        self._config, self._rng, self._frame = config, np.random.default_rng(seed), 0

    def add(
        self, name: str, frame: np.ndarray, *, missing: int = 0, shuffled: bool = False, slack: int | None = None,
        **options: object,
    ) -> Planned:
        """Adds the run that plays a frame's (height, width) FramePixel records; `options` are those of `planned`.

        With `missing` so many of the last tiles do not come, and the frame does not finish. `shuffled`: tiles come in any
        order. With `slack` the run may take that many cycles more than its rows or its beats, whichever are more.
        """
        self._frame = (self._frame + 1) % 256
        height, width = frame.shape
        base, rows = int(self._rng.integers(1 << BEAT_BITS)), rows_of(self._config, frame, self._rng)
        columns = -(-width // TILE)
        count = columns * -(-height // TILE)
        if shuffled:
            rows = shuffled_tiles(self._rng, rows, columns)
        packed, order = packed_pixels(self._config, frame), tile_order(rows, columns)
        rows = rows[: len(rows) // count * (count - missing)]
        writes = packed_writes(self._config, packed, order[: count - missing], base)
        if missing:
            writes = writes[:-1]  # the last beat of the table waits for the tile
        if slack is not None:
            options["most_cycles"] = max(len(rows), len(writes)) + slack
        item = planned(
            name, {"rows": rows}, {"writes": writes},
            settings={"width": width, "height": height, "frame_base": base, "tile_count": count, "frame": self._frame},
            observed={"busy": 0, "finished": not missing, "early": 0} | ({} if missing else {"pixels": width * height})
            if options.get("quiet", 1) else None, **options)
        self.runs.append(item)
        return item


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Frames of many sizes and kinds, tiles in any order, patterns of pauses, runs cut off by resets, and runs back to back."""
    plan, rng = Plan(config, seed), np.random.default_rng(seed)
    for width, height in SIZES:
        for kind, make in KINDS.items():
            plan.add(f"{width} x {height}, {kind}", make(config, rng, width, height))
    plan.add("tiles in any order", graded_pixels(config, rng, 150, 50), shuffled=True)
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.add(name, graded_pixels(config, rng, 75, 21), patterns=patterns, reset=False)
        plan.add(f"{name}, noise", random_pixels(config, rng, 49, 21), patterns=patterns, reset=False)
    plan.add("a tile is missing", graded_pixels(config, rng, 37, 16), missing=1)
    for cycles in (1, 2, 3, 30, 77):
        plan.add(f"cut off after {cycles} cycles", graded_pixels(config, rng, 64, 32), abort=cycles)
        plan.add(f"whole frame after a reset at {cycles}", graded_pixels(config, rng, 35, 17))
    for k in range(8):
        plan.add(f"back to back {k}", graded_pixels(config, rng, 33 + k, 17), reset=False)
    plan.add("every value", every_value(config, rng))
    return plan.runs


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Runs that must take a row of the array or write a beat in every cycle."""
    plan, rng = Plan(config, seed), np.random.default_rng(seed)
    plan.add("rate, one colour", uniform_pixels(config, rng, 256, 64), slack=SETTLING)
    plan.add("rate, noise", random_pixels(config, rng, 128, 64), slack=SETTLING)
    plan.add("rate, smooth", graded_pixels(config, rng, 256, 64, 1.0), slack=SETTLING)
    return plan.runs


def traced_plan(config: AcceleratorConfig, size: str) -> list[Planned]:
    """The frames of real scenes."""
    plan = Plan(config, 0)
    for name, frame in traced_frames(config, size).items():
        plan.add(f"traced {name}", frame_pixels(frame))
    return plan.runs


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [*unit_plan(config, seed), *rate_plan(config, seed), *traced_plan(config, "131x75")]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome):
        rows, beats = len(item.run.inputs["rows"]), len(item.expected["writes"])
        pixels = item.run.settings["width"] * item.run.settings["height"]
        lines.append(f"{item.name}: {rows} rows, {beats} beats ({32 * beats / (4 * pixels):.3f} of unpacked) "
                     f"in {recording.cycles} cycles")
    return lines


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""

assert BLOCKS * BLOCK_HEIGHT == BLOCK_WIDTH == TILE
