"""The cycles of a frame: simulates the phases of a trace on a machine with a memory."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import lru_cache

import numpy as np

from golden.host.run_options import LPDDR3
from golden.kernels import work_clock
from perf import bus, chunk_units, chunks, constants, datapath, geometry, render, warp
from perf.phases import LIMIT, LastingMemory, MemoryModel, counts_of, dram_commands, finished, table_cycles
from perf.plan import (
    Lists,
    MemoryMap,
    RenderPlan,
    eye_lists,
    group_ends,
    largest_group,
    memory_map,
    render_plan,
    tile_rows,
)
from perf.trace import EyeTrace, FrameTrace
from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES, TILE
from spec.memory import (
    BEAT_BYTES,
    BEAT_ENTRIES,
    DISPLAY_PIXEL_BYTES,
    PIXEL_BYTES,
    colour_beats,
)
from spec.queues import OUTPUT_DRAINS, TILE_TEST_BESIDE, read_depths
from spec.records import COUNT_BITS, frame_lists
from spec.registers import STEREO_WRITE_CLIENTS, WRITE_CLIENTS, read_clients
from spec.stages import StagePhase, watched
from spec.stereo import disparity, reach

GEOMETRY_STAGES = watched(StagePhase.GEOMETRY)
RENDER_STAGES = watched(StagePhase.RENDERING, StagePhase.SECOND_EYE)

_TMU_LATENCY = 9  # cycles from the frame's last intersection to the first group (rtl.sort_tmu.tile_merge)


@dataclass(frozen=True)
class Stage:
    """Cycles of a stage's input in a frame.

    Attributes:
        busy: an item moved.
        blocked: an item was offered and not taken.
        starved: no item was offered.
    """

    busy: int
    blocked: int
    starved: int


@dataclass(frozen=True)
class FrameCycles:
    """The cycles of a frame.

    Attributes:
        total: from start to end, without the clearing that follows a reset.
        phases: the cycles of clear, table, geometry and render; for two eyes, their sums.
        eyes: the same for each eye.
        stages: by the names of `spec.registers.stages`.
        reads, writes: bytes by client.
        entries, groups, ops, skipped, fetch_misses, spilled_entries: counted events of the frame.
        activates, refreshes: commands of the LPDDR3 channels in all phases but TABLE; 0 with other memories. A read or write
            command is one burst, that is, one beat.
        utilisation: for the array, the share of the rendering phase's cycles in which it takes an entry or issues an operation,
            whichever is more; for the memory, the share of `MemoryModel.peak` that is used over the frame.
        timeline: (stage, eye, group, first cycle, last cycle); group -1 stands for a whole phase.
        seconds: the time that the simulation took.
    """

    total: int
    phases: dict[str, int]
    eyes: tuple[dict[str, int], ...]
    stages: dict[str, Stage]
    reads: dict[str, int]
    writes: dict[str, int]
    entries: int
    groups: int
    ops: int
    skipped: int
    fetch_misses: int
    spilled_entries: int
    activates: int
    refreshes: int
    utilisation: dict[str, float]
    timeline: list[tuple[str, int, int, int, int]] = field(repr=False)
    seconds: float = 0.0

    @property
    def dram_bytes(self) -> dict[str, object]:
        """The bytes read and written, in the form of frame.json of tb.frame."""
        sums = {"read": sum(self.reads.values()), "write": sum(self.writes.values())}
        return {**sums, "reads": self.reads, "writes": self.writes}

    def as_json(self) -> dict[str, object]:
        """The values in JSON-ready form, without the timeline."""
        out = asdict(self) | {"dram_bytes": self.dram_bytes}
        return {name: value for name, value in out.items() if name not in ("timeline", "reads", "writes")}


@dataclass
class _Pass:
    """The results of one eye's pass."""

    cycles: dict[str, int]
    stages: dict[str, np.ndarray]
    reads: np.record
    writes: np.record
    events: dict[str, int]
    timeline: list[tuple[str, int, int, int]]


