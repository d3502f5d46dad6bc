"""Golden cycles of frames of two eyes: every phase as long as its busiest part at one item a cycle, beats at the memory's rate.

The estimate of `msv2.studies.training.frame_cycles`, with display pixels and the warp unit's work. A better model of cycles
takes the place of `golden_cycles`: the table asks it for nothing but the `StereoCycles` of a frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from golden.msv2_ref.eyes import StereoFrame
from golden.msv2_ref.pipeline import Frame
from msv2.studies.training.frame_cycles import frame_work
from spec.constants import TILE
from spec.memory import BEAT_BYTES, DISPLAY_PIXEL_BYTES, DRAM_BYTES_PER_CYCLE, PIXEL_BYTES


@dataclass(frozen=True)
class StereoCycles:
    """Cycles of a frame of two eyes.

    Attributes:
        source, target: of each eye, geometry and rendering, one after the other.
        geometry: of both eyes.
        render: of both eyes, the warp unit's work beside the source's included.
        busiest: least of both eyes' rendering without warping: the busiest stage's work on the entries that are rendered.
        stages: that work, by stage.
    """

    source: int
    target: int
    geometry: int
    render: int
    busiest: int
    stages: dict[str, int]

    @property
    def total(self) -> int:
        """Of the frame."""
        return self.source + self.target

    @property
    def overhead(self) -> float:
        """Over the same frame if warping were free."""
        return self.total / (self.geometry + self.busiest)


CycleModel = Callable[[StereoFrame], StereoCycles]
"""What gives the cycles of a golden frame of two eyes."""


def golden_cycles(frame: StereoFrame) -> StereoCycles:
    """The busiest-stage bound of a golden frame."""
    config, r = frame.source.config, frame.source.registers
    geometry, stages = zip(*(_phases(eye) for eye in (frame.source, frame.target)), strict=True)
    pixels = r.width * r.height
    warp_beats = pixels * DISPLAY_PIXEL_BYTES / BEAT_BYTES
    beat = BEAT_BYTES / DRAM_BYTES_PER_CYCLE
    lanes = -(-r.width // TILE) * TILE * -(-r.height // TILE) * TILE // config.warp_lanes
    warping = {**stages[0], "memory": stages[0]["memory"] + warp_beats * beat, "warp": lanes}
    render = round(max(warping.values())), round(max(stages[1].values()))
    both = {name: round(stages[0][name] + stages[1][name]) for name in stages[0]}
    return StereoCycles(geometry[0] + render[0], geometry[1] + render[1], sum(geometry), sum(render), max(both.values()), both)


def eye_cycles(eye: Frame) -> int:
    """The same of one eye rendered alone, as a whole."""
    geometry, stages = _phases(eye)
    return geometry + round(max(stages.values()))


def _phases(eye: Frame) -> tuple[int, dict[str, float]]:
    """An eye's geometry, and what each stage of rendering does."""
    shown = np.ones(len(eye.registers.header), bool) if eye.rendered is None else eye.rendered
    work = frame_work(eye, shown)
    rendered = eye.registers.width * eye.registers.height * float(shown.mean())
    beats = work.render_beats - rendered * (PIXEL_BYTES - DISPLAY_PIXEL_BYTES) / BEAT_BYTES
    rows = int(shown.sum()) * TILE * TILE // eye.config.cores_x
    return round(work.geometry_cycles), {
        "sort": work.entries, "array": work.array, "pixel_rows": rows, "memory": beats * BEAT_BYTES / DRAM_BYTES_PER_CYCLE}
