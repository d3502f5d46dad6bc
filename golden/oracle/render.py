"""The float64 reference renderer for one eye, with or without foveation. It is written to be read rather than to be fast."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from golden.oracle.blend import blend_tiles
from golden.oracle.project import project
from golden.oracle.tiles import tile_lists
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, FoveationMap, foveation_map, no_foveation
from golden.scenes.model import GaussianModel
from spec.constants import ALPHA_MAX_L1, COVERAGE_VALID, SUPPORT_SIGMA
from spec.errors import InputError
from spec.guard_band import MEAN_RANGE, Range

ALPHA_MAX = (ALPHA_MAX_L1, 1.0, 1.0, 1.0)
"""Upper bound of alpha for each level: that of 3DGS for level 1; none (that is, 1) for the amplified levels (paper section
4.4)."""


@dataclass(frozen=True)
class OracleFrame:
    """A rendered frame of H x W pixels.

    Attributes:
        image: (H, W, 3) float64, background included, not clamped: colours may exceed 1.
        depth: (H, W) float64, alpha-weighted mean depth in world units, nan where coverage < 0.5.
        transmittance: (H, W) float64 in 0..1, the background's weight.
        foveation: which levels each tile rendered.
        tile_intersections: (tiles_y, tiles_x) int64, length of each tile's list.
        visible: number of splats on at least one tile's list.
        culled: number of points that are on no list, by reason: those of `project.project`, and `no_tile` (the footprint lies
            between pixel centres, or every tile that it meets has a level beyond the quality bound). Together with `visible`
            they add up to the model.
    """

    image: np.ndarray
    depth: np.ndarray
    transmittance: np.ndarray
    foveation: FoveationMap
    tile_intersections: np.ndarray
    visible: int
    culled: dict[str, int]

    @property
    def coverage(self) -> np.ndarray:
        """(H, W) float64, accumulated alpha 1 - T."""
        return 1.0 - self.transmittance

    @property
    def entries(self) -> int:
        """Number of intersections, that is (splat, tile) pairs, in the frame."""
        return int(self.tile_intersections.sum())


def render(
    model: GaussianModel,
    camera: Camera,
    *,
    display: Display | None = None,
    gaze: tuple[float, float] | None = None,
    foveation: FoveationMap | None = None,
    weights: str = "exact",
    background: Sequence[float] = (0.0, 0.0, 0.0),
    support_sigma: float | None = SUPPORT_SIGMA,
    alpha_max: Sequence[float] = ALPHA_MAX,
    tile_test: str = "exact",
    mean_range: Range = MEAN_RANGE,
) -> OracleFrame:
    """Renders `model` as `camera` sees it (paper sections 2.2, 4 and 5.1).

    Args:
        model: the Gaussians; all of the model's levels are used.
        camera: the camera, with the frame's size.
        display: the display that defines eccentricity; by default as large as the frame and 90 degrees wide.
        gaze: gazed point in pixels of the display; None renders level 1 everywhere.
        foveation: a ready foveation map, instead of `display` and `gaze`.
        weights: blend weights from each pixel's `exact` eccentricity, or from the tile's `plane` as in hardware.
        background: red, green, blue behind everything.
        support_sigma: Mahalanobis radius that bounds a splat's support; None for 3DGS's bound on alpha alone.
        alpha_max: upper bound of alpha for each level.
        tile_test: `exact` or `obb` (oriented bounding box); the image is the same, the lists are not.
        mean_range: the guard band (`spec.guard_band`): pixels between which a projected mean must lie.

    Raises:
        InputError: the gaze is off the display, the display or map does not fit the frame, or the map uses levels
            that the model lacks.
        ValueError: `weights` or `tile_test` is none of the accepted words, or `alpha_max` lacks a level.
    """
    if foveation is None:
        display = display or Display(camera.width, camera.height)
        foveation = no_foveation(display) if gaze is None else foveation_map(display, gaze, model.levels)
    _check_fit(foveation, model, camera)
    if weights not in ("exact", "plane"):
        raise ValueError(f"weights must be 'exact' or 'plane', not {weights!r}")
    if len(alpha_max) < model.levels:
        raise ValueError(f"alpha_max must hold a bound for each of {model.levels} levels, not {alpha_max!r}")

    splats, culled = project(model, camera, support_sigma, mean_range)
    lists = tile_lists(splats, foveation, tile_test)
    visible = len(np.unique(lists.entries))
    culled["no_tile"] = len(splats) - visible

    weight = foveation.blend_weights_exact if weights == "exact" else foveation.blend_weights_plane
    image, depth_sum, transmittance = blend_tiles(
        splats, lists, foveation, weight, support_sigma=support_sigma, alpha_max=alpha_max, background=background
    )
    coverage = 1.0 - transmittance
    with np.errstate(invalid="ignore", divide="ignore"):
        depth = np.where(coverage >= COVERAGE_VALID, depth_sum / coverage, np.nan)
    tile_intersections = np.diff(lists.start).reshape(foveation.tile_level.shape)
    return OracleFrame(image, depth, transmittance, foveation, tile_intersections, visible, culled)


def _check_fit(foveation: FoveationMap, model: GaussianModel, camera: Camera) -> None:
    """Raises InputError unless the map suits the frame and the model."""
    display = foveation.display
    if (display.width_px, display.height_px) != (camera.width, camera.height):
        raise InputError(
            f"display of {display.width_px}x{display.height_px} pixels is not accepted: "
            f"the frame has {camera.width}x{camera.height}"
        )
    if foveation.levels > model.levels:
        raise InputError(f"{foveation.levels} levels are not accepted: the model has {model.levels}")
