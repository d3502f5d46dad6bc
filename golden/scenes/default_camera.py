"""The camera for a model that came without cameras and for which none was named, and orbits around a model by their numbers.

`plan_view` finds the subject of the model and tries cameras around it: azimuths, elevations and distances. A coarse picture of
each says which share of the subject it sees, how much of the frame is covered, and whether splats near the camera hide it. From
outside a room one sees its walls, so the best of these cameras stand inside. A camera is described by numbers that a user can
copy: azimuth, elevation and distance around a target (`View`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.coarse import Discs, Picture, picture_of
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import FOV_DEG, look_at
from golden.scenes.subject import Subject, find_subject

AZIMUTHS = tuple(float(azimuth) for azimuth in range(0, 360, 30))
ELEVATIONS = (20.0, 10.0, 35.0, 55.0)
DISTANCES = (1.3, 1.0, 0.75, 0.55, 0.4, 0.3)
"""Distances that are tried, as multiples of the distance at which a sphere of the subject's radius fills the frame's width."""
ELEVATION_COST = {20.0: 0.0, 10.0: 0.03, 35.0: 0.05, 55.0: 0.25}
"""What an elevation costs a camera's merit: people look at things from a little above."""
REFINED = 6
"""Number of the best cameras at the first elevation that are tried at the others, too."""
COVERAGE_MERIT, SPREAD_MERIT, CLOSE_MERIT = 0.3, 0.3, 0.08
"""Weights beside the share of the subject that is seen, which counts 1."""
OBSTRUCTION_COST = 1.0
NEAR_SHARE = 0.4
"""Splats obstruct that are nearer than this share of the distance to the target, or half way to the subject if that is
farther."""
NEAR_PLANE = 0.02
"""Largest near plane as a share of the distance to the target."""


@dataclass(frozen=True)
class View:
    """A camera by numbers: where it stands around a target.

    Attributes:
        target: (3,) the point that the camera looks at, world units.
        up: (3,) unit vector, world up.
        azimuth_deg: angle around `up`, counter-clockwise as seen from above, from the first of `horizontal_axes(up)`.
        elevation_deg: angle above the horizontal plane through the target, between -90 and 90.
        distance: from target to camera, world units.
        fov_deg: horizontal field of view.
    """

    target: np.ndarray
    up: np.ndarray
    azimuth_deg: float
    elevation_deg: float
    distance: float
    fov_deg: float = FOV_DEG

    @property
    def position(self) -> np.ndarray:
        """(3,) the camera's place in world units."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        east, north = horizontal_axes(self.up)
        level = math.cos(azimuth) * east + math.sin(azimuth) * north
        return self.target + self.distance * (math.cos(elevation) * level + math.sin(elevation) * self.up)

    def camera(self, width: int, height: int, name: str | None = None) -> Camera:
        """The camera with a frame of `width` by `height` pixels."""
        up = self.up
        if abs(self.elevation_deg) > 89.9:  # straight down or up: the frame's upper edge points away from the azimuth
            azimuth = math.radians(self.azimuth_deg)
            east, north = horizontal_axes(self.up)
            up = -math.copysign(1.0, self.elevation_deg) * (math.cos(azimuth) * east + math.sin(azimuth) * north)
        return look_at(self.position, self.target, up, width, height, self.fov_deg,
                       near=min(Camera.near, NEAR_PLANE * self.distance), name=name or f"orbit {self.orbit}")

    @property
    def orbit(self) -> str:
        """The numbers as `--orbit` takes them: azimuth, elevation and distance, rounded to what one can see."""
        return f"{self.azimuth_deg:.5g},{self.elevation_deg:.5g},{self.distance:.5g}"


def horizontal_axes(up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that make a right-handed frame with `up`; azimuth 0 lies along the first, 90 along the second.

    The first lies along the axis that follows the one nearest to `up`, x for +z, so it does not jump where `up` is tilted.
    """
    along = np.eye(3)[(int(np.argmax(np.abs(up))) + 1) % 3]
    east = along - (along @ up) * up
    east = east / np.linalg.norm(east)
    return east, np.cross(up, east)


def view_of(camera: Camera, target: np.ndarray, up: np.ndarray) -> View:
    """The view at the place of `camera` that looks at `target`: the inverse of `View.camera`."""
    east, north = horizontal_axes(up)
    offset = camera.position - target
    distance = float(np.linalg.norm(offset))
    azimuth = math.degrees(math.atan2(float(offset @ north), float(offset @ east))) % 360.0
    elevation = math.degrees(math.asin(float(np.clip(offset @ up / distance, -1, 1))))
    return View(target, up, azimuth, elevation, distance, math.degrees(2 * math.atan(camera.width / 2 / camera.fx)))


