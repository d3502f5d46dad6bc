"""One run of the trainer: from parsed arguments through a chain of stages to a report."""

from __future__ import annotations

import argparse
import hashlib
import shlex
import sys
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from golden.diff.gaussians import Gaussians, from_model
from golden.metrics.hvsq import FULL_WIDTH
from golden.scenes.files import only_inside
from golden.scenes.load import EMBEDDED, load_model
from golden.training.chain import CHECKPOINTS, Chain, Interrupted
from golden.training.checkpoint import Checkpoints
from golden.training.embedded_photographs import EMBEDDED_VIEWS
from golden.training.failure import room_needed
from golden.training.recipe import (
    DEFAULTS,
    EMBEDDED_DEFAULTS,
    EMBEDDED_FULL,
    FULL,
    RESULTS,
    Recipe,
    full_points,
    levels_of,
    models_of,
    plan,
)
from golden.training.report import Trained, write_report
from golden.training.scene import TrainingScene, load_training_scene
from golden.training.ship import shipped_text, write_shipped
from golden.training.teacher import has_photographs, teacher_scene
from spec.errors import InputError
from spec.paths import BUILD
from spec.private import output_folder

LOG_SCALE_MIN = -20.0
"""Degenerate axes of loaded models (log scale -inf) get this log scale: they look the same and can be trained."""


def train(args: argparse.Namespace, size: tuple[int, int] | None, device: str) -> int:
    """Trains a foveated model and writes its report.

    Args:
        args: the parsed command line of golden/train.py.
        size: (width, height) to train at; None for the photographs' size.
        device: torch's name of the device.

    Returns:
        The exit status: 0, or 130 after an interrupt.

    Raises:
        InputError: an option is not accepted, or nothing can be trained from the scene.
        TrainingError: numbers became non-finite, or the disk is full.
    """
    recipe = chosen_recipe(args)
    dense = None if args.source is None else loaded_dense(Path(args.source), device)
    with _reading(args):
        scene, references = chosen_scene(args.scene, size, dense, args.views)
    if args.full and args.max_points is None and dense is None:
        recipe = replace(recipe, max_points=full_points(scene.size))
    if scene.doubtful:
        print(f"warning: {scene.name}: the reconstruction contradicts the poses of {len(scene.doubtful)} of {len(scene)} views "
              "(reprojection error); they neither train nor validate", file=sys.stderr)
    if scene.random_start and dense is None:
        print(f"note: {scene.name} has no points of structure from motion; {len(scene.points):,} random ones in the volume "
              "that the cameras have in common take their place", file=sys.stderr)
    default = BUILD / "train" / run_name(scene.name, recipe)
    with output_folder(args.out or (default if args.resume else None), default) as out:  # to resume means one certain folder
        if args.source is not None and out.resolve() == Path(args.source).resolve():
            raise InputError(f"out {str(out)!r} is not accepted: --from reads the run in this folder")
        return _run(args, recipe, scene, references, dense, device, out)


def _reading(args: argparse.Namespace) -> AbstractContextManager[None]:
    """Within it, with `--no-outside`, a data set's files must lie in its folder."""
    scene = Path(args.scene)
    if not getattr(args, "no_outside", False) or str(scene) == EMBEDDED:  # a study's command line has no such option
        return nullcontext()
    return only_inside(scene if scene.is_dir() else scene.parent)


def _run(
    args: argparse.Namespace, recipe: Recipe, scene: TrainingScene, references: str, dense: Gaussians | None, device: str,
    out: Path,
) -> int:
    """Trains in the folder `out` and writes the report there; the exit status."""
    options = run_options(args, recipe, scene, device)
    chain = Chain(plan(recipe, scene, device, dense), out, options, resume=args.resume, classes=RESULTS)
    try:
        results = chain.run()
    except (Interrupted, KeyboardInterrupt) as interrupt:
        print(f"\n{str(interrupt) or 'interrupted'}; go on with: {resume_command(args, out)}", file=sys.stderr)
        return 130
    with room_needed(out, f"training is finished; make room, then: {resume_command(args, out)}"):
        results = {name: left.to(device) if hasattr(left, "to") else left for name, left in results.items()}
        rows = models_of(results, [stage.name for stage in chain.plan])
        trained = Trained(results["dense"], levels_of(results), rows, chain.spent, options, references, recipe.pooling)
        report = write_report(trained, scene, out, note=lambda text: print(text, file=sys.stderr))
        if args.ship:
            print(shipped_text(write_shipped(trained.levels, scene, options, report["seconds"]["total"])))
    print(f"{out}: PSNR {report['psnr_dense']:.2f} dB dense, {report['psnr_l1']:.2f} dB L1, "
          f"points {' > '.join(f'{count:,}' for count in [len(trained.dense), *trained.levels.counts])}, "
          f"{report['seconds']['total']:.0f} s; see {out / 'report.md'}")
    return 0


