"""The paper's comparison of foveated representations: storage, HVSQ of each level, and what a foveated frame costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from golden.training.frame_cycles import FrameWork, foveated_frame_work
from golden.training.level_quality import Levels, level_hvsq

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

SMFR, MMFR, OURS, PLAIN = "SMFR", "MMFR", "ours", "ours without opacity enhancement"
"""Methods; the last is the predecessor's."""

PAPER = {
    SMFR: {"fps": 125.9, "storage_mb": 161.6, "hvsq_e5": (2.12, 10.1, 21.7, 28.3)},
    MMFR: {"fps": 52.6, "storage_mb": 311.0, "hvsq_e5": (2.12, 1.87, 1.79, 1.76)},
    OURS: {"fps": 102.2, "storage_mb": 171.8, "hvsq_e5": (2.12, 2.10, 2.09, 2.08)},
}
"""The paper's table of FR methods: means of 13 scenes, frames per second of a Jetson Xavier."""

PREDECESSOR_PERCENT = (100.0, 40.1, 21.8, 17.4)
"""Points per level of the predecessor's model of the bicycle scene, percent of L1's."""

PAPER_FEWER_PERCENT = 33.0
"""The paper's largest cut of points in R3 and R4 by opacity enhancement, at equal HVSQ."""


@dataclass(frozen=True)
class Compared:
    """A method's row.

    Attributes:
        method: its name.
        points: of each level.
        storage_mb: 10^6 bytes, of all levels.
        over_l1_percent: what the levels add to L1's storage.
        hvsq: of each level at its own pooling, means over test views.
        frame: mean foveated frame of the test views, gaze in the centre.
        seconds: what training it took beyond its L1.
    """

    method: str
    points: tuple[int, ...]
    storage_mb: float
    over_l1_percent: float
    hvsq: tuple[float, ...]
    frame: FrameWork
    seconds: float

    @property
    def points_percent(self) -> tuple[float, ...]:
        """Points of each level, percent of L1's."""
        return tuple(100.0 * count / self.points[0] for count in self.points)

    def record(self) -> dict[str, object]:
        """Ready for JSON."""
        frame = asdict(self.frame) | {"cycles": self.frame.cycles, "entries_per_tile": self.frame.entries_per_tile}
        return asdict(self) | {"points_percent": self.points_percent, "frame": frame}


def compare(scene: TrainingScene, methods: Mapping[str, Levels], seconds: Mapping[str, float]) -> list[Compared]:
    """The rows, in the methods' order.

    Args:
        scene: its test views judge.
        methods: models by name.
        seconds: of training, by name.
    """
    rows = []
    for name, levels in methods.items():
        storage = levels.storage
        frames = [foveated_frame_work(levels, scene.cameras[view]) for view in scene.test]
        rows.append(Compared(
            name, tuple(levels.counts), storage.total / 1e6, storage.overhead_percent, level_hvsq(levels, scene, scene.test),
            FrameWork.mean(frames), seconds.get(name, 0.0)))
    return rows


def fewer_percent(ours: Compared, plain: Compared) -> tuple[float, ...]:
    """Points of each level that opacity enhancement saves, percent of those without it."""
    return tuple(100.0 * (1 - a / b) for a, b in zip(ours.points, plain.points, strict=True))
