"""Foveation geometry: eccentricity on a virtual flat display, tile levels, blend bands and their per-tile planes.

The host does this work once per gaze, and every renderer uses the result (paper sections 4.1 and 6.2): which level a tile
renders, whether it blends two levels, and the three coefficients from which the hardware computes a pixel's blend weight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from spec.constants import BAND_START_DEG, DISPLAY_FOV_DEG, MAX_LEVELS, REGION_START_DEG, TILE
from spec.errors import InputError

FIT_RANGE = (-0.25, 1.25)
"""Only pixels whose blend parameter lies in this range are used to fit a tile's plane: outside it the weight is constant."""


@dataclass(frozen=True)
class Display:
    """A virtual flat display that the eye sees from in front of its centre; independent of the camera's field of view.

    Attributes:
        width_px, height_px: size in (square) pixels; the frame shown on it has the same size.
        fov_deg: angle that the display's width spans at the eye, in degrees, between 0 and 180.

    Raises:
        InputError: the size is below one pixel, or the angle is not between 0 and 180 degrees.
    """

    width_px: int
    height_px: int
    fov_deg: float = DISPLAY_FOV_DEG

    def __post_init__(self) -> None:
        if self.width_px < 1 or self.height_px < 1:
            raise InputError(f"display size {self.width_px}x{self.height_px} is not accepted: both must be at least 1 pixel")
        if not 0 < self.fov_deg < 180:
            raise InputError(f"display width of {self.fov_deg} degrees is not accepted: it must lie between 0 and 180")

    def directions(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(..., 3) float64 directions (not normalised) from the eye to the display points (x, y), in pixels."""
        distance_px = self.width_px / (2 * math.tan(math.radians(self.fov_deg) / 2))
        x, y = np.broadcast_arrays(np.asarray(x, float) - self.width_px / 2, np.asarray(y, float) - self.height_px / 2)
        return np.stack([x, y, np.full(x.shape, distance_px)], axis=-1)

    def eccentricity(self, gaze_xy: tuple[float, float]) -> np.ndarray:
        """(height, width) float64: the angle in degrees between each pixel centre's direction and the gaze's.

        Args:
            gaze_xy: the gazed point in pixels, x right and y down; (0, 0) is the display's top left corner.

        Raises:
            InputError: the gaze is not on the display.
        """
        x, y = gaze_xy
        if not (0 <= x <= self.width_px and 0 <= y <= self.height_px):
            raise InputError(f"gaze {x},{y} is off the display: accepted are 0..{self.width_px},0..{self.height_px} pixels")
        pixels = self.directions(np.arange(self.width_px)[None, :] + 0.5, np.arange(self.height_px)[:, None] + 0.5)
        gaze = self.directions(x, y)
        sine = np.linalg.norm(np.cross(pixels, gaze), axis=-1)
        return np.degrees(np.arctan2(sine, pixels @ gaze))  # arctan2 keeps full precision near the gaze, arccos does not


def smoothstep(t: np.ndarray) -> np.ndarray:
    """The blend weight 3t^2 - 2t^3 for a blend parameter t, which is first clamped to 0..1."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3 - 2 * t)


@dataclass(frozen=True)
class FoveationMap:
    """What a frame's tiles render for one gaze. Tiles are in row-major order; levels are 0-based.

    The blend parameter of a tile of level L is t = (eccentricity - band_L) / (start_{L+1} - band_L); a pixel shows
    (1 - w) C_L + w C_{L+1} with w = smoothstep(t). `plane` approximates t over a tile by three coefficients.

    Attributes:
        display: the display, of the frame's size.
        gaze_xy: gaze in pixels, or None: level 0 everywhere and no blending.
        levels: number of levels in use, 1..4.
        tile: tile edge in pixels.
        tile_level: (tiles_y, tiles_x) uint8, the level of the tile's least eccentric pixel.
        blend: (tiles_y, tiles_x) bool, whether some pixel of the tile has w > 0.
        plane: (tiles_y, tiles_x, 3) float64: t at the tile's first pixel, its slope per pixel in x, and in y; 0 where
            the tile does not blend.
    """

    display: Display
    gaze_xy: tuple[float, float] | None
    levels: int
    tile: int
    tile_level: np.ndarray
    blend: np.ndarray
    plane: np.ndarray

    @property
    def tiles_x(self) -> int:
        """Number of tiles in a row."""
        return self.tile_level.shape[1]

    @property
    def tiles_y(self) -> int:
        """Number of rows of tiles."""
        return self.tile_level.shape[0]

    @cached_property
    def blend_weights_exact(self) -> np.ndarray:
        """(height, width) float64 in 0..1: w from each pixel's own eccentricity; 0 in tiles that do not blend."""
        if self.gaze_xy is None:
            return np.zeros((self.display.height_px, self.display.width_px))
        level = self._per_pixel(self.tile_level)
        t = blend_parameter(self.display.eccentricity(self.gaze_xy), level, self.levels)
        return smoothstep(t)

    @cached_property
    def blend_weights_plane(self) -> np.ndarray:
        """(height, width) float64 in 0..1: w from the tile's plane, as the hardware computes it."""
        y, x = np.indices((self.display.height_px, self.display.width_px)) % self.tile
        value, slope_x, slope_y = np.moveaxis(self._per_pixel(self.plane), -1, 0)
        return smoothstep(value + slope_x * x + slope_y * y)

    def _per_pixel(self, per_tile: np.ndarray) -> np.ndarray:
        """(height, width, ...) the tile's value at each of its pixels."""
        expanded = per_tile.repeat(self.tile, axis=0).repeat(self.tile, axis=1)
        return expanded[: self.display.height_px, : self.display.width_px]


def region_level(eccentricity: np.ndarray, levels: int = MAX_LEVELS) -> np.ndarray:
    """uint8 level (0-based) of the quality region that each eccentricity, in degrees, falls into."""
    return (np.searchsorted(REGION_START_DEG[:levels], eccentricity, side="right") - 1).astype(np.uint8)


def blend_parameter(eccentricity: np.ndarray, level: np.ndarray, levels: int = MAX_LEVELS) -> np.ndarray:
    """float64 blend parameter t, not clamped, of each eccentricity (degrees) in a tile of `level`.

    The last level in use has no outer level to blend with, so its t is 0 everywhere.
    """
    band = np.array([*BAND_START_DEG[: levels - 1], math.inf])
    start = np.array([*REGION_START_DEG[1:levels], math.inf])
    last = level == levels - 1
    with np.errstate(invalid="ignore"):
        return np.where(last, 0.0, (eccentricity - band[level]) / (start[level] - band[level]))


def foveation_map(
    display: Display, gaze_xy: tuple[float, float], levels: int = MAX_LEVELS, tile: int = TILE
) -> FoveationMap:
    """Tile levels, blend flags and blend planes for one gaze.

    Levels and flags are computed from the exact eccentricity of every pixel; only the planes are approximations. With fewer
    than four levels, the regions beyond the last level belong to it.

    Args:
        display: the display the frame is shown on.
        gaze_xy: gaze in pixels of the display.
        levels: number of levels in use, 1..4.
        tile: tile edge in pixels.

    Raises:
        InputError: the gaze is off the display, or `levels` is not 1..4.
    """
    if levels not in range(1, MAX_LEVELS + 1):
        raise InputError(f"{levels} levels are not accepted: 1 to {MAX_LEVELS} are")
    eccentricity = _by_tile(display.eccentricity(gaze_xy), tile)
    nearest = np.nanmin(eccentricity, axis=(2, 3))
    farthest = np.nanmax(eccentricity, axis=(2, 3))
    tile_level = region_level(nearest, levels)
    blend = smoothstep(blend_parameter(farthest, tile_level, levels)) > 0  # t rises with the eccentricity
    plane = np.zeros((*blend.shape, 3))
    t = blend_parameter(eccentricity, tile_level[:, :, None, None], levels)
    plane[blend] = _fit_planes(t[blend])
    return FoveationMap(display, (float(gaze_xy[0]), float(gaze_xy[1])), levels, tile, tile_level, blend, plane)


def no_foveation(display: Display, tile: int = TILE) -> FoveationMap:
    """The map for a frame without a gaze: level 0 everywhere and nothing blended."""
    shape = (-(-display.height_px // tile), -(-display.width_px // tile))
    return FoveationMap(display, None, 1, tile, np.zeros(shape, np.uint8), np.zeros(shape, bool), np.zeros((*shape, 3)))


def _by_tile(image: np.ndarray, tile: int) -> np.ndarray:
    """(tiles_y, tiles_x, tile, tile) view of `image`, nan beyond its right and lower edges."""
    height, width = image.shape
    image = np.pad(image, ((0, -height % tile), (0, -width % tile)), constant_values=np.nan)
    return image.reshape(image.shape[0] // tile, tile, -1, tile).swapaxes(1, 2)


def _fit_planes(t: np.ndarray) -> np.ndarray:
    """(n, 3) least-squares planes of `t` (n, tile, tile) over the pixels within FIT_RANGE; nan pixels are left out.

    A tile without a pixel in that range (its band is narrower than a pixel) is fitted over all its pixels.
    """
    n, tile, _ = t.shape
    y, x = np.indices((tile, tile))
    design = np.stack([np.ones(tile * tile), x.ravel(), y.ravel()], axis=1)
    t = t.reshape(n, tile * tile)
    with np.errstate(invalid="ignore"):
        use = (t >= FIT_RANGE[0]) & (t <= FIT_RANGE[1])
    use |= ~use.any(axis=1, keepdims=True) & ~np.isnan(t)
    # Where the pixels do not determine the slopes (a row, a column, one pixel), the pseudo-inverse gives the smallest ones.
    inverse = np.linalg.pinv(design * use[:, :, None])
    return np.einsum("nkp,np->nk", inverse, np.where(use, t, 0.0))
