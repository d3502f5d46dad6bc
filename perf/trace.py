"""The properties of a golden frame on which the machine's timing depends: sizes, counts, orders and places in memory, but no
pixels and no splats.

A `FrameTrace` stands for one frame of one or two eyes, and an `EyeTrace` for the pass of one eye. A trace depends on the scene,
the camera, the formats and the other fields of the configuration that `trace_key` names. It does not depend on merging,
handover, lanes or memory, which `perf.model` takes into account.
"""

from __future__ import annotations

import argparse
import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from golden.kernels import work_clock
from golden.msv2_ref import pipeline, projection
from golden.msv2_ref.eyes import StereoFrame, render_request
from golden.msv2_ref.warp import FILLED
from golden.scenes.files import atomic_output
from golden.scenes.request import Request, resolve
from perf import geometry
from perf.runs import tile_runs
from perf.stops import stop_entries
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.effects import with_two_eyes
from spec.sources import fingerprint, sources_of

VERSION = 2
"""Version of the trace files; files of other versions are made again."""


@dataclass(frozen=True, eq=False)
class EyeTrace:
    """The pass of one eye.

    Attributes:
        point_class: (points + 1,) uint8 of the classes in `perf.geometry`, in order; the frame's end counts as VISIBLE.
        splat_steps: (projected + 1,) int32, the groups of sixteen tiles that each projected splat's box covers, row by row.
        step_runs: (steps,) uint8, the runs of tiles of one kind in each of these groups.
        run_entries: (runs,) uint8, the intersections of each run; run_closes: NOT_LAST, CLOSES or ENDS.
        survivor: (survivors,) int32 index of each splat with an intersection; views: its levels, a bit each.
        tile: (intersections,) int32 the tile of each intersection, in the order in which the tile test gives them.
        counts: (tiles,) int32 the intersections of each tile.
        rendered: (tiles,) bool. blend: (tiles,) bool. level: (tiles,) uint8.
        splat: (intersections,) int32 in rendering order; use: uint8 as in `Intersections`.
        rank: (intersections,) int32, in rendering order: the place in the tile's list in memory.
        stop: (tiles, 2) int32, the intersections after which all pixels of a level bank have stopped; -1 where some never stop.
        filtered: (1,) the number of (splat, tile) pairs that the tile test dropped.
        chunk_count: (chunks,) uint8, the Gaussians of each chunk of the model; empty where the model has no chunks.
        chunk_read: (chunks,) bool, whether the chunk test lets the chunk be read.
    """

    point_class: np.ndarray
    splat_steps: np.ndarray
    step_runs: np.ndarray
    run_entries: np.ndarray
    run_closes: np.ndarray
    survivor: np.ndarray
    views: np.ndarray
    tile: np.ndarray
    counts: np.ndarray
    rendered: np.ndarray
    blend: np.ndarray
    level: np.ndarray
    splat: np.ndarray
    use: np.ndarray
    rank: np.ndarray
    stop: np.ndarray
    filtered: np.ndarray
    chunk_count: np.ndarray
    chunk_read: np.ndarray


