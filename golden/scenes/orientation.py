"""Which way is up in a model, and how sure that is.

Every direction that may be up gets a sum of evidence, in units of log odds:

- a file or a person may have said it, or cameras beside the model show it: people hold cameras upright. Either decides.
- the file's format has a habit (`HABITS`). SPZ is y up by its specification, PLY mostly y down, but each is often written
  otherwise, so a habit is only a prior. A direction that is tilted against the axes belongs to the habit of the nearest axis.
- surfaces: a ground, a floor or a table makes many normals parallel to up. Walls are perpendicular to up and would be
  candidates of their own, but they share their normals among several directions.
- what stands on a ground: most of the mass lies on the upper side of the densest layer, the lower part is wider than the upper
  part, and flat surfaces lie low.

A flat object, such as a sign or a logo, is no ground: nothing stands on it. Then only the habit is left. The confidence is the
share of the winner, and of directions within SAME_DEG of it, among all candidates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from golden.scenes.subject import Subject, find_subject, weighted_percentiles

GIVEN = "given"
"""`GaussianModel.up_source` of a model whose up was stated, by a comment in its file or by a caller."""

AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
"""Names of the six axis directions, as `--up` takes them."""

HABITS = {
    "ply": {"-y": 0.60, "+z": 0.20, "+y": 0.14}, "splat": {"-y": 0.60, "+z": 0.20, "+y": 0.14},
    "compressed ply": {"-y": 0.55, "+z": 0.20, "+y": 0.19}, "spz": {"+y": 0.70, "-y": 0.15, "+z": 0.10},
    "sog": {"-y": 0.45, "+z": 0.25, "+y": 0.24},
}
"""How often each axis is up, by format. They are estimates, not measurements: a format's own convention leads, other tools'
conventions follow, and the axes that are not named share the rest."""

SAMPLE = 12_000
"""Number of splats whose surroundings are examined."""
NEIGHBOURS = 12
"""Number of splats through which a surface is laid."""
SHARP_DEG, WIDE_DEG = 6.0, 25.0
"""A habit means a direction within SHARP_DEG of the axis, or, with a weight of TILTED, within WIDE_DEG: captures are tilted."""
TILTED = 0.4
ALONG_DEG = 12.0
"""A surface counts for a direction if its normal lies within this angle."""
SURFACE_WEIGHT, STANDING_WEIGHT = 2.5, 4.0
CAPTURED_SHARE = 0.01
"""Share of the normals that fall within ALONG_DEG of a random direction by chance, with some allowance."""
FLAT = 0.08
"""A model is flat if its thickness is less than this share of its width."""
FLAT_SURE = 0.8
"""What the confidence is multiplied with where only the habit of the format speaks."""
SAME_DEG = 20.0
AGREEMENT = 0.5
"""Cameras tell up if the length of the mean of their own up directions is at least this; those of a drone that looks down and
turns have a mean near zero."""
SURE = 0.99
LOW = 0.7
"""Below this confidence, commands print the alternatives."""


@dataclass(frozen=True)
class Orientation:
    """The direction that was chosen as up.

    Attributes:
        up: (3,) unit vector in world axes.
        confidence: 0..1.
        source: what decided: 'option', 'file', 'cameras' or 'model'.
        evidence: numbers and words for JSON, by kind.
        runner_up: (3,) the best direction more than SAME_DEG away, None where there was no choice.
    """

    up: np.ndarray
    confidence: float
    source: str
    evidence: dict[str, object]
    runner_up: np.ndarray | None = None

    @property
    def record(self) -> dict[str, object]:
        """What is written beside pictures."""
        found: dict[str, object] = {
            "up": [round(float(x), 6) for x in self.up], "axis": axis_name(self.up), "confidence": round(self.confidence, 3),
            "source": self.source, "evidence": self.evidence}
        return found if self.runner_up is None else found | {"otherwise": axis_name(self.runner_up)}


def axis_name(direction: np.ndarray) -> str:
    """The nearest of AXES, with the angle in whole degrees where the direction is tilted against it."""
    index = int(np.argmax(np.abs(direction)))
    name = ("+" if direction[index] > 0 else "-") + "xyz"[index]
    tilt = math.degrees(math.acos(min(1.0, abs(float(direction[index])) / float(np.linalg.norm(direction)))))
    return name if tilt < 0.5 else f"{name} tilted by {tilt:.0f} degrees"


def axis_vector(name: str) -> np.ndarray:
    """(3,) the unit vector of one of AXES."""
    vector = np.zeros(3)
    vector["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
    return vector


def find_orientation(model: GaussianModel, cameras: Sequence[Camera] = ()) -> Orientation:
    """Finds up; the same model and cameras give the same answer.

    Args:
        model: the Gaussians; `up` and `up_source` say what the file knew.
        cameras: the cameras beside the model, as far as photographs were taken with them.
    """
    if model.up_source == GIVEN:
        return Orientation(np.asarray(model.up, np.float64), SURE, "file", {"stated": "the model's up is stated"})
    if len(cameras):
        mean = -np.stack([camera.rotation[1] for camera in cameras]).mean(axis=0)
        agreement = float(np.linalg.norm(mean))
        if agreement >= AGREEMENT:
            evidence: dict[str, object] = {"cameras": len(cameras), "agreement": round(agreement, 3)}
            return Orientation(mean / agreement, SURE if len(cameras) > 2 else agreement * 0.9, "cameras", evidence)
    return _from_model(model)


def _from_model(model: GaussianModel) -> Orientation:
    surfaces = _Surfaces.of(model)
    candidates = surfaces.directions()
    flat = surfaces.thickness(candidates[0]) < FLAT
    along = np.array([surfaces.along(direction) for direction in candidates])
    standing = np.array([surfaces.standing(direction) for direction in candidates])
    habit = np.array([_habit(model.up_source, direction) for direction in candidates])
    ground = np.log(along + CAPTURED_SHARE)
    if flat:  # a plane without anything on it is a picture or a sign, and says nothing
        ground = ground * np.minimum(1.0, np.abs(standing))
    score = np.log(habit) + SURFACE_WEIGHT * ground + STANDING_WEIGHT * standing
    odds = np.exp(score - score.max())
    best = int(np.argmax(odds))
    up = candidates[best]
    same = candidates @ up > math.cos(math.radians(SAME_DEG))
    others = np.where(same, -np.inf, score)
    evidence = {
        "format": model.up_source, "habit": round(float(habit[best]), 3), "surfaces": round(float(along[best]), 3),
        "standing": round(float(standing[best]), 3), "flat": bool(flat)}
    confidence = _share(odds, candidates, same) * (FLAT_SURE if flat else 1.0)
    return Orientation(up, confidence, "model", evidence, candidates[int(np.argmax(others))])


def _share(odds: np.ndarray, candidates: np.ndarray, same: np.ndarray) -> float:
    """The winners' share; of several candidates within SAME_DEG of each other only the best counts."""
    total, left = 0.0, odds.copy()
    while left.max() > 0:
        top = int(np.argmax(left))
        total += float(left[top])
        left[candidates @ candidates[top] > math.cos(math.radians(SAME_DEG))] = 0.0
    return float(odds[same].max()) / total


