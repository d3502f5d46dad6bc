"""The second phase of machines with super-tiles: from lists of pairs and Gaussians in memory to pixels in memory."""

from __future__ import annotations

from typing import Any, NamedTuple

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Member, Out

from rtl.culling.saturations import SaturationCounters
from rtl.pixels.frame_writer import FrameWriter
from rtl.shapes import layout
from rtl.sort_tmu.handover import handover
from rtl.sort_tmu.hierarchical_sorter import HierarchicalSorter
from rtl.sort_tmu.tile_merge import TileMergeUnit
from rtl.stream import Broadcast, Buffer, Fork
from rtl.supertiles.batch_buffer import BatchBuffer
from rtl.supertiles.colour import PairColour
from rtl.supertiles.list_replay import ListReplay
from rtl.supertiles.reader import SuperTileReader
from rtl.supertiles.record_fetch import RecordFetch
from rtl.supertiles.stream_arrays import StreamArrays
from rtl.supertiles.warp_strips import WarpStrips, known_write
from rtl.tile_lists.list_reader import ListReader
from rtl.top.ports import connect_settings, phase_ports, watch
from rtl.vrc_array.batch_array import BatchArray
from rtl.vrc_array.pixel_writer import PixelWriter
from rtl.warp_unit.warp_unit import EVENTS as WARP_EVENTS
from spec.config import AcceleratorConfig
from spec.queues import LISTS_AHEAD, OUTPUT_DRAINS, SUPERTILES_AHEAD
from spec.records import (
    chunk_item,
    frame_lists,
    frame_tiles,
    gaussian_point,
    intersection_tile,
    list_group,
    surviving_splat,
    tile_group,
)
from spec.registers import CHUNK_READ_CLIENTS, STEREO_EVENTS, STEREO_STAGES, STEREO_WRITE_CLIENTS, SWEEP_EVENTS
from spec.saturations import WATCHED
from spec.supertiles import check_supertiles, frame_rows, supertile

READERS, WRITERS = ("tiles", "colour", "entries", "spill", *CHUNK_READ_CLIENTS), ("spill", "frame")
"""Memory clients of this phase, by the names of `spec.registers`."""

STAGES = ("list_read", "sort", "handover", "fetch", "colour", "batch", "array", "pixel_write")
"""Stages of this phase whose input streams are watched by the performance counters."""

_SATURATED = tuple(s.name for s in WATCHED if s.stream == "views")



def stages(config: AcceleratorConfig) -> tuple[str, ...]:
    """The watched stages of this phase in a machine of `config`."""
    return STAGES + STEREO_STAGES if config.stereo else STAGES


def _writers(config: AcceleratorConfig) -> tuple[str, ...]:
    """The write clients of this phase in a machine of `config`."""
    return WRITERS + STEREO_WRITE_CLIENTS if config.stereo else WRITERS


_COUNTS = (
    "groups", "spilled_entries", "header_hits", "header_misses", "batches", "visits", "ops", "skipped", "pixels", *_SATURATED)


class _Watched(NamedTuple):
    """Streams together, as counters see them: whether any has an item, and whether any moves."""

    valid: Value
    ready: Value


