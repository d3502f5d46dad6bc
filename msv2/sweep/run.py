"""Runs the points of a sweep, each of them once, and keeps each result as soon as it is there.

A result is a file of its own, `points/KEY.json`, which is complete or absent. A run that was interrupted therefore goes on
where it was, and a second run of the same sweep measures nothing. Whoever measures, the process that was started writes, so
that a cluster's workers need no common folder.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from golden.scenes.files import read_json
from golden.scenes.request import make_folder, write_json
from msv2.studies.tradeoff.jobs import run_all
from msv2.sweep.measure import pixels_key, point_key, tried
from msv2.sweep.points import Point
from spec.errors import InputError

POINTS = "points"


def run_points(
    points: Sequence[Point], out: Path, *, jobs: int = 1, scheduler: str | None = None,
    done: Callable[[Point, dict[str, object]], None] = lambda point, row: None,
) -> list[dict[str, object]]:
    """The results of all points, in their order; those that fail have `error` and are not kept.

    Args:
        points: what to measure.
        out: the folder of the sweep.
        jobs: processes of this machine.
        scheduler: the address of a Dask scheduler, instead of processes.
        done: called with every result of this run, as it comes.

    Raises:
        InputError: the scheduler is not accepted, or jobs is not.
    """
    folder = make_folder(out / POINTS)
    keys = [point_key(point) for point in points]
    rows = {key: found for key in keys if (found := _kept(folder / f"{key}.json")) is not None}
    for number, part in enumerate(_parts([(key, point) for key, point in zip(keys, points, strict=True) if key not in rows])):
        alone = number == 0 and scheduler is None
        for index, found in run_all(tried, [(point,) for _, point in part], jobs=1 if alone else jobs, scheduler=scheduler):
            key, point = part[index]
            rows[key] = {"key": key, "settings": dict(point.varied), "command": command_of(point), **found}
            if "error" not in found:
                write_json(folder / f"{key}.json", rows[key])
            done(point, rows[key])
    return [{**rows[key], "settings": dict(point.varied)} for key, point in zip(keys, points, strict=True)]


def kept_points(points: Sequence[Point], out: Path) -> int:
    """How many of the points have results."""
    return sum(_kept(out / POINTS / f"{point_key(point)}.json") is not None for point in points)


def command_of(point: Point) -> str:
    """The command that models the point alone."""
    return "msv2 perf " + shlex.join(point.argv)


def _kept(path: Path) -> dict[str, object] | None:
    if not path.is_file():
        return None
    try:
        return read_json(path)
    except InputError:
        return None  # the file is damaged, so the point is measured again


def _parts(points: Sequence[tuple[str, Point]]) -> Iterator[list[tuple[str, Point]]]:
    """The points in three parts, each of which leaves something to the next.

    First comes one point, for which kernels are compiled where they are not yet; then the first point of every other golden
    frame, which renders it and keeps its trace; then all others.
    """
    first: dict[str, tuple[str, Point]] = {}
    for item in points:
        first.setdefault(pixels_key(item[1]), item)
    begin = {key for key, _ in first.values()}
    frames = list(first.values())
    for part in (frames[:1], frames[1:], [item for item in points if item[0] not in begin]):
        if part:
            yield part
