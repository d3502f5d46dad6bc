"""Stimuli of the batch buffer in joint frames (`spec.joint`): super-tiles with tiles of both eyes, and pairs that have places
in one of them or in both."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from spec.config import AcceleratorConfig
from spec.constants import MAX_LEVELS, SUPER_TILES
from spec.joint import EYES, SHIFT_MOST
from tb.supertiles.batch_stimuli import EVERY, Case, Tiles, case_of, random_tiles

TARGET = SUPER_TILES
"""Place of the target's first bit in a mask of both eyes."""

BOTH = EVERY << TARGET | EVERY
"""Mask of all tiles of both eyes."""

LEVELS = (0, 1, 2, 3) * (EYES * SUPER_TILES // MAX_LEVELS)
"""All levels among the tiles of each eye."""

FLAT = (0,) * EYES * SUPER_TILES
"""One level."""


def joint_tiles(rng: np.random.Generator, pairs: int, density: float, levels: int) -> Tiles:
    """A super-tile of both eyes at random; a third of its pairs each are in the source alone, in both, and in the target
    alone."""
    source, target = (random_tiles(rng, pairs, density, levels) for _ in range(EYES))
    kinds = rng.integers(0, 3, pairs)
    masks = [(kind < 2) * mine | (kind > 0) * other << TARGET
             for kind, mine, other in zip(kinds.tolist(), source.masks, target.masks, strict=True)]
    return Tiles(masks, [*source.levels, *target.levels], source.inside | target.inside << TARGET)


def random_joint_case(
    config: AcceleratorConfig, name: str, seed: int, *, supertiles: int = 12, mean_pairs: float | None = None,
    density: float | None = None,
) -> Case:
    """A case of random super-tiles, as `tb.supertiles.batch_stimuli.random_case`, with a random shift."""
    rng = np.random.default_rng(seed)
    mean = config.batch_places if mean_pairs is None else mean_pairs
    made = []
    for _ in range(supertiles):
        pairs = 0 if rng.random() < 0.15 else int(rng.exponential(mean))
        share = float(rng.choice([0.0, 0.1, 0.3, 0.9])) if density is None else density
        made.append(joint_tiles(rng, pairs, share, int(rng.integers(1, MAX_LEVELS))))
    return case_of(config, name, made, seed, joint=True, shift=int(rng.integers(-SHIFT_MOST, SHIFT_MOST + 1)))


def _joint(config: AcceleratorConfig, name: str, made: list[Tiles], seed: int, shift: int) -> Case:
    return case_of(config, name, made, seed, joint=True, shift=shift)


def _outside(config: AcceleratorConfig) -> Case:
    """Super-tiles of which one eye sees all, some or none; with few pairs and without."""
    made = []
    for inside in (BOTH, EVERY, EVERY << TARGET, 1, 1 << TARGET, 0x8001 << TARGET | 0x0180, 0):
        made += [Tiles([], FLAT, inside)] * 3
        if inside:
            lowest, highest = inside & -inside, 1 << inside.bit_length() - 1
            made += [Tiles([lowest], FLAT, inside), Tiles([lowest, highest, inside], FLAT, inside)]
    return _joint(config, "joint, outside", made, 1, SHIFT_MOST)


def _boundaries(config: AcceleratorConfig) -> Case:
    """Super-tiles whose last pair ends a full batch, comes one pair later, or has as many places as a pair can have."""
    most = config.batch_places
    limit = most - EYES * MAX_LEVELS
    one = [[(1, 1 << TARGET)[n % 2] for n in range(count)] for count in range(limit - 1, limit + 4)]
    last = [[1 << TARGET] * count + [BOTH] for count in range(limit - 3, limit + 1)]
    full = [[1] * count + [BOTH] + [2] * 3 for count in range(limit - 3, limit + 1)]
    return _joint(config, "joint, ends of batches", [
        *[Tiles(masks, FLAT, BOTH) for masks in one], *[Tiles(masks, LEVELS, BOTH) for masks in (*last, *full)],
        Tiles([BOTH] * (2 * most // (EYES * MAX_LEVELS) + 1), LEVELS, BOTH)], 2, -3)


def _one_eye(config: AcceleratorConfig) -> Case:
    """Super-tiles of which only one eye has places, in many batches, and the last tile of each eye alone."""
    count = 2 * config.batch_places
    ends = [1 << TARGET - 1, 1 << 2 * TARGET - 1]
    return _joint(config, "joint, one eye", [
        Tiles([0x20] * count, FLAT, BOTH), Tiles([0x20 << TARGET] * count, FLAT, BOTH), Tiles(ends * count, FLAT, BOTH),
        Tiles([1 << TARGET] * count, FLAT, 1 << TARGET)], 3, 1)


JOINT: tuple[Callable[[AcceleratorConfig], Case], ...] = (_outside, _boundaries, _one_eye)
"""Cases made by hand."""
