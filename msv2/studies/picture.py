"""Diagrams of reports: matplotlib without a display, which is an optional dependency, and files that are complete or absent."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from golden.scenes.files import atomic_output
from msv2.studies.destination import place


def find_pyplot() -> Any | None:
    """matplotlib's pyplot, which draws without a display; None if matplotlib is not installed."""
    try:
        import matplotlib
    except ImportError:
        return None
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def save_figure(figure: Any, path: Path, *, dpi: int = 110, **options: object) -> None:
    """Writes a figure as a PNG and closes it; `options` are those of matplotlib's `savefig`. For a
    picture in reports/, see `msv2.studies.destination`."""
    from matplotlib import pyplot

    with atomic_output(place(path)) as file:
        figure.savefig(file, format="png", dpi=dpi, **options)
    pyplot.close(figure)
