"""A run's report: model.ply, report.json, and report.md made from it, with pictures and curves."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from golden.diff.gaussians import Gaussians
from golden.diff.render import render, render_foveated
from golden.metrics.hvsq import foveated
from golden.metrics.level_pooling import LevelPooling
from golden.metrics.pooling import KINDS
from golden.scenes.files import atomic_output
from golden.scenes.gaze import region_level
from golden.scenes.pictures import levels_picture, save_png
from golden.scenes.request import make_folder, write_json
from golden.scenes.save import save_model
from golden.scenes.transforms import CAMERAS, save_inria_cameras
from golden.training.evaluate import Quality, evaluate
from golden.training.foveated import level_alpha_max
from golden.training.level_quality import Levels, centre_foveation, level_hvsq
from golden.training.levels import LevelOptions
from golden.training.plots import curves, plot_curves, read_log
from golden.training.poses import with_poses
from golden.training.report_machine import machine_numbers, model_files
from golden.training.report_text import markdown
from golden.training.representable import misplaced
from golden.training.scene import TrainingScene
from spec.constants import ALPHA_MAX_L1, REGION_START_DEG

AMPLIFIED = 4
"""Factor on differences in pictures."""


@dataclass(frozen=True)
class Trained:
    """A finished chain, with everything that its report needs.

    Attributes:
        dense: the model from which pruning started.
        levels: the resulting levels.
        rows: for each stage, its name, and the 0-based level and the Gaussians of its result.
        spent: iterations and seconds of each stage.
        options: the run's options.
        references: what everything is compared with: photographs, or renders of the dense model.
        pooling: HVSQ's pooling.
    """

    dense: Gaussians
    levels: Levels
    rows: Sequence[tuple[str, int, Gaussians]]
    spent: Mapping[str, Mapping[str, float]]
    options: Mapping[str, Any]
    references: str
    pooling: LevelPooling = field(default_factory=LevelPooling)


def write_report(trained: Trained, scene: TrainingScene, folder: Path, note: Callable[[str], None] = print) -> dict[str, Any]:
    """Writes model.ply, cameras.json, report.json, report.md, curves.png, curves.json and pictures/ into a folder that holds
    the run's log.

    Everything is measured on test views, which no stage has read. Those whose poses are in doubt are in no mean; the keys that
    end with `_all` hold what the mean over all test views would be.

    Args:
        trained: the finished chain.
        scene: the scene.
        folder: the output folder.
        note: called with messages for the user.

    Returns:
        The content of report.json.
    """
    begin = time.monotonic()
    for name, model in model_files(trained.levels, scene).items():
        save_model(model, folder / name)
    save_inria_cameras(scene.cameras, folder / CAMERAS)
    note(f"measuring on {len(scene.judged)} test views")
    report = numbers(trained, scene)
    report["pictures"] = _pictures(trained, scene, folder)
    records = read_log(folder / "log.jsonl")
    report["narrowed"] = _narrowed(records)
    shown = curves(records)
    plot_curves(shown, folder / "curves.png")
    report["curves"] = "curves.png"
    report["seconds"]["report"] = time.monotonic() - begin
    report["seconds"]["total"] = sum(report["seconds"].values())
    write_json(folder / "report.json", report)
    with atomic_output(folder / "report.md") as file:
        file.write(markdown(report).encode())
    return report


def numbers(trained: Trained, scene: TrainingScene) -> dict[str, Any]:
    """The content of report.json except pictures, curves and narrowed splats."""
    stages = [_stage_row(name, level, left, trained, scene) for name, level, left in trained.rows]
    l1 = next(row for row in reversed(stages) if row["level"] == 1)
    levels = _level_rows(trained.levels, scene, trained.pooling)
    machine = machine_numbers(trained.levels, trained.dense, scene)
    storage = trained.levels.storage
    return {
        "scene": scene.name, "size": list(scene.size), "options": dict(trained.options), "references": trained.references,
        "views": {"train": len(scene.train), "validation": len(scene.validation), "test": len(scene.test),
                  "doubtful": list(scene.doubtful), "judged": list(scene.judged)},
        "psnr_dense_all": stages[0]["psnr_all"], "psnr_l1_all": l1["psnr_all"],
        "poses": _poses(trained, scene),
        "psnr_dense": stages[0]["psnr"], "ssim_dense": stages[0]["ssim"], "psnr_l1": l1["psnr"], "ssim_l1": l1["ssim"],
        "points": {"dense": len(trained.dense), "levels": list(trained.levels.counts)},
        "entries_per_frame": machine.entries if machine else {"dense": stages[0]["entries"], "l1": l1["entries"]},
        "hvsq": [row["hvsq_test"] for row in levels],
        "storage": {**asdict(storage), "total": storage.total, "overhead_percent": storage.overhead_percent},
        "quantised_loss_db": machine.loss_db if machine else None,
        "seconds": {name: float(spent["seconds"]) for name, spent in trained.spent.items()},
        "stages": stages, "levels": levels,
        "pooling": trained.pooling.kind, "pooling_px": list(trained.pooling.widths[: trained.levels.levels]),
        "misplaced": misplaced(trained.levels.level(0), scene, scene.test),
        "regions": _regions(trained, scene),
        "machine": asdict(machine) if machine else None,
    }


def _narrowed(records: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """For each stage, how often a splat was too wide for the machine and was narrowed. The same splat may be counted again."""
    found: dict[str, int] = {}
    for record in records:
        if "narrowed" in record:
            found[record["stage"]] = found.get(record["stage"], 0) + int(record["narrowed"])
    return found


def _poses(trained: Trained, scene: TrainingScene) -> dict[str, Any]:
    """PSNR of level 1 against the dense model on the interpolated poses that the levels' gates read. It gates nothing."""
    posed, views = with_poses(scene, trained.dense, LevelOptions.poses)
    psnr = evaluate(trained.levels.level(0), posed, views, ssim=False).psnr if views else None
    return {"count": len(views), "psnr_l1_to_dense": psnr}


