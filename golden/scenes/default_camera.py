"""The camera for a model that came without cameras and for which none was named.

`choose_framing` finds the subject of the model and tries cameras around it: azimuths, elevations and distances. A coarse
picture of each says which share of the subject it sees, how much of the frame is covered, over how much of the frame detail is
spread, and whether splats near the camera hide the rest. From outside a room one sees its walls, and from within an object one
sees a part of it, so neither wins.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.coarse import Discs, Picture, picture_of
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import FOV_DEG
from golden.scenes.standpoint import Standpoint
from golden.scenes.subject import Subject, find_subject, weighted_percentiles

AZIMUTHS = tuple(float(azimuth) for azimuth in range(0, 360, 30))
ELEVATIONS = (20.0, 10.0, 35.0, 55.0)
DISTANCES = (1.3, 1.0, 0.75, 0.55, 0.4, 0.3)
"""Distances that are tried, as multiples of the distance at which a sphere of the subject's radius fills the frame's width."""
ELEVATION_COST = {20.0: 0.0, 10.0: 0.03, 35.0: 0.05, 55.0: 0.25}
"""What an elevation costs a camera's merit: people look at things from a little above."""
LYING_ELEVATION, FLAT = 60.0, 0.05
"""A subject whose height is less than FLAT of its width, such as a sign that lies, is looked at from this elevation."""
WIDE_ASPECT = 9 / 16
"""Largest height over width of a frame that is judged."""
REFINED = 6
"""Number of the best cameras at the first elevation that are tried at the others, too."""
CHECKED, NEAR_SAMPLE = 8, 20_000
"""Number of the best cameras whose near field is looked at with all of its splats, or with about NEAR_SAMPLE of them."""
COVERAGE_MERIT, SPREAD_MERIT, CLOSE_MERIT = 0.3, 0.3, 0.08
"""Weights beside the share of the subject that is seen, which counts 1."""
OBSTRUCTION_COST = 1.0
NEAR_SHARE = 0.4
"""Splats obstruct that are nearer than this share of the distance to the target, or half way to the subject if that is
farther."""


@dataclass(frozen=True)
class Framing:
    """The standpoint that was chosen, and how it looks by the coarse picture.

    Attributes:
        standpoint: the standpoint.
        subject: what it shows.
        seen: share of the subject's weight that is inside the frame and not hidden, 0..1.
        contained: share of the subject's weight that is inside the frame, hidden or not, 0..1.
        coverage: estimated mean coverage of the frame, 0..1.
        obstruction: estimated share of the frame that splats near the camera hide, 0..1.
        spread: share of the frame over which detail is spread, 0..1.
        close: the distance at which the subject fills the frame's width over the standpoint's distance.
    """

    standpoint: Standpoint
    subject: Subject
    seen: float
    contained: float
    coverage: float
    obstruction: float
    spread: float
    close: float

    @property
    def merit(self) -> float:
        """What the choice of a standpoint maximises."""
        cost = ELEVATION_COST.get(self.standpoint.elevation_deg, 0.0) + OBSTRUCTION_COST * self.obstruction
        return (self.seen + COVERAGE_MERIT * self.coverage + SPREAD_MERIT * self.spread
                + CLOSE_MERIT * math.log2(self.close) - cost)


