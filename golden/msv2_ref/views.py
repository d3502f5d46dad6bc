"""What a frame leaves in memory: the array's views of its splats, and its pixels."""

from __future__ import annotations

import numpy as np

from golden.msv2_ref.pipeline import Frame
from spec.memory import frame_pixel, splat_view


def splat_views(frame: Frame, levels: int) -> np.ndarray:
    """(Gaussians, levels) SplatView records, by tile level; those of Gaussians that are not visible mean nothing."""
    s = frame.splats
    level = np.arange(levels)
    both = np.minimum(np.stack([level, level + 1], 1), s.log2_opacity.shape[1] - 1)
    out = np.zeros((len(s.mean2d), levels), splat_view(frame.config).dtype)
    out["mean2d"], out["depth"] = s.mean2d[:, None], s.depth[:, None]
    out["conic"] = frame.config.formats.conic.quantise(frame.projected.conic)[:, None]
    out["log2_opacity"] = s.log2_opacity[:, both]
    out["colour"] = s.colour[:, both].reshape(len(s.mean2d), levels, 6)
    out["bound"] = frame.words.geometry["bound"][:, None]
    return out


def frame_pixels(frame: Frame) -> np.ndarray:
    """(height, width) FramePixel records."""
    r = frame.registers
    out = np.zeros((r.height, r.width), frame_pixel(frame.config).dtype)
    for name, tiled in frame.pixels._asdict().items():
        out[name] = frame.untiled(tiled)
    return out