def _stage_row(name: str, level: int, left: Gaussians, trained: Trained, scene: TrainingScene) -> dict[str, Any]:
    """The row of a stage: its model's whole frames on the judged test views, and its PSNR on the gate's."""
    def measured(views: Sequence[int]) -> Quality:
        return evaluate(left, scene, views, alpha_max=level_alpha_max(level),
                        hvsq=[lambda photograph: trained.pooling.hvsq(photograph, level)])

    quality, gate = measured(scene.judged), measured(scene.validation)
    doubtful = [view for view in scene.test if view not in scene.judged]
    every = [*quality.views, *(measured(doubtful).views if doubtful else ())]
    spent = trained.spent.get(name, {"iterations": 0, "seconds": 0.0})
    return {
        "stage": name, "level": level + 1, "points": quality.points,
        "points_per_pixel": quality.points / (scene.size[0] * scene.size[1]), "entries": quality.entries,
        "entries_per_tile": quality.entries_per_tile, "psnr": quality.psnr, "ssim": quality.ssim, "hvsq": quality.hvsq[0],
        "psnr_gate": gate.psnr, "psnr_all": float(np.mean([view[0] for view in every])),
        "ssim_all": float(np.mean([view[1] for view in every])),
        "iterations": int(spent["iterations"]), "seconds": float(spent["seconds"])}


