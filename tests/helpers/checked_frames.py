"""Frames of the integer renderer, after the checks that hold for any."""

from __future__ import annotations

import numpy as np

from golden.msv2_ref.pipeline import Frame, render
from golden.msv2_ref.projection import OUTSIDE
from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from spec.config import PAPER_SMALL

N = PAPER_SMALL.formats


def checked(model: GaussianModel, camera: Camera, **options) -> Frame:
    """The frame, of PAPER_SMALL if no machine is given, after the checks that hold for any: finite, bounded, every point
    accounted for, and repeatable."""
    options = {"config": PAPER_SMALL, **options}
    frame = render(model, camera, **options)
    assert np.isfinite(frame.image).all() and np.isfinite(frame.projected.conic).all()
    assert (frame.image >= 0).all() and ((frame.transmittance >= 0) & (frame.transmittance < 1)).all()
    assert len(frame.projected.reason) == len(model) and (frame.projected.reason <= OUTSIDE).all()
    assert len(frame.registers.header) == len(frame.entries.start) - 1
    again = render(model, camera, **options)
    assert all(np.array_equal(a, b) for a, b in zip(frame.pixels, again.pixels, strict=True))
    return frame


def coverage(frame: Frame) -> np.ndarray:
    """1 - T, from T as it starts: the largest value of its format."""
    return N.transmittance.to_float(N.transmittance.raw_max) - frame.transmittance
