"""Tiles of real scenes, as realistic stimuli for the array."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from golden.msv2_ref.pipeline import Frame
from golden.scenes.captured import scene_argument
from spec.config import AcceleratorConfig
from tb.common.scenes import TRAINED, traced_frame
from tb.vrc_array.array_stimuli import Case

_TILES, _ENTRIES = 12, 6000


def case_of(frame: Frame, name: str) -> Case:
    """A whole frame as a case."""
    return Case(name, frame.headers, frame.array_entries, frame.registers.background)


def pick_tiles(case: Case, seed: int, tiles: int = _TILES, entries: int = _ENTRIES) -> Case:
    """Some tiles of a case, in order: at most `tiles` tiles with at most `entries` intersections, chosen by `seed`."""
    start = np.concatenate(([0], np.cumsum(case.headers["count"])))
    chosen: list[int] = []
    total = 0
    for tile in np.random.default_rng(seed).permutation(len(case.headers)).tolist():
        count = int(case.headers["count"][tile])
        if len(chosen) < tiles and total + count <= entries:
            chosen.append(tile)
            total += count
    chosen.sort()
    which = np.concatenate([np.arange(start[t], start[t + 1]) for t in chosen])
    return Case(case.name, case.headers[chosen], case.entries[which], case.background)


def traced_cases(config: AcceleratorConfig, seed: int) -> list[Case]:
    """Tiles of the embedded scene and of those trained scenes that are present, with foveation and without."""
    return [pick_tiles(case, seed) for case in _whole_frames(config)]


@cache
def _whole_frames(config: AcceleratorConfig) -> list[Case]:
    scenes = filter(None, map(scene_argument, ("embedded", *TRAINED)))
    cases = []
    for scene in scenes:
        for gaze, levels in (("none", None), ("50,40", config.levels))[: 1 + (config.levels > 1)]:
            _, frame = traced_frame(config, scene, "160x96", gaze, levels)
            cases.append(case_of(frame, f"traced {Path(scene).stem}{', foveated' * (gaze != 'none')}"))
    return cases
