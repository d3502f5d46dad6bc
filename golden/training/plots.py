"""Plots of a run: each is a PNG and a JSON file with the numbers that it shows."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from golden.scenes.files import atomic_output
from golden.scenes.request import write_json
from spec.errors import InputError

SAMPLES = 400
"""Largest number of points of a curve; each is the mean over its share of the iterations."""

LAST = ("points", "seconds")
"""Curves whose points show the last value of their share instead of the mean."""


def read_log(path: Path) -> list[dict[str, Any]]:
    """The records of a run's log, one for each iteration.

    Raises:
        InputError: the file cannot be read as such a log.
    """
    try:
        return [json.loads(line) for line in path.read_text().splitlines()]
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: is no readable log of a run ({error})") from error


def curves(records: Iterable[Mapping[str, Any]], samples: int = SAMPLES) -> dict[str, Any]:
    """Loss, PSNR, points and seconds by iteration, reduced to at most `samples` points; no point spans two stages.

    Returns:
        `iteration`, `loss`, `psnr`, `points`, `seconds`: lists of the same length, None where nothing was measured; `stages`:
        name, first and last iteration of each stage.
    """
    records = list(records)
    result: dict[str, Any] = {name: [] for name in ("iteration", "loss", "psnr", "points", "seconds")} | {"stages": []}
    size = max(1, math.ceil(len(records) / samples))
    names = [record["stage"] for record in records]
    start = 0
    while start < len(records):
        end = start
        while end < len(records) and names[end] == names[start]:
            end += 1
        first, last = records[start]["iteration"], records[end - 1]["iteration"]
        result["stages"].append({"name": names[start], "first": first, "last": last})
        for share in range(start, end, size):
            part = records[share : min(share + size, end)]
            result["iteration"].append(part[-1]["iteration"])
            for name in ("loss", "psnr", "points", "seconds"):
                values = [record[name] for record in part if record.get(name) is not None]
                reduced = values[-1:] if name in LAST else [float(np.mean(values))] if values else []
                result[name].append(reduced[0] if reduced else None)
        start = end
    return result


def plot_curves(shown: Mapping[str, Any], path: Path) -> None:
    """Plots loss, PSNR and points against the iteration, with the bounds of the stages; writes a PNG and, beside it, JSON.

    PSNR is what stages log: in dense training that of single training views, later that of the validation views when a gate is
    checked.

    Args:
        shown: the result of `curves`.
        path: path of the PNG.
    """
    figure, axes = _figure(3)
    x = np.array(shown["iteration"], float)
    labels = {"loss": "loss", "psnr": "PSNR, dB", "points": "points"}
    for axis, (name, label) in zip(axes, labels.items(), strict=True):
        y = np.array([math.nan if value is None else value for value in shown[name]], float)
        measured = np.isfinite(y)
        axis.plot(x[measured], y[measured], linewidth=1.0, color="C0")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        for stage in shown["stages"]:
            axis.axvline(stage["last"], color="0.6", linewidth=0.6)
    if any(value is not None and value > 0 for value in shown["loss"]):
        axes[0].set_yscale("log")
    for stage in shown["stages"]:
        axes[0].annotate(stage["name"], ((stage["first"] + stage["last"]) / 2, 1.01), xycoords=("data", "axes fraction"),
                         ha="center", fontsize=8)
    seconds = [value for value in shown["seconds"] if value is not None]
    axes[-1].set_xlabel("iteration" + (f" ({seconds[-1] / 60:.1f} minutes in all)" if seconds else ""))
    _save(figure, path)
    write_json(path.with_suffix(".json"), dict(shown))


def _figure(rows: int) -> tuple[Any, Any]:
    """A figure with `rows` plots below each other, drawn without a display."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot.subplots(rows, 1, figsize=(8, 2.4 * rows), sharex=True, constrained_layout=True)


def _save(figure: Any, path: Path) -> None:
    from matplotlib import pyplot

    with atomic_output(path) as file:
        figure.savefig(file, format="png", dpi=110)
    pyplot.close(figure)