def simulate(
    trace: FrameTrace, config: AcceleratorConfig, *, memory: MemoryModel | LastingMemory | None = None, merge: bool = True,
    pipeline: bool | None = None, beta: int | None = None, display: bool | None = None,
) -> FrameCycles:
    """Simulates a frame.

    Args:
        trace: the trace of the golden frame.
        config: the machine's configuration.
        memory: the memory; None for four channels of LPDDR3-1600, the paper's. A `LastingMemory` goes on as the frame before
            left it; any other was reset when the frame starts.
        merge: whether tiles are merged.
        pipeline: whether stages hand over incrementally; None for the configuration's value.
        beta: the merge threshold in intersections; None for the automatic one. It has no effect without `merge`.
        display: whether a pixel takes 4 bytes in memory instead of 16; None for frames of two eyes only, which need it.

    Raises:
        ValueError: the frame has two eyes, and the machine has no stereo or `display` is False; or the frame needs a higher SH
            degree than the machine has; or only one of them has chunks; or the machine's lists belong to super-tiles, which
            `perf.supertiles` simulates.
    """
    if config.supertiles:
        raise ValueError(f"config must be a machine with lists by tile, like the trace, not {config.name!r}")
    if not isinstance(memory, LastingMemory):
        memory = LastingMemory(memory or MemoryModel(LPDDR3))
    if pipeline is not None:
        config = config.with_(incremental=pipeline)
    two = len(trace.eyes) > 1
    if two and not config.stereo:
        raise ValueError(f"config must be a machine with stereo, not {config.name!r}")
    if two and display is False:
        raise ValueError(f"display must be True in a frame of two eyes, not {display!r}")
    if config.chunks != trace.chunked:
        raise ValueError(f"config must be a machine {'with' if trace.chunked else 'without'} chunks, like the trace, "
                         f"not {config.name!r}")
    if trace.sh_degree > config.sh_degree:
        raise ValueError(f"config must be a machine of SH degree {trace.sh_degree}, not {config.sh_degree!r}")
    display, beta, begin = bool(two or display), (beta if merge else 0), work_clock()
    written = [_lists(eye) for eye in trace.eyes]
    largest = largest_group(trace, config, beta)
    plans = [render_plan(trace, eye, config, beta, largest) for eye in trace.eyes]
    where = memory_map(trace, config, display, max(w.beats for w in written), plans[0].spill_beats)
    passes = []
    for number, (eye, made, plan) in enumerate(zip(trace.eyes, written, plans, strict=True)):
        passes.append(_eye(trace, eye, number, config, memory, beta, display, made, plan, where))
    return _together(trace, config, memory, passes, plans, work_clock() - begin)


_lists = lru_cache(maxsize=4)(eye_lists)  # because a trace is often simulated on several machines in a row


def _eye(
    trace: FrameTrace, eye: EyeTrace, number: int, config: AcceleratorConfig, memory: LastingMemory, beta: int | None,
    display: bool, written: Lists, plan: RenderPlan, where: MemoryMap,
) -> _Pass:
    """Simulates an eye's pass, phase after phase."""
    memory.wait(trace.tiles_y + 1)
    table = table_cycles(memory, len(eye.counts), where.target_tiles if number else where.tiles, read_depths(config))
    shapes, counted = _geometry(trace, eye, config, memory, written, where)
    latency = _TMU_LATENCY + (COUNT_BITS + frame_lists(config).bit_length() + 1 if beta is None else 0)
    drawn = _render(trace, eye, number, config, memory, display, written, plan, where,
                    max(0, counted - 1 + latency - shapes.cycles["geometry"]))
    cycles = {"clear": trace.tiles_y + 1, "table": table, **shapes.cycles, **drawn.cycles}
    reads = shapes.reads + drawn.reads
    reads[bus.TILES] += (len(eye.counts) + 3) // 4
    events = drawn.events | {name: count + drawn.events[name] for name, count in shapes.events.items()}
    at = cycles["clear"] + table
    ends = [("geometry", -1, at, at + cycles["geometry"])]
    ends += [("render", -1, at + cycles["geometry"], at + cycles["geometry"] + cycles["render"])]
    ends += [(stage, group, a + at + cycles["geometry"], b + at + cycles["geometry"]) for stage, group, a, b in drawn.timeline]
    return _Pass(cycles, shapes.stages | drawn.stages, reads, shapes.writes + drawn.writes, events, ends)


