"""The units of the render phase: from tile lists of intersections and splat records in memory to pixels in memory."""

from __future__ import annotations

from typing import Any

from amaranth.hdl import Cat, Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Member, Out

from rtl.shapes import layout
from rtl.sort_tmu.handover import handover
from rtl.sort_tmu.hierarchical_sorter import HierarchicalSorter
from rtl.sort_tmu.swap import GATES, SwapTogether
from rtl.sort_tmu.tile_merge import TileMergeUnit
from rtl.stream import Broadcast, Buffer, Fork, Skid
from rtl.tile_lists.header_maker import HeaderMaker
from rtl.tile_lists.list_reader import ListReader
from rtl.top.ports import connect_settings, phase_ports, watch
from rtl.vrc_array.array import VrcArray
from rtl.vrc_array.pixel_writer import PixelWriter
from rtl.vrc_array.splat_fetch import SplatFetch
from rtl.warp_unit.warp_unit import EVENTS as WARP_EVENTS
from rtl.warp_unit.warp_unit import WarpUnit
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.queues import COUNTER_BITS, OUTPUT_DRAINS
from spec.records import frame_tiles, intersection_tile, tile_index
from spec.registers import STEREO_EVENTS, STEREO_STAGES, STEREO_WRITE_CLIENTS

READERS, WRITERS = ("tiles", "entries", "spill", "views"), ("spill", "frame")
"""Memory clients of this phase, by the names of `spec.registers`."""

STAGES = ("list_read", "sort", "handover", "fetch", "array", "pixel_write")
"""Stages of this phase whose input streams are watched by the performance counters."""

_COUNTS = ("groups", "spilled_entries", "fetch_hits", "fetch_misses", "ops", "skipped", "pixels")


def writers(config: AcceleratorConfig) -> tuple[str, ...]:
    """The write clients of this phase in a machine of `config`."""
    return WRITERS + STEREO_WRITE_CLIENTS if config.stereo else WRITERS


def stages(config: AcceleratorConfig) -> tuple[str, ...]:
    """The watched stages of this phase in a machine of `config`."""
    return STAGES + STEREO_STAGES if config.stereo else STAGES