@dataclass(frozen=True)
class FrameTrace:
    """The trace of a frame.

    Attributes:
        width, height: the frame's size in pixels.
        points, sh_degree, view_shift: properties of the model and the frame.
        eyes: one pass or two.
        holes: (height, width) uint8, 1 for pixels of the target eye that the warp unit fills; empty for frames of one eye.
        golden_seconds: the time that rendering and tracing took when the trace was made.
        record: the request as JSON-ready values.
        source_right: for a frame of two eyes, whether the right eye is the source, which is rendered as a whole.
        chunked: whether the frame is of a machine that reads its model in chunks.
    """

    width: int
    height: int
    points: int
    sh_degree: int
    view_shift: int
    eyes: tuple[EyeTrace, ...]
    holes: np.ndarray
    golden_seconds: float
    record: dict[str, object]
    source_right: bool = False
    chunked: bool = False

    @property
    def tiles_x(self) -> int:
        return -(-self.width // TILE)

    @property
    def tiles_y(self) -> int:
        return -(-self.height // TILE)

    @property
    def points_read(self) -> int:
        """The number of Gaussians whose geometry is read, in the passes of all eyes."""
        if not self.chunked:
            return self.points * len(self.eyes)
        return sum(int(eye.chunk_count[eye.chunk_read].sum(dtype=np.int64)) for eye in self.eyes)

    @property
    def entries(self) -> int:
        return sum(len(eye.splat) for eye in self.eyes)


def eye_trace(frame: pipeline.Frame) -> EyeTrace:
    """The trace of a golden frame of one eye."""
    projected, header, e = frame.projected, frame.registers.header, frame.entries
    tiles = len(header)
    rendered = np.ones(tiles, bool) if frame.rendered is None else np.asarray(frame.rendered, bool)
    reason = projected.reason
    classes = np.full(len(reason) + 1, geometry.VISIBLE, np.uint8)
    classes[:-1][reason != projection.VISIBLE] = geometry.NEAR_CULLED
    classes[:-1][reason == projection.OUTSIDE] = geometry.OUTSIDE
    classes[:-1][reason == projection.UNREAD] = geometry.UNREAD

    counts = np.diff(e.start)
    tile_of = np.repeat(np.arange(tiles, dtype=np.int32), counts)
    arrival = np.argsort(e.splat.astype(np.int64) * tiles + tile_of, kind="stable")  # in the order of splats, then of tiles
    rank = np.empty(len(arrival), np.int32)
    by_tile = np.argsort(tile_of[arrival], kind="stable")  # for each tile, the order of arrival
    rank[arrival[by_tile]] = np.arange(len(arrival)) - np.repeat(e.start[:-1], counts)

    visible = np.flatnonzero(reason == projection.VISIBLE).astype(np.int32)
    kind = header[:, 0] * 4 + header[:, 1] * 2 + rendered
    runs = tile_runs(
        projected.box[visible].astype(np.int64), visible, e.splat[arrival], tile_of[arrival], kind.astype(np.int64),
        frame.registers.tiles_x)
    survivor = np.flatnonzero(np.bincount(e.splat, minlength=len(reason)))  # far faster than np.unique
    mask = np.zeros(len(reason), np.uint8)
    np.bitwise_or.at(mask, e.splat, (1 << header[tile_of, 0]).astype(np.uint8))
    return EyeTrace(
        classes, *runs, survivor.astype(np.int32), mask[survivor], tile_of[arrival], counts.astype(np.int32), rendered,
        header[:, 1] != 0, header[:, 0].astype(np.uint8), e.splat.astype(np.int32), e.use, rank, stop_entries(frame),
        np.array([e.filtered]), *_chunks(frame))


def _chunks(frame: pipeline.Frame) -> tuple[np.ndarray, np.ndarray]:
    """`chunk_count` and `chunk_read` of a frame's trace."""
    chunks = frame.words.chunks
    if chunks is None:
        return np.zeros(0, np.uint8), np.zeros(0, bool)
    read = chunks["count"] > 0
    read[read] = frame.projected.reason[chunks["first"][read]] != projection.UNREAD
    return chunks["count"].astype(np.uint8), read


def trace_of(
    frame: pipeline.Frame | StereoFrame, *, seconds: float = 0.0, record: Mapping[str, object] | None = None,
) -> FrameTrace:
    """The trace of a golden frame."""
    eyes = [frame.source, frame.target] if isinstance(frame, StereoFrame) else [frame]
    source = eyes[0]
    r, begin = source.registers, work_clock()
    traces = tuple(eye_trace(eye) for eye in eyes)
    shift = max(int(eye.registers.header[:, 0].max()).bit_length() for eye in eyes)
    holes, right = np.zeros((0, 0), np.uint8), False
    if isinstance(frame, StereoFrame):
        holes, right = (frame.warped.origin == FILLED).astype(np.uint8), bool(frame.registers.source_right)
    return FrameTrace(
        r.width, r.height, len(source.words.geometry), source.words.sh_degree, shift, traces, holes,
        seconds + work_clock() - begin, dict(record or {}), right, source.words.chunks is not None)


def trace_request(
    args: argparse.Namespace, config: AcceleratorConfig, *, cache: Path | None = None, request: Request | None = None,
    render: Callable[[], pipeline.Frame | StereoFrame] | None = None,
) -> FrameTrace:
    """The trace of the frame that a command line requests (`golden.scenes.request`, `golden.msv2_ref.eyes`).

    Args:
        args: the parsed arguments; for two eyes, after `take_stereo_arguments`.
        config: the configuration of the machine as it is built. Units that the frame does not need are not removed here.
        cache: the folder in which traces are kept; None to keep none.
        request: the resolved arguments, if they are known already.
        render: a function that makes the frame if it is not kept, from the arguments and the machine alone; None to render the
            request as it is, without a plan of effects.

    Raises:
        InputError: see `resolve`.
    """
    kept = cache / f"{trace_key(args, config)}.npz" if cache else None
    found = load_trace(kept) if kept and kept.is_file() else None
    if found:
        return found
    begin = work_clock()
    request = request or resolve(args)
    if render is not None:
        golden = render()
    elif getattr(args, "stereo", False):
        golden = render_request(args, request, with_two_eyes(config))
    else:
        golden = pipeline.render(
            request.model, request.camera, config=config, foveation=request.foveation, background=request.background)
    trace = trace_of(golden, seconds=work_clock() - begin, record=request.record)
    if kept:
        save_trace(trace, kept)
    return trace


_REQUEST = ("scene", "camera", "size", "gaze", "levels", "levels_from", "background", "seed", "stereo", "ecc_thresh", "ipd",
            "units_per_metre", "source", "gaze_target", "effects", "depth", "machine", "pixels", "lod",
            "orbit", "fov", "up", "look_at")


def trace_key(args: argparse.Namespace, config: AcceleratorConfig) -> str:
    """The file name of a trace: a hash of the request, of the scene's and camera's files, and of the configuration's fields."""
    asked = {name: str(getattr(args, name, None)) for name in _REQUEST}
    files = [(str(path), path.stat().st_size, path.stat().st_mtime_ns)
             for path in (Path(asked["scene"]), Path(asked["camera"])) if path.exists()]
    machine = (config.formats, config.levels, config.blend, config.sh_degree, config.depth, config.fine_depth,
               config.support_sigma, config.row_width, config.warp_columns, config.warp_fill, config.warp_veiled,
               config.order, config.chunks, config.records, config.lists)
    return fingerprint(sources_of("perf.trace"), VERSION, asked, files, machine)


def save_trace(trace: FrameTrace, path: Path) -> None:
    """Saves the trace as a compressed npz file, which is written completely or not at all."""
    scalars = {f.name: getattr(trace, f.name) for f in fields(trace) if f.name not in ("eyes", "holes")}
    arrays = {f"{f.name}_{i}": getattr(eye, f.name) for i, eye in enumerate(trace.eyes) for f in fields(eye)}
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_output(path) as file:
        np.savez_compressed(file, version=VERSION, scalars=json.dumps(scalars, default=float), holes=trace.holes, **arrays)


def load_trace(path: Path) -> FrameTrace | None:
    """The trace that `save_trace` wrote; None for files of other versions and for broken files."""
    try:
        with np.load(path) as file:
            if int(file["version"]) != VERSION:
                return None
            scalars, count = json.loads(str(file["scalars"])), 1 + ("splat_1" in file)
            eyes = tuple(EyeTrace(**{f.name: file[f"{f.name}_{i}"] for f in fields(EyeTrace)}) for i in range(count))
            return FrameTrace(**scalars, eyes=eyes, holes=file["holes"])
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return None
