"""The paper's comparison of foveated representations: storage, HVSQ of each level, and the cost of a foveated frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from golden.metrics.level_pooling import LevelPooling
from golden.metrics.pooling import KINDS
from golden.training.level_quality import Levels, level_hvsq
from msv2.studies.training.frame_work import FrameWork, foveated_frame_work

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene


@dataclass(frozen=True)
class Compared:
    """The row of a method.

    Attributes:
        method: the method's name.
        points: the number of points of each level.
        storage_mb: the storage of all levels in 10^6 bytes.
        over_l1_percent: the storage that the levels add to that of L1.
        hvsq, hvsq_validation: for each level at its own pooling, the mean HVSQ over test views and over validation views, with
            the windows of the gates.
        hvsq_by_kind: that over test views for each kind of windows.
        points_per_pixel: the points of each level over the pixels of a frame.
        frame: the mean foveated frame of the test views, with the gaze in the centre.
        seconds: the time of the training beyond L1.
    """

    method: str
    points: tuple[int, ...]
    storage_mb: float
    over_l1_percent: float
    hvsq: tuple[float, ...]
    hvsq_validation: tuple[float, ...]
    frame: FrameWork
    seconds: float
    hvsq_by_kind: dict[str, tuple[float, ...]]
    points_per_pixel: tuple[float, ...]

    @property
    def points_percent(self) -> tuple[float, ...]:
        """The points of each level in percent of L1's."""
        return tuple(100.0 * count / self.points[0] for count in self.points)

    def record(self) -> dict[str, object]:
        """The row as JSON-ready values."""
        return asdict(self) | {"points_percent": self.points_percent, "frame": self.frame.record()}


def compare(
    scene: TrainingScene, methods: Mapping[str, Levels], seconds: Mapping[str, float], pooling: LevelPooling,
) -> list[Compared]:
    """The rows of the methods, in their order.

    Args:
        scene: the scene. Quality is measured on its judged test views and on its validation views.
        methods: the models by the method's name.
        seconds: the seconds of training by the method's name.
        pooling: HVSQ's pooling in the gates.
    """
    rows, pixels = [], scene.size[0] * scene.size[1]
    for name, levels in methods.items():
        storage = levels.storage
        frames = [foveated_frame_work(levels, scene.cameras[view]) for view in scene.judged]
        by_kind = {kind: level_hvsq(levels, scene, scene.judged, pooling=pooling.of_kind(kind)) for kind in KINDS}
        hvsq = (by_kind[pooling.kind], level_hvsq(levels, scene, scene.validation, pooling=pooling))
        rows.append(Compared(
            name, tuple(levels.counts), storage.total / 1e6, storage.overhead_percent, *hvsq, FrameWork.mean(frames),
            seconds.get(name, 0.0), by_kind, tuple(count / pixels for count in levels.counts)))
    return rows


def fewer_percent(ours: Compared, plain: Compared) -> tuple[float, ...]:
    """The points of each level that opacity enhancement saves, in percent of those without it."""
    return tuple(100.0 * (1 - a / b) for a, b in zip(ours.points, plain.points, strict=True))
