"""Makes what failed smaller: fewer frames, then fewer Gaussians."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from msv2.cases.soak.draw import Drawn

Fails = Callable[[Sequence[Drawn]], bool]


def fewest_frames(frames: Sequence[Drawn], fails: Fails) -> list[Drawn]:
    """The shortest end of the frames that still fails; the last one is the one that failed."""
    for count in range(1, len(frames)):
        if fails(frames[-count:]):
            return list(frames[-count:])
    return list(frames)


def fewest_gaussians(frames: Sequence[Drawn], fails: Fails, *, tries: int = 40) -> list[Drawn]:
    """The same frames with as few Gaussians in the last one as `tries` simulations find: halves, quarters and so on are left
    out as long as it still fails."""
    kept, parts = list(frames), 2
    while tries > 0 and len(kept[-1].model) > 1:
        rows = np.array_split(np.arange(len(kept[-1].model)), min(parts, len(kept[-1].model)))
        for part in rows:
            rest = np.setdiff1d(np.concatenate(rows), part)
            fewer = [*kept[:-1], replace(kept[-1], model=kept[-1].model.select(rest))]
            tries -= 1
            if fails(fewer):
                kept, parts = fewer, max(parts - 1, 2)
                break
            if tries == 0:
                break
        else:
            if parts >= len(kept[-1].model):
                break
            parts *= 2
    return kept
