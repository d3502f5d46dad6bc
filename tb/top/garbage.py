"""Frames of a host that errs: random bits in what it put into memory, and random values in the registers.

Such a frame may show anything or be refused, but it must end, keep the rules of the bus, write nothing into what the host
filled, and leave the machine so that the next frame is right. What the host must get right is where things lie: bases and sizes
of regions, the numbers of Gaussians and chunks, and a frame that fits its region. Machines with super-tiles may need their
watchdog, for which a simulation waits only in the machine of `tb.top.power_up`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from spec.codes import ErrorCode
from spec.config import AcceleratorConfig
from spec.host_settings import settings
from tb.top.planned import PlannedFrame, planned, problems
from tb.top.player import FrameResult
from tb.top.stimuli import case, cloud, crowd

PLACES = ("gaussians", "chunks", "width", "height", "display", "packed", "view_shift")
"""Settings besides bases and sizes of regions that say where things lie."""

WAYS = ("any bits", "few bits", "zeros", "ones", "repeated")
"""How a region is spoilt."""


@dataclass(frozen=True)
class Spoilt:
    """A frame to play.

    Attributes:
        item: the frame, or where `free` is set one of which only is asked that it ends.
        free: whether memory or registers are random.
        what: what is random, in words.
    """

    item: PlannedFrame
    free: bool = False
    what: Sequence[str] = field(default=())


def garbage_plan(config: AcceleratorConfig, seed: int, count: int) -> list[Spoilt]:
    """`count` spoilt frames, each with a right one after it, and no reset between them."""
    rng = np.random.default_rng(seed)
    scenes = [case(config, "scene", cloud(rng, 150, levels=config.levels, sh=1), (64, 48), gaze=(20, 10)),
              case(config, "crowd", crowd(rng, 300), (32, 32), beta=5)]
    plan: list[Spoilt] = []
    for number in range(count):
        scene = scenes[number % 2]
        item = planned(scene, f"spoilt {number}", ("usual", "instant", "pauses")[number % 3], reset=number == 0, poison=True)
        if number % 3 < 2:
            item, what = _spoil_memory(rng, item)
        else:
            what = []
        if number % 3:
            changes = _random_settings(rng, config)
            item, what = replace(item, run=replace(item.run, changes=changes)), [*what, *changes]
        plan += [Spoilt(item, True, what), Spoilt(planned(scene, f"after spoilt {number}", reset=False, poison=False))]
    return plan


def _spoil_memory(rng: np.random.Generator, item: PlannedFrame) -> tuple[PlannedFrame, list[str]]:
    image = item.run.image
    names = [name for name, rows in image.contents.items() if len(rows)]
    chosen = rng.choice(names, int(rng.integers(1, len(names) + 1)), replace=False)
    contents: dict[str, np.ndarray] = dict(image.contents)
    for name in chosen:
        contents[name] = _spoilt(rng, image.contents[name], str(rng.choice(WAYS)))
    return replace(item, run=replace(item.run, image=replace(image, contents=contents))), [str(name) for name in chosen]


def _spoilt(rng: np.random.Generator, rows: np.ndarray, way: str) -> np.ndarray:
    """(beats, bytes) uint8 of a region, spoilt in one of WAYS."""
    if way == "any bits":
        return rng.integers(0, 256, rows.shape, np.uint8)
    if way == "few bits":
        return rows ^ ((rng.random(rows.shape) < 0.02) * (1 << rng.integers(0, 8, rows.shape))).astype(np.uint8)
    if way == "repeated":
        return np.repeat(rows[rng.integers(len(rows))][None], len(rows), 0)
    return np.full_like(rows, 0 if way == "zeros" else 255)


def _random_settings(rng: np.random.Generator, config: AcceleratorConfig) -> dict[str, int]:
    """Random values of some settings or of all that may be random: any bits, the limits, or few ones."""
    free = [s for s in settings(config) if not s.name.endswith(("_base", "_beats")) and s.name not in PLACES]
    share = rng.choice([0.05, 0.3, 1.0])
    changes: dict[str, int] = {}
    for setting in free:
        if rng.random() < share:
            low, high = setting.field.raw_range
            changes[setting.name] = int(rng.choice([rng.integers(low, high + 1), low, high, low + (high - low) // 3]))
    return changes


def wrongs(plan: Sequence[Spoilt], results: Sequence[FrameResult]) -> dict[str, list[str]]:
    """What is wrong, by the frame's name."""
    found = {}
    for spoilt, result in zip(plan, results, strict=True):
        wrong = _of_free(result) if spoilt.free else problems(spoilt.item, result)
        if wrong:
            found[spoilt.item.name] = [*wrong, *([f"spoilt: {', '.join(spoilt.what)}"] if spoilt.free else [])]
    return found


def _of_free(result: FrameResult) -> list[str]:
    ended = result.done != (result.error is not ErrorCode.NONE)
    return [*result.errors, *([] if ended else [f"it ended with {result.error.name} and done {result.done}"])]


def ends(plan: Sequence[Spoilt], results: Sequence[FrameResult]) -> Mapping[str, int]:
    """How many spoilt frames ended in which way."""
    codes = [result.error.name for spoilt, result in zip(plan, results, strict=True) if spoilt.free]
    return {code: codes.count(code) for code in sorted(set(codes))}
