"""The paper's ablation: points, intersections and quality after each technique, beginning with the dense model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from golden.diff.gaussians import Gaussians
from golden.training.evaluate import evaluate
from golden.training.foveated import FLOAT_BYTES, FoveatedModel, floats_per_point
from msv2.studies.training.frame_work import FrameWork, foveated_frame_work, whole_frame_work

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene


@dataclass(frozen=True)
class Step:
    """A row of the ablation.

    Attributes:
        name: the technique that was added.
        points: the number of points of L1.
        storage_mb: the storage of all levels in 10^6 bytes.
        psnr, ssim: of L1 on the test views. A foveated frame shows the same L1 in the fovea.
        points_per_pixel: the points of L1 over the pixels of a frame.
        psnr_gate: PSNR of L1 on the validation views.
        frame: the mean frame of the test views; it is foveated, with the gaze in the centre, if the model has levels.
    """

    name: str
    points: int
    storage_mb: float
    psnr: float
    ssim: float
    frame: FrameWork
    points_per_pixel: float
    psnr_gate: float

    def record(self) -> dict[str, object]:
        """The row as JSON-ready values."""
        return asdict(self) | {"frame": self.frame.record()}


def ablate(scene: TrainingScene, models: Sequence[tuple[str, Gaussians | FoveatedModel]]) -> list[Step]:
    """The rows of models, which are named and in the order in which techniques are added. Quality is measured on test views."""
    rows = []
    for name, model in models:
        foveated = isinstance(model, FoveatedModel)
        first = model.level(0) if foveated else model
        storage = model.storage.total if foveated else FLOAT_BYTES * floats_per_point(model) * len(model)
        work = foveated_frame_work if foveated else whole_frame_work
        quality, gate = evaluate(first, scene, scene.judged), evaluate(first, scene, scene.validation, ssim=False)
        frames = [work(model, scene.cameras[view]) for view in scene.judged]
        rows.append(Step(name, len(first), storage / 1e6, quality.psnr, quality.ssim, FrameWork.mean(frames),
                         len(first) / (scene.size[0] * scene.size[1]), gate.psnr))
    return rows
