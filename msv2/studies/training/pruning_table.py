"""Compares pruning: the intersections that each gate and each criterion leaves of one dense model, with the same loop."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from golden.diff.gaussians import Gaussians, to_model
from golden.training.evaluate import evaluate
from golden.training.pruning import OURS, gate_views
from msv2.studies.training.frame_work import UP, FrameWork, whole_frame_work
from msv2.studies.training.square_lists import square_intersections
from msv2.studies.training.table_runs import Trained, prune_stages, tuned_stage

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene


@dataclass(frozen=True)
class Look:
    """An evaluation of a pruning loop's model at its gate.

    Attributes:
        psnr: PSNR in dB on the gate's validation views.
        entries: intersections per frame of these views.
        passed: whether the model passed.
    """

    psnr: float
    entries: float
    passed: bool


@dataclass(frozen=True)
class EqualQuality:
    """A baseline's result compared with the evaluations of our loop with the same gate, on the gate's validation views.

    Attributes:
        psnr: PSNR in dB of the baseline's result.
        entries: intersections per frame of the baseline's result.
        ours: the fewest intersections of our loop at no less PSNR; None if it never had that PSNR.
    """

    psnr: float
    entries: float
    ours: float | None


@dataclass(frozen=True)
class Pruned:
    """A row of the table.

    Attributes:
        criterion: one of efficiency.CRITERIA; None for the dense model.
        variant: the variant of the gate; None for the dense model.
        tuned: whether the model was fine-tuned after the loop, which makes it the L1 of a finished run.
        points: the number of Gaussians.
        psnr, ssim: on the test views.
        frame: the mean frame of the test views.
        squares: its intersections if they were listed as 3DGS lists them, see `square_lists`.
        points_per_pixel: the points over the pixels of a frame.
        psnr_gate: PSNR on the gate's validation views.
        equal: for baselines, the comparison with our loop.
    """

    criterion: str | None
    variant: str | None
    tuned: bool
    points: int
    psnr: float
    ssim: float
    frame: FrameWork
    squares: float
    points_per_pixel: float
    psnr_gate: float
    equal: EqualQuality | None = None

    def record(self, dense: Pruned) -> dict[str, Any]:
        """The row as JSON-ready values, with shares of the dense model's."""
        return asdict(self) | {
            "frame": self.frame.record(), "points_percent": 100 * self.points / dense.points,
            "psnr_percent": 100 * self.psnr / dense.psnr, "psnr_gate_percent": 100 * self.psnr_gate / dense.psnr_gate,
            "ssim_percent": 100 * self.ssim / dense.ssim, "cut": dense.frame.entries / max(self.frame.entries, 1.0),
            "cut_squares": dense.squares / max(self.squares, 1.0)}


def pruning_rows(scene: TrainingScene, trained: Trained) -> list[Pruned]:
    """The row of the dense model, then ours for each gate, then the baselines'. Quality is measured on the scene's test
    views."""
    results, recipe, views = trained.results, trained.recipe, gate_views(scene, trained.recipe.prune_options())
    dense = evaluate(results["dense"], scene, views, ssim=False)
    first = Look(dense.psnr, dense.entries, True)
    rows = [_row(scene, views, results["dense"], None, None)]
    loops = prune_stages(recipe)
    mine = looks(trained.records, loops[OURS, recipe.variant], first)
    for (criterion, variant), stage in loops.items():
        if criterion == OURS:
            rows.append(_row(scene, views, results[stage], criterion, variant))
            rows.append(_row(scene, views, results[tuned_stage(stage)], criterion, variant, tuned=True))
        else:
            equal = equal_quality(looks(trained.records, stage, first), mine)
            rows.append(_row(scene, views, results[stage], criterion, variant, equal=equal))
    return rows


def _row(
    scene: TrainingScene, gate: Sequence[int], model: Gaussians, criterion: str | None, variant: str | None, **more: Any,
) -> Pruned:
    quality = evaluate(model, scene, scene.judged)
    frame = FrameWork.mean([whole_frame_work(model, scene.cameras[view]) for view in scene.judged])
    plain = to_model(model, up=UP, name="level")
    squares = float(np.mean([square_intersections(plain, scene.cameras[view]) for view in scene.judged]))
    return Pruned(criterion, variant, points=len(model), psnr=quality.psnr, ssim=quality.ssim, frame=frame, squares=squares,
                  points_per_pixel=len(model) / (scene.size[0] * scene.size[1]),
                  psnr_gate=evaluate(model, scene, gate, ssim=False).psnr, **{"tuned": False, **more})


def looks(records: Iterable[Mapping[str, Any]], stage: str, dense: Look) -> list[Look]:
    """The evaluations of a loop from its chain's log, preceded by that of the dense model, which the log does not contain."""
    return [dense, *(Look(record["psnr"], record["entries"], bool(record["passed"]))
                     for record in records if record["stage"] == stage and "passed" in record)]


def equal_quality(baseline: Sequence[Look], ours: Sequence[Look]) -> EqualQuality:
    """Compares the baseline's result, which is its passing evaluation with the fewest intersections, with all of ours."""
    kept = min((look for look in baseline if look.passed), key=lambda look: look.entries)
    return EqualQuality(
        kept.psnr, kept.entries, min((look.entries for look in ours if look.psnr >= kept.psnr), default=None))
