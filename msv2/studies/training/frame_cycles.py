"""Golden cycles: what a frame costs the machine, estimated from the integer golden's frame alone.

Two phases with a barrier between, each as long as its busiest part at one item a cycle: projection (a Gaussian), tile test and
sort (an entry), the array (an entry at each level that uses it, in every block of a tile), pixel rows, and memory's beats at
the paper's bandwidth. What latency and hand-overs add is left out, and what the machine clears once after a reset. Two things
are modelled, not counted: splat views come through a direct-mapped cache, and groups beyond the sort buffer go to memory and
back once. Frames of captured scenes take 1 to 2 % more than this (`reports/frames.json`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from golden.diff.gaussians import Gaussians, to_model
from golden.msv2_ref import pipeline, tile_merge
from golden.msv2_ref.pipeline import Frame
from golden.scenes.camera import Camera
from golden.training.foveated import FoveatedModel
from golden.training.level_quality import Levels, centre_foveation
from spec.config import PAPER, AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BYTES, BEAT_ENTRIES, DRAM_BYTES_PER_CYCLE, FIRST_PAGE_ENTRIES, PIXEL_BYTES, colour_beats

LEVEL_BITS = 2
"""Bits of a level in the key of a splat's view."""

UP = np.array([0.0, -1.0, 0.0])
"""Of models that are only rendered, which does not read it."""


@dataclass(frozen=True)
class FrameWork:
    """What a frame makes the machine do, or the mean of several.

    Attributes:
        points: Gaussians read and projected.
        survivors: those with an entry.
        entries: (splat, tile) pairs: the tile-ellipse intersections.
        tiles: of the frame.
        array: cycles of the array: entries by level that uses them, and backgrounds, in every block of a tile.
        geometry_beats, render_beats: of memory, by phase.
        geometry_cycles, render_cycles: golden cycles of each phase.
    """

    points: float
    survivors: float
    entries: float
    tiles: float
    array: float
    geometry_beats: float
    render_beats: float
    geometry_cycles: float
    render_cycles: float

    @property
    def cycles(self) -> float:
        """Golden cycles of both phases."""
        return self.geometry_cycles + self.render_cycles

    @property
    def entries_per_tile(self) -> float:
        """Intersections per tile."""
        return self.entries / self.tiles

    @classmethod
    def mean(cls, works: Sequence[FrameWork]) -> FrameWork:
        """The mean frame."""
        return cls(**{f.name: float(np.mean([getattr(work, f.name) for work in works])) for f in fields(cls)})

    @classmethod
    def total(cls, works: Sequence[FrameWork]) -> FrameWork:
        """The parts of one frame that the machine makes one after the other; tiles are those of the frame."""
        sums = {f.name: float(sum(getattr(work, f.name) for work in works)) for f in fields(cls)}
        return cls(**sums | {"tiles": works[0].tiles})


def frame_work(frame: Frame, shown: np.ndarray | None = None) -> FrameWork:
    """The work of a golden frame.

    Args:
        frame: from `golden.msv2_ref.pipeline.render`.
        shown: (tiles,) bool, or None for all: the tiles whose entries and pixels count. A model that serves one level of
            separate ones lists its Gaussians in these alone.
    """
    config, r = frame.config, frame.registers
    shown = np.ones(len(r.header), bool) if shown is None else shown
    counts = np.where(shown, np.diff(frame.entries.start), 0)
    keep = np.repeat(shown, np.diff(frame.entries.start))
    splat, use = frame.entries.splat[keep].astype(np.int64), frame.entries.use[keep]
    level, blend = r.header[:, 0], r.header[:, 1]
    views = splat << LEVEL_BITS | np.repeat(level, counts)
    entries, survivors = len(splat), len(np.unique(splat))
    points = len(frame.projected.reason)
    array = entries + int((use == 3).sum()) + int((1 + blend)[shown].sum())
    rows = int(shown.sum()) * TILE * TILE // config.cores_x
    geometry_beats = (
        points + survivors * colour_beats(config, frame.words.sh_degree) + entries + _pages(counts) + len(np.unique(views)))
    render_beats = (
        int((-(-counts // BEAT_ENTRIES)).sum()) + _misses(views, config.splat_cache_lines)
        + _spilled_beats(config, counts, r.tiles_x) + r.width * r.height * float(shown.mean()) * PIXEL_BYTES / BEAT_BYTES)
    beat = BEAT_BYTES / DRAM_BYTES_PER_CYCLE
    geometry = max(points, entries, geometry_beats * beat)
    render = max(entries, config.blocks * array, rows, render_beats * beat)
    return FrameWork(
        points, survivors, entries, len(shown), config.blocks * array, geometry_beats, render_beats,
        round(geometry), round(render))


def _pages(counts: np.ndarray) -> int:
    """Directory slots written: each page of a tile beyond its first."""
    last = np.maximum(counts - 1, 0) // FIRST_PAGE_ENTRIES + 1
    return int(np.floor(np.log2(last)).sum())


def _misses(views: np.ndarray, lines: int) -> int:
    """Accesses, in order, that miss in a direct-mapped cache of so many lines, empty before."""
    line = (views >> LEVEL_BITS) % lines
    order = np.argsort(line, kind="stable")
    line, view = line[order], views[order]
    return int((np.diff(line, prepend=-1) != 0).sum() + ((np.diff(line) == 0) & (np.diff(view) != 0)).sum())


def _spilled_beats(config: AcceleratorConfig, counts: np.ndarray, tiles_x: int) -> int:
    """Beats of the entries of groups larger than half the sort buffer, written once and read once."""
    room = config.sort_chunk
    groups = np.bincount(tile_merge.merge_tiles(counts, tiles_x, tile_merge.auto_beta(counts, config)), counts)
    return int(2 * (-(-groups[groups > room] // BEAT_ENTRIES)).sum())


def whole_frame_work(gaussians: Gaussians, camera: Camera, config: AcceleratorConfig = PAPER) -> FrameWork:
    """The work of a frame of one level, without a gaze."""
    return frame_work(pipeline.render(to_model(gaussians, up=UP, name="level"), camera, config=config))


def foveated_frame_work(levels: Levels, camera: Camera, config: AcceleratorConfig = PAPER) -> FrameWork:
    """The work of a foveated frame with the gaze in its centre.

    Separate models are projected each, each lists its Gaussians in the tiles that show its level, and a tile that blends two
    levels is made twice.
    """
    foveation = centre_foveation(camera, levels.levels)
    if isinstance(levels, FoveatedModel):
        model = levels.to_model(up=UP, name="levels")
        return frame_work(pipeline.render(model, camera, config=config, foveation=foveation))
    works = []
    for level in range(levels.levels):
        shown = (foveation.tile_level == level) | (foveation.blend & (foveation.tile_level + 1 == level))
        frame = pipeline.render(to_model(levels.level(level), up=UP, name="level"), camera, config=config)
        works.append(frame_work(frame, shown.ravel()))
    return FrameWork.total(works)
