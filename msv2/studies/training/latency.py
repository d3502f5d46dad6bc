"""The latency of a frame against its points and against its intersections (the paper's motivation, section 3.1).

The study uses versions of one dense model with more and more of its points removed, by LightGaussian's importance as in the
paper and by CE. None is retrained, so that only the number and the choice of points differ.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from golden.diff.gaussians import Gaussians
from golden.scenes.camera import Camera
from golden.training.efficiency import Scores, without_lowest
from msv2.studies.cycles import CYCLES, LPDDR3_MODEL, RTL
from msv2.studies.training.frame_work import FrameWork, whole_frame_work
from msv2.studies.training.rtl_cycles import RtlCycles

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

CRITERIA = ("importance", "ce")
"""The criteria that choose the points to remove, named as in `golden.training.efficiency`."""

REMOVED = (0.0, 0.25, 0.5, 0.75, 0.9, 0.97)
"""The shares of points that are removed; the paper shows 75 to 97 %."""

EDGE = 256
"""Longest edge of the frames in pixels, a size at which simulating the RTL takes seconds."""


@dataclass(frozen=True)
class Version:
    """A pruned version of the model, and the cost of its frame.

    Attributes:
        criterion: one of CRITERIA.
        removed: the share of the dense model's points that was removed.
        points: the number of remaining points.
        work: the work for the frame, by the golden renderer and the cycle model.
        rtl: the cycles of the RTL, or None.
    """

    criterion: str
    removed: float
    points: int
    work: FrameWork
    rtl: RtlCycles | None

    def record(self) -> dict[str, Any]:
        """The version as JSON-ready values."""
        rtl = None if self.rtl is None else asdict(self.rtl) | {"cycles": self.rtl.cycles}
        return asdict(self) | {"work": self.work.record(), "rtl": rtl}


def frame_camera(camera: Camera, edge: int = EDGE) -> Camera:
    """The camera with the same proportions, at a size of at most `edge`."""
    scale = min(1.0, edge / max(camera.width, camera.height))
    return camera.resized(max(1, round(scale * camera.width)), max(1, round(scale * camera.height)))


def pruned(dense: Gaussians, scene: TrainingScene, criterion: str, removed: Sequence[float] = REMOVED) -> list[Gaussians]:
    """The dense model without the shares `removed` of its points. Those with the lowest scores on the training views go
    first."""
    scores = Scores(criterion, [scene.cameras[view] for view in scene.train]).measure(dense)
    counts = [min(round(share * len(dense)), len(dense) - 1) for share in removed]
    return [dense.select(without_lowest(scores, count)) for count in counts]


def measure(
    dense: Gaussians, scene: TrainingScene, *, edge: int = EDGE, removed: Sequence[float] = REMOVED,
    rtl: Callable[[Gaussians, Camera], RtlCycles] | None = None, progress: Callable[[], object] | None = None,
) -> list[Version]:
    """The versions by both criteria. The version from which nothing is removed is measured once and appears under both.

    Args:
        dense: the dense model.
        scene: the scene; the frame is that of its first test view.
        edge: the longest edge of the frame in pixels.
        removed: the shares of points to remove.
        rtl: a function that gives the RTL's cycles of a frame of a model; None for cycles by the model alone.
        progress: is called after each version.
    """
    camera, versions, whole = frame_camera(scene.cameras[scene.test[0]], edge), [], None
    for criterion in CRITERIA:
        for share, model in zip(removed, pruned(dense, scene, criterion, removed), strict=True):
            if len(model) < len(dense) or whole is None:
                cost = whole_frame_work(model, camera), None if rtl is None else rtl(model, camera)
                whole = cost if len(model) == len(dense) else whole
            else:
                cost = whole
            versions.append(Version(criterion, share, len(model), *cost))
            if progress is not None:
                progress()
    return versions


def series(versions: Sequence[Version]) -> dict[str, np.ndarray]:
    """(V,) float64 of each quantity: points, intersections, cycles by the model, and RTL cycles if all were measured."""
    result = {
        "points": [v.points for v in versions], "entries": [v.work.entries for v in versions],
        LPDDR3_MODEL: [v.work.cycles for v in versions]}
    if all(v.rtl is not None for v in versions):
        result[RTL] = [v.rtl.cycles for v in versions]
    return {name: np.array(values, np.float64) for name, values in result.items()}


def proportionality(versions: Sequence[Version]) -> dict[str, dict[str, dict[str, float]]]:
    """How latency follows points and intersections: by the source of the latency (model, RTL), then by points or entries.

    `pearson` is the correlation. `off` is the mean over versions of |ln(latency / dense's) - ln(quantity / dense's)|. It is 0
    if both fall at the same rate, and 0.69 if one falls to half of what the other does.
    """
    data, result = series(versions), {}
    for latency in CYCLES:
        if latency not in data:
            continue
        result[latency] = {}
        for quantity in ("points", "entries"):
            x, y = data[quantity], data[latency]
            shares = np.log(np.maximum(x, 1) / max(x[0], 1)), np.log(y / y[0])
            varies = len(x) > 1 and x.std() > 0 and y.std() > 0
            result[latency][quantity] = {
                "pearson": float(np.corrcoef(x, y)[0, 1]) if varies else float("nan"),
                "off": float(np.abs(shares[1] - shares[0]).mean())}
    return result
