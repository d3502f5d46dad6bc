"""The frames, and how each of them runs on the machines between `paper` and `v3`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from golden.scenes.load import EMBEDDED
from golden.scenes.request import parse_size
from msv2.studies.energy.frame import Table, frame_energy, model_counts
from msv2.studies.memory import IDEAL, LPDDR3, memory_arguments
from msv2.studies.performance.frames import CHUNKS, SPATIAL, request, scene_file
from perf.model import FrameCycles, MemoryModel, simulate
from perf.trace import FrameTrace, trace_request
from spec.command_line import command_parser
from spec.config import PAPER, V3_RECORDS, AcceleratorConfig
from spec.paths import REPORTS, cache_folder

CACHE = cache_folder("traces")
CLOCK_HZ = 1e9

MACHINES = {
    PAPER.name: PAPER, "paper, spatial order": SPATIAL, "chunks, wide records": CHUNKS, V3_RECORDS.name: V3_RECORDS}
"""The machines by name, each with one change more than the one before it."""

MEMORIES = (LPDDR3, IDEAL)
"""The memories, the one that counts first; the other one is a bound."""

SIZES = ("640x360", "1920x1080")
SCENES = ("truck", "rock_sh3", "garden_large", EMBEDDED)
"""Scenes that need no training."""


@dataclass(frozen=True)
class Subject:
    """A foveated frame of four levels with the gaze in its centre, seen from the orbit's first camera."""

    scene: str
    size: str

    @property
    def name(self) -> str:
        """Scene and size in words."""
        return f"{self.scene}, {self.size}"


def subjects(scenes: tuple[str, ...] = SCENES, sizes: tuple[str, ...] = SIZES) -> list[Subject]:
    """All frames, the small ones first."""
    return [Subject(scene, size) for size in sizes for scene in scenes]


def frame_arguments(study: str, doc: str | None, argv: Sequence[str] | None) -> argparse.Namespace:
    """The command line of a study of these frames that has no other options than its frames and its output folder.

    Args:
        study: its name.
        doc: the docstring of its module.
        argv: the arguments; None for those of the process.
    """
    parser = command_parser(f"msv2 study run {study}", doc)
    add_subjects(parser)
    parser.add_argument("--out", type=Path, default=REPORTS, metavar="DIR",
                        help="output folder (default: build/reports; --keep: reports)")
    args = parser.parse_args(argv)
    for size in args.size:
        parse_size(size)
    return args


def add_subjects(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments that choose the frames of a study, which `chosen` reads."""
    parser.add_argument("scene", nargs="*", metavar="SCENE",
                        help="'embedded', a model file or a scene of MSV2_DATA (default: all four scenes)")
    parser.add_argument("--size", action="append", default=[], metavar="WxH",
                        help=f"size of the frames; can be repeated (default: {', '.join(SIZES)})")


def chosen(args: argparse.Namespace) -> tuple[list[Subject], list[str]]:
    """The frames that a command line asks for, and the scenes that are not here. A scene that it names is never missing: its
    first use refuses it."""
    scenes = tuple(args.scene) or SCENES
    missing = [] if args.scene else [name for name in scenes if name != EMBEDDED and scene_file(name) is None]
    return subjects(tuple(name for name in scenes if name not in missing), tuple(args.size) or SIZES), missing


def traced(subject: Subject, config: AcceleratorConfig) -> FrameTrace:
    """The trace of a frame on a machine, from the cache where it is there.

    Raises:
        InputError: the scene is missing.
    """
    parse_size(subject.size)
    return trace_request(request(subject.scene, subject.size), config, cache=CACHE)


def frame_row(
    subject: Subject, machine: str, memory: str, trace: FrameTrace, config: AcceleratorConfig, table: Table,
) -> dict[str, object]:
    """The numbers of a frame on a machine with a memory, JSON-ready; energies in mJ, `bytes` by client."""
    frame = simulate(trace, config, memory=MemoryModel(**memory_arguments(memory)), display=True)
    energy = frame_energy(model_counts(trace, frame), frame.total, config, table, clock_hz=CLOCK_HZ)
    return {
        "frame": subject.name, "scene": subject.scene, "size": subject.size, "machine": machine, "memory": memory,
        "cycles": frame.total, "phases": frame.phases, "bytes": moved(frame), "total_bytes": total_bytes(frame),
        "activates": frame.activates, "refreshes": frame.refreshes, "points": trace.points, "points_read": trace.points_read,
        "chunks": chunks(trace), "chunks_read": chunks_read(trace), "survivors": sum(len(eye.survivor) for eye in trace.eyes),
        "entries": frame.entries,
        "energy_mj": {"chip": energy.chip_mj, "dram": energy.sum_mj("dram"), "dram_by_use": energy.by_dram()}}


def moved(frame: FrameCycles) -> dict[str, dict[str, int]]:
    """The bytes of a frame, read and written, by client."""
    return {"read": frame.reads, "write": frame.writes}


def total_bytes(frame: FrameCycles) -> int:
    """All bytes of a frame."""
    return sum(frame.reads.values()) + sum(frame.writes.values())


def chunks(trace: FrameTrace) -> int | None:
    """The number of chunks of a frame's model; None on machines without chunks."""
    return len(trace.eyes[0].chunk_count) if trace.chunked else None


def chunks_read(trace: FrameTrace) -> int | None:
    """How many of them the machine reads."""
    return int(trace.eyes[0].chunk_read.sum()) if trace.chunked else None
