"""The properties of a golden frame on which the timing of a machine with lists by super-tile depends (`spec.supertiles`).

A `SuperTrace` depends on the scene, the camera, the formats and the bounds of no frame: where a pair's list lies, and how
pairs are merged, sorted and dealt, is found by `perf.supertiles_plan` for a machine and the bounds that it has.
"""

from __future__ import annotations

import argparse
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from golden.kernels import work_clock
from golden.msv2_ref import pipeline, projection, tile_test
from golden.msv2_ref.frame_memory import display_pixels
from golden.msv2_ref.frame_packing import display_bytes, pack_frame
from golden.msv2_ref.ranges import range_of
from golden.msv2_ref.supertiles import chunk_order
from golden.scenes.files import atomic_output
from golden.scenes.request import Request, resolve
from perf import geometry
from perf.stops import stop_entries
from perf.trace import trace_key
from spec.chunks import PLACE_BITS
from spec.config import AcceleratorConfig
from spec.constants import SUPER_TILES, SUPER_X, SUPER_Y, TILE
from spec.effects import with_two_eyes
from spec.joint import grid_origins, joint_columns
from spec.queues import LEVEL_GROUP
from spec.sources import fingerprint, sources_of

VERSION = 6
"""Version of the trace files; files of other versions are made again."""