@dataclass(frozen=True)
class Judge:
    """Judges cameras of one model by coarse pictures.

    Attributes:
        model: the model.
        discs: the thinned model.
        subject: its subject.
        aspect: frame height over frame width.
    """

    model: GaussianModel
    discs: Discs
    subject: Subject
    aspect: float

    @classmethod
    def of(cls, model: GaussianModel, aspect: float) -> Judge:
        """The judge of a model for frames of an aspect. A frame that is taller shows as much as a wide one between its left and
        right edges, and more above and below, so it is judged as a wide one and gets the same standpoint."""
        discs = Discs.of(model)
        return cls(model, discs, find_subject(discs.means, discs.weight, discs.sigma), min(aspect, WIDE_ASPECT))

    def picture(self, standpoint: Standpoint) -> Picture:
        """The coarse picture of a standpoint."""
        return picture_of(self.discs, self.camera(standpoint), standpoint.distance, self.near(standpoint))

    def thickness(self, up: np.ndarray) -> float:
        """The height of the subject as a share of its width."""
        offset = self.discs.means - self.subject.middle
        inside = np.linalg.norm(offset, axis=1) <= self.subject.radius
        height = offset[inside] @ up
        low, high = weighted_percentiles(height, self.discs.weight[inside], (3, 97))
        across = np.linalg.norm(offset[inside] - np.outer(height, up), axis=1)
        return float((high - low) / max(2 * np.percentile(across, 90), 1e-300))

    def camera(self, standpoint: Standpoint) -> Camera:
        """A standpoint's camera for coarse pictures."""
        return standpoint.camera(64, max(1, round(64 * self.aspect)))

    def near(self, standpoint: Standpoint) -> float:
        """The depth, in world units, before which splats are in the way."""
        return max(NEAR_SHARE * standpoint.distance, 0.5 * (standpoint.distance - self.subject.radius))

    def checked(self, framing: Framing) -> Framing:
        """The framing with its obstruction by all splats of the near field, of which the thinned model may lack some."""
        standpoint = framing.standpoint
        camera, near = self.camera(standpoint), self.near(standpoint)
        depth = self.model.means @ camera.rotation[2] + camera.translation[2]
        inside = np.flatnonzero((depth > camera.near) & (depth < near))
        if not len(inside):
            return framing
        discs = Discs.of(self.model.select(inside), sample=NEAR_SAMPLE, giants=NEAR_SAMPLE // 4)
        obstruction = picture_of(discs, camera, standpoint.distance, near).obstruction
        return replace(framing, obstruction=max(framing.obstruction, obstruction))

    def framing(self, standpoint: Standpoint) -> Framing:
        """The standpoint with its numbers."""
        picture = self.picture(standpoint)
        inside = np.linalg.norm(self.discs.means - self.subject.middle, axis=1) <= self.subject.radius
        weight = self.discs.weight * inside
        total = max(float(weight.sum()), 1e-300)
        seen, contained = float(weight @ picture.visible) / total, float(weight @ picture.framed) / total
        close = fit_distance(self.subject, standpoint.fov_deg) / standpoint.distance
        return Framing(standpoint, self.subject, seen, contained, picture.coverage, picture.obstruction, picture.spread, close)


def fit_distance(subject: Subject, fov_deg: float) -> float:
    """The distance, in world units, at which a sphere of the subject's radius fills the frame's width."""
    return subject.radius / math.sin(math.radians(fov_deg) / 2)


def choose_framing(
    model: GaussianModel, up: np.ndarray, *, aspect: float = 9 / 16, fov_deg: float = FOV_DEG,
    target: np.ndarray | None = None,
) -> Framing:
    """Chooses a standpoint of a model; the same arguments give the same standpoint.

    Args:
        model: the Gaussians.
        up: (3,) unit vector, world up (`golden.scenes.orientation` finds it).
        aspect: frame height over frame width.
        fov_deg: horizontal field of view.
        target: (3,) the point to look at, world units; the middle of the subject by default.
    """
    judge = Judge.of(model, aspect)
    target = judge.subject.middle if target is None else np.asarray(target, np.float64)
    return choose(judge, target, up, fov_deg)


def choose(judge: Judge, target: np.ndarray, up: np.ndarray, fov_deg: float) -> Framing:
    """The framing of most merit around a target; the arguments are those of `choose_framing`."""
    fit = fit_distance(judge.subject, fov_deg)
    start = LYING_ELEVATION if judge.thickness(up) < FLAT else ELEVATIONS[0]
    first = [judge.framing(Standpoint(target, up, azimuth, start, factor * fit, fov_deg))
             for factor in DISTANCES for azimuth in AZIMUTHS]
    best = sorted(first, key=lambda found: found.merit, reverse=True)[:REFINED]
    higher = [judge.framing(replace(found.standpoint, elevation_deg=elevation, distance=factor * found.standpoint.distance))
              for found in best if start == ELEVATIONS[0] for elevation in ELEVATIONS[1:] for factor in (1.0, 0.75)]
    tried = sorted([*best, *higher], key=lambda found: found.merit, reverse=True)
    return max(map(judge.checked, tried[:CHECKED]), key=lambda found: found.merit)


def default_camera(
    model: GaussianModel, cameras: Sequence[Camera] = (), width: int = 640, height: int = 360, *,
    up: np.ndarray | None = None, fov_deg: float = FOV_DEG,
) -> Camera:
    """The camera of a scene for which none was named: the first of its own, else the one that `choose_framing` chooses.

    Args:
        model: the Gaussians.
        cameras: the scene's own cameras.
        width, height: frame size in pixels.
        up: (3,) unit vector; the model's own by default.
        fov_deg: horizontal field of view where the scene has no cameras.
    """
    if cameras:
        return fitted(cameras[0], width, height)
    standpoint = choose_framing(model, model.up if up is None else up, aspect=height / width, fov_deg=fov_deg).standpoint
    return standpoint.camera(width, height)


def as_wide(camera: Camera, width: int, height: int) -> Camera:
    """The camera with another frame size and undistorted pixels: it shows as much in width, and less or more in height."""
    scale = width / camera.width
    return replace(camera, fx=camera.fx * scale, fy=camera.fx * scale, cx=camera.cx * scale, width=width, height=height,
                   cy=height / 2 + (camera.cy - camera.height / 2) * scale)


def fitted(camera: Camera, width: int, height: int) -> Camera:
    """The camera with another frame size and undistorted pixels: what it showed is shown whole, with more at two sides where
    the proportions differ."""
    scale = min(width / camera.width, height / camera.height)
    return replace(camera, fx=camera.fx * scale, fy=camera.fy * scale, width=width, height=height,
                   cx=width / 2 + (camera.cx - camera.width / 2) * scale,
                   cy=height / 2 + (camera.cy - camera.height / 2) * scale)