def _habit(source: str, direction: np.ndarray) -> float:
    """The prior of a direction: of each axis, a sharp and a wide part around it."""
    habits = HABITS.get(source, {})
    rest = (1.0 - sum(habits.values())) / (6 - len(habits))
    total = 1e-3
    for name in AXES:
        angle = math.degrees(math.acos(float(np.clip(direction @ axis_vector(name), -1, 1))))
        near = math.exp(-0.5 * (angle / SHARP_DEG) ** 2) + TILTED * math.exp(-0.5 * (angle / WIDE_DEG) ** 2)
        total += habits.get(name, rest) * near / (1 + TILTED)
    return total


@dataclass(frozen=True)
class _Surfaces:
    """Points of a thinned model with the normals of the surfaces on which they lie.

    Attributes:
        points: (n, 3) float64, world units.
        weight: (n,) float64, opacity.
        normal: (n, 3) float64, unit, of either sign.
        planar: (n,) float64, opacity times how flat the surroundings are; the sum is 1.
        subject: the model's subject.
    """

    points: np.ndarray
    weight: np.ndarray
    normal: np.ndarray
    planar: np.ndarray
    subject: Subject

    @classmethod
    def of(cls, model: GaussianModel) -> _Surfaces:
        stride = max(1, len(model) // SAMPLE)
        points, weight = model.means[::stride], model.opacity[::stride, 0].clip(0.0, 1.0)
        neighbours = min(NEIGHBOURS, len(points))
        around = points[cKDTree(points).query(points, k=neighbours)[1].reshape(len(points), neighbours)]
        around = around - around.mean(axis=1, keepdims=True)
        size = np.abs(around).max(axis=(1, 2), keepdims=True)
        around = around / np.where(size > 0, size, 1.0)
        spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
        planar = weight * (spread[:, 1] - spread[:, 0]) / np.maximum(spread[:, 2], 1e-30)
        total = planar.sum()
        planar = planar / total if total > 0 else np.full(len(points), 1 / len(points))
        return cls(points, weight, axes[:, :, 0], planar, find_subject(points, weight))

    def directions(self) -> np.ndarray:
        """(k, 3) candidates: both signs of the most frequent normals, refined, and of the axes."""
        found, left = [], self.planar.copy()
        trial = self.normal[np.argsort(-self.planar, kind="stable")[:: max(1, len(self.normal) // 400)]]
        for _ in range(3):
            if not left.sum() > 0:
                break
            support = (np.abs(trial @ self.normal.T) > math.cos(math.radians(8.0))) @ left
            direction = trial[int(np.argmax(support))]
            for _ in range(3):
                near = left * (np.abs(self.normal @ direction) > math.cos(math.radians(ALONG_DEG)))
                direction = np.linalg.eigh((self.normal * near[:, None]).T @ self.normal)[1][:, 2]
            found += [direction, -direction]
            left[np.abs(self.normal @ direction) > math.cos(math.radians(15.0))] = 0.0
        return np.array([*found, *(axis_vector(name) for name in AXES)])

    def along(self, direction: np.ndarray) -> float:
        """Share of the surfaces that lie across a direction."""
        return float(self.planar[np.abs(self.normal @ direction) > math.cos(math.radians(ALONG_DEG))].sum())

    def thickness(self, direction: np.ndarray) -> float:
        """Extent of the model along a direction as a share of its extent across it."""
        height = self.points @ direction
        level = self.points - self.points.mean(axis=0) - np.outer(height - height.mean(), direction)
        low, high = weighted_percentiles(height, self.weight, (3, 97))
        across = 2 * weighted_percentiles(np.linalg.norm(level, axis=1), self.weight, (90,))[0]
        return float((high - low) / max(across, 1e-300))

    def standing(self, direction: np.ndarray) -> float:
        """-1..1: whether things stand on something in this direction, or hang in it. The mean of four radii."""
        height = (self.points - self.subject.middle) @ direction
        distance = np.linalg.norm(self.points - self.subject.middle, axis=1)
        across = np.abs(self.normal @ direction) > math.cos(math.radians(ALONG_DEG))
        parts = (np.flatnonzero(distance <= radius) for radius in self.subject.scales)
        return float(np.mean([self._standing(part, height, direction, across) for part in parts]))

    def _standing(self, inside: np.ndarray, height: np.ndarray, direction: np.ndarray, across: np.ndarray) -> float:
        h, weight = height[inside], self.weight[inside]
        if len(inside) < 20 or not weight.sum() > 0:
            return 0.0
        low, middle, high = weighted_percentiles(h, weight, (2, 50, 98))
        if not high > low:
            return 0.0
        flat = self.planar[inside] * across[inside]
        counts, edges = np.histogram(h, bins=30, range=(low, high), weights=flat)
        slab, step = int(np.argmax(counts)), edges[1] - edges[0]
        layer = edges[slab] + step / 2
        above = float(weight[h > layer + 1.5 * step].sum())
        below = float(weight[h < layer - 1.5 * step].sum())
        side = (above - below) / max(above + below, 0.02 * float(weight.sum()))
        dense = min(1.0, 2.0 * float(counts[slab]) / max(float(counts.sum()), 1e-300))
        skew = 1.0 - 2.0 * float(middle - low) / float(high - low)
        return 0.5 * (dense * side + (1 - dense) * skew) + 0.5 * self._base(inside, h, weight, direction) \
            + 0.25 * self._low_and_flat((h - low) / (high - low), flat)

    def _base(self, inside: np.ndarray, h: np.ndarray, weight: np.ndarray, direction: np.ndarray) -> float:
        """-1..1: how much wider the lowest fifth is than the highest."""
        low, high = weighted_percentiles(h, weight, (20, 80))
        level = self.points[inside] - np.outer(h, direction)
        widths = []
        for part in (h <= low, h >= high):
            offset = level[part] - np.average(level[part], axis=0, weights=weight[part])
            widths.append(math.sqrt(float((weight[part] * (offset**2).sum(axis=1)).sum() / weight[part].sum())))
        return (widths[0] - widths[1]) / (sum(widths) or 1.0)

    @staticmethod
    def _low_and_flat(share: np.ndarray, flat: np.ndarray) -> float:
        """-1..1: how much more of the surfaces across the direction lies in the lower third than in the upper."""
        return float(flat[share < 0.35].sum() - flat[share > 0.65].sum()) / max(float(flat.sum()), 1e-300)