class RenderPhase(wiring.Component):
    """Tile merge unit, list reader, sorter, splat fetch, array and pixel writer::

                                              entries           spill                     views
                                                 ▼                ▼                         ▼
        hits ─► TileMergeUnit ─gate─► Fork ─► ListReader ─► HierarchicalSorter ─► handover ─► SplatFetch ─┐
                                       └────► HeaderMaker ─────────── levels ─────────────────▲           │
                                         tiles ▲    └──────────────── headers ─────────► VrcArray ◄───────┘
                                                                                            └─► PixelWriter ─► frame

    With stereo, while the source eye is rendered, the array's rows also go to the warp unit::

        array ─► Broadcast ─► PixelWriter ─► frame
                    └───────► WarpUnit ────► warp
                                 └─ mask ──► HeaderMaker, and the geometry phase's TableLoader, in the target eye's pass

    Parameters:
        config: the machine; `incremental` selects the handover between sorter and array.

    Ports:
        settings, tiles_x, tile_count: settings of the frame and its numbers of tiles.
        clear: strobe before a frame.
        start: strobe; what the geometry phase wrote is in memory.
        reads_NAME, data_NAME: the memory clients of READERS; writes_NAME, idle_NAME: those of WRITERS.
        hits: the tile of every intersection; it comes during the geometry phase.
        counted: all hits of the frame have come since `clear`.
        done: all pixels of the frame are in memory.
        overflow: a group did not fit the spill region.
        saturated: a tile has more intersections than can be counted, or an intersection's tile is not in the frame.
        ready: nothing is being cleared.
        stage_valid, stage_ready: handshakes of the input streams of STAGES, one bit each.
        groups, spilled_entries, fetch_hits, fetch_misses, ops, skipped, pixels: counts of the frame.

    With stereo:
        target: the target eye's pass is running.
        rendered_tiles: tiles of the pass that are rendered.
        mask_tile, mask: number of a tile and, a cycle later, whether the warp unit left holes in it; usable until `start` of
            the target eye's pass.
        warped, filled, invalid_tiles, target_tiles: counts of the pass.
    """

    def __init__(self, config: AcceleratorConfig):
        self.config = config
        super().__init__({
            **phase_ports(config, READERS, writers(config), stages(config), _COUNTS),
            "hits": In(stream.Signature(layout(intersection_tile(config)))), "counted": Out(1), "overflow": Out(1),
            "saturated": Out(1),
            **(self._stereo_ports() if config.stereo else {}),
        })

    def _stereo_ports(self) -> dict[str, Member]:
        tile, tiles = tile_index(self.config).width, range(frame_tiles(self.config) + 1)
        return {"rendered_tiles": In(tiles), "mask_tile": In(tile), "mask": Out(1),
                **{name: Out(COUNTER_BITS) for name in STEREO_EVENTS}}

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.tile_merge = merge = TileMergeUnit(self.config)
        m.submodules.fork = fork = Fork(merge.groups.payload.shape())
        m.submodules.reader = reader = ListReader(self.config)
        m.submodules.headers = headers = HeaderMaker(self.config)
        m.submodules.sorter = sorter = HierarchicalSorter(self.config)
        m.submodules.handover = buffer = handover(self.config)
        m.submodules.fetch = fetch = SplatFetch(self.config)
        rows = OUTPUT_DRAINS * self.config.cores_y if self.config.incremental else None
        m.submodules.array = array = VrcArray(self.config, lines=rows)
        m.submodules.writer = writer = PixelWriter(self.config)
        for unit in (merge, reader, headers, sorter, fetch, array, writer):
            connect_settings(m, self, unit)
        m.d.comb += merge.auto.eq(self.settings.auto_beta)
        m.d.comb += [unit.clear.eq(self.clear) for unit in (reader, headers, sorter, fetch)]
        wiring.connect(m, wiring.flipped(self.hits), merge.hits)
        opened = self._gate(m, merge, fork)
        wiring.connect(m, fork.sources[0], reader.tiles)
        wiring.connect(m, fork.sources[1], headers.tiles)
        ways = ((self._unpacked(m, reader.groups), sorter.groups), (sorter.sorted, buffer.sink), (buffer.source, fetch.sorted))
        self._sort(m, merge, array, ways)
        wiring.connect(m, headers.levels, fetch.tiles)
        wiring.connect(m, headers.headers, array.tiles)
        wiring.connect(m, fetch.entries, array.entries)
        # The rows come out of a memory, and the writer rounds them: both do not fit into a cycle.
        m.submodules.finished = finished = Buffer(array.pixels.payload.shape())
        if not self.config.stereo:
            wiring.connect(m, array.pixels, finished.sink)
        wiring.connect(m, finished.source, writer.rows)
        for name, unit in (("tiles", headers), ("entries", reader), ("spill", sorter), ("views", fetch)):
            wiring.connect(m, unit.reads, wiring.flipped(getattr(self, f"reads_{name}")))
            wiring.connect(m, wiring.flipped(getattr(self, f"data_{name}")), unit.data)
        for name, unit in (("spill", sorter), ("frame", writer)):
            wiring.connect(m, unit.writes, wiring.flipped(getattr(self, f"writes_{name}")))
            m.d.comb += unit.writes_idle.eq(getattr(self, f"idle_{name}"))
        m.d.comb += [
            writer.begin.eq(self.start), self.done.eq(writer.finished), self.overflow.eq(sorter.overflow),
            self.saturated.eq(merge.saturated | merge.outside), self.ready.eq(~merge.busy),
        ]
        watched = [reader.data, sorter.groups, buffer.sink, fetch.sorted, array.entries, writer.rows]
        if self.config.stereo:
            watched.append(self._second_eye(m, merge, headers, array.pixels, finished.sink, writer, opened))
        watch(m, self, watched)
        if self.config.counters:
            self._count(m, merge, sorter, fetch, array, writer)
        return m

    def _unpacked(self, m: Module, groups: stream.Interface) -> stream.Interface:
        """The list reader's stream, with a register behind its `ready` in machines for FPGAs, where the longest path between
        units would lead from the sorter through the list reader to the queues of memory."""
        if not self.config.bank_memories:
            return groups
        m.submodules.unpacked = unpacked = Skid(groups.payload.shape())
        wiring.connect(m, groups, unpacked.sink)
        return unpacked.source

    def _sort(self, m: Module, merge: TileMergeUnit, array: VrcArray, ways: tuple[tuple[Any, Any], ...]) -> None:
        """Connects the ways of intersections into the sorter, out of it, and to the splat fetch."""
        if self.config.lockstep:
            m.submodules.swap = swap = SwapTogether(self.config)
            groups, rows, last_row, last_column = merge.groups, array.pixels, TILE - 1, TILE - self.config.cores_x
            m.d.comb += [
                swap.clear.eq(self.clear), swap.tile.eq(groups.payload), swap.tile_moves.eq(groups.valid & groups.ready),
                swap.row_ends.eq(
                    rows.valid & rows.ready & (rows.payload.row == last_row) & (rows.payload.column == last_column))]
            ways = tuple(way for name, (source, sink) in zip(GATES, ways, strict=True) for way in (
                (source, getattr(swap, f"{name}_in")), (getattr(swap, f"{name}_out"), sink)))
        for source, sink in ways:
            wiring.connect(m, source, sink)

    def _second_eye(
        self, m: Module, merge: TileMergeUnit, headers: HeaderMaker, rows: stream.Interface, finished: stream.Interface,
        writer: PixelWriter, opened: Signal,
    ) -> stream.Interface:
        """Adds the warp unit beside the pixel writer, and connects its mask; returns the stream of rows that it takes.

        Each of the two has a buffer of its own: registers that drive both are too slow for the writer's sums.

        A pass is done when all that is rendered of it is in memory and the headers of all other tiles have been passed over. In
        the source eye's pass what was warped must be in memory, too.
        """
        m.submodules.broadcast = broadcast = Broadcast(rows.payload.shape())
        m.submodules.warp_rows = warp_rows = Buffer(rows.payload.shape())
        m.submodules.warp = warp = WarpUnit(self.config)
        connect_settings(m, self, warp)
        wiring.connect(m, rows, broadcast.sink)
        wiring.connect(m, broadcast.sources[0], finished)
        wiring.connect(m, broadcast.sources[1], warp_rows.sink)
        wiring.connect(m, warp_rows.source, warp.rows)
        wiring.connect(m, warp.writes, wiring.flipped(self.writes_warp))
        warps = Signal()
        m.d.comb += [
            warps.eq(self.settings.stereo & ~self.target), broadcast.wanted.eq(Cat(1, warps)),
            warp.writes_idle.eq(self.idle_warp), warp.begin.eq(self.start & warps),
            warp.tile.eq(Mux(opened, headers.mask_tile, self.mask_tile)),
            self.mask.eq(warp.invalid), headers.mask.eq(warp.invalid),
            writer.tile_count.eq(self.rendered_tiles),
            self.done.eq(writer.finished & headers.done & (warp.finished | ~warps)),
            self.ready.eq(~merge.busy & ~(warp.busy & self.settings.stereo)),
            self.target_tiles.eq(Mux(self.target, self.rendered_tiles, 0)),
            *(getattr(self, name).eq(Mux(warps, getattr(warp, name), 0)) for name in WARP_EVENTS),
        ]
        return warp.rows

    def _gate(self, m: Module, merge: TileMergeUnit, fork: Fork) -> Signal:
        """Holds groups back until `start`; returns whether it has come.

        The tile lists are complete when the last hit comes, but splat records may not all be in memory yet.
        """
        counted, open_ = Signal(), Signal()
        with m.If(self.hits.valid & self.hits.ready & self.hits.payload.end):
            m.d.sync += counted.eq(1)
        with m.If(self.start):
            m.d.sync += open_.eq(1)
        with m.If(self.clear):
            m.d.sync += [counted.eq(0), open_.eq(0)]
        m.d.comb += [
            self.counted.eq(counted),
            fork.sink.payload.eq(merge.groups.payload),
            fork.sink.valid.eq(merge.groups.valid & open_),
            merge.groups.ready.eq(fork.sink.ready & open_),
        ]
        return open_

    def _count(
        self, m: Module, merge: TileMergeUnit, sorter: HierarchicalSorter, fetch: SplatFetch, array: VrcArray,
        writer: PixelWriter,
    ) -> None:
        groups = merge.groups
        with m.If(groups.valid & groups.ready & groups.payload.last):
            m.d.sync += self.groups.eq(self.groups + 1)
        ops, skipped = Signal.like(self.ops), Signal.like(self.skipped)  # counts up to the previous frame
        with m.If(self.clear):
            m.d.sync += [self.groups.eq(0), ops.eq(array.ops), skipped.eq(array.skipped)]
        m.d.sync += [self.ops.eq(array.ops - ops), self.skipped.eq(array.skipped - skipped)]
        m.d.comb += [
            self.spilled_entries.eq(sorter.spilled), self.fetch_hits.eq(fetch.hits), self.fetch_misses.eq(fetch.misses),
            self.pixels.eq(writer.pixels)]
