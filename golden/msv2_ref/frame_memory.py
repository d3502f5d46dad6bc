"""What a frame leaves in memory: the splat records that the array reads, and the pixels."""

from __future__ import annotations

import numpy as np

from golden.msv2_ref.pipeline import Frame
from golden.msv2_ref.supertiles import list_counts
from spec.config import AcceleratorConfig
from spec.formats import Fixed
from spec.memory import display_pixel, frame_pixel, splat_record
from spec.records import Record


def splat_records(frame: Frame, levels: int) -> np.ndarray:
    """(Gaussians, levels) SplatRecord records by tile level; the records of invisible Gaussians have no meaning."""
    rows = np.arange(len(frame.splats.mean2d))[:, None]
    return records_at(frame, rows, np.arange(levels)[None], splat_record(frame.config))


def records_at(frame: Frame, rows: np.ndarray, level: np.ndarray, record: Record) -> np.ndarray:
    """Records that hold the fields of a SplatRecord; their other fields are 0.

    Args:
        frame: the frame.
        rows: Gaussians.
        level: tile levels, broadcast with `rows`; the result has the shape of both.
        record: the record, SplatRecord or one with more fields.
    """
    s, (rows, level) = frame.splats, np.broadcast_arrays(rows, level)
    both = np.minimum(np.stack([level, level + 1], -1), s.log2_opacity.shape[1] - 1)
    out = np.zeros(rows.shape, record.dtype)
    out["mean2d"], out["depth"] = s.mean2d[rows], s.depth[rows]
    out["conic"] = frame.config.formats.conic.quantise(frame.projected.conic[rows])
    out["log2_opacity"] = s.log2_opacity[rows[..., None], both]
    out["colour"] = s.colour[rows[..., None], both].reshape(*rows.shape, 6)
    out["bound"] = frame.words.geometry["bound"][rows]
    return out


def list_lengths(frame: Frame) -> np.ndarray:
    """(lists,) int64: intersections of each tile, or with super-tiles pairs of each list."""
    if frame.pairs is None or frame.bounds is None:
        return np.diff(frame.entries.start)
    return list_counts(frame.pairs, frame.bounds)


def frame_pixels(frame: Frame) -> np.ndarray:
    """(height, width) FramePixel records."""
    r = frame.registers
    out = np.zeros((r.height, r.width), frame_pixel(frame.config).dtype)
    for name, tiled in frame.pixels._asdict().items():
        out[name] = frame.untiled(tiled)
    return out


def displayed(config: AcceleratorConfig, pixels: np.ndarray) -> np.ndarray:
    """Converts FramePixel records to DisplayPixel records of the same shape."""
    n, out = config.formats, np.zeros(pixels.shape, display_pixel(config).dtype)
    out["colour"] = np.minimum(_bytes(pixels["colour"], n.accumulator), 255)
    out["coverage"] = 255 - _bytes(pixels["transmittance"], n.transmittance)
    return out


def display_pixels(frame: Frame) -> np.ndarray:
    """(height, width) DisplayPixel records."""
    return displayed(frame.config, frame_pixels(frame))


def _bytes(raw: np.ndarray, number: Fixed) -> np.ndarray:
    """255 times the value, rounded HALF_UP."""
    one = 1 << number.frac_bits
    return (510 * raw.astype(np.int64) + one) // (2 * one)
