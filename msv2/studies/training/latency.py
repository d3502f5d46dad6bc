"""Latency of a frame against points and against tile-ellipse intersections (the paper's motivation, section 3.1).

Versions of one dense model with more and more of its points removed, by LightGaussian's importance as the paper does and by CE;
none is retrained, so that only the number and the choice of points differ.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from golden.diff.gaussians import Gaussians
from golden.scenes.camera import Camera
from golden.training.efficiency import Scores, without_lowest
from msv2.studies.cycles import CYCLES, MODEL, RTL
from msv2.studies.training.frame_work import FrameWork, whole_frame_work
from msv2.studies.training.rtl_cycles import RtlCycles

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

CRITERIA = ("importance", "ce")
"""What chooses the points that go; names as in `golden.training.efficiency`."""

REMOVED = (0.0, 0.25, 0.5, 0.75, 0.9, 0.97)
"""Shares of the points removed; the paper shows 75 to 97 %."""

EDGE = 256
"""Longest edge of the frames, in pixels: what the RTL can be simulated at in seconds."""


@dataclass(frozen=True)
class Version:
    """A pruned version and what its frame costs.

    Attributes:
        criterion: one of CRITERIA.
        removed: share of the dense model's points.
        points: that are left.
        work: of the frame, by the golden renderer and the cycle model.
        rtl: measured, or None.
    """

    criterion: str
    removed: float
    points: int
    work: FrameWork
    rtl: RtlCycles | None

    def record(self) -> dict[str, Any]:
        """Ready for JSON."""
        rtl = None if self.rtl is None else asdict(self.rtl) | {"cycles": self.rtl.cycles}
        return asdict(self) | {"work": self.work.record(), "rtl": rtl}


def frame_camera(camera: Camera, edge: int = EDGE) -> Camera:
    """The camera at a size no longer than `edge`, of its proportions."""
    scale = min(1.0, edge / max(camera.width, camera.height))
    return camera.resized(max(1, round(scale * camera.width)), max(1, round(scale * camera.height)))


def pruned(dense: Gaussians, scene: TrainingScene, criterion: str, removed: Sequence[float] = REMOVED) -> list[Gaussians]:
    """The dense model without the shares `removed` of its points, the lowest scores on the training views first."""
    scores = Scores(criterion, [scene.cameras[view] for view in scene.train]).measure(dense)
    counts = [min(round(share * len(dense)), len(dense) - 1) for share in removed]
    return [dense.select(without_lowest(scores, count)) for count in counts]


def measure(
    dense: Gaussians, scene: TrainingScene, *, edge: int = EDGE, removed: Sequence[float] = REMOVED,
    rtl: Callable[[Gaussians, Camera], RtlCycles] | None = None, progress: Callable[[], object] | None = None,
) -> list[Version]:
    """The versions by both criteria; what removes nothing is measured once and stands in both.

    Args:
        edge: longest edge of the frame, of the scene's first test view.
        rtl: cycles of a frame of a model, or None: cycles by the model alone.
        progress: called after each version.
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
    """(V,) float64 of each quantity: points, entries, cycles by the model, and RTL cycles where all were measured."""
    result = {
        "points": [v.points for v in versions], "entries": [v.work.entries for v in versions],
        MODEL: [v.work.cycles for v in versions]}
    if all(v.rtl is not None for v in versions):
        result[RTL] = [v.rtl.cycles for v in versions]
    return {name: np.array(values, np.float64) for name, values in result.items()}


def proportionality(versions: Sequence[Version]) -> dict[str, dict[str, dict[str, float]]]:
    """How latency follows points and entries: by latency (model, rtl), then by points or entries.

    `pearson`: correlation. `off`: mean over versions of |ln(latency / dense's) - ln(quantity / dense's)|: 0 where both fall at
    the same rate, 0.69 where one falls to half of what the other does.
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