def _geometry(
    trace: FrameTrace, eye: EyeTrace, config: AcceleratorConfig, memory: LastingMemory, written: Lists, where: MemoryMap,
) -> tuple[_Pass, int]:
    """Simulates the geometry phase. Returns it with the cycle in which its last intersection was in memory."""
    s = memory.begin(geometry.layout, read_depths(config))
    paths, beats = constants.culling(config), colour_beats(config, trace.sh_degree)
    datapath.set_culling(s, paths)
    s.points, s.kept_room = trace.points, paths.ellipse.rows + TILE_TEST_BESIDE
    chunk_arrays = chunk_units.prepare(s, eye.chunk_count, eye.chunk_read, config, paths)
    classes = eye.point_class[eye.point_class != geometry.UNREAD]
    s.colour_waiting, s.colour_beats, s.colour_compact = paths.colour_waiting, beats, config.compact
    writes = np.where(written.writes < 0, where.directory - 1 - written.writes, where.entries + written.writes)
    survivor = np.append(eye.survivor, 0).astype(np.int64)
    cycles, counted = geometry.geometry_phase(
        s, classes, classes[classes != geometry.NEAR_CULLED], eye.splat_steps, eye.step_runs,
        eye.run_entries, eye.run_closes, np.append(eye.views, 0).astype(np.uint8), where.views + (survivor << trace.view_shift),
        where.colour + survivor * beats, where.geometry, written.begins, writes,
        constants.colour_steps(config, trace.sh_degree), where.chunks, *chunk_arrays, LIMIT)
    return _Pass(
        {"geometry": memory.end(finished("GEOMETRY", cycles))}, counts_of(s, GEOMETRY_STAGES),
        s.reads[: bus.READERS].copy(), s.writes[: bus.WRITERS].copy(),
        dram_commands(s), []), int(counted)


def _set_array(s: np.record, trace: FrameTrace, config: AcceleratorConfig, display: bool) -> None:
    """Sets the array's sizes and latencies (rtl.vrc_array)."""
    expand, blend = (config.cores_x - 1).bit_length(), constants.BLEND_LATENCY if config.level_banks == 2 else 0
    s.blocks, s.cores_x, s.cores_y = config.blocks, config.cores_x, config.cores_y
    s.row_latency = expand + constants.ROW_PIPELINE + constants.SUMS_LATER + 2 + blend + 3
    s.leave_latency = expand + config.cores_y + 4
    s.stop_latency = constants.SETUP_LATENCY + expand + config.cores_y + 4
    s.rows_free, s.row_halves = OUTPUT_DRAINS * config.cores_y, 2
    s.drain_rows = config.cores_y if config.incremental else tile_rows(config)
    s.width, s.height, s.tiles_x = trace.width, trace.height, trace.tiles_x
    s.pixel_words = (DISPLAY_PIXEL_BYTES if display else PIXEL_BYTES) // 4


