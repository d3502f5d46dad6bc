"""The cycles of a frame on a machine with lists by super-tile (`spec.supertiles`): simulates its phases on a memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from golden.host.run_options import LPDDR3
from golden.kernels import work_clock
from golden.msv2_ref.buckets import Bounds
from perf import (
    bus,
    chunk_units,
    chunks,
    constants,
    datapath,
    geometry,
    supertiles_bin,
    supertiles_gather,
    supertiles_render,
)
from perf.model import FrameCycles, MemoryModel, Stage, set_warp
from perf.phases import LIMIT, LastingMemory, counts_of, dram_commands, finished, table_cycles
from perf.supertiles_gather import SUPERTILE_BEATS
from perf.supertiles_plan import SuperPlan, steady_bounds, super_plan
from perf.supertiles_trace import SuperTrace
from perf.warp_trace import WarpedTrace, strip_fills
from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES, TILE
from spec.memory import BEAT_BYTES, BEAT_ENTRIES, DISPLAY_PIXEL_BYTES, PIXEL_BYTES, colour_beats
from spec.packed import BLOCKS, table_beat
from spec.queues import LIST_POINTERS, OUTPUT_DRAINS, TILE_TEST_BESIDE, read_depths
from spec.records import COUNT_BITS, frame_lists, frame_supertiles
from spec.registers import STEREO_WRITE_CLIENTS, WRITE_CLIENTS, read_clients, stages, write_clients
from spec.supertiles import check_supertiles, frame_rows

READ_AHEAD = 2
"""Records of a stream that have been read, or are being read, before the array takes them."""

BATCHES = 2
"""Batches in the batch buffer: one is filled while the other is dealt."""

PACKED = 2
"""The number of the format of packed frames, behind those of `display`."""

_TMU_LATENCY = 9  # cycles from the frame's last pair to the first group (rtl.sort_tmu.tile_merge)

BIN_STAGES = ("geometry", "projection", "tile_test", "entry_write")
RENDER_STAGES = (
    "list_read", "sort", "handover", "fetch", "projection", "tile_test", "colour", "batch", "array", "pixel_write", "warp")


@dataclass(frozen=True)
class SuperCycles(FrameCycles):
    """The cycles of a frame on a machine with lists by super-tile. `fetch_misses` are those of chunk headers.

    Attributes:
        pairs, batches, visits: counted events.
        again: the pairs that the second sweep of a frame with a warped target reads. sweep_cycles: its cycles.
        lists: the number of lists. overflow: the pairs in lists that the sorter cannot hold at once.
    """

    pairs: int = 0
    batches: int = 0
    visits: int = 0
    again: int = 0
    sweep_cycles: int = 0
    lists: int = 0
    overflow: int = 0

    @property
    def overflow_share(self) -> float:
        """The share of pairs in lists that the sorter cannot hold at once."""
        return self.overflow / max(1, self.pairs)


@dataclass
class _Pass:
    """The results of a phase."""

    cycles: int
    stages: dict[str, np.ndarray]
    reads: np.ndarray
    writes: np.ndarray
    commands: dict[str, int]


def simulate_supertiles(
    trace: SuperTrace | WarpedTrace, config: AcceleratorConfig, *, memory: MemoryModel | LastingMemory | None = None,
    merge: bool = True, pipeline: bool | None = None, beta: int | None = None, display: bool = False, packed: bool = False,
    bounds: Bounds | None = None, shared_colour: bool = False,
) -> SuperCycles:
    """Simulates a frame.

    Args:
        trace: the trace of the golden frame, or of a joint frame with a warped target, which has display pixels.
        config: the machine's configuration.
        memory: the memory; None for four channels of LPDDR3-1600, the paper's. A `LastingMemory` goes on as the frame before
            left it; any other was reset when the frame starts.
        merge: whether lists are merged.
        pipeline: whether stages hand over incrementally; None for the configuration's value.
        beta: the merge threshold in pairs; None for the automatic one. It has no effect without `merge`.
        display: whether a pixel takes 4 bytes in memory instead of 16.
        packed: whether the frame is packed instead (`spec.packed`).
        bounds: the bounds that the frame before left; None for those of a camera that stands still.
        shared_colour: whether the colours of a pair are computed once for both eyes of a joint frame.

    Raises:
        ValueError: the machine has no super-tiles, a lower SH degree than the frame, packs no frames, or has no warp unit.
    """
    check_supertiles(config)
    warped = trace if isinstance(trace, WarpedTrace) else None
    if warped is not None:
        trace, display = warped.joint, True
        if packed or not config.warps_joint:
            raise ValueError(f"config must be a machine whose joint frames may have a warped eye, not {config.name!r}")
    if not isinstance(memory, LastingMemory):
        memory = LastingMemory(memory or MemoryModel(LPDDR3))
    if pipeline is not None:
        config = config.with_(incremental=pipeline)
    check_trace(trace, config, packed)
    beta, begin = beta if merge else 0, work_clock()
    plan = super_plan(trace, config, steady_bounds(trace, config) if bounds is None else bounds, beta, display, packed, warped)
    clear = clear_cycles(trace, config)
    memory.wait(clear)
    table = table_cycles(memory, trace.eye_tiles, plan.where.tiles, read_depths(config))
    if trace.eyes > 1:
        table += table_cycles(memory, trace.eye_tiles, plan.where.target_tiles, read_depths(config))
    binned, counted = _bin(trace, config, memory, plan)
    drawn, events = _render(
        trace, config, memory, PACKED if packed else int(display), shared_colour, plan,
        max(0, counted - 1 + merge_latency(config, beta) - binned.cycles), warped)
    phases = {"clear": clear, "table": table, "geometry": binned.cycles, "render": drawn.cycles}
    total, both = sum(phases.values()), (binned, drawn)
    reads, writes = sum(p.reads for p in both), sum(p.writes for p in both)
    reads[bus.TILES] += trace.eyes * -(-trace.eye_tiles // 4)
    moved = {"reads": _bytes(reads, bus.READER_NAMES, read_clients(config)),
             "writes": _bytes(writes, WRITE_CLIENTS + STEREO_WRITE_CLIENTS, write_clients(config))}
    found = {}
    for name in stages(config):
        busy, blocked = (int(sum(p.stages[name][i] for p in both if name in p.stages)) for i in range(2))
        found[name] = Stage(busy, blocked, total - busy - blocked)
    at = phases["clear"] + table
    timeline = [("geometry", 0, -1, at, at + binned.cycles), ("render", 0, -1, at + binned.cycles, total)]
    commands = {name: binned.commands[name] + drawn.commands[name] for name in binned.commands}
    entries = trace.entries if warped is None else warped.drawn.entries
    utilisation = {"array": max(entries, events["ops"]) / (config.streams * max(1, drawn.cycles)),
                   "memory": sum(sum(m.values()) for m in moved.values()) / (memory.model.peak * total)}
    return SuperCycles(
        total, phases, (dict(phases),), found, **moved, entries=entries, groups=_groups(plan),
        spilled_entries=int(plan.sorting.way_of.size), **events, **commands, utilisation=utilisation, timeline=timeline,
        seconds=work_clock() - begin, pairs=trace.pairs, again=0 if warped is None else int(warped.second.sum()),
        batches=len(plan.visits.batch_supertile), lists=len(plan.lists.counts),
        overflow=plan.lists.overflow(config.sort_chunk))


def _groups(plan: SuperPlan) -> int:
    """The groups of a frame; in the second sweep over lists, those without pairs are none."""
    first = len(plan.lists.counts)
    return int(plan.sorting.groups[first - 1]) + 1 + int((plan.read.counts[first:] > 0).sum())


def check_trace(trace: SuperTrace, config: AcceleratorConfig, packed: bool) -> None:
    """Raises ValueError where the machine has other streams or a lower SH degree than the frame's trace, or cannot pack the
    frame though it should."""
    if trace.streams != config.streams:
        raise ValueError(f"trace must be one of a machine with {config.streams} streams, not {trace.streams!r}")
    if trace.sh_degree > config.sh_degree:
        raise ValueError(f"config must be a machine of SH degree {trace.sh_degree}, not {config.sh_degree!r}")
    if packed and not config.packed:
        raise ValueError(f"config must be a machine that packs frames, not {config.name!r}")


def clear_cycles(trace: SuperTrace, config: AcceleratorConfig) -> int:
    """Cycles before the table of tiles is read, in which joint frames clear the last Gaussian of every list."""
    return 1 + (trace.tiles_y if trace.eyes == 1 else max(trace.tiles_y, frame_supertiles(config.with_(joint=True))))


def merge_latency(config: AcceleratorConfig, beta: int | None) -> int:
    """Cycles from the frame's last pair to the first group, with a merge threshold or, with None, the automatic one."""
    return _TMU_LATENCY + (COUNT_BITS + frame_lists(config).bit_length() + 1 if beta is None else 0)


