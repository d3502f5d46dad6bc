"""Frames in a row whose phases overlap: the first phase of frame n + 1 runs beside the second one of frame n, on one memory.

The RTL is `rtl.top.overlap` and `rtl.top.splat_paths`. What both phases use is shared so:

- Memory: all clients take turns at one AXI master. The chunk headers of the two phases have a client each, and the table of
  tiles comes through that of the first phase.
- Projection, near test and tile test: one of each, into which a slot of one phase enters in an interval. In even ones the
  second phase goes first; in odd ones a slot of the first phase that waits does. Slots carry the number of their phase, and
  each phase has an output queue of its own, so that neither waits for the other's.
- Everything that one phase writes and the next one reads exists twice: level table, list heads, bounds, directory and pairs.

The bounds of depth buckets are then those of the frame before the last.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from golden.host.run_options import LPDDR3
from golden.msv2_ref.buckets import Bounds
from perf import bus, chunk_units, memory, supertiles, supertiles_bin, supertiles_render
from perf.bus import CHUNKS, GEOMETRY, READER_NAMES, VIEWS, W_ENTRIES
from perf.datapath import ELLIPSE, NEAR, PROJECTION
from perf.kernel import phase, step
from perf.model import MemoryModel
from perf.phases import LIMIT, LastingMemory, dram_commands, finished
from perf.supertiles import SuperPlan, bin_arguments, drawn_events, render_arguments, super_plan
from perf.supertiles_plan import frame_beats, steady_bounds
from perf.supertiles_trace import SuperTrace
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BYTES, DISPLAY_PIXEL_BYTES, PIXEL_BYTES
from spec.queues import read_depths
from spec.registers import WRITE_CLIENTS
from spec.supertiles import check_supertiles

BIN_CHUNKS = VIEWS
"""The place at the bus of the first phase's headers and table: machines with super-tiles have no splat records to read."""

_ROW = 4096  # beats of all banks and channels with one row number
_UNLIMITED = 1 << 40  # credits of clients that wait for their own state's credits


@dataclass(frozen=True)
class OverlapCycles:
    """Frames in a row.

    Attributes:
        period: cycles from the start of a frame's second phase to the start of the next frame's.
        first, second: cycles of the two phases in it, counted from its beginning; the first includes clearing and table.
        bytes: bytes that a frame moves. activates, refreshes: DRAM commands of a frame.
        utilisation: busy share of the arrays, and of memory's peak bandwidth.
    """

    period: int
    first: int
    second: int
    bytes: int
    activates: int
    refreshes: int
    utilisation: dict[str, float]


@step
def _step_table(b, t, granted):
    """Reads the tables of tiles, one eye's after the other's, four tiles to a beat, a tile a cycle, as
    `perf.geometry.table_phase` does."""
    uses_up = b.table_left == 0 or b.table_taken == b.table_tiles - 1
    b.table_taken += b.table_valid
    if (b.table_valid == 0 or uses_up) and bus.offered(b, CHUNKS, t):
        bus.take(b, CHUNKS)
        b.table_valid, b.table_left = 1, 3
    elif b.table_valid:
        b.table_valid, b.table_left = not uses_up, b.table_left - 1
    if granted:
        bus.read(b, CHUNKS, b.table_base + b.table_asked)
        b.table_asked += 1
    if b.table_taken == b.table_tiles and b.table_next:
        b.table_base, b.table_next = b.table_next, 0
        b.table_asked = b.table_left = b.table_valid = b.table_taken = 0
    elif b.table_taken == b.table_tiles and b.bin_from == bus.NEVER:
        b.bin_from = t + 2  # `done` rises one cycle later and is seen in the cycle after that


@step
def _first_asking(b, t):
    """What the first phase asks for, by its own numbers of clients: while it clears, nothing; then the table; then the rest."""
    if t >= b.bin_from:
        return supertiles_bin.asking(b)
    wanted = t >= b.table_from and 4 * b.table_asked < b.table_tiles and b.credits[CHUNKS] != 0
    return (1 << CHUNKS) * wanted, 0


@step
def _hand_over(s, b):
    """Passes the answers of memory to the first phase's clients."""
    for mine, theirs in ((GEOMETRY, GEOMETRY), (CHUNKS, BIN_CHUNKS)):
        at = b.beats_in[mine]
        while at != s.beats_in[theirs]:
            b.beat_times[mine, at & bus.BEATS - 1] = s.beat_times[theirs, at & bus.BEATS - 1]
            at += 1
        b.beats_in[mine] = at
    count = b.written[W_ENTRIES]
    while count != s.written[W_ENTRIES]:
        b.client_answers[W_ENTRIES, count & bus.ANSWERS - 1] = s.client_answers[W_ENTRIES, count & bus.ANSWERS - 1]
        count += 1
    b.written[W_ENTRIES] = count


@step
def _pass_on(s, b, reader):
    """Sends the requests of the first phase, if it was granted any, to memory."""
    if b.read_new:
        bus.read(s, reader, b.read_address[b.read_push - 1 & bus.RING - 1])
    if b.write_new:
        bus.write(s, W_ENTRIES, b.write_address[b.write_push - 1 & bus.RING - 1])


