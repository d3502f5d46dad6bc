"""The work of the machine for a frame of trained models: intersections by the golden renderer, cycles by the cycle model with
LPDDR3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from golden.diff.gaussians import Gaussians, to_model
from golden.host.quantise import quantise_model
from golden.host.registers import frame_registers
from golden.msv2_ref import pipeline
from golden.msv2_ref.pipeline import Frame
from golden.scenes.camera import Camera
from golden.scenes.gaze import no_foveation
from golden.training.foveated import FoveatedModel
from golden.training.level_quality import Levels, centre_foveation
from msv2.studies.cycles import LPDDR3_MODEL
from perf.model import MemoryModel, simulate
from perf.trace import trace_of
from spec.config import PAPER, AcceleratorConfig

UP = np.array([0.0, -1.0, 0.0])
"""The upward direction of the models made here. Rendering does not read it."""


@dataclass(frozen=True)
class FrameWork:
    """The work of the machine for a frame, or the mean of several frames.

    Attributes:
        points: Gaussians that are read.
        entries: intersections of tiles and splats.
        tiles: tiles of the frame.
        geometry_cycles: cycles of the tile table and the geometry phase.
        render_cycles: cycles of the rendering phase.
    """

    points: float
    entries: float
    tiles: float
    geometry_cycles: float
    render_cycles: float

    @property
    def cycles(self) -> float:
        """Cycles of both phases."""
        return self.geometry_cycles + self.render_cycles

    @property
    def entries_per_tile(self) -> float:
        """Intersections per tile."""
        return self.entries / self.tiles

    def record(self) -> dict[str, Any]:
        """The frame as JSON-ready values, with the source of the cycles."""
        return asdict(self) | {"cycles": self.cycles, "entries_per_tile": self.entries_per_tile, "cycles_by": LPDDR3_MODEL}

    @classmethod
    def mean(cls, works: Sequence[FrameWork]) -> FrameWork:
        """The mean frame."""
        return cls(**{f.name: float(np.mean([getattr(work, f.name) for work in works])) for f in fields(cls)})

    @classmethod
    def total(cls, works: Sequence[FrameWork]) -> FrameWork:
        """The sum of the parts of one frame that the machine makes one after the other. The tiles are counted once."""
        sums = {f.name: float(sum(getattr(work, f.name) for work in works)) for f in fields(cls)}
        return cls(**sums | {"tiles": works[0].tiles})


def frame_work(frame: Frame, memory: MemoryModel | None = None) -> FrameWork:
    """The work of a golden frame; without `memory`, with LPDDR3."""
    cycles = simulate(trace_of(frame), frame.config, memory=memory or MemoryModel("lpddr3"))
    render = cycles.phases["render"]
    return FrameWork(len(frame.projected.reason), cycles.entries, len(frame.registers.header), cycles.total - render, render)


def whole_frame_work(gaussians: Gaussians, camera: Camera, config: AcceleratorConfig = PAPER) -> FrameWork:
    """The work of a frame of one level, without a gaze."""
    return frame_work(pipeline.render(to_model(gaussians, up=UP, name="level"), camera, config=config))


def foveated_frame_work(levels: Levels, camera: Camera, config: AcceleratorConfig = PAPER) -> FrameWork:
    """The work of a foveated frame with the gaze in its centre.

    Of separate models, each is projected, and lists its Gaussians in the tiles that show its level. A tile that blends two
    levels is rendered twice.
    """
    foveation = centre_foveation(camera, levels.levels)
    if isinstance(levels, FoveatedModel):
        model = levels.to_model(up=UP, name="levels")
        return frame_work(pipeline.render(model, camera, config=config, foveation=foveation))
    works, plain = [], no_foveation(foveation.display)
    for level in range(levels.levels):
        shown = (foveation.tile_level == level) | (foveation.blend & (foveation.tile_level + 1 == level))
        words = quantise_model(config, to_model(levels.level(level), up=UP, name="level"))
        registers = frame_registers(config, camera, words, plain, (0.0, 0.0, 0.0))
        works.append(frame_work(pipeline.render_frame(config, words, registers, rendered=shown.ravel())))
    return FrameWork.total(works)
