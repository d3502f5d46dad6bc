"""Pruning compared: from one dense model, by the same loop, what each gate and each criterion leaves of intersections."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from golden.diff.gaussians import Gaussians
from golden.training.evaluate import evaluate
from golden.training.pruning import gate_views
from msv2.studies.training.frame_work import FrameWork, whole_frame_work
from msv2.studies.training.table_runs import Trained, prune_stages, tuned_stage

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene

OURS = "ce"
"""The criterion of our loops."""


@dataclass(frozen=True)
class Look:
    """A loop's look at its gate.

    Attributes:
        psnr: dB, on the gate's validation views.
        entries: (splat, tile) pairs listed per frame of these.
        passed: whether it passed.
    """

    psnr: float
    entries: float
    passed: bool


@dataclass(frozen=True)
class EqualQuality:
    """A baseline's result beside the looks of our loop with the same gate, on the gate's validation views.

    Attributes:
        psnr: dB, of the baseline's result.
        entries: per frame, of the baseline's result.
        ours: fewest entries that our loop had at no less PSNR; None: it never had that PSNR.
    """

    psnr: float
    entries: float
    ours: float | None


@dataclass(frozen=True)
class Pruned:
    """A row.

    Attributes:
        criterion: one of efficiency.CRITERIA, or None: the dense model.
        variant: of the gate, or None: the dense model.
        tuned: whether it was fine-tuned after the loop: the L1 of a finished run.
        points: Gaussians.
        psnr, ssim: on the test views.
        frame: mean frame of the test views.
        equal: of baselines, how our loop compares.
    """

    criterion: str | None
    variant: str | None
    tuned: bool
    points: int
    psnr: float
    ssim: float
    frame: FrameWork
    equal: EqualQuality | None = None

    def record(self, dense: Pruned) -> dict[str, Any]:
        """Ready for JSON, with shares of the dense model's."""
        return asdict(self) | {
            "frame": self.frame.record(), "points_percent": 100 * self.points / dense.points,
            "psnr_percent": 100 * self.psnr / dense.psnr,
            "ssim_percent": 100 * self.ssim / dense.ssim, "cut": dense.frame.entries / max(self.frame.entries, 1.0)}


def pruning_rows(scene: TrainingScene, trained: Trained) -> list[Pruned]:
    """The dense model's row, then ours gate by gate, then the baselines'; the scene's test views judge."""
    results, recipe, views = trained.results, trained.recipe, gate_views(scene, trained.recipe.prune_options())
    dense = evaluate(results["dense"], scene, views)
    first = Look(dense.psnr, dense.entries, True)
    rows = [_row(scene, results["dense"], None, None)]
    loops = prune_stages(recipe)
    mine = looks(trained.records, loops[OURS, recipe.variant], first)
    for (criterion, variant), stage in loops.items():
        if criterion == OURS:
            rows.append(_row(scene, results[stage], criterion, variant))
            rows.append(_row(scene, results[tuned_stage(stage)], criterion, variant, tuned=True))
        else:
            equal = equal_quality(looks(trained.records, stage, first), mine)
            rows.append(_row(scene, results[stage], criterion, variant, equal=equal))
    return rows


def _row(scene: TrainingScene, model: Gaussians, criterion: str | None, variant: str | None, **more: Any) -> Pruned:
    quality = evaluate(model, scene, scene.test)
    frame = FrameWork.mean([whole_frame_work(model, scene.cameras[view]) for view in scene.test])
    return Pruned(criterion, variant, points=len(model), psnr=quality.psnr, ssim=quality.ssim, frame=frame,
                  **{"tuned": False, **more})


def looks(records: Iterable[Mapping[str, Any]], stage: str, dense: Look) -> list[Look]:
    """A loop's looks from its chain's log: the dense model's, which comes before the first iteration, and the logged ones."""
    return [dense, *(Look(record["psnr"], record["entries"], bool(record["passed"]))
                     for record in records if record["stage"] == stage and "passed" in record)]


def equal_quality(baseline: Sequence[Look], ours: Sequence[Look]) -> EqualQuality:
    """The baseline's result, which is its passing look with the fewest entries, against all looks of ours."""
    kept = min((look for look in baseline if look.passed), key=lambda look: look.entries)
    return EqualQuality(
        kept.psnr, kept.entries, min((look.entries for look in ours if look.psnr >= kept.psnr), default=None))