def _bytes(beats: np.ndarray, names: tuple[str, ...], clients: tuple[str, ...]) -> dict[str, int]:
    """Bytes by client of a machine. For frames alone on a machine whose phases overlap, what its client `first` reads counts as
    that of `tiles` and `chunks`, which read the same in phases in turn."""
    return {name: BEAT_BYTES * int(beats[names.index(name)]) for name in clients if name in names}


def _results(s: np.record, cycles: int, watched: tuple[str, ...]) -> _Pass:
    return _Pass(cycles, counts_of(s, watched), s.reads[: bus.READERS].copy(), s.writes[: bus.WRITERS].copy(),
                 dram_commands(s))


def _bin(trace: SuperTrace, config: AcceleratorConfig, memory: LastingMemory, plan: SuperPlan) -> tuple[_Pass, int]:
    """Simulates the first phase. Returns it with the cycle in which its last pair was in memory."""
    s = memory.begin(supertiles_bin.layout, read_depths(config))
    s.path_shift = memory.age
    cycles = supertiles_bin.bin_phase(s, bin_arguments(s, trace, config, plan), LIMIT)
    return _results(s, memory.end(finished("GEOMETRY", cycles)), BIN_STAGES), int(s.counted)


def bin_arguments(s: np.record, trace: SuperTrace, config: AcceleratorConfig, plan: SuperPlan) -> tuple[np.ndarray | int, ...]:
    """Initialises a state of the first phase. Returns the arguments of `bin_phase` between the state and the limit."""
    paths = _set_paths(s, config)
    arrays = chunk_units.prepare(s, trace.chunk_count, trace.chunk_read, config, paths, trace.eyes)
    s.two_eyes, s.points_left = trace.eyes - 1, len(trace.point_class) // trace.eyes
    s.list_count = len(plan.lists.counts)
    writes, where = plan.lists.writes, plan.where
    classes = trace.point_class
    drops = np.zeros(trace.pairs + 1, np.uint8) if trace.pair_drops is None else trace.pair_drops
    return (classes, classes[classes != geometry.NEAR_CULLED], trace.splat_steps, trace.step_groups, trace.step_pairs,
            trace.step_closes, drops, plan.lists.pair_writes,
            np.where(writes < 0, where.directory - 1 - writes, where.entries + writes), plan.lists.flushed, where.chunks,
            where.geometry, *arrays)


