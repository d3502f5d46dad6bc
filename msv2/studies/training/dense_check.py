"""Compares the defaults of dense training with their alternatives, on validation views: python -m
msv2.studies.training.dense_check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from golden.scenes.request import make_folder, parse_size
from golden.training.dense import DenseOptions, DenseStage
from golden.training.evaluate import evaluate
from golden.training.minisplatting import BLURRED, REINITIALISED
from golden.training.recipe import DENSE
from golden.training.scene import load_training_scene
from msv2.studies.page import table, write_page
from msv2.studies.record import write_report
from spec.command_line import command_parser
from spec.errors import run_command_line
from spec.paths import REPORTS

VARIANTS: dict[str, dict[str, Any]] = {
    "defaults": {}, "3DGS's rates": {"gain": 1.0, "means_gain": 1.0, "cooled": 1.0},
    "no fading": {"opacity_decay": 1.0}, "Mini-Splatting-D": DENSE["minisplatting"],
    "blur split alone": {"blurred": BLURRED}, "depth reinitialisation alone": {"reinitialised": REINITIALISED}}
"""The differences of each variant from the defaults of `DenseOptions`."""


def measure(scene: str, size: tuple[int, int] | None, options: DenseOptions, seeds: int) -> list[dict[str, Any]]:
    """A row for each variant: PSNR and SSIM of its dense model on the validation views, by seed."""
    loaded, rows = load_training_scene(scene, size), []
    for name, changes in VARIANTS.items():
        found = []
        for seed in range(seeds):
            stage = DenseStage(loaded, replace(options, **changes), seed)
            while not stage.finished:
                stage.step()
            quality = evaluate(stage.result(), loaded, loaded.validation)
            found.append({"seed": seed, "psnr": quality.psnr, "ssim": quality.ssim, "points": quality.points})
            print(f"{name}, seed {seed}: {quality.psnr:.2f} dB, SSIM {quality.ssim:.4f}", flush=True)
        rows.append({"variant": name, "changes": changes, "seeds": found})
    return rows


def page(report: dict[str, Any]) -> str:
    """The report as Markdown."""
    lines = [
        "# Dense training's defaults", "",
        f"{report['scene']} at {report['size']}, {report['iterations']:,} iterations, at most {report['max_points']:,} points; "
        "means over the validation views, which neither train nor test; one column for each seed.", "",
    ]
    cells = []
    for row in report["rows"]:
        psnr = [each["psnr"] for each in row["seeds"]]
        cells.append([row["variant"], ", ".join(f"{value:.2f}" for value in psnr), f"{np.mean(psnr):.2f}",
                      f"{np.mean([each['ssim'] for each in row['seeds']]):.4f}"])
    return "\n".join([*lines, table(["variant", "PSNR dB by seed", "mean", "SSIM, mean"], cells), ""])


def main(argv: Sequence[str] | None = None) -> int:
    """Trains, and writes dense_check.json and dense_check.md; returns the exit status."""
    parser = command_parser("python -m msv2.studies.training.dense_check", __doc__)
    add = parser.add_argument
    add("scene", nargs="?", default="embedded", metavar="SCENE", help="a scene that can be trained (default: embedded)")
    add("--size", metavar="WxH", help="size to train at")
    add("--iterations", type=int, default=1000, help="iterations of each dense training (default: 1000)")
    add("--max-points", type=int, default=10_000, help="largest number of points (default: 10000)")
    add("--seeds", type=int, default=2, help="number of seeds (default: 2)")
    add("--out", type=Path, default=REPORTS, metavar="DIR", help="output folder (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    options = DenseOptions(iterations=args.iterations, max_points=args.max_points)
    rows = measure(args.scene, parse_size(args.size) if args.size else None, options, args.seeds)
    report = {"scene": Path(args.scene).name, "size": args.size or "its own size", "iterations": args.iterations,
              "max_points": args.max_points, "rows": rows}
    out = make_folder(args.out)
    write_report(out / "dense_check.json", report, [__name__], {"arguments": args}, [args.scene])
    write_page(out / "dense_check.md", page(report))
    print(page(report))
    return 0


if __name__ == "__main__":
    run_command_line(main)
