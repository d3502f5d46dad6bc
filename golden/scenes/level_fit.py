"""Foveation levels fitted to a model's own pictures: no photographs, no torch, well under a minute of one processor core.

Cameras on orbits around the model show what the model looks like. Level by level, the points that contribute least to these
pictures for each tile that they cost are left out (paper section 3.2 ranks points likewise), and the opacities and DC colours
of the points that stay are moved towards the full model's pictures (Adam on the squared error). Each level starts from the one
before, so points are nested. Means, scales, rotations and harmonics are shared by all levels and do not change. Opacities may
pass 1, as in the paper's opacity enhancement (section 4.4).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.level_blend import LOOK, draw, gradient
from golden.scenes.level_views import REACH, LevelView, Shapes, look
from golden.scenes.levels import spread_levels
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import plan_orbit
from spec.constants import ALPHA_MAX_L1, ALPHA_MIN, AMP_MAX, MAX_LEVELS, SH_C0

WIDTH, HEIGHT = 640, 360
"""Size in pixels of the pictures to which levels are fitted."""

VIEWS, FEWEST_VIEWS = 30, 8
"""Number of cameras for models of up to POINTS points; larger models have fewer, because each costs time and memory."""

POINTS = 1_500_000

CAMERAS = ((0.0, 1.0), (18.0, 1.0), (0.0, 1.0), (0.0, 1.0), (-10.0, 1.2), (0.0, 1.0))
"""Elevation in degrees beyond the orbit's own, and radius as a multiple of the orbit's, by turns. Most cameras are on the orbit
on which the project's own cameras are; the others keep the levels from serving that circle alone."""

BUDGET = 0.83
"""Intersections of a level as a share of those that the same level of `spread_levels` has in the cameras' frames. The remainder
makes up for the fovea and the blend tiles: a whole foveated frame has no more intersections than one of those levels."""

PRUNES, STEPS = (3, 2, 2), (72, 72, 270)
"""For L2, L3 and L4: the number of prunes that lead to it, and the number of steps of the optimiser, half of them between
prunes. Most of a frame is L4."""

RATES = np.array([0.15, 0.05, 0.05, 0.05], np.float32)
"""Step sizes of the log opacity and of the three DC coefficients."""

FINE, FINE_FROM = 0.3, 0.6
"""Factor on the step sizes in the last steps of a level, and the share of the steps after which they begin."""

DECAY = np.float32(0.8), np.float32(0.98)
"""Decay of the optimiser's mean and of its mean square."""

RAISE = np.float32(0.38)
"""What a prune adds to the log2 opacity of the points that stay: they have to close the holes of the others."""

OPENNESS = np.float32(0.1)
"""Weight of the transmittance's error relative to a colour's. It keeps the levels closed before any background."""

_LOWEST, _HIGHEST = np.float32(-8), np.float32(np.log2(AMP_MAX))
"""Bounds of the log2 opacity: below the first nothing is drawn, and the machine has no opacity above the second."""

Progress = Callable[[int, int], None]
"""Called with the number of steps that are done and of all steps."""


def enhanced_levels(
    model: GaussianModel, levels: int = MAX_LEVELS, seed: int = 0, progress: Progress | None = None,
) -> GaussianModel:
    """Levels that are fitted to the model's own pictures; the result depends on the arguments alone.

    Points that no camera sees have the levels that `spread_levels` gives them. At levels that do not use a point, it has the
    opacity and the colour of level 1.

    Args:
        model: its level 1 is used, and stays as it is.
        levels: number of levels, 1..4.
        seed: seed of the order in which the cameras take their turns.
        progress: is told of every step.

    Raises:
        ValueError: `levels` is outside 1..4.
    """
    spread = spread_levels(model, levels)
    if levels == 1:
        return spread
    views, weight = _views(model)
    cost = _tiles_met(views, len(model))
    seen, fit = cost > 0, _Fit(model, views, seed)
    bound = np.where(seen, 1, spread.quality_bound).astype(np.uint8)
    unused = np.arange(levels) >= np.where(seen, levels, spread.quality_bound)[:, None]
    opacity, dc = np.where(seen[:, None] | unused, model.opacity[:, :1], spread.opacity), spread.sh_dc.copy()
    done, steps = 0, sum(STEPS[: levels - 1])
    for level in range(1, levels):
        stays = seen & (bound == level)
        goal = BUDGET * cost[spread.quality_bound > level].sum()
        for turn in range(PRUNES[level - 1]):
            left = PRUNES[level - 1] - turn
            weight = fit.weights() if done else weight
            stays = _best(weight, cost, stays, cost[stays].sum() * (goal / max(cost[stays].sum(), 1)) ** (1 / left))
            fit.keep(stays)
            before = STEPS[level - 1] // (2 * PRUNES[level - 1])
            last = STEPS[level - 1] - before * (PRUNES[level - 1] - 1)
            for step in range(last if left == 1 else before):
                fit.step(FINE if left == 1 and step >= FINE_FROM * last else 1.0)
                done += 1
                if progress:
                    progress(done, steps)
        bound[stays] = level + 1
        opacity[stays, level], dc[stays, level] = np.exp2(fit.log2_opacity[stays]), fit.dc[stays]
    return replace(spread, quality_bound=bound, opacity=opacity, sh_dc=dc)