def _set_paths(s: np.record, config: AcceleratorConfig) -> constants.Culling:
    """Sets the datapaths that both phases share."""
    paths = constants.culling(config)
    datapath.set_culling(s, paths)
    s.kept_room = paths.ellipse.rows + TILE_TEST_BESIDE
    return paths


def _new_streams(config: AcceleratorConfig) -> np.recarray:
    """The records of the streams, with the sizes and latencies of their arrays (rtl.vrc_array)."""
    expand, blend = (config.array_x - 1).bit_length(), constants.BLEND_LATENCY if config.level_banks == 2 else 0
    streams = np.zeros(config.streams, supertiles_render.stream_layout.dtype).view(np.recarray)
    streams.blocks, streams.cores_y, streams.incremental = config.blocks, config.array_y, config.incremental
    streams.row_latency = expand + constants.ROW_PIPELINE + constants.SUMS_LATER + 2 + blend + 3
    streams.leave_latency = expand + config.array_y + 4
    streams.stop_latency = constants.SETUP_LATENCY + expand + config.array_y + 4
    streams.store_latency = expand + constants.ROW_PIPELINE + constants.SUMS_LATER + config.array_y + 4
    streams.rows_free, streams.row_halves = OUTPUT_DRAINS * config.array_y, 2
    streams.drain_rows = config.array_y if config.incremental else config.region**2 // config.array_x
    streams.banks = config.batch_banks if config.streams > 1 else 0
    return streams


