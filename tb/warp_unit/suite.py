"""The warp unit's tests: every beat and every tile of the target eye's frame must be right, at the required speed."""

from __future__ import annotations

import numpy as np

from golden.msv2_ref.frame_memory import frame_pixels
from spec.config import PAPER, PAPER_SMALL, TINY, AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BITS, WORDS
from spec.stereo import clear_cycles, reach
from tb.common import exact
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.framed import IDLE_AFTER
from tb.common.patterns import Pattern
from tb.common.scenes import traced_frames, traced_size
from tb.vrc_array.pixel_writer_stimuli import random_pixels, rows_of
from tb.warp_unit.cones import cones, cones_folder, psnr_of_cones
from tb.warp_unit.device import playback
from tb.warp_unit.stimuli import (
    Source,
    anything,
    close_by,
    every_border,
    every_neighbourhood,
    many_to_one,
    placed,
    tiles_of,
    traced,
    with_holes,
    writes_of,
)

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny": TINY.with_(stereo=True),
    "tiny-16-lanes": TINY.with_(stereo=True, warp_lanes=16, cores_x=2, warp_fill="interior", warp_columns=64),
    "tiny-8-lanes": TINY.with_(stereo=True, warp_lanes=8, cores_x=8, counters=False, warp_veiled=True, warp_columns=512),
    "paper_small": PAPER_SMALL.with_(stereo=True), "paper": PAPER.with_(stereo=True)}
"""Configurations that can be tested."""

DISTINCT = tuple(VARIANTS)
"""Configurations with different units: every number of lanes, both rules of filling, veiled pixels warped or not, the smallest
ring buffer, and one that holds whole rows."""

PORTS = ("rows", "writes", "tiles")

SIZES = ((1, 1), (2, 3), (7, 17), (8, 16), (9, 17), (15, 33), (16, 16), (17, 16), (24, 32), (31, 49), (33, 5), (40, 40),
         (97, 18))
"""Sizes of frames: narrower than a beat and than a tile, whole and incomplete beats and tiles, one row of tiles and several."""

LEAST_COLUMNS = 4 * TILE
"""The smallest number of columns of a machine's ring buffer."""

BETWEEN_STRIPS = 36
"""Cycles that are lost between two strips: the latency of the last pixel on its way into the ring buffer, or that of the last
group through the median."""


class Plan:
    """Runs of the warp unit; each has a new frame number, as the bench starts a frame when that number changes.

    Attributes:
        runs: the runs added so far.
    """

    def __init__(self, config: AcceleratorConfig, seed: int):
        self.runs: list[Planned] = []
        self._config, self._rng, self._frame = config, np.random.default_rng(seed), 0

    def add(self, name: str, source: Source, **options: object) -> Planned:
        """Adds the run that warps a frame. Only the first run resets the unit, because clearing the ring buffer takes time,
        unless `options`, which are those of `planned`, say otherwise."""
        self._frame = self._frame % 255 + 1  # never 0, which is the bench's number before the first frame
        height, width = source.pixels.shape
        base, warped = int(self._rng.integers(1 << BEAT_BITS)), source.warped(self._config)
        events = warped.events if self._config.counters else dict.fromkeys(warped.events, 0)
        item = planned(
            name, {"rows": rows_of(self._config, source.pixels, self._rng)},
            {"writes": writes_of(self._config, warped.pixels, base), "tiles": tiles_of(self._config, warped.invalid)},
            settings={"width": width, "height": height, "source_right": int(source.right), "disparity_scale": source.scale,
                      "target_frame_base": base, "tile_count": len(warped.invalid), "frame": self._frame},
            observed={"busy": 0, "finished": 1, "early": 0, **events}, **{"reset": not self.runs, **options})
        self.runs.append(item)
        return item