@dataclass(frozen=True)
class Plan:
    """The view that was chosen, and how it looks by the coarse picture.

    Attributes:
        view: the view.
        subject: what it shows.
        seen: share of the subject's weight that is inside the frame and not hidden, 0..1.
        coverage: estimated mean coverage of the frame, 0..1.
        obstruction: estimated share of the frame that splats near the camera hide, 0..1.
        spread: share of the frame over which detail is spread, 0..1.
        close: the distance at which the subject fills the frame's width over the view's distance.
    """

    view: View
    subject: Subject
    seen: float
    coverage: float
    obstruction: float
    spread: float
    close: float

    @property
    def merit(self) -> float:
        """What the choice of a view maximises."""
        cost = ELEVATION_COST.get(self.view.elevation_deg, 0.0) + OBSTRUCTION_COST * self.obstruction
        return (self.seen + COVERAGE_MERIT * self.coverage + SPREAD_MERIT * self.spread
                + CLOSE_MERIT * math.log2(self.close) - cost)


@dataclass(frozen=True)
class Judge:
    """Judges cameras of one model by coarse pictures.

    Attributes:
        discs: the thinned model.
        subject: its subject.
        aspect: frame height over frame width.
    """

    discs: Discs
    subject: Subject
    aspect: float

    @classmethod
    def of(cls, model: GaussianModel, aspect: float) -> Judge:
        """The judge of a model for frames of an aspect."""
        discs = Discs.of(model)
        return cls(discs, find_subject(discs.means, discs.weight, discs.sigma), aspect)

    def picture(self, view: View) -> Picture:
        """The coarse picture of a view."""
        front = view.distance - self.subject.radius
        near = max(NEAR_SHARE * view.distance, 0.5 * front)
        return picture_of(self.discs, view.camera(64, max(1, round(64 * self.aspect))), view.distance, near)

    def plan(self, view: View) -> Plan:
        """The view with its numbers."""
        picture = self.picture(view)
        inside = np.linalg.norm(self.discs.means - self.subject.middle, axis=1) <= self.subject.radius
        weight = self.discs.weight * inside
        seen = float(weight @ picture.visible / weight.sum()) if weight.sum() > 0 else 0.0
        close = fit_distance(self.subject, view.fov_deg) / view.distance
        return Plan(view, self.subject, seen, picture.coverage, picture.obstruction, picture.spread, close)


def fit_distance(subject: Subject, fov_deg: float) -> float:
    """The distance, in world units, at which a sphere of the subject's radius fills the frame's width."""
    return subject.radius / math.sin(math.radians(fov_deg) / 2)


def plan_view(
    model: GaussianModel, up: np.ndarray, *, aspect: float = 9 / 16, fov_deg: float = FOV_DEG,
    target: np.ndarray | None = None,
) -> Plan:
    """Chooses a view of a model; the same arguments give the same view.

    Args:
        model: the Gaussians.
        up: (3,) unit vector, world up (`golden.scenes.orientation` finds it).
        aspect: frame height over frame width.
        fov_deg: horizontal field of view.
        target: (3,) the point to look at, world units; the middle of the subject by default.
    """
    judge = Judge.of(model, aspect)
    target = judge.subject.middle if target is None else np.asarray(target, np.float64)
    fit = fit_distance(judge.subject, fov_deg)
    first = [judge.plan(View(target, up, azimuth, ELEVATIONS[0], factor * fit, fov_deg))
             for factor in DISTANCES for azimuth in AZIMUTHS]
    best = sorted(first, key=lambda plan: plan.merit, reverse=True)[:REFINED]
    higher = [judge.plan(replace(plan.view, elevation_deg=elevation, distance=factor * plan.view.distance))
              for plan in best for elevation in ELEVATIONS[1:] for factor in (1.0, 0.75)]
    return max([*best, *higher], key=lambda plan: plan.merit)


def default_camera(
    model: GaussianModel, cameras: Sequence[Camera] = (), width: int = 640, height: int = 360, *,
    up: np.ndarray | None = None, fov_deg: float = FOV_DEG,
) -> Camera:
    """The camera of a scene for which none was named: the first of its own, else the one that `plan_view` chooses.

    Args:
        model: the Gaussians.
        cameras: the scene's own cameras.
        width, height: frame size in pixels.
        up: (3,) unit vector; the model's own by default.
        fov_deg: horizontal field of view where the scene has no cameras.
    """
    if cameras:
        return fitted(cameras[0], width, height)
    view = plan_view(model, model.up if up is None else up, aspect=height / width, fov_deg=fov_deg).view
    return view.camera(width, height)


def fitted(camera: Camera, width: int, height: int) -> Camera:
    """The camera with another frame size and undistorted pixels: what it showed is shown whole, with more at two sides where
    the proportions differ."""
    scale = min(width / camera.width, height / camera.height)
    return replace(camera, fx=camera.fx * scale, fy=camera.fy * scale, width=width, height=height,
                   cx=width / 2 + (camera.cx - camera.width / 2) * scale,
                   cy=height / 2 + (camera.cy - camera.height / 2) * scale)