def set_warp(s: np.record, config: AcceleratorConfig, rows: int, source_right: bool) -> None:
    """Sets the sizes and latencies of a warp unit (rtl.warp_unit) for a frame of so many rows of tiles."""
    groups = TILE // config.warp_lanes
    waiting = max(2, groups - groups // config.warp_lanes + 1)
    s.warp_present, s.warp_lanes, s.warp_to_take = 1, config.warp_lanes, rows
    s.warp_depth = max(2, groups * TILE // config.cores_x)
    s.warp_to_scan, s.warp_right = rows, source_right
    s.warp_ring, s.warp_reach = config.warp_columns // TILE, -(-reach(config) // TILE)
    s.warp_settle_cycles = disparity(config).width + constants.DISPARITY_STAGES
    s.warp_queue_depth = min(groups, 1 << (waiting - 1).bit_length())


def _render(
    trace: FrameTrace, eye: EyeTrace, number: int, config: AcceleratorConfig, memory: LastingMemory, display: bool,
    written: Lists, plan: RenderPlan, where: MemoryMap, sweep_from: int,
) -> _Pass:
    """Simulates the rendering phase."""
    line = config.line_buffer_bytes // ENTRY_BYTES
    s = memory.begin(warp.layout, read_depths(config))
    s.line_size, s.line_mask = line, (1 << (line - 1).bit_length()) - 1
    s.tile_count, s.rendered_tiles, s.sweep_from = len(eye.counts), len(plan.drawn), sweep_from
    s.pointer_room, s.wait_room = 64, 2 * -(-config.row_width // TILE) + 64
    s.entries_base, s.directory_base, s.views_base = where.entries, where.directory, where.views
    s.table_base, s.frame_base = (where.target_tiles, where.target_frame) if number else (where.tiles, where.frame)
    s.capacity = capacity = config.sort_chunk
    stages, keys = chunks.chunk_stages(capacity)
    chunks.begin_stages(stages, plan.chunk_ends)
    s.lockstep = config.lockstep
    s.incremental, s.ring_runs = config.incremental, plan.ring_runs if plan.chunk_spill.any() else 0
    s.spill_base, s.ring_beats = where.spill, plan.ring_runs * capacity // BEAT_ENTRIES
    s.way_room[: config.merge_ways] = 32
    _set_array(s, trace, config, display)
    if len(trace.eyes) > 1 and number == 0:
        set_warp(s, config, trace.tiles_y, trace.source_right)
        s.warp_target_base = where.target_frame
    times = np.full((8, len(plan.filled) + 1), -1, np.int64)
    tile_times = np.full((2, len(plan.drawn) + 1), -1, np.int64)
    cycles = render.render_phase(
        s, config.merge_ways, eye.counts, plan.lasts, eye.rendered, written.page_beat, written.page_start,
        eye.counts[plan.drawn], eye.blend[plan.drawn] & (config.level_banks == 2), plan.drawn, eye.stop[plan.drawn],
        plan.group_end, eye.use, plan.missed, plan.view, plan.chunk_length, plan.chunk_spill, plan.chunk_last,
        plan.chunk_ends, plan.arrival, stages, keys, plan.part_runs, plan.job_start, plan.job_length, plan.job_entries,
        plan.job_out, plan.job_waits, plan.way_of, plan.job_begin, plan.job_goal, *group_ends(plan), trace.holes, times,
        tile_times, LIMIT)
    events = dram_commands(s) | {
        "ops": int(s.ops), "skipped": int(s.skipped), "fetch_misses": int(s.missed),
        "spilled_entries": int(plan.way_of.size)}
    return _Pass(
        {"render": memory.end(finished("RENDER", cycles))}, counts_of(s, RENDER_STAGES),
        s.reads[: bus.READERS].copy(), s.writes[: bus.WRITERS].copy(), events,
        _timeline(plan, times, tile_times))


def _timeline(plan: RenderPlan, times: np.record, tile_times: np.record) -> list[tuple[str, int, int, int]]:
    """The first and last cycle of every group in each stage of the rendering phase."""
    out = []
    for place, stage in enumerate(("sort", "handover", "fetch", "array")):
        firsts, ends = times[2 * place : 2 * place + 2, : len(plan.filled)].tolist()
        out += [(stage, *item) for item in zip(plan.filled.tolist(), firsts, ends, strict=True)]
    group_of = plan.groups[plan.drawn]
    firsts = np.flatnonzero(np.diff(group_of, prepend=-1))
    ends = np.append(firsts[1:], len(group_of)) - 1 if len(firsts) else firsts
    out += [("pixel_write", int(group_of[a]), int(tile_times[0, a]), int(tile_times[1, b]))
            for a, b in zip(firsts, ends, strict=True)]
    return out


def _together(
    trace: FrameTrace, config: AcceleratorConfig, memory: LastingMemory, passes: list[_Pass], plans: list[RenderPlan],
    seconds: float,
) -> FrameCycles:
    """Adds up the numbers of all passes, as the machine counts them."""
    phases = {name: sum(p.cycles[name] for p in passes) for name in passes[0].cycles}
    total = sum(phases.values())
    stages = {}
    for name in passes[0].stages:
        if name == "warp" and not config.stereo:
            continue
        busy, blocked = (int(sum(p.stages[name][i] for p in passes)) for i in range(2))
        stages[name] = Stage(busy, blocked, total - busy - blocked)
    reads = {name: BEAT_BYTES * int(sum(p.reads[i] for p in passes)) for i, name in enumerate(read_clients(config))}
    clients = WRITE_CLIENTS + (STEREO_WRITE_CLIENTS if config.stereo else ())
    writes = {name: BEAT_BYTES * int(sum(p.writes[i] for p in passes)) for i, name in enumerate(clients)}
    events = {name: sum(p.events[name] for p in passes) for name in passes[0].events}
    timeline, at = [], 0
    for eye, p in enumerate(passes):
        timeline += [(stage, eye, group, first + at, last + at) for stage, group, first, last in p.timeline]
        at += sum(p.cycles.values())
    utilisation = {"array": max(trace.entries, events["ops"]) / max(1, phases["render"]),
                   "memory": (sum(reads.values()) + sum(writes.values())) / (memory.model.peak * total)}
    return FrameCycles(
        total, phases, tuple(p.cycles for p in passes), stages, reads, writes, trace.entries,
        sum(int(plan.groups[-1]) + 1 for plan in plans), utilisation=utilisation, timeline=timeline, seconds=seconds, **events)
