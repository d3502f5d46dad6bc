"""The cost of training: iterations, points and seconds against quality, from the logs of finished runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from golden.scenes.files import read_json
from spec.errors import InputError

Row = dict[str, object]


def runs(folders: Sequence[Path]) -> list[Row]:
    """One row for each finished run in folders of runs, with its `stages` and a `curve` of the dense stage.

    The PSNR of the curve is that of training views during the run; the PSNR of a stage is that of the test views at its end.
    """
    found, seen = [], set()
    for folder in folders:
        for path in sorted(folder.glob("*/report.json")):
            try:
                report = read_json(path)
                row = _run(path.parent, report)
            except (InputError, KeyError, TypeError):
                continue  # the report is of another kind or version, so that the run cannot be compared
            key = repr((row["scene"], row["variant"], row["size"], row["stages"]))
            if key not in seen:
                seen.add(key)
                found.append(row)
    return found


def _run(folder: Path, report: dict[str, object]) -> Row:
    options, done, seconds, stages = report["options"], 0, 0.0, []
    for stage in report["stages"]:
        done += int(stage["iterations"])
        seconds += float(stage["seconds"])
        stages.append({name: stage[name] for name in ("stage", "level", "points", "entries", "psnr", "ssim", "hvsq")}
                      | {"iterations": done, "seconds": seconds})
    curve = {"iteration": [], "psnr": [], "points": [], "seconds": []}
    curves = folder / "curves.json"
    if curves.exists():
        kept = read_json(curves)
        dense = int(report["stages"][0]["iterations"])
        for values in zip(*(kept[name] for name in curve), strict=True):
            if values[0] <= dense and values[1] is not None:
                for name, value in zip(curve, values, strict=True):
                    curve[name].append(value)
    return {"scene": Path(str(options["scene"])).name, "variant": options["variant"], "size": report["size"],
            "iterations": options["iterations"], "stages": stages, "curve": curve}
