"""Eight cameras that show a model from all sides, from above and from close by, for a contact sheet."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from golden.scenes.default_camera import CHECKED, Framing, Judge, choose, fit_distance
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import FOV_DEG
from golden.scenes.standpoint import Standpoint

TURNS_DEG = (60.0, 120.0, 180.0, 240.0, 300.0)
"""Azimuths of the cameras around the subject, from that of the default one."""
NEARER = (1.0, 0.75, 1.3, 0.55, 0.4)
"""Distances that such a camera may take, as multiples of the default one's, where something stands in its way."""
BETTER = 0.15
"""A camera leaves the default distance if another one's merit is higher by this much."""
HIGH_ELEVATIONS, FAR = (35.0, 60.0, 85.0), (1.0, 1.4, 1.9, 2.6)
"""Elevations and multiples of the fitting distance among which the camera is chosen that sees most of the whole model."""
WHOLE = 3.5
"""The camera of the whole model shows at most this many times the subject's radius, since a background may be far away."""
CLOSE = (0.5, 0.4, 0.3)
"""Multiples of the default distance for the camera close by."""


def eight_cameras(
    model: GaussianModel, up: np.ndarray, *, aspect: float = 9 / 16, fov_deg: float = FOV_DEG,
    target: np.ndarray | None = None,
) -> list[tuple[str, Framing]]:
    """Titles and framings of eight cameras: the default one, five around the subject, one of the whole model, one close by.

    Args:
        model: the Gaussians.
        up: (3,) unit vector, world up.
        aspect: frame height over frame width.
        fov_deg: horizontal field of view.
        target: (3,) the point to look at, world units; the middle of the subject by default.
    """
    judge = Judge.of(model, aspect)
    target = judge.subject.middle if target is None else np.asarray(target, np.float64)
    first = choose(judge, target, up, fov_deg)
    start = first.standpoint
    found = [("default", first)]
    for turn in TURNS_DEG:
        azimuth = (start.azimuth_deg + turn) % 360.0
        options = [judge.checked(judge.framing(replace(start, azimuth_deg=azimuth, distance=factor * start.distance)))
                   for factor in NEARER]
        best = max(options, key=lambda framing: framing.merit)
        found.append((f"turned by {turn:.0f}", best if best.merit > options[0].merit + BETTER else options[0]))
    radius = judge.subject.radius
    all_of_it = replace(judge.subject, radius=max(radius, min(judge.subject.extent, WHOLE * radius)))
    wide = replace(judge, subject=all_of_it)
    fit = fit_distance(all_of_it, fov_deg)
    azimuths = [start.azimuth_deg, *((start.azimuth_deg + turn) % 360.0 for turn in TURNS_DEG)]
    above = _framings(wide, [Standpoint(target, up, azimuth, elevation, factor * fit, fov_deg)
                             for azimuth in azimuths for elevation in HIGH_ELEVATIONS for factor in FAR])
    found.append(("whole", max(map(wide.checked, sorted(above, key=_whole)[-CHECKED:]), key=_whole)))
    near = _framings(judge, [replace(start, azimuth_deg=azimuth, distance=factor * start.distance)
                             for azimuth in azimuths for factor in CLOSE])
    near.sort(key=lambda framing: framing.merit)
    found.append(("close", max(map(judge.checked, near[-CHECKED:]), key=lambda framing: framing.merit)))
    return found


def _framings(judge: Judge, standpoints: Iterable[Standpoint]) -> list[Framing]:
    return [judge.framing(standpoint) for standpoint in standpoints]


def _whole(framing: Framing) -> float:
    """What the camera of the whole model maximises: the seen share, and among equals nearness and freedom from obstruction."""
    return framing.seen + framing.contained - framing.obstruction + 0.1 * framing.close