def directed_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Cases by hand."""
    plan, rng = Plan(config, seed), np.random.default_rng(seed)
    for right in (False, True):
        eye = "right" if right else "left"
        for every in (1, 2):
            plan.add(f"many to one, {eye}, every {every}", many_to_one(config, rng, 67, 32, right, every))
        plan.add(f"one disparity, {eye}", placed(config, rng, np.full((32, 48), 5.5), right))
        plan.add(f"off the row, {eye}", placed(config, rng, np.linspace(0, 120, 90) + np.zeros((17, 1)), right))
        plan.add(f"no depth, {eye}", placed(config, rng, np.full((16, 40), np.inf), right))
        plan.add(f"close by, {eye}", close_by(config, rng, 90, 48, right))
    for width in (1, 16, 48):  # the scan begins at the place to which a row's last pixel was just warped
        plan.add(f"last to first, {width} wide", placed(config, rng, np.full((33, width), width - 1.0)))
    plan.add("background", with_holes(config, rng, np.ones((40, 37), bool), 1.0))
    plan.add("all holes", with_holes(config, rng, np.zeros((40, 37), bool)))
    plan.add("every neighbourhood", every_neighbourhood(config, rng))
    plan.add("every border", every_border(config, rng))
    for width, height in ((1, 65), (2, 130), (3, 193), (40, 1), (33, 17)):  # corners, and frames without inner pixels
        for share in (0.5, 0.8):
            plan.add(f"narrow, {width} x {height}, {share}", with_holes(config, rng, rng.random((height, width)) < share))
    for share in (0.2, 0.5, 0.7, 0.9, 0.99):
        plan.add(f"{share} of pixels warped", with_holes(config, rng, rng.random((35, 61)) < share))
    for width, times in ((config.warp_columns + 37, 4), (config.row_width, 1), (reach(config) + 1, 3)):
        width = min(width, config.row_width)
        for right in (False, True):  # to the other side of the frame, at one column more and one less than the reach
            size, most = (times * TILE - 5, width), reach(config)
            far = rng.choice([0.5, most - 1, most, most + 1, 2 * most], size).repeat(7, 1)[:, :width]
            far = np.maximum(far + rng.choice([-1, -0.5, 0, 0.5, 1], size), 0)
            plan.add(f"reached, {width} wide, {'right' if right else 'left'}", placed(config, rng, far, right))
    wide = np.random.default_rng(seed).random((18, config.row_width)) * rng.choice([1, 30, 300], (18, config.row_width))
    plan.add("widest", placed(config, rng, wide, True))
    return plan.runs


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Frames of many sizes, patterns of pauses, runs back to back, and runs cut off by resets."""
    plan, rng = Plan(config, seed), np.random.default_rng(seed + 1)
    for n, (width, height) in enumerate(SIZES):
        plan.add(f"{width} x {height}", anything(config, rng, width, height, n % 2 == 1))
    for n, (name, patterns) in enumerate(every_pattern(PORTS, seed).items()):
        plan.add(name, anything(config, rng, 37, 50, n % 2 == 1), patterns=patterns)
    for k in range(6):  # the last strip has few rows, so its beats wait while other columns are packed
        plan.add(f"paused writes of a low strip {k}", anything(config, rng, 61 + k, 17 + k // 2, k % 2 == 1),
                 patterns={"writes": (Pattern.BURSTY, seed + k)})
    for k in range(6):
        plan.add(f"back to back {k}", anything(config, rng, 33 + k, 17, k % 2 == 1))
    for cycles in (30, 3000 + clear_cycles(config)):  # before the ring buffer is clear, and well into the frame
        plan.add(f"cut off after {cycles} cycles", anything(config, rng, 64, 96), abort=cycles)
        plan.add(f"whole frame after a reset at {cycles}", anything(config, rng, 35, 17), reset=True)
    return plan.runs


def strip_cycles(config: AcceleratorConfig, width: int) -> int:
    """Most cycles of a strip without holes, including those between strips. The pixels per cycle are the smallest of the number
    of lanes, the pixels of a row from the array, and the pixels of a beat."""
    return width * TILE // min(config.warp_lanes, config.cores_x, WORDS) + BETWEEN_STRIPS


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Frames without holes, which take `warp_lanes` pixels per cycle at any width, because some columns are warped while others
    are written. The smallest ring buffer is excepted: it has no free space beyond the tiles that a pixel can reach."""
    plan, rng = Plan(config, seed), np.random.default_rng(seed + 2)
    plan.add("clear", anything(config, rng, 16, 16))
    for width, height in ((128, 64), (127, 64), (250, 32)):
        full = with_holes(config, rng, np.ones((height, width), bool))
        item = plan.add(f"rate, {width} x {height}", full)
        tiles = 4 * len(item.expected["tiles"])
        most = (height // TILE + 1) * strip_cycles(config, width) + tiles + IDLE_AFTER
        plan.runs[-1] = planned(
            item.name, item.run.inputs, item.expected, settings=item.run.settings, observed=item.observed, reset=False,
            most_cycles=None if config.warp_columns == LEAST_COLUMNS else most)
    return plan.runs


CONES = "traced Middlebury cones"


def cones_plan(config: AcceleratorConfig) -> list[Planned]:
    """A photograph with its true disparities, where it is present and the machine's rows are wide enough."""
    plan, folder = Plan(config, 0), cones_folder()
    if folder is not None and config.row_width >= 450 and not config.warp_veiled:
        plan.add("clear, then cones", anything(config, np.random.default_rng(0), 16, 16))
        plan.add(CONES, cones(config, folder))
    return plan.runs


def traced_plan(config: AcceleratorConfig, size: str) -> list[Planned]:
    """The frames of real scenes."""
    plan = Plan(config, 0)
    plan.add("clear, then scenes", anything(config, np.random.default_rng(0), 16, 16))
    for n, (name, frame) in enumerate(traced_frames(config, size).items()):
        for right in (False, True) if n < 2 else (n % 2 == 1,):  # the embedded scene is warped both ways
            plan.add(f"traced {name}, {'right' if right else 'left'}", traced(config, frame_pixels(frame), right))
    return plan.runs


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    random = Plan(config, seed)
    rng = np.random.default_rng(seed + 3)
    for k in range(4):
        random.add(f"random {k}", Source(random_pixels(config, rng, 150, 70), int(rng.integers(1 << 16)), k % 2 == 1))
    return [*directed_plan(config, seed), *unit_plan(config, seed), *rate_plan(config, seed), *random.runs,
            *traced_plan(config, traced_size(config, "320x176")), *cones_plan(config)]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome):
        width, height = (item.run.settings[name] for name in ("width", "height"))
        cycles = recording.cycles - 4 * len(item.expected["tiles"]) - IDLE_AFTER
        shares = ", ".join(f"{name} {item.observed[name]}" for name in ("warped", "filled", "invalid_tiles"))
        lines.append(f"{item.name}: {width * height} pixels in about {cycles} cycles, {width * height / cycles:.3f} a cycle, "
                     f"rows wait {recording.stalls['rows']} cycles; {shares}")
        if item.name == CONES:
            base = item.run.settings["target_frame_base"]
            seen = psnr_of_cones(config, cones_folder(), recording.outputs["writes"], base)
            lines.append(f"{CONES} against the right photograph: {seen['warped_db']:.2f} dB warped, "
                         f"{seen['unwarped_db']:.2f} dB not, over {seen['share']:.1%} of its pixels")
    return lines


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
