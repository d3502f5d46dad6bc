"""Writes pictures as PNG: frames, depth maps and tile levels. A file appears complete or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from golden.scenes.files import atomic_output
from golden.scenes.gaze import FoveationMap

_LEVEL_COLOURS = np.array([[255, 80, 80], [255, 200, 60], [80, 200, 120], [90, 140, 255]], np.float64) / 255
_KIND_COLOURS = np.array([[255, 255, 255], [255, 80, 80], [80, 200, 120], [90, 140, 255], [255, 200, 60], [200, 60, 255]],
                         np.float64) / 255
_DEPTH_STOPS = np.array([[253, 231, 37], [53, 183, 121], [49, 104, 142], [68, 1, 84]], np.float64) / 255


def to_bytes(image: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 of a float image, clamped to [0, 1] and rounded HALF_UP."""
    return np.floor(np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)


def save_png(path: Path, image: np.ndarray) -> None:
    """Writes an image (H, W, 3) or (H, W), uint8 or float in [0, 1], as PNG."""
    with atomic_output(path) as file:
        Image.fromarray(image if image.dtype == np.uint8 else to_bytes(image)).save(file, format="PNG")


def depth_picture(depth: np.ndarray) -> np.ndarray:
    """A depth map (H, W) in colours, (H, W, 3) float: near is yellow and far is violet, NaN is black.

    The scale is logarithmic and runs from the 1st to the 99th percentile.
    """
    valid = np.isfinite(depth) & (depth > 0)
    picture = np.zeros((*depth.shape, 3))
    if valid.any():
        low, high = np.log(np.percentile(depth[valid], [1, 99]))
        t = np.clip((np.log(depth[valid]) - low) / max(high - low, 1e-9), 0, 1) * (len(_DEPTH_STOPS) - 1)
        for channel in range(3):
            picture[valid, channel] = np.interp(t, np.arange(len(_DEPTH_STOPS)), _DEPTH_STOPS[:, channel])
    return picture


def levels_picture(image: np.ndarray, foveation: FoveationMap) -> np.ndarray:
    """(H, W, 3) float: the frame tinted by each tile's level, with tile edges; a blend tile has the mean tint of its two
    levels."""
    height, width = image.shape[:2]
    tile_y, tile_x = np.arange(height) // foveation.tile, np.arange(width) // foveation.tile
    level = foveation.tile_level[tile_y][:, tile_x]
    blend = foveation.blend[tile_y][:, tile_x, None]
    outer = np.minimum(level + 1, len(_LEVEL_COLOURS) - 1)
    colour = np.where(blend, 0.5 * _LEVEL_COLOURS[level] + 0.5 * _LEVEL_COLOURS[outer], _LEVEL_COLOURS[level])
    edge = (np.arange(height) % foveation.tile == 0)[:, None] | (np.arange(width) % foveation.tile == 0)[None, :]
    return np.where(edge[..., None], 0.45, 0.65) * np.clip(image, 0, 1) + 0.35 * colour


def kinds_picture(image: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """(H, W, 3) float: the brightness of an image in a colour that shows each pixel's kind.

    Args:
        image: (H, W, 3) uint8.
        kind: (H, W) of 0..5: white, red, green, blue, yellow, violet.
    """
    brightness = image.astype(np.float64).mean(axis=2, keepdims=True) / 255
    return (0.35 + 0.65 * brightness) * _KIND_COLOURS[kind]


def anaglyph(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 of two eyes' images for red-cyan glasses: red from the left eye, green and blue from the right."""
    return np.concatenate([left[..., :1], right[..., 1:]], axis=2)