@phase
def overlap_phase(b, s, streams, first, second, limit):
    """Simulates both phases from the same cycle on until both have ended, with the first phase's state `b` and arguments
    `first`, and the second one's `s`, `streams` and `second`. The memory is that of `s`. Returns the cycles of the first phase
    and those of the second, -1 for one that has not ended within `limit` cycles."""
    binned, drawn = -1, -1
    for t in range(limit):
        reads, writes = (0, 0) if drawn >= 0 else supertiles_render.asking(s, t)
        own_reads, own_writes = (0, 0) if binned >= 0 else _first_asking(b, t)
        reads |= own_reads & 1 << GEOMETRY | (own_reads >> CHUNKS & 1) << BIN_CHUNKS
        reader, writer = bus.grant_read(s, t, reads), bus.grant_write(s, t, writes | own_writes)
        b.read_new = b.write_new = 0
        turn = t // s.path_interval[NEAR] & 1
        s.path_held[NEAR] = turn and (b.eye_points != 0 if b.two_eyes else chunk_units.decoded(b))
        s.path_held[PROJECTION] = turn and b.path_full[NEAR] != 0
        s.path_held[ELLIPSE] = turn and b.walked != 0
        before = s.path_in[NEAR], s.path_in[PROJECTION], s.path_in[ELLIPSE]
        if drawn < 0 and supertiles_render.render_cycle(s, streams, t, reader, writer, *second):
            drawn = t + 1
        for place in (NEAR, PROJECTION, ELLIPSE):
            b.path_held[place] = s.path_in[place] != before[place]
        if binned < 0:
            mine = GEOMETRY if reader == GEOMETRY else CHUNKS if reader == BIN_CHUNKS else -1
            if t < b.bin_from:
                _step_table(b, t, mine == CHUNKS)
            elif supertiles_bin.bin_cycle(b, t, mine, writer, *first):
                binned = t + 1
            _pass_on(s, b, reader)
        if binned >= 0 and drawn >= 0:
            break
        memory.end_cycle(s, t)
        _hand_over(s, b)
    return binned, drawn


def simulate_overlap(
    trace: SuperTrace, config: AcceleratorConfig, *, memory: MemoryModel | None = None, display: bool = False,
    packed: bool = False, shared_colour: bool = False, bounds: Bounds | None = None,
) -> OverlapCycles:
    """Simulates one of many frames in a row of a camera that stands still: the second phase of one beside the first of the
    next.

    Args:
        trace, config, display, packed, shared_colour: as in `perf.supertiles.simulate_supertiles`.
        memory: the memory; None for four channels of LPDDR3-1600.
        bounds: the bounds of both frames; None for those that such frames leave for each other.

    Raises:
        ValueError: the machine has no super-tiles, or cannot render the frame (`perf.supertiles.check_trace`).
    """
    check_supertiles(config)
    model = memory or MemoryModel(LPDDR3)
    supertiles.check_trace(trace, config, packed)
    plan = super_plan(trace, config, steady_bounds(trace, config) if bounds is None else bounds, None, display, packed)
    s = LastingMemory(model).begin(supertiles_render.layout, read_depths(config))
    s.credits[GEOMETRY] = s.credits[BIN_CHUNKS] = _UNLIMITED
    pixels = supertiles.PACKED if packed else int(display)
    streams, *second = render_arguments(
        s, trace, config, pixels, shared_colour, plan, supertiles.merge_latency(config, None))
    b = LastingMemory(model).begin(supertiles_bin.layout, read_depths(config))
    b.table_from, b.bin_from = supertiles.clear_cycles(trace, config), bus.NEVER
    b.table_tiles, b.table_base = trace.eye_tiles, plan.where.tiles
    b.table_next = plan.where.target_tiles if trace.eyes > 1 else 0
    first = bin_arguments(b, trace, config, _second_set(trace, plan, display or packed))
    binned, drawn = (finished(name, cycles) for name, cycles in zip(
        ("GEOMETRY", "RENDER"), overlap_phase(b, s, streams, first, tuple(second), LIMIT), strict=True))
    period, events, commands = max(binned, drawn), drawn_events(s, streams), dram_commands(s)
    moved = BEAT_BYTES * int(s.reads[: len(READER_NAMES)].sum() + s.writes[: len(WRITE_CLIENTS)].sum())
    return OverlapCycles(
        period, binned, drawn, moved, **commands,
        utilisation={"array": max(trace.entries, events["ops"]) / (config.streams * period),
                     "memory": moved / (model.peak * period)})


def _second_set(trace: SuperTrace, plan: SuperPlan, display: bool) -> SuperPlan:
    """The plan with directory and pairs of the next frame, which lie behind everything else."""
    last = plan.where.target_frame if trace.eyes > 1 else plan.where.frame
    end = last + frame_beats(trace, DISPLAY_PIXEL_BYTES if display else PIXEL_BYTES)
    by = -(-end // _ROW) * _ROW
    where = replace(plan.where, directory=plan.where.directory + by, entries=plan.where.entries + by)
    return replace(plan, where=where)
