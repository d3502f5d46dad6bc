"""The pixel writer's tests: every beat of a frame must be right, at the required speed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from golden.msv2_ref.frame_memory import frame_pixels
from spec.config import PAPER, PAPER_SMALL, TINY, TINY_EYES, V3_EYES, AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BITS, WORDS
from tb.common import exact
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.patterns import PERIOD, Pattern
from tb.common.scenes import traced_frames
from tb.vrc_array.pixel_writer_device import playback
from tb.vrc_array.pixel_writer_stimuli import every_value, random_pixels, rows_of, writes_of

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny": TINY, "tiny-2-wide": TINY.with_(cores_x=2), "tiny-8-wide": TINY.with_(cores_x=8, depth=False),
    "paper_small": PAPER_SMALL, "paper": PAPER,
    "tiny_eyes": TINY_EYES, "v3_eyes": V3_EYES}
"""Configurations that can be tested."""

DISTINCT = ("tiny", "tiny-2-wide", "tiny-8-wide", "paper", "tiny_eyes", "v3_eyes")
"""Configurations with different units: every width of a pixel row, and joint frames. PAPER_SMALL's is PAPER's."""

PORTS = ("rows", "writes")

SIZES = ((1, 1), (2, 1), (1, 3), (15, 17), (16, 16), (17, 16), (31, 33), (32, 5), (33, 20), (50, 35), (97, 18))
"""Sizes of frames: odd and even widths, narrower than a row of cores and than a tile, and one pixel more or less than tiles."""

LARGE = 512
"""Width and height of the largest frame in whole tiles that every machine can render."""

FORMATS = ("", ", display")
"""The ends of run names for each format: whole pixels, and display pixels."""


class Plan:
    """Runs of the pixel writer; each has a new frame number, as the bench starts a frame when that number changes.

    Attributes:
        runs: the runs added so far.
    """

    def __init__(self, config: AcceleratorConfig, seed: int):
        self.runs: list[Planned] = []
        self._config, self._rng, self._frame = config, np.random.default_rng(seed), 0

    def add(
        self, name: str, frame: np.ndarray, *, display: bool = False, missing: int = 0, **options: object,
    ) -> Planned:
        """Adds the run that plays a frame's (height, width) FramePixel records; `options` are those of `planned`.

        With `display` the frame is written as display pixels. With `missing` the unit is told to expect that many more tiles
        than come, so that the frame does not finish.
        """
        self._frame = (self._frame + 1) % 256
        height, width = frame.shape
        base, rows = int(self._rng.integers(1 << BEAT_BITS)), rows_of(self._config, frame, self._rng)
        tiles = -(-width // TILE) * -(-height // TILE) + missing
        item = planned(
            name + FORMATS[display], {"rows": rows}, {"writes": writes_of(self._config, frame, rows, base, display)},
            settings={"width": width, "height": height, "display": int(display), "frame_base": base, "tile_count": tiles,
                      "frame": self._frame, **self._joint(joint=0)},
            observed={"busy": 0, "finished": not missing, "pixels": width * height, "early": 0}
            if options.get("quiet", 1) else None, **options)
        self.runs.append(item)
        return item


    def _joint(self, *, joint: int) -> dict[str, int]:
        base = int(self._rng.integers(1 << BEAT_BITS))
        return {"joint": joint, "target_frame_base": base} if self._config.joint else {}

    def add_joint(
        self, name: str, eyes: Sequence[np.ndarray], *, display: bool = False, missing: int = 0, **options: object,
    ) -> None:
        """Adds the run that plays the FramePixel records of two eyes, whose rows come by turns, some of each; `missing` is as
        for `add`, for each eye."""
        self._frame = (self._frame + 1) % 256
        height, width = eyes[0].shape
        more = self._joint(joint=1)
        bases = int(self._rng.integers(1 << BEAT_BITS)), more["target_frame_base"]
        parts, writes = [], []
        every = [rows_of(self._config, frame, self._rng) for frame in eyes]
        cuts = np.sort(self._rng.integers(0, len(every[0]) + 1, 6))
        for part in zip(*(np.split(rows, cuts) for rows in every), strict=True):
            for eye, rows in enumerate(part):
                rows["eye"] = eye
                parts.append(rows)
                writes.append(writes_of(self._config, eyes[eye], rows, bases[eye], display))
        self.runs.append(planned(
            name + FORMATS[display], {"rows": np.concatenate(parts)}, {"writes": np.concatenate(writes)},
            settings={"width": width, "height": height, "display": int(display), "frame_base": bases[0],
                      "tile_count": -(-width // TILE) * -(-height // TILE) + missing, "frame": self._frame, **more},
            observed={"busy": 0, "finished": not missing, "pixels": 2 * width * height, "early": 0}
            if options.get("quiet", 1) else None, **options))


def joint_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Joint frames of many sizes, with pauses, and between frames of one eye."""
    plan, rng = Plan(config, seed), np.random.default_rng(seed)

    def pixels(width: int, height: int) -> list[np.ndarray]:
        return [random_pixels(config, rng, width, height) for _ in range(2)]

    for display in (False, True):
        for width, height in (*SIZES, (config.row_width, 17), (config.row_width - 1, 3), (3, config.row_width)):
            plan.add_joint(f"joint, {width} x {height}", pixels(width, height), display=display)
        for name, patterns in every_pattern(PORTS, seed).items():
            plan.add_joint(f"joint, {name}", pixels(37, 21), display=display, patterns=patterns, reset=False)
        plan.add_joint("joint, a tile is missing", pixels(37, 21), display=display, missing=1, reset=False)
    for k in range(6):
        if k % 3 == 1:
            plan.add(f"joint, back to back {k}", random_pixels(config, rng, 33 + k, 17), display=k % 2 == 1, reset=False)
        else:
            plan.add_joint(f"joint, back to back {k}", pixels(33 + k, 17), display=k % 2 == 1, reset=False)
    return plan.runs


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Frames of many sizes, patterns of pauses, runs cut off by resets, and runs back to back."""
    plan, rng = Plan(config, seed), np.random.default_rng(seed)
    for display in (False, True):
        for width, height in (*SIZES, (config.row_width, 17), (config.row_width - 1, 3), (3, config.row_width)):
            plan.add(f"{width} x {height}", random_pixels(config, rng, width, height), display=display)
        for name, patterns in every_pattern(PORTS, seed).items():
            plan.add(name, random_pixels(config, rng, 37, 21), display=display, patterns=patterns, reset=False)
        plan.add("a tile is missing", random_pixels(config, rng, 37, 21), display=display, missing=1, reset=False)
    for n, cycles in enumerate((1, 2, 3, 30, 77)):
        plan.add(f"cut off after {cycles} cycles", random_pixels(config, rng, 64, 32), display=n % 2 == 1, abort=cycles)
        plan.add(f"whole frame after a reset at {cycles}", random_pixels(config, rng, 35, 17), display=n % 3 == 1)
    for k in range(8):
        plan.add(f"back to back {k}", random_pixels(config, rng, 33 + k, 17), display=k % 2 == 1, reset=False)
    plan.add("every value", every_value(config, rng), display=True)
    plan.add("a large frame", random_pixels(config, rng, LARGE - 1, LARGE - 3), display=True)
    plan.add("a long pause inside the last tile", random_pixels(config, rng, TILE * _tiles_until_ebb(config), TILE),
             display=True, patterns={"rows": (Pattern.TIDAL, seed)})
    return plan.runs


def _tiles_until_ebb(config: AcceleratorConfig) -> int:
    """Tiles of which the last one is begun, but not complete, when rows with tidal pauses stop coming for the first time after
    they began to come, where rows are display pixels and begin at whole beats."""
    rows = (PERIOD // 2 - PERIOD // 3) // max(1, config.cores_x // WORDS)
    return rows // (TILE * TILE // config.cores_x) + 1


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Runs that must write one beat per cycle, wherever the rows of the frame begin in a beat."""
    plan, rng = Plan(config, seed), np.random.default_rng(seed)
    for display, width, height in ((d, *size) for d in (False, True) for size in ((128, 64), (127, 64), (128, 49))):
        item = plan.add(f"rate, {width} x {height}", random_pixels(config, rng, width, height), display=display)
        rows = item.run.inputs["rows"]
        outside = int((rows["tile_y"].astype(np.int64) * TILE + rows["row"] >= height).sum())  # one cycle for each
        plan.runs[-1] = planned(
            item.name, item.run.inputs, item.expected, settings=item.run.settings, observed=item.observed,
            most_cycles=len(item.expected["writes"]) + outside + 4)
    return plan.runs


def traced_plan(config: AcceleratorConfig, size: str) -> list[Planned]:
    """The frames of real scenes."""
    plan = Plan(config, 0)
    for name, frame in traced_frames(config, size).items():
        pixels = frame_pixels(frame)
        if not config.depth:
            pixels["depth"] = 0
        for display in (False, True):
            plan.add(f"traced {name}", pixels, display=display)
    return plan.runs


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    joint = joint_plan(config, seed) if config.joint else []
    return [*unit_plan(config, seed), *rate_plan(config, seed), *joint, *traced_plan(config, "131x75")]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome):
        beats = len(item.expected["writes"])
        lines.append(f"{item.name}: {beats} beats in {recording.cycles} cycles, {beats / recording.cycles:.4f} a cycle")
    return lines


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