@dataclass(frozen=True, eq=False)
class SuperTrace:
    """The trace of a frame.

    A pair's number is its place in rendering order: by super-tile, depth key and index. A *step* is SUPER_Y rows of a splat's
    box, from its first one on: the tile test takes the box of a splat step by step. Gaussians and splats are in the order in
    which the first phase reads their chunks.

    Attributes:
        width, height: the frame's size in pixels.
        points, sh_degree: properties of the model.
        point_class: (read points + 1,) uint8 of the classes in `perf.geometry`, in order; the frame's end counts as VISIBLE.
        chunk_count: (chunks,) uint8, in their order in memory, the Gaussians of each chunk. chunk_read: (chunks,) bool, whether
            it passes its test.
        splat_steps: (projected + 1,) int32, the steps of each projected splat, and 1 for the frame's end.
        step_groups: (steps,) uint8, the groups of LEVEL_GROUP columns in which the splat touches tiles of the step, at least 1.
        step_pairs: (steps,) uint8, the pairs of each step: they leave with the last row of their super-tile or of the box.
            step_closes: (steps,) uint8, kinds as those of runs in `perf.geometry`.
        arrival: (pairs,) int32, the numbers of the pairs in the order in which the first phase emits them.
        start: (super-tiles + 1,) int64, first pair of each super-tile.
        key: (pairs,) int64, the depth key. splat: (pairs,) int32, the Gaussian's place in memory. chunk: (pairs,) int32, its
            chunk. places: (pairs,) uint8, its levels.
        counts: (tiles,) int32 the intersections of each tile. blend: (tiles,) bool.
        pair: (intersections,) int32, by tile, in rendering order: the number of the pair. use: uint8 as in `Intersections`.
        regions: (intersections,) uint8, the streams that have it, one bit each.
        stop: (streams, tiles, 2) int32, the stream's intersections after which all pixels of a level bank have stopped; -1
            where some never stop.
        blocks: (blocks,) uint8, the beats of each block of the packed frame (`spec.packed`), by number; in joint frames the
            second eye's follow.
        survivors: the number of splats with a pair. filtered: that of intersections that the foveation filter dropped.
        record: the request as JSON-ready values. golden_seconds: the CPU time that rendering and tracing took.
        eyes: 2 in joint frames (`spec.joint`), whose tiles are those of the source and then those of the target. All properties
            of Gaussians stand twice then, for both eyes in turn: `perf.joint_trace` says what steps and classes mean.
        shift: the distance of the eyes' grids in tiles.
        places_by_eye: (pairs, eyes) uint8, the levels of each pair in each eye. pair_drops: uint8, of all pairs that the steps
            give, in turn, whether it is dropped because the source has it, too. None in frames of one eye.
        tile_sweep: (tiles,) int8, for the second phase of frames with a warped target the sweep that renders each tile, or -1;
            None: all tiles are rendered in one sweep (`perf.warp_trace`).
    """

    width: int
    height: int
    points: int
    sh_degree: int
    point_class: np.ndarray
    chunk_count: np.ndarray
    chunk_read: np.ndarray
    splat_steps: np.ndarray
    step_groups: np.ndarray
    step_pairs: np.ndarray
    step_closes: np.ndarray
    arrival: np.ndarray
    start: np.ndarray
    key: np.ndarray
    splat: np.ndarray
    chunk: np.ndarray
    places: np.ndarray
    counts: np.ndarray
    blend: np.ndarray
    pair: np.ndarray
    use: np.ndarray
    regions: np.ndarray
    stop: np.ndarray
    blocks: np.ndarray
    survivors: int
    filtered: int
    record: dict[str, object]
    golden_seconds: float = 0.0
    eyes: int = 1
    shift: int = 0
    places_by_eye: np.ndarray | None = None
    pair_drops: np.ndarray | None = None
    tile_sweep: np.ndarray | None = None

    @property
    def tiles_x(self) -> int:
        return -(-self.width // TILE)

    @property
    def tiles_y(self) -> int:
        return -(-self.height // TILE)

    @property
    def eye_tiles(self) -> int:
        """The number of tiles of one eye."""
        return self.tiles_x * self.tiles_y

    @property
    def eye_places(self) -> np.ndarray:
        """(pairs, eyes), the places of each pair for each eye."""
        return self.places[:, None] if self.places_by_eye is None else self.places_by_eye

    @property
    def grid(self) -> tuple[np.ndarray, np.ndarray]:
        """(eyes * tiles,) int64 each: the super-tile of each tile, and its place among the tiles of all eyes in it."""
        eye, tile = np.divmod(np.arange(self.eyes * self.eye_tiles), self.eye_tiles)
        y, x = np.divmod(tile, self.tiles_x)
        x += np.array(grid_origins(self.shift))[eye]
        columns = joint_columns(self.tiles_x, self.shift)
        return y // SUPER_Y * columns + x // SUPER_X, eye * SUPER_TILES + y % SUPER_Y * SUPER_X + x % SUPER_X

    @property
    def supertiles(self) -> int:
        """The number of super-tiles."""
        return len(self.start) - 1

    @property
    def pairs(self) -> int:
        """The number of pairs."""
        return len(self.splat)

    @property
    def points_read(self) -> int:
        """The number of Gaussians whose geometry is read."""
        return int(self.chunk_count[self.chunk_read].sum(dtype=np.int64))

    @property
    def entries(self) -> int:
        """The number of intersections."""
        return len(self.pair)

    @property
    def streams(self) -> int:
        """The number of streams."""
        return len(self.stop)

    @property
    def supertile(self) -> np.ndarray:
        """(pairs,) int64, the super-tile of each pair."""
        return range_of(self.start)


def super_trace(
    frame: pipeline.Frame, record: dict[str, object] | None = None, seconds: float = 0.0, stop: np.ndarray | None = None,
) -> SuperTrace:
    """The trace of a golden frame; `seconds` is the CPU time that rendering it took, to which this function adds its own.
    `stop` is the trace's field where it is known.

    Raises:
        ValueError: the frame is of a machine without super-tiles.
    """
    begin, pairs, chunks = work_clock(), frame.pairs, frame.words.chunks
    if pairs is None or chunks is None:
        raise ValueError(f"frame must be of a machine with super-tiles, not {frame.config.name!r}")
    r, e, reason = frame.registers, frame.entries, frame.projected.reason
    count = chunks["count"].astype(np.uint8)
    read = count > 0
    read[read] = reason[chunks["first"][read]] != projection.UNREAD
    turn = chunk_turns(count)
    order = np.argsort(turn)
    arrival = np.lexsort((pairs.supertile, turn[pairs.splat]))
    classes = np.full(len(reason), geometry.VISIBLE, np.uint8)
    classes[reason != projection.VISIBLE] = geometry.NEAR_CULLED
    classes[reason == projection.OUTSIDE] = geometry.OUTSIDE
    return SuperTrace(
        r.width, r.height, len(frame.words.geometry), frame.words.sh_degree,
        np.append(classes[order][reason[order] != projection.UNREAD], geometry.VISIBLE).astype(np.uint8), count, read,
        *_steps(frame, order), arrival.astype(np.int32), pairs.start,
        pairs.depth_key.astype(np.int64), pairs.splat.astype(np.int32), (pairs.index >> PLACE_BITS).astype(np.int32),
        np.unpackbits(pairs.levels[:, None], axis=1).sum(1).astype(np.uint8), np.diff(e.start).astype(np.int32),
        r.header[:, 1] != 0, pairs.intersection.astype(np.int32), e.use,
        np.ones(len(e.use), np.uint8) if frame.regions is None else frame.regions,
        np.stack([stop_entries(frame, q) for q in range(frame.config.streams)]) if stop is None else stop,
        block_sizes(frame), len(np.unique(pairs.splat)),
        int(e.filtered), dict(record or {}), seconds + work_clock() - begin)


def block_sizes(frame: pipeline.Frame) -> np.ndarray:
    """(blocks,) uint8, the beats of each block of the packed frame."""
    return pack_frame(display_bytes(display_pixels(frame))).sizes.astype(np.uint8)


def chunk_turns(count: np.ndarray) -> np.ndarray:
    """(N,) int64, the place of each Gaussian in the order in which the first phase would read all of them, from the numbers of
    Gaussians of the chunks."""
    order, count = chunk_order(len(count)), count.astype(np.int64)
    begin = np.empty(len(count), np.int64)
    begin[order] = np.cumsum(count[order]) - count[order]
    return np.arange(count.sum()) + np.repeat(begin - (np.cumsum(count) - count), count)


def _steps(frame: pipeline.Frame, order: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """`splat_steps`, `step_groups`, `step_pairs` and `step_closes` of a frame's trace, followed by the end of the frame.

    Args:
        frame: the frame.
        order: (N,) the Gaussians in the order in which they are read.
    """
    pairs, tiles_x = frame.pairs, frame.registers.tiles_x
    visible = order[frame.projected.reason[order] == projection.VISIBLE]
    first, last = frame.projected.box[:, 2].astype(np.int64), frame.projected.box[:, 3].astype(np.int64)
    steps = (last[visible] - first[visible]) // SUPER_Y + 1
    begin, total = np.full(len(order), -1, np.int64), int(steps.sum())
    begin[visible] = np.cumsum(steps) - steps
    ends = np.minimum(pairs.supertile // -(-tiles_x // SUPER_X) * SUPER_Y + SUPER_Y - 1, last[pairs.splat])
    step_pairs = np.bincount(begin[pairs.splat] + (ends - first[pairs.splat]) // SUPER_Y, minlength=total).astype(np.uint8)
    low, high = np.full(total, tiles_x), np.full(total, -1)
    touched = touched_intersections(frame)
    row, column = np.divmod(range_of(touched.start), tiles_x)
    step = begin[touched.splat] + (row - first[touched.splat]) // SUPER_Y
    np.minimum.at(low, step, column // LEVEL_GROUP)
    np.maximum.at(high, step, column // LEVEL_GROUP)
    return step_arrays(steps, high - low + 1, step_pairs)


def step_arrays(
    steps: np.ndarray, groups: np.ndarray, pairs: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """`splat_steps`, `step_groups`, `step_pairs` and `step_closes` of a trace, followed by the end of the frame.

    Args:
        steps: (splats,) the steps of each splat, which follow each other.
        groups: (steps,) the groups of columns that each step looks at; at least one counts.
        pairs: (steps,) uint8, the pairs that each step gives.
    """
    closes = np.full(len(groups) + 1, geometry.NOT_LAST, np.uint8)
    closes[np.cumsum(steps) - 1], closes[-1] = geometry.CLOSES, geometry.ENDS
    return (np.append(steps, 1).astype(np.int32), np.append(np.maximum(groups, 1), 1).astype(np.uint8), np.append(pairs, 0),
            closes)


def touched_intersections(frame: pipeline.Frame) -> tile_test.Intersections:
    """The intersections of a frame before the foveation filter."""
    words = frame.words
    everywhere = replace(frame.registers, header=np.zeros_like(frame.registers.header))
    tested = tile_test.tested_opacity(frame.config, words.geometry["log2_opacity"], words.decoded.opacity)
    visible = np.flatnonzero(frame.projected.reason == projection.VISIBLE).astype(np.int32)
    return tile_test.tile_intersections(
        frame.config, frame.projected, tested, words.geometry["bound"], everywhere, visible)


def trace_request(
    args: argparse.Namespace, config: AcceleratorConfig, *, cache: Path | None = None, request: Request | None = None,
    render: Callable[[], pipeline.Frame] | None = None,
) -> SuperTrace:
    """The trace of the frame that a command line requests.

    Args:
        args: the parsed arguments.
        config: the machine.
        cache: the folder in which traces are kept; None to keep none.
        request: the resolved arguments, if they are known already.
        render: a function that makes the frame if it is not kept; None to render the request as it is.

    Raises:
        InputError: two eyes are asked for; or see `resolve`.
    """
    if getattr(args, "stereo", False):
        with_two_eyes(config)  # raises
    key = fingerprint(sources_of("perf.supertiles_trace"), VERSION, trace_key(args, config), config.streams)
    kept = cache / f"{key}.npz" if cache else None
    found = load_trace(kept) if kept and kept.is_file() else None
    if found:
        return found
    begin = work_clock()
    request = request or resolve(args)
    golden = render() if render is not None else pipeline.render(
        request.model, request.camera, config=config, foveation=request.foveation, background=request.background)
    trace = super_trace(golden, request.record, work_clock() - begin)
    if kept:
        save_trace(trace, kept)
    return trace


def save_trace(trace: SuperTrace, path: Path) -> None:
    """Saves the trace as a compressed npz file, which is written completely or not at all."""
    values = {f.name: getattr(trace, f.name) for f in fields(trace)}
    arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    scalars = {name: value for name, value in values.items() if name not in arrays}
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_output(path) as file:
        np.savez_compressed(file, scalars=json.dumps(scalars, default=float), **arrays)


def load_trace(path: Path) -> SuperTrace | None:
    """The trace that `save_trace` wrote; None for broken files."""
    try:
        with np.load(path) as file:
            arrays = {f.name: file[f.name] for f in fields(SuperTrace) if f.name in file}
            return SuperTrace(**json.loads(str(file["scalars"])), **arrays)
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
        return None