def _set_frame(s: np.record, trace: SuperTrace, config: AcceleratorConfig, pixels: int) -> None:
    """Sets what the pixel writer or the frame packer needs."""
    s.packs, s.pack_blocks, s.pack_eye = pixels == PACKED, len(trace.blocks), BLOCKS * trace.eye_tiles
    s.pack_table = table_beat(trace.width, trace.height)
    s.array_x, s.row_x, s.read_ahead = config.array_x, frame_rows(config).cores_x, READ_AHEAD
    s.width, s.height, s.tiles_x = trace.width, trace.height, trace.tiles_x
    pixel = DISPLAY_PIXEL_BYTES if pixels else PIXEL_BYTES
    s.pixel_words, s.eye_tiles = pixel // 4, trace.eye_tiles
    s.two_eyes, s.super_beats = trace.eyes - 1, trace.eyes * SUPERTILE_BEATS


def _gathered(
    trace: SuperTrace, shared: bool, eyes: np.ndarray, second: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`lit`, `places` and `frees` of `perf.supertiles_gather`, each with an item behind the last. Where both eyes share
    colours, the source's survivor brings the places of both. `eyes` and `second` are those of a `WarpedTrace`; a pair without a
    place has one all the same, which takes none of the batch."""
    places = trace.eye_places.astype(np.int64)
    last = np.zeros(places.shape, bool)
    last[:, -1] = True
    ends = np.where((eyes == 1)[:, None], np.arange(places.shape[1]) == second[:, None] * (places.shape[1] - 1), last)
    items = np.where((eyes == 1)[:, None], ends, True)
    empty = places.sum(axis=1, keepdims=True) == 0
    places = np.where(empty, ends, places)
    if shared:
        firsts = items & (np.cumsum(items, axis=1) == 1)
        lit, places = firsts, places.sum(axis=1, keepdims=True) * np.ones_like(places)
    else:
        lit = places > 0
    frees = lit & (np.cumsum(lit[:, ::-1], axis=1)[:, ::-1] == 1)
    flags = lit * supertiles_gather.LIT + ~ends * supertiles_gather.WAITS
    return (np.append(flags[items], 1).astype(np.uint8), np.append(places[lit], 0), np.append(frees[lit], 1).astype(np.uint8))


def _render(
    trace: SuperTrace, config: AcceleratorConfig, memory: LastingMemory, pixels: int, shared_colour: bool, plan: SuperPlan,
    sweep_from: int, warped: WarpedTrace | None = None,
) -> tuple[_Pass, dict[str, int]]:
    """Simulates the second phase; `pixels` is 0 for whole pixels, 1 for those of displays, or PACKED. Returns it with counted
    events."""
    s = memory.begin(supertiles_render.layout, read_depths(config))
    s.path_shift = memory.age
    streams, *arguments = render_arguments(s, trace, config, pixels, shared_colour, plan, sweep_from, warped)
    cycles = supertiles_render.render_phase(s, streams, tuple(arguments), LIMIT)
    events = drawn_events(s, streams) | {"sweep_cycles": cycles - int(s.again_at) if s.again_open else 0}
    return _results(s, memory.end(finished("RENDER", cycles)), RENDER_STAGES), events


def drawn_events(s: np.record, streams: np.recarray) -> dict[str, int]:
    """The events of a second phase, counted."""
    return {"ops": int(s.ops), "skipped": int(s.skipped), "fetch_misses": int(s.header_misses),
            "visits": int(streams.visits_taken.sum())}


def render_arguments(
    s: np.record, trace: SuperTrace, config: AcceleratorConfig, pixels: int, shared_colour: bool, plan: SuperPlan,
    sweep_from: int, warped: WarpedTrace | None = None,
) -> tuple[Any, ...]:
    """Initialises a state of the second phase. Returns the arguments of `render_phase` between the state and the limit, of
    which the first are the states of the streams."""
    line, sorting, lists, visits, where = (
        config.line_buffer_bytes // ENTRY_BYTES, plan.sorting, plan.read, plan.visits, plan.where)
    shared = trace.eyes > 1 and (shared_colour or not trace.sh_degree)
    strips, more, eyes, second = _warping(s, trace, config, plan, shared_colour and trace.sh_degree, warped)
    trace = trace if warped is None else warped.drawn
    s.line_size, s.line_mask = line, (1 << (line - 1).bit_length()) - 1
    s.tile_count, s.sweep_from = len(lists.counts), sweep_from
    s.pointer_room, s.entries_base, s.directory_base = LIST_POINTERS, where.entries, where.directory
    s.table_base, s.capacity = where.supertiles, config.sort_chunk
    merging, keys = chunks.chunk_stages(config.sort_chunk)
    chunks.begin_stages(merging, sorting.chunk_ends)
    s.incremental, s.ring_runs = config.incremental, sorting.ring_runs if sorting.chunk_spill.any() else 0
    s.spill_base, s.ring_beats = where.spill, sorting.ring_runs * config.sort_chunk // BEAT_ENTRIES
    s.way_room[: config.merge_ways] = 32
    s.frame_base, s.eye_beats, s.rendered_tiles = where.frame, where.target_frame - where.frame, len(visits.drawn)
    _set_paths(s, config)
    _set_frame(s, trace, config, pixels)
    streams = _new_streams(config)
    beats = colour_beats(config, trace.sh_degree)
    s.record_beats = beats
    s.colour_steps = len(constants.colour_steps(config, trace.sh_degree)) if trace.sh_degree else 0
    s.parts, s.batches = BATCHES, len(visits.batch_supertile)
    stop = np.where(trace.stop < 0, 1 << 40, trace.stop.astype(np.int64))
    blend = trace.blend & (config.level_banks == 2)
    tile_times = np.full((2, len(visits.drawn) + 1), -1, np.int64)
    return (
        streams, config.merge_ways, lists.counts, sorting.lasts, lists.ends, lists.page_beat, lists.page_start,
        sorting.group_end, sorting.chunk_length, sorting.chunk_spill, sorting.chunk_last, sorting.chunk_ends, sorting.arrival,
        merging, keys, sorting.part_runs, sorting.job_start, sorting.job_length, sorting.job_entries, sorting.job_out,
        sorting.job_waits, sorting.way_of, sorting.job_begin, sorting.job_goal, np.append(plan.missed, 0),
        where.chunks + trace.chunk, where.colour + trace.splat.astype(np.int64) * beats,
        *_gathered(trace, shared, eyes, second),
        np.append(np.diff(np.concatenate(([0], np.cumsum(eyes, dtype=np.int64)))[trace.start]), 0),
        visits.batch_supertile, visits.batch_places, visits.batch_visit, visits.visit_tile, visits.visit_final,
        visits.visit_entry, visits.visit_seen, visits.use, visits.slot, stop, blend, visits.drawn,
        trace.blocks, np.full((trace.streams, len(trace.counts)), bus.NEVER, np.int64),
        np.zeros((trace.streams, len(trace.counts)), np.int64), tile_times, np.append(eyes, 0),
        np.append(trace.supertile, 0), strips, *more)


def _warping(
    s: np.record, trace: SuperTrace, config: AcceleratorConfig, plan: SuperPlan, shared: bool, warped: WarpedTrace | None,
) -> tuple[np.recarray, tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]:
    """Sets what concerns a warped target (rtl/supertiles/warp_strips.py). Returns the states of both strips, where they fill
    holes and write, for how many eyes each pair is projected, and whether a single one is the target. `shared`: the direction
    of colours is the source's."""
    strips = np.zeros(2, supertiles_render.strip_layout.dtype).view(np.recarray)
    s.by_turns, s.again_lists = config.warps_joint, len(plan.lists.counts)
    if warped is None:
        pairs = trace.pairs
        return strips, (np.zeros((1, 1), np.uint8),) * 2, np.full(pairs, trace.eyes, np.uint8), np.zeros(pairs, bool)
    s.warps, s.warp_base = 1, plan.where.target_frame
    wide, rows = frame_rows(config), np.minimum(TILE, trace.height - TILE * np.arange(trace.tiles_y))
    for odd, a in enumerate(strips):
        height = int(rows[odd::2].sum())
        a.width, a.height, a.tiles_x, a.cores_x, a.cores_y = trace.width, height, trace.tiles_x, wide.cores_x, wide.cores_y
        set_warp(a, wide, -(-height // TILE), warped.source_right)
    eyes = np.where(warped.second, trace.eyes, warped.eyes).astype(np.uint8) if shared else warped.eyes
    fills = strip_fills(warped.fills, 0), strip_fills(warped.fills, 1)
    return strips, fills, eyes, warped.second
