"""Cycles of the RTL: a frame of a model, simulated once and kept by what it was made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from msv2.studies import rtl_frame

OPTIONS = ("--config", "paper", "--machine", "full")
"""Options of every frame: the machine whose cycles by the model stand beside."""


@dataclass(frozen=True)
class RtlCycles:
    """Cycles of a frame, bit-exact against the golden renderer.

    Attributes:
        geometry: of the tile table and the geometry phase.
        render: of the rendering phase.
        entries: intersections of tiles and splats.
    """

    geometry: int
    render: int
    entries: int

    @property
    def cycles(self) -> int:
        """Cycles of the frame, without what the machine clears once after a reset."""
        return self.geometry + self.render


def rtl_cycles(model: GaussianModel, camera: Camera, folder: Path) -> RtlCycles:
    """Cycles of a frame of level 1.

    Args:
        folder: for what was simulated before.

    Raises:
        InputError: the simulation fails or a bit differs.
    """
    found = rtl_frame.model_frame(folder, model, camera, OPTIONS)
    return RtlCycles(found["table_cycles"] + found["geometry_cycles"], found["render_cycles"], found["entries"])
