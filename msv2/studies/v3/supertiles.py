"""Frames on the machine with lists by super-tile, and how well the bounds of a frame suit the next one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from golden.host.quantise import GaussianWords, quantise_model
from golden.host.registers import frame_registers
from golden.msv2_ref import projection, sort, tile_test
from golden.msv2_ref.buckets import Bounds, next_bounds, no_bounds
from golden.msv2_ref.supertiles import Pairs, find_pairs, list_counts
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, FoveationMap, no_foveation
from golden.scenes.load import EMBEDDED
from golden.scenes.request import Request, resolve
from msv2.studies.energy.frame import frame_energy
from msv2.studies.energy.supertiles import super_counts, super_table
from msv2.studies.energy.table import Table
from msv2.studies.memory import memory_arguments
from msv2.studies.performance.frames import request
from msv2.studies.v3.frames import CACHE, CLOCK_HZ, Subject, moved, total_bytes
from perf.model import MemoryModel
from perf.supertiles import simulate_supertiles
from perf.supertiles_trace import SuperTrace, trace_request
from spec.config import V3, AcceleratorConfig

TURNS = (0.5, 2.0)
"""Degrees by which the camera turns between two frames."""

STEP = 0.005
"""How far the camera moves to the side meanwhile, in units of the world."""


def super_traced(subject: Subject, config: AcceleratorConfig = V3) -> SuperTrace:
    """The trace of a frame on a machine, from the cache where it is there. Packing changes no trace.

    Raises:
        InputError: the scene is missing.
    """
    return trace_request(request(subject.scene, subject.size), config, cache=CACHE)


def super_row(
    subject: Subject, memory: str, trace: SuperTrace, table: Table, config: AcceleratorConfig = V3,
) -> dict[str, object]:
    """The numbers of a frame with a memory, as `msv2.studies.v3.frames.frame_row` gives them, and those of super-tiles. The
    frame is packed where the machine can."""
    frame = simulate_supertiles(
        trace, config, memory=MemoryModel(**memory_arguments(memory)), display=True, packed=config.packed)
    energy = frame_energy(
        super_counts(trace, frame, config), frame.total, config, super_table(table, config), clock_hz=CLOCK_HZ)
    return {
        "frame": subject.name, "scene": subject.scene, "size": subject.size, "machine": config.name, "memory": memory,
        "cycles": frame.total, "phases": frame.phases, "bytes": moved(frame), "total_bytes": total_bytes(frame),
        "activates": frame.activates, "refreshes": frame.refreshes, "points": trace.points, "points_read": trace.points_read,
        "chunks": len(trace.chunk_count), "chunks_read": int(trace.chunk_read.sum()), "survivors": trace.survivors,
        "entries": frame.entries, "pairs": frame.pairs, "places": int(trace.places.sum(dtype=np.int64)), "lists": frame.lists,
        "batches": frame.batches, "visits": frame.visits, "header_misses": frame.fetch_misses,
        "overflow_share": frame.overflow_share,
        "energy_mj": {"chip": energy.chip_mj, "dram": energy.sum_mj("dram"), "dram_by_use": energy.by_dram()}}


def turned(camera: Camera, degrees: float, step: float) -> Camera:
    """A camera that is turned about its vertical axis, and moved to the side."""
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    return replace(camera, rotation=turn @ camera.rotation, translation=turn @ camera.translation + np.array([step, 0, 0]))


@dataclass(frozen=True)
class _View:
    """What the pairs of a frame depend on."""

    words: GaussianWords
    asked: Request
    foveation: FoveationMap

    def pairs(self, camera: Camera) -> Pairs:
        """The pairs of the frame as another camera sees it."""
        registers = frame_registers(V3, camera, self.words, self.foveation, self.asked.background, None)
        projected = projection.project(V3, self.words, registers)
        order = sort.depth_order(projected.depth_key, projected.reason == projection.VISIBLE)
        tested = tile_test.tested_opacity(V3, self.words.geometry["log2_opacity"], self.words.decoded.opacity)
        entries = tile_test.tile_intersections(
            V3, projected, tested, self.words.geometry["bound"], registers, order)
        return find_pairs(registers, self.words.chunks, projected.depth_key, entries)


@lru_cache(maxsize=1)
def _words(scene: str) -> GaussianWords:
    return quantise_model(V3, resolve(request(scene, "640x360")).model)


def overflow_rows(subject: Subject, turns: tuple[float, ...] = TURNS) -> list[dict[str, object]]:
    """How many pairs of a frame lie in lists that the sorter cannot hold at once: after a turn by each of so many degrees, with
    the bounds that the frame before the turn left; and after a cut, without any. With four levels and without foveation.

    Raises:
        InputError: the scene is missing.
    """
    asked = resolve(request(subject.scene, subject.size))
    out = []
    for foveated in (True, False):
        foveation = asked.foveation if foveated else no_foveation(Display(asked.camera.width, asked.camera.height))
        view = _View(_words(subject.scene), asked, foveation)
        pairs = view.pairs(asked.camera)
        supertiles = len(pairs.start) - 1
        for degrees in (*turns, None):
            bounds = no_bounds(supertiles)
            if degrees is not None:
                before = view.pairs(turned(asked.camera, degrees, STEP))
                bounds = next_bounds(V3, before.start, before.depth_key)
            out.append({"frame": subject.name, "scene": subject.scene, "size": subject.size, "foveated": foveated,
                        "degrees": degrees, **_overflow(pairs, bounds)})
    return out


def _overflow(pairs: Pairs, bounds: Bounds) -> dict[str, object]:
    counts = list_counts(pairs, bounds)
    over = int(counts[counts > V3.sort_chunk].sum())
    return {"pairs": len(pairs.splat), "lists": bounds.lists, "largest": int(counts.max(initial=0)), "overflow": over,
            "overflow_share": over / max(1, len(pairs.splat))}


def captured(subjects: list[Subject]) -> list[Subject]:
    """The frames of captured scenes."""
    return [subject for subject in subjects if subject.scene != EMBEDDED]