def chosen_recipe(args: argparse.Namespace) -> Recipe:
    """The recipe that parsed arguments describe.

    Raises:
        InputError: a value is not accepted, or an option would have no effect.
    """
    if args.source is not None and args.max_points is not None:
        raise InputError("max-points is not accepted together with --from: there is no dense training to cap")
    dense = getattr(args, "dense", "adc")  # a study's command line has no such option
    if args.source is not None and dense != "adc":
        raise InputError(f"dense {dense!r} is not accepted together with --from: there is no dense training")
    embedded = str(args.scene) == EMBEDDED
    default = EMBEDDED_DEFAULTS if embedded else DEFAULTS
    if args.full:
        default = default | (EMBEDDED_FULL if embedded else FULL)
    iterations, points = (
        default[name] if value is None else value
        for name, value in (("iterations", args.iterations), ("max_points", args.max_points)))
    pooling_width = FULL_WIDTH if args.pooling_width is None else args.pooling_width
    return Recipe(args.variant, args.baseline, args.enhancement, iterations, points, args.seed, pooling_width, args.gate,
                  args.pooling, dense)


def run_name(scene: str, recipe: Recipe) -> str:
    """The scene's name with what differs from the default, so that runs of different kinds do not overwrite each other."""
    kinds = [recipe.variant if recipe.variant != "H" else None, recipe.baseline, None if recipe.enhancement else "v1",
             recipe.dense if recipe.dense != "adc" else None,
             f"pooled{recipe.pooling_width}" if recipe.pooling_width != FULL_WIDTH else None,
             recipe.windows if recipe.windows != "blocks" else None, "ssim" if recipe.gate == "both" else None]
    return "-".join([scene, *filter(None, kinds)])


def loaded_dense(path: Path, device: str) -> Gaussians:
    """Level 1 of a trained model, ready to be trained; of a trainer's output folder, the run's dense model.

    Raises:
        InputError: the file is no model, the model is empty, or the run has not made its dense model.
    """
    checkpoints = path / CHECKPOINTS
    if checkpoints.is_dir():
        results = Checkpoints(checkpoints, RESULTS).load().results
        if "dense" not in results:
            raise InputError(f"{path}: dense training has not ended; a run whose dense model is made is needed")
        return results["dense"].to(device).detached()
    model = load_model(path)
    if not len(model):
        raise InputError(f"{path}: holds no Gaussians; a trained model is needed")
    gaussians = from_model(model, device)
    gaussians.log_scales.clamp_(min=LOG_SCALE_MIN)
    return gaussians


def chosen_scene(
    name: str, size: tuple[int, int] | None, dense: Gaussians | None, views: int | None = None,
) -> tuple[TrainingScene, str]:
    """The training scene, and what its references are: photographs or, where there are only cameras, the dense model's
    renders. `views` is the number of photographs of the embedded scene."""
    if dense is not None and str(name) != EMBEDDED and not has_photographs(Path(name)):
        return teacher_scene(Path(name), size, dense), "renders of the dense model"
    return load_training_scene(name, size, points_needed=dense is None, views=views or EMBEDDED_VIEWS), "photographs"


def run_options(args: argparse.Namespace, recipe: Recipe, scene: TrainingScene, device: str) -> dict[str, Any]:
    """The options that a resumed run must have in common with the first one, by the names of the command line."""
    return {
        "scene": str(args.scene) if str(args.scene) == EMBEDDED else str(Path(args.scene).resolve()),
        "variant": recipe.variant, "from": None if args.source is None else _content(Path(args.source)),
        "baseline": recipe.baseline, "opacity-enhancement": recipe.enhancement, "size": f"{scene.size[0]}x{scene.size[1]}",
        "iterations": recipe.iterations, "max-points": None if args.source else recipe.max_points, "seed": recipe.seed,
        "gate": recipe.gate, "pooling": recipe.windows, "pooling-width": recipe.pooling_width, "device": device,
        **({"dense": recipe.dense} if recipe.dense != "adc" else {}),
        **({"views": len(scene)} if getattr(args, "views", None) else {})}  # a study's command line has no views


def _content(path: Path) -> str:
    """A model file's name and a hash of its content; of a folder, its path."""
    if path.is_dir():
        return str(path.resolve())
    with open(path, "rb") as file:
        return f"{path.name} (sha256 {hashlib.file_digest(file, 'sha256').hexdigest()[:12]})"


def resume_command(args: argparse.Namespace, out: Path) -> str:
    """The command that continues a run."""
    given = [str(args.scene)] if str(args.scene) != EMBEDDED else []
    for name, value, default in (
        ("variant", args.variant, "H"), ("from", args.source, None), ("baseline", args.baseline, None),
        ("size", args.size, None), ("iterations", args.iterations, None), ("max-points", args.max_points, None),
        ("seed", args.seed, 0), ("gate", args.gate, "psnr"), ("pooling", args.pooling, "blocks"),
        ("pooling-width", args.pooling_width, None), ("views", args.views, None),
        ("device", args.device, "auto"),
    ):
        given += [f"--{name}", str(value)] if value != default else []
    dense = getattr(args, "dense", "adc")
    given += ["--dense", dense] if dense != "adc" else []
    given += ["--full"] if args.full else []
    given += [] if args.enhancement else ["--no-opacity-enhancement"]
    given += ["--no-outside"] if getattr(args, "no_outside", False) else []
    given += ["--ship"] if args.ship else []
    return shlex.join(["python", "golden/train.py", *given, "--out", str(out), "--resume"])
