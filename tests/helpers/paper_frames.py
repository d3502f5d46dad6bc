"""Frames of the machine with wide records and lists by tile, whose stages most tests of the integer renderer look into."""

from __future__ import annotations

from golden.msv2_ref import pipeline
from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from spec.config import PAPER_SMALL, AcceleratorConfig


def render(model: GaussianModel, camera: Camera, *, config: AcceleratorConfig = PAPER_SMALL, **options) -> pipeline.Frame:
    """The integer renderer's frame on `config`, if no other machine is given PAPER_SMALL."""
    return pipeline.render(model, camera, config=config, **options)
