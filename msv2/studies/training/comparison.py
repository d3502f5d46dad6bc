"""The paper's comparison of foveated representations: storage, HVSQ of each level, and what a foveated frame costs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from golden.training.level_quality import Levels, level_hvsq
from msv2.studies.training.frame_work import FrameWork, foveated_frame_work

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene


@dataclass(frozen=True)
class Compared:
    """A method's row.

    Attributes:
        method: its name.
        points: of each level.
        storage_mb: 10^6 bytes, of all levels.
        over_l1_percent: what the levels add to L1's storage.
        hvsq, hvsq_validation: of each level at its own pooling, means over test views and over validation views.
        frame: mean foveated frame of the test views, gaze in the centre.
        seconds: what training it took beyond its L1.
    """

    method: str
    points: tuple[int, ...]
    storage_mb: float
    over_l1_percent: float
    hvsq: tuple[float, ...]
    hvsq_validation: tuple[float, ...]
    frame: FrameWork
    seconds: float

    @property
    def points_percent(self) -> tuple[float, ...]:
        """Points of each level, percent of L1's."""
        return tuple(100.0 * count / self.points[0] for count in self.points)

    def record(self) -> dict[str, object]:
        """Ready for JSON."""
        return asdict(self) | {"points_percent": self.points_percent, "frame": self.frame.record()}


def compare(scene: TrainingScene, methods: Mapping[str, Levels], seconds: Mapping[str, float]) -> list[Compared]:
    """The rows, in the methods' order.

    Args:
        scene: its test views judge; its validation views are measured too.
        methods: models by name.
        seconds: of training, by name.
    """
    rows = []
    for name, levels in methods.items():
        storage = levels.storage
        frames = [foveated_frame_work(levels, scene.cameras[view]) for view in scene.test]
        hvsq = [level_hvsq(levels, scene, views) for views in (scene.test, scene.validation)]
        rows.append(Compared(
            name, tuple(levels.counts), storage.total / 1e6, storage.overhead_percent, *hvsq, FrameWork.mean(frames),
            seconds.get(name, 0.0)))
    return rows


def fewer_percent(ours: Compared, plain: Compared) -> tuple[float, ...]:
    """Points of each level that opacity enhancement saves, percent of those without it."""
    return tuple(100.0 * (1 - a / b) for a, b in zip(ours.points, plain.points, strict=True))