def _level_rows(levels: Levels, scene: TrainingScene, pooling: LevelPooling) -> list[dict[str, Any]]:
    """For each level: its points, and HVSQ at its own pooling on test and validation views beside level 1's, the gate's
    target; and HVSQ on test views with both kinds of windows."""
    each = {kind: level_hvsq(levels, scene, scene.judged, pooling=pooling.of_kind(kind)) for kind in KINDS}
    test, validation = each[pooling.kind], level_hvsq(levels, scene, scene.validation, pooling=pooling)
    pixels = scene.size[0] * scene.size[1]
    return [
        {"level": level + 1, "points": points, "share": points / levels.counts[0], "points_per_pixel": points / pixels,
         "hvsq_test": test[level], "hvsq_validation": validation[level], "target_validation": validation[0],
         "excess_percent": 100 * (validation[level] / validation[0] - 1),
         "excess_test_percent": 100 * (test[level] / test[0] - 1),
         **{f"hvsq_test_{kind}": values[level] for kind, values in each.items()}}
        for level, points in enumerate(levels.counts)]


def _regions(trained: Trained, scene: TrainingScene) -> list[dict[str, Any]]:
    """For each region of frames with the gaze in the centre: HVSQ of the dense model, of L1 everywhere and of the foveated
    frame.

    Each pixel's pooling depends on its eccentricity. Regions that a frame is too small to reach are left out.
    """
    camera = scene.cameras[scene.test[0]]
    foveation = centre_foveation(camera, trained.levels.levels)
    eccentricity = foveation.display.eccentricity(foveation.gaze_xy)
    region = region_level(eccentricity)
    masks = {level: torch.from_numpy(region == level) for level in range(len(REGION_START_DEG)) if (region == level).any()}
    rows = []
    for view in scene.judged:
        judge = foveated(scene.photograph(view), eccentricity)
        with torch.no_grad():
            images = {"dense": _frame(trained.dense, scene, view), "l1": _frame(trained.levels.level(0), scene, view),
                      "foveated": _foveated_frame(trained.levels, scene, view)}
            images = {name: scene.unmasked(view, image) for name, image in images.items()}
            rows.append([judge.regions(image, list(masks.values())).numpy() for image in images.values()])
    mean = np.mean(rows, axis=0)
    return [
        {"region": level + 1, "start_deg": REGION_START_DEG[level], "pixels": float((region == level).mean()),
         **{f"hvsq_{name}": float(mean[i, j]) for i, name in enumerate(images)}}
        for j, level in enumerate(masks)]


def _frame(gaussians: Gaussians, scene: TrainingScene, view: int, alpha_max: float = ALPHA_MAX_L1) -> torch.Tensor:
    """(H, W, 3) display values of a whole frame of one level, on the CPU."""
    with torch.no_grad():
        return render(gaussians, scene.cameras[view], alpha_max=alpha_max).image.clamp(0.0, 1.0).cpu()


def _foveated_frame(levels: Levels, scene: TrainingScene, view: int) -> torch.Tensor:
    """(H, W, 3) display values of a foveated frame with the gaze in the centre, on the CPU."""
    camera = scene.cameras[view]
    each = [levels.level(level) for level in range(levels.levels)]
    with torch.no_grad():
        return render_foveated(each, camera, centre_foveation(camera, levels.levels)).clamp(0.0, 1.0).cpu()


def _pictures(trained: Trained, scene: TrainingScene, folder: Path) -> dict[str, str]:
    """Writes pictures of the first test view; returns their paths below the folder by what they show."""
    view = scene.test[0]
    shown = {"reference": scene.photograph(view), "dense": _frame(trained.dense, scene, view),
             "foveated": _foveated_frame(trained.levels, scene, view)}
    shown["difference"] = AMPLIFIED * (shown["foveated"] - shown["reference"]).abs()
    for level in range(trained.levels.levels):
        shown[f"level {level + 1}"] = _frame(trained.levels.level(level), scene, view, level_alpha_max(level))
    arrays = {name: image.numpy() for name, image in shown.items()}
    arrays["regions"] = levels_picture(arrays["foveated"], centre_foveation(scene.cameras[view], trained.levels.levels))
    make_folder(folder / "pictures")
    paths = {name: f"pictures/{name.replace(' ', '')}.png" for name in arrays}
    for name, image in arrays.items():
        save_png(folder / paths[name], image)
    return paths
