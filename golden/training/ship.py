"""The trained model of the embedded scene that the project ships: `msv2 train embedded --ship` trains and writes it."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from golden.scenes.embedded import trained
from golden.scenes.files import atomic_output
from golden.scenes.load import EMBEDDED
from golden.scenes.request import write_json
from golden.training.embedded_photographs import EMBEDDED_VIEWS
from spec.errors import InputError
from spec.paths import BUILD
from spec.sources import fingerprint, sources_of

if TYPE_CHECKING:
    from golden.training.foveated import FoveatedModel
    from golden.training.scene import TrainingScene

PRESET = {"size": "320x320", "views": 48, "iterations": 9000, "max_points": 24_000, "pooling_width": 640}
"""What `--ship` fills in where the command line gives no value; the shipped model was made so. HVSQ pools as in frames of 640
pixels, the width that `render` and the viewer show a model at."""

MAX_BYTES = 2_000_000
"""Largest size of the shipped file."""


def add_ship_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds `--views` and `--ship`, which concern the embedded scene alone."""
    group = parser.add_argument_group("the embedded scene")
    group.add_argument("--views", type=int, metavar="N",
                       help=f"number of its ray-traced photographs (default: {EMBEDDED_VIEWS})")
    group.add_argument("--ship", action="store_true", help="train the model that the project ships as scene "
                       "'embedded_trained', with settings of its own, and write it into the package")


def take_ship_arguments(args: argparse.Namespace) -> None:
    """Fills in what `--ship` chooses where the command line gives no value.

    Raises:
        InputError: an option concerns the embedded scene and another scene is given, or a shipped model would have no
            foveated levels.
    """
    if str(args.scene) != EMBEDDED:
        for name, given in (("views", args.views is not None), ("ship", args.ship)):
            if given:
                raise InputError(f"--{name} is not accepted with the scene {args.scene}: it is for the scene {EMBEDDED!r}")
    if args.views is not None and args.views < 3:
        raise InputError(f"views {args.views} is not accepted: 3 or more are, to train, to validate and to test")
    if not args.ship:
        return
    if args.baseline is not None:
        raise InputError(f"baseline {args.baseline!r} is not accepted with --ship: the shipped model has the project's levels")
    for name, value in PRESET.items():
        if getattr(args, name) is None:
            setattr(args, name, value)
    args.out = args.out or Path(BUILD / "train" / "embedded_trained")


def write_shipped(levels: FoveatedModel, scene: TrainingScene, options: Mapping[str, Any], seconds: float) -> dict[str, Any]:
    """Writes a trained model and its record into the package, and says how good it is as a user will see it.

    Quality is measured on the test views, with the file's own fields.

    Returns:
        The record, which is the content of `golden/scenes/embedded/trained.json`.

    Raises:
        InputError: the package's folder is not writable, or the file is larger than MAX_BYTES.
    """
    from golden.training.evaluate import evaluate
    from golden.training.foveated import FoveatedModel, level_alpha_max

    content = trained.packed(levels.to_model(up=scene.up, name=trained.NAME))
    if len(content) > MAX_BYTES:
        raise InputError(f"the model takes {len(content):,} bytes; up to {MAX_BYTES:,} are shipped (fewer --max-points take "
                         "less)")
    with atomic_output(trained.FILE) as file:
        file.write(content)
    shown = FoveatedModel.from_model(trained.load_trained(trained.FILE))
    rows = []
    for level in range(shown.levels):
        stored, before = (
            evaluate(each.level(level), scene, scene.judged, alpha_max=level_alpha_max(level)) for each in (shown, levels))
        rows.append({"level": level + 1, "points": stored.points, "intersections_per_frame": stored.entries,
                     "psnr": stored.psnr, "ssim": stored.ssim, "psnr_before_compression": before.psnr})
    record = {
        "scene": trained.NAME, "command": "msv2 train embedded --ship", "seed": options["seed"], "options": dict(options),
        "training_seconds": round(seconds), "licence": "Apache-2.0", "made_from": "ray-traced pictures of the project's own "
        "embedded scene; no photograph or model of others", "file": trained.FILE.name, "bytes": len(content),
        "sha256": trained.sha256(trained.FILE), "sources": fingerprint(sources_of("golden.training.run")),
        "views": {"train": len(scene.train), "validation": len(scene.validation), "test": len(scene.test)},
        "quality": "means over the test views, whole frames of one level against the ray-traced pictures", "levels": rows,
    }
    write_json(trained.RECORD, record)
    return record


def shipped_text(record: Mapping[str, Any]) -> str:
    """A record in a line for the user."""
    levels = "; ".join(f"L{row['level']} {row['points']:,} points, {row['psnr']:.2f} dB" for row in record["levels"])
    return f"{trained.FILE}: {record['bytes']:,} bytes, sha256 {record['sha256'][:12]}; {levels}"
