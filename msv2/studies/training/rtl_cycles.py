"""Cycles of the RTL for a frame of a model. A frame is simulated once and kept under a key of its inputs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from msv2.studies import rtl_frame

OPTIONS = ("--config", "paper", "--machine", "full")
"""Options of every frame. The machine is the one whose cycles the model gives for comparison."""


@dataclass(frozen=True)
class RtlCycles:
    """Cycles of a frame that is bit-exact against the golden renderer.

    Attributes:
        geometry: the cycles of the tile table and the geometry phase.
        render: the cycles of the rendering phase.
        entries: the intersections.
    """

    geometry: int
    render: int
    entries: int

    @property
    def cycles(self) -> int:
        """Cycles of the frame, without the clearing that follows a reset."""
        return self.geometry + self.render


def rtl_cycles(model: GaussianModel, camera: Camera, folder: Path) -> RtlCycles:
    """Cycles of a frame of level 1.

    Args:
        model: the model.
        camera: the camera.
        folder: the folder of earlier simulations.

    Raises:
        InputError: the simulation fails, or a bit differs.
    """
    found = rtl_frame.model_frame(folder, model, camera, OPTIONS)
    return RtlCycles(found["table_cycles"] + found["geometry_cycles"], found["render_cycles"], found["entries"])