def cameras(model: GaussianModel) -> list[Camera]:
    """The cameras to whose pictures levels are fitted. None of them is a camera of an orbit of 1, 2, 4 or 8."""
    count = min(VIEWS, max(FEWEST_VIEWS, VIEWS * POINTS // max(len(model), 1)))
    orbit = plan_orbit(model, aspect=HEIGHT / WIDTH)
    turns = [CAMERAS[k % len(CAMERAS)] for k in range(count)]
    return [replace(orbit, elevation_deg=orbit.elevation_deg + more, radius=orbit.radius * factor).camera(
        2 * k + 1, 2 * count, WIDTH, HEIGHT) for k, (more, factor) in enumerate(turns)]


def _views(model: GaussianModel) -> tuple[list[LevelView], np.ndarray]:
    """The cameras' views with their targets, and for each point the sum of T alpha over all pixels of all targets."""
    shapes, opacity, dc = Shapes.of(model), _log2(model.opacity[:, 0]), model.sh_dc[:, 0].astype(np.float32)
    views, weight = [look(model, shapes, camera) for camera in cameras(model)], np.zeros(len(model))
    for view in views:
        view.target, part = _draw(view, _look(view, opacity, dc), ALPHA_MAX_L1, weigh=True)
        np.clip(view.target, 0, 1, out=view.target)
        weight[view.index] += part
    return views, weight


def _log2(opacity: np.ndarray) -> np.ndarray:
    return np.log2(np.maximum(opacity, 1e-12)).astype(np.float32)


def _look(view: LevelView, log2_opacity: np.ndarray, dc: np.ndarray) -> np.ndarray:
    """(M, LOOK) float32: what `draw` blends, of all points' opacities (N,) and DC coefficients (N, 3)."""
    out = np.empty((len(view.index), LOOK), np.float32)
    out[:, 0] = log2_opacity[view.index]
    out[:, 1] = np.minimum(REACH, out[:, 0] - np.float32(np.log2(ALPHA_MIN)))
    out[:, 2:] = np.maximum(view.rest + np.float32(SH_C0) * dc[view.index], 0)
    return out


def _draw(view: LevelView, shown: np.ndarray, alpha_max: float, weigh: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """The picture of a view as (height, width, 4), and the weight of each of its splats, or nothing."""
    image = np.empty((view.camera.height, view.camera.width, 4), np.float32)
    weight = np.zeros(len(view.index) if weigh else 0, np.float32)
    draw(view.geometry, shown, view.start, view.splat, view.camera.width, view.camera.height, np.float32(alpha_max), image,
         weight)
    return image, weight


def _tiles_met(views: list[LevelView], count: int) -> np.ndarray:
    """(count,) int64: the intersections that each point has in all frames together."""
    return sum((view.tiles_met(count) for view in views), np.zeros(count, np.int64))


def _best(weight: np.ndarray, cost: np.ndarray, among: np.ndarray, budget: float) -> np.ndarray:
    """(N,) bool: the points of `among` with the most weight for each intersection, with at most `budget` intersections, and
    with one at least."""
    index = np.flatnonzero(among)
    order = index[np.argsort(-weight[index] / np.maximum(cost[index], 1), kind="stable")]
    out = np.zeros(len(weight), bool)
    out[order[: max(1, np.searchsorted(np.cumsum(cost[order]), budget, side="right"))]] = True
    return out


class _Fit:
    """Opacities and DC colours of a level that are being fitted to the targets of views.

    Attributes:
        log2_opacity: (N,) float32 of all points.
        dc: (N, 3) float32.
    """

    def __init__(self, model: GaussianModel, views: list[LevelView], seed: int) -> None:
        self.log2_opacity, self.dc = _log2(model.opacity[:, 0]), model.sh_dc[:, 0].astype(np.float32)
        self._views, self._random, self._queue = views, np.random.default_rng(seed), []
        self._mean, self._square = np.zeros((2, len(model), 4), np.float32)
        self._times = np.zeros((len(model), 1), np.int32)

    def weights(self) -> np.ndarray:
        """(N,) the sum of T alpha over all pixels of all views."""
        out = np.zeros(len(self.dc))
        for view in self._views:
            out[view.index] += _draw(view, _look(view, self.log2_opacity, self.dc), 1.0, weigh=True)[1]
        return out

    def keep(self, chosen: np.ndarray) -> None:
        """Leaves out the points for which `chosen` (N,) bool is False, and raises the opacity of the others."""
        for view in self._views:
            view.keep(chosen)
        self.log2_opacity[chosen] = np.minimum(self.log2_opacity[chosen] + RAISE, _HIGHEST)

    def step(self, factor: float) -> None:
        """One step of Adam on the next view; a point's bias correction counts the steps in which it was in the view."""
        if not self._queue:
            self._queue = list(self._random.permutation(len(self._views)))
        view = self._views[self._queue.pop()]
        i, slope = view.index, self._slope(view)
        self._times[i] += 1
        mean = self._mean[i] = DECAY[0] * self._mean[i] + (1 - DECAY[0]) * slope
        square = self._square[i] = DECAY[1] * self._square[i] + (1 - DECAY[1]) * slope**2
        mean, square = mean / (1 - DECAY[0] ** self._times[i]), square / (1 - DECAY[1] ** self._times[i])
        change = np.float32(factor) * RATES * mean / (np.sqrt(square) + np.float32(1e-8))
        self.log2_opacity[i] = np.clip(self.log2_opacity[i] - change[:, 0] / np.float32(np.log(2)), _LOWEST, _HIGHEST)
        self.dc[i] -= change[:, 1:]

    def _slope(self, view: LevelView) -> np.ndarray:
        """(M, 4) float32: half the derivative of the squared error by log opacity and DC coefficients."""
        shown = _look(view, self.log2_opacity, self.dc)
        image, _ = _draw(view, shown, 1.0)
        error = image - view.target
        error[..., 3] *= OPENNESS
        slope = np.zeros((len(shown), 4), np.float32)
        gradient(view.geometry, shown, view.start, view.splat, view.camera.width, view.camera.height, np.float32(1), image,
                 error, slope)
        slope[:, 1:] *= np.where(shown[:, 2:] > 0, np.float32(SH_C0), np.float32(0))
        return slope