class GatherPhase(wiring.Component):
    """Tile merge unit, list reader, sorter, record fetch, colour unit, batch buffer, array and pixel writer::

                                          entries        spill              chunks, colour
                                             ▼             ▼                      ▼
        hits ─► TileMergeUnit ─► merged   ListReader ─► HierarchicalSorter ─► RecordFetch ─► gathered
                                    ┆        ▲                                    └─ beats ──────────┐
        listed ─► gate ─► Fork ──────────────┤                                                       ▼
                                             ▼                                          tested ─► PairColour
        tiles ──────────────────────► SuperTileReader ─┬─► supertiles                                │ places
                                                       └───────────► queue ─────────────────► BatchBuffer
                                                                                         done ▲      │ visits, entries
                                                          frame ◄─ PixelWriter ◄─────────── BatchArray

    With several streams, `StreamArrays` takes the place of batch buffer and array.

    The streams that end here with a name pass through units of the first phase, which both phases use: `merged` comes back as
    `listed`, with the ends of super-tiles, `gathered` as `tested`, projected and tested again, for which it needs `supertiles`.
    Neither reader of lists keeps the other waiting for ever: that of super-tiles takes all lists of a frame without waiting,
    and ListReader has space for more lists than a super-tile has, so that a super-tile comes before its pairs.

    With a warp unit and joint frames (`spec.joint_warp`), ListReplay stands before the fork, and the source's rows of pixels
    also go to WarpStrips. `second` rises when all that is warped is in memory, and then the lists come once more::

        listed ─► gate ─► ListReplay ─► Fork            BatchArray ─► Broadcast ─► PixelWriter ─► frame
                              ▲ ▲                                         └─► WarpStrips ─┬─► warp
                      finished └─┴────── tiles with holes ──► SuperTileReader ◄───────────┘

    Where the machine packs frames, FrameWriter stands in PixelWriter's place. In machines whose phases overlap, the tile merge
    unit is in the first phase.

    Parameters:
        config: the machine, with super-tiles; `incremental` selects the handover behind the sorter.

    Ports:
        settings, tiles_x, tile_count: settings of the frame and its numbers of tiles.
        clear: strobe before a frame.
        start: strobe; what the first phase wrote is in memory.
        list_count: number of the frame's lists.
        reads_NAME, data_NAME: the memory clients of READERS; writes_NAME, idle_NAME: those of WRITERS.
        hits: the list of every pair; it comes during the first phase.
        merged, listed: TileGroup items of all lists, and the same lists as ListGroup items.
        sorted_item, sorted_taken: what leaves the sorter, and whether it does.
        gathered: GaussianPoint items of sorted pairs. tested: a SurvivingSplat for each of them, in joint frames for each eye.
        supertiles: a SuperTile for each super-tile of the frame, in joint frames for each eye, in order.
        counted: all hits of the frame have come since `clear`.
        done: all pixels of the frame are in memory.
        overflow: a group did not fit the spill region.
        saturated: a list has more pairs than can be counted, or a pair's list is not one of the frame.
        ready: nothing is being cleared.
        stage_valid, stage_ready: handshakes of the input streams of STAGES, one bit each.
        groups, spilled_entries, header_hits, header_misses, batches, visits, ops, skipped, pixels,
        saturated_colours: counts of the frame.

    With a warp unit and joint frames:
        known, rendered_tiles: tiles of the target as the table says, and how many tiles the first sweep renders.
        second: the second sweep has begun.
        warped, filled, invalid_tiles, target_tiles, pairs_again: counts of the frame.

    With overlapped phases there are neither list_count, hits and merged nor counted, saturated and ready.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        sweep = (*STEREO_EVENTS, *SWEEP_EVENTS) if config.warps_joint else ()
        ports = phase_ports(config, READERS, _writers(config), stages(config), (*_COUNTS, *sweep))
        in_turn = {
            "list_count": In(range(frame_lists(config) + 1)),
            "hits": In(stream.Signature(layout(intersection_tile(config)))),
            "merged": Out(stream.Signature(layout(tile_group(config))))}
        if config.overlap:
            del ports["ready"]
        super().__init__({
            **ports, **({} if config.overlap else in_turn),
            "listed": In(stream.Signature(layout(list_group(config)))),
            "sorted_item": Out(layout(chunk_item(config))), "sorted_taken": Out(1),
            "gathered": Out(stream.Signature(layout(gaussian_point(config)))),
            "tested": In(stream.Signature(layout(surviving_splat(config)))),
            "supertiles": Out(stream.Signature(layout(supertile(config)))),
            **({} if config.overlap else {"counted": Out(1), "saturated": Out(1)}), "overflow": Out(1),
            **(self._sweep_ports(config) if config.warps_joint else {})})
        check_supertiles(config)
        self.config = config

    def _sweep_ports(self, config: AcceleratorConfig) -> dict[str, Member]:
        return {"known": In(known_write(config)), "rendered_tiles": In(range((frame_tiles(config) << 1) + 1)), "second": Out(1)}

    def elaborate(self, platform: object) -> Module:
        m = Module()
        if not self.config.overlap:
            m.submodules.tile_merge = merge = TileMergeUnit(self.config)
        m.submodules.reader = reader = ListReader(self.config)
        m.submodules.sorter = sorter = HierarchicalSorter(self.config)
        m.submodules.handover = buffer = handover(self.config)
        m.submodules.fetch = fetch = RecordFetch(self.config)
        m.submodules.colour = colour = PairColour(self.config, sh_degree=self.config.sh_degree)
        batches, array = self._arrays(m)
        wide = frame_rows(self.config)
        m.submodules.writer = writer = FrameWriter(wide) if self.config.packed else PixelWriter(wide)
        for unit in dict.fromkeys((reader, sorter, fetch, colour, batches, array, writer)):
            connect_settings(m, self, unit)
        m.d.comb += [
            *([] if self.config.overlap else [
                merge.beta.eq(self.settings.beta), merge.auto.eq(self.settings.auto_beta),
                merge.tiles_x.eq(self.list_count), merge.tile_count.eq(self.list_count)]),
            *(unit.clear.eq(self.clear) for unit in (reader, sorter, fetch, batches))]
        if not self.config.overlap:
            wiring.connect(m, wiring.flipped(self.hits), merge.hits)
            wiring.connect(m, merge.groups, wiring.flipped(self.merged))
        made, replay = self._super_tiles(m, reader, batches)
        wiring.connect(m, reader.groups, sorter.groups)
        wiring.connect(m, sorter.sorted, buffer.sink)
        wiring.connect(m, buffer.source, fetch.sorted)
        wiring.connect(m, fetch.points, wiring.flipped(self.gathered))
        wiring.connect(m, wiring.flipped(self.tested), colour.survivors)
        wiring.connect(m, fetch.beats, colour.data)
        wiring.connect(m, colour.places, batches.places)
        entries: _Watched | stream.Interface
        if self.config.streams > 1:
            entries, stops = _Watched(array.taking, array.taken), []
        else:
            wiring.connect(m, batches.visits, array.visits)
            wiring.connect(m, batches.entries, array.entries)
            entries, stops = array.entries, [batches.done.eq(array.done), batches.current.eq(array.current)]
        watched = [reader.data, sorter.groups, buffer.sink, fetch.sorted, colour.survivors, batches.places, entries,
                   writer.rows]
        # The rows come out of a memory, and the writer rounds them: both do not fit into a cycle.
        m.submodules.finished = finished = Buffer(array.pixels.payload.shape())
        if replay is None:
            wiring.connect(m, array.pixels, finished.sink)
        wiring.connect(m, finished.source, writer.rows)
        if replay is not None:
            watched.append(self._warp(m, array.pixels, finished.sink, writer, made, replay))
        for name, unit in (("entries", reader), ("spill", sorter)):
            wiring.connect(m, unit.reads, wiring.flipped(getattr(self, f"reads_{name}")))
            wiring.connect(m, wiring.flipped(getattr(self, f"data_{name}")), unit.data)
        for name in ("chunks", "colour"):
            wiring.connect(m, getattr(fetch, f"reads_{name}"), wiring.flipped(getattr(self, f"reads_{name}")))
            wiring.connect(m, wiring.flipped(getattr(self, f"data_{name}")), getattr(fetch, f"data_{name}"))
        for name, unit in (("spill", sorter), ("frame", writer)):
            wiring.connect(m, unit.writes, wiring.flipped(getattr(self, f"writes_{name}")))
            m.d.comb += unit.writes_idle.eq(getattr(self, f"idle_{name}"))
        m.d.comb += [
            *stops, writer.begin.eq(self.start),
            self.sorted_item.eq(sorter.sorted.payload),
            self.sorted_taken.eq(sorter.sorted.valid & sorter.sorted.ready & (~self.second if replay else 1)),
            self.overflow.eq(sorter.overflow), *([] if replay else [self.done.eq(writer.finished)]),
            *([] if self.config.overlap else [self.saturated.eq(merge.saturated | merge.outside)]),
            *([] if self.config.overlap or replay else [self.ready.eq(~merge.busy)])]
        if replay:
            m.d.comb += self.ready.eq(~merge.busy & ~self._rings_busy)
        watch(m, self, watched)
        if self.config.counters:
            self._count(m, sorter, fetch, colour, batches, array, writer, replay)
        return m

    def _warp(
        self, m: Module, rows: stream.Interface, finished: stream.Interface, writer: PixelWriter | FrameWriter,
        made: SuperTileReader, replay: ListReplay,
    ) -> stream.Interface:
        """Adds the warp unit beside the pixel writer, and begins the second sweep; returns the stream of rows that is warped.

        Each of the two has a buffer of its own: registers that drive both are too slow for the writer's sums.
        A frame is done when all that is rendered and warped of it is in memory. The warp unit has taken all rows of the source
        when it has finished, so that no pair of the first sweep is on its way any more.
        """
        m.submodules.broadcast = broadcast = Broadcast(rows.payload.shape())
        m.submodules.warp_rows = warp_rows = Buffer(rows.payload.shape())
        m.submodules.warp = warp = WarpStrips(frame_rows(self.config))
        connect_settings(m, self, warp)
        wiring.connect(m, rows, broadcast.sink)
        wiring.connect(m, broadcast.sources[0], finished)
        wiring.connect(m, broadcast.sources[1], warp_rows.sink)
        wiring.connect(m, warp_rows.source, warp.rows)
        wiring.connect(m, warp.writes, wiring.flipped(self.writes_warp))
        warps, sweeps, total, began = Signal(), Signal(), Signal.like(writer.tile_count), Signal()
        self._rings_busy = Signal()
        with m.If(self.start):
            m.d.sync += began.eq(1)
        with m.If(self.clear):
            m.d.sync += began.eq(0)
        # Settings are stable long before `start`. The last hole tile is in `total` when `warp.finished` rises.
        m.d.sync += [
            warps.eq(self.settings.joint & self.settings.stereo), sweeps.eq(warps & self.settings.second_sweep),
            total.eq(self.rendered_tiles + Mux(sweeps, warp.hole_tiles, 0)),
            self._rings_busy.eq(warp.busy & self.settings.stereo),
            self.target_tiles.eq(Mux(warps, total - self.tile_count, 0))]
        m.d.comb += [
            broadcast.wanted.eq(Cat(1, warps & ~rows.payload.eye)),
            warp.writes_idle.eq(self.idle_warp), warp.begin.eq(self.start & warps), warp.clear.eq(self.clear),
            warp.known.eq(self.known), writer.tile_count.eq(total),
            warp.number[0].eq(made.number), made.holes.eq(warp.tiles[0]), made.second.eq(replay.second),
            warp.number[1].eq(replay.number), replay.holes.eq(warp.tiles[1].any()), replay.clear.eq(self.clear),
            replay.again.eq(sweeps & began & warp.finished & warp.hole_tiles.any() & ~replay.second),
            self.second.eq(replay.second), self.done.eq(writer.finished & (warp.finished | ~warps)),
            self.pairs_again.eq(replay.pairs_again),
            *(getattr(self, name).eq(Mux(warps, getattr(warp, name), 0)) for name in WARP_EVENTS)]
        return warp.rows

    def _arrays(self, m: Module) -> tuple[Any, Any]:
        """Adds the batch buffer and the array, which is one unit with several streams."""
        rows = OUTPUT_DRAINS * self.config.array_y if self.config.incremental else None
        if self.config.streams > 1:
            m.submodules.arrays = arrays = StreamArrays(self.config, lines=rows)
            return arrays, arrays
        m.submodules.batches = batches = BatchBuffer(self.config)
        m.submodules.array = array = BatchArray(self.config, lines=rows)
        return batches, array

    def _super_tiles(
        self, m: Module, reader: ListReader, batches: BatchBuffer | StreamArrays,
    ) -> tuple[SuperTileReader, ListReplay | None]:
        """Holds lists back until `start`, sends them to both readers, and each super-tile to the batch buffer and out. Returns
        the reader of super-tiles, and with a warp unit what gives lists once more."""
        m.submodules.fork = fork = Fork(self.listed.payload.shape())
        m.submodules.supertiles = made = SuperTileReader(self.config)
        m.submodules.supertile_fork = broadcast = Broadcast(made.supertiles.payload.shape())
        m.submodules.queue = queue = SyncFIFOBuffered(
            width=made.supertiles.payload.shape().size, depth=SUPERTILES_AHEAD << self.config.joint)
        connect_settings(m, self, made)
        counted, open_ = Signal(), Signal()
        if not self.config.overlap:
            with m.If(self.hits.valid & self.hits.ready & self.hits.payload.end):
                m.d.sync += counted.eq(1)
        with m.If(self.start):
            m.d.sync += open_.eq(1)
        with m.If(self.clear):
            m.d.sync += [*([] if self.config.overlap else [counted.eq(0)]), open_.eq(0)]
        m.submodules.lists = lists = SyncFIFOBuffered(width=self.listed.payload.shape().size, depth=LISTS_AHEAD)
        listed, ahead = data.View(self.listed.payload.shape(), lists.r_data), broadcast.sources[1]
        gate, replay = fork.sink, None
        if self.config.warps_joint:
            m.submodules.replay = replay = ListReplay(self.config)
            wiring.connect(m, replay.lists, fork.sink)
            gate = replay.listed
            m.d.comb += replay.list_count.eq(self.list_count)
        m.d.comb += [
            *([] if self.config.overlap else [self.counted.eq(counted)]),
            gate.payload.eq(self.listed.payload), gate.valid.eq(self.listed.valid & open_),
            self.listed.ready.eq(gate.ready & open_),
            lists.w_data.eq(fork.sources[0].payload), lists.w_en.eq(fork.sources[0].valid),
            fork.sources[0].ready.eq(lists.w_rdy),
            reader.tiles.valid.eq(lists.r_rdy), lists.r_en.eq(reader.tiles.ready),
            *(reader.tiles.payload[name].eq(listed[name]) for name in reader.tiles.payload.shape().members),
            made.clear.eq(self.clear), broadcast.wanted.eq(0b11),
            queue.w_data.eq(ahead.payload), queue.w_en.eq(ahead.valid), ahead.ready.eq(queue.w_rdy),
            batches.supertiles.payload.eq(queue.r_data), batches.supertiles.valid.eq(queue.r_rdy),
            queue.r_en.eq(batches.supertiles.ready)]
        wiring.connect(m, fork.sources[1], made.lists)
        wiring.connect(m, made.supertiles, broadcast.sink)
        wiring.connect(m, broadcast.sources[0], wiring.flipped(self.supertiles))
        wiring.connect(m, made.reads, wiring.flipped(self.reads_tiles))
        wiring.connect(m, wiring.flipped(self.data_tiles), made.data)
        return made, replay

    def _count(
        self, m: Module, sorter: HierarchicalSorter, fetch: RecordFetch, colour: PairColour,
        batches: BatchBuffer | StreamArrays, array: BatchArray | StreamArrays, writer: PixelWriter | FrameWriter,
        replay: ListReplay | None,
    ) -> None:
        m.submodules.saturations = counts = SaturationCounters(self.config)
        lists, places = self.listed, colour.places
        groups = self.groups if replay is None else Signal.like(self.groups, name="first_groups")
        if replay is not None:
            m.d.comb += self.groups.eq(groups + replay.groups_again)
        with m.If(lists.valid & lists.ready & lists.payload.last):
            m.d.sync += groups.eq(groups + 1)
        ops, skipped = Signal.like(self.ops), Signal.like(self.skipped)  # counts up to the previous frame
        with m.If(self.clear):
            m.d.sync += [groups.eq(0), ops.eq(array.ops), skipped.eq(array.skipped)]
        m.d.sync += [self.ops.eq(array.ops - ops), self.skipped.eq(array.skipped - skipped)]
        m.d.comb += [
            counts.clear.eq(self.clear), counts.views.eq(places.payload.as_value()[: counts.views.shape().size]),
            counts.views_move.eq(places.valid & places.ready & (1 if replay is None else ~places.payload.none)),
            *(getattr(self, name).eq(getattr(counts, name)) for name in _SATURATED),
            self.spilled_entries.eq(sorter.spilled), self.header_hits.eq(fetch.hits), self.header_misses.eq(fetch.misses),
            self.batches.eq(batches.batches), self.visits.eq(batches.visits_count), self.pixels.eq(writer.pixels)]
