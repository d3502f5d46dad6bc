"""The volume rendering array of a machine with super-tiles: takes visits of tiles, and keeps the state of pixels between them.

    visits, entries -> BatchSetup -> BatchSequencer -> Expand -> BatchRow x cores_y -> BatchCollect -> pixels
                           ^           ^      |                      ^                   |      |
                           |           |      +- loading, storing -> PixelState <- rows -+      |
                           |           +-- may_load, may_drain ------|--------------------------+
                           +---------------- stopped ----------------+

As in `rtl.vrc_array.array`, only the stages before the sequencer's output can wait. With that module's E, P and L, the first
row of a store is written E + P + L + 3 cycles after its slot at the sequencer, and a load of the same tile can follow the
store after E + P + L + `cores_y` + 3 cycles, 28 with 16 by 16 cores. Loads of other tiles do not wait for it.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Signal
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.emit import add_shared
from rtl.shapes import layout, shape
from rtl.vrc_array.array import chain, to_transmittance
from rtl.vrc_array.batch_blocks import BatchSequencer
from rtl.vrc_array.batch_collect import BatchCollect
from rtl.vrc_array.batch_row import BatchRow
from rtl.vrc_array.batch_setup import BatchSetup, quarter_port
from rtl.vrc_array.collect import place_layout
from rtl.vrc_array.expand import Expand
from rtl.vrc_array.pixel_state import PixelState
from spec.config import AcceleratorConfig
from spec.queues import ARRAY_TILES, COUNTER_BITS
from spec.records import pixel_row
from spec.supertiles import SEQUENCE_BITS, batch_tiles, check_supertiles, tile_visit, visit_entry


class BatchArray(wiring.Component):
    """The array with its setup unit, the state of pixels and the output buffer.

    Parameters:
        config: the machine, with lists by super-tile.
        lines: rows of the line buffer; None stands for the minimum (see `rtl.vrc_array.collect`).

    Ports:
        visits: visits of tiles. A tile's first one is `fresh`, its last one `final`; all visits of a super-tile follow each
            other.
        entries: the intersections of each visit in rendering order, then an item with `end`.
        quarter: with streams, the column (bit 0) and the row (bit 1) of this array's region in its tile; constant. What is said
            below of tiles then holds for their regions.
        background: r, g, b behind everything; must be stable during a frame.
        pixels: all pixel rows of every tile, ordered by final visit, then block (row-major), then row.
        current: the super-tile (`sequence`) of the last visit taken.
        done: one bit per tile of `current`, in joint frames of both eyes: all of its pixels had stopped when its state was
            last stored. See PixelState.
        ops: ops issued to the cores since reset, loads and stores among them; an op counts once for each block.
        skipped: intersections skipped since reset because all pixels of their tile had stopped.
        waits: cycles since reset in which an op waited, and the array with it: a load for its tile's last store, or one that
            ends a block for free space in the output buffer.
        busy: a visit, its pixels or a store are inside.

    Throughput: one intersection per cycle; two cycles if both levels of a blend tile use it, and `config.blocks` times as many
    if the array is smaller than a tile. A visit adds a load, and a store or a background op for each level. It takes at least
    `cores_y` cycles per block, and a machine with several blocks spends as many again on its load. Order is kept.
    """

    def __init__(self, config: AcceleratorConfig, *, lines: int | None = None):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_supertiles(config)
        self.config, self._collect = config, BatchCollect(config, lines=lines)
        super().__init__({
            "visits": In(stream.Signature(layout(tile_visit(config)))),
            "entries": In(stream.Signature(layout(visit_entry(config)))),
            **quarter_port(config),
            "background": In(data.ArrayLayout(shape(config.formats.colour), 3)),
            "pixels": Out(stream.Signature(layout(pixel_row(config)))),
            "current": Out(SEQUENCE_BITS),
            "done": Out(batch_tiles(config)),
            "ops": Out(COUNTER_BITS),
            "skipped": Out(COUNTER_BITS),
            "waits": Out(COUNTER_BITS),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.setup = setup = BatchSetup(self.config)
        m.submodules.sequencer = sequencer = BatchSequencer(self.config)
        m.submodules.expand = expand = Expand(self.config)
        m.submodules.collect = collect = self._collect
        m.submodules.state = state = PixelState(self.config)
        rows = [add_shared(m, platform, f"row{y}", "batch_row", BatchRow, self.config) for y in range(self.config.array_y)]
        wiring.connect(m, wiring.flipped(self.entries), setup.entries)
        wiring.connect(m, setup.ops, sequencer.ops)
        wiring.connect(m, collect.pixels, wiring.flipped(self.pixels))
        m.d.comb += [
            setup.background.eq(self.background),
            sequencer.may_drain.eq(collect.may_drain),
            sequencer.may_store.eq(collect.may_store),
            sequencer.may_load.eq(state.may_load),
            *(getattr(state, name).eq(getattr(sequencer, name)) for name in ("place", "fresh", "block", "loading", "storing")),
            collect.draining.eq(sequencer.draining),
            collect.storing.eq(sequencer.storing),
            collect.place.eq(sequencer.place),
            state.stored.eq(collect.stored),
            expand.issue.eq(sequencer.issue),
            *(row.state.eq(state.state) for row in rows),
            self.current.eq(state.current),
            self.done.eq(state.done),
        ]
        if self.config.streams > 1:
            m.d.comb += [setup.quarter.eq(self.quarter), collect.quarter.eq(self.quarter)]
        chain(m, expand, rows, collect)
        in_flight = self._take_visits(m, setup, state, rows)
        m.d.comb += self.busy.eq(in_flight.any() | collect.busy | state.pending.any())
        issued = Signal()  # a cycle later: whether an op may be issued is known late
        m.d.sync += [
            issued.eq(sequencer.issued), self.ops.eq(self.ops + issued), self.skipped.eq(self.skipped + setup.skipped),
            self.waits.eq(self.waits + sequencer.waits)]
        return m

    def _take_visits(self, m: Module, setup: BatchSetup, state: PixelState, rows: list[BatchRow]) -> Signal:
        """Passes visits to the setup unit and their places to the collection; returns the number of visits in flight.

        Whether the pixels of a tile have stopped is known only after its load has left the last row, and if no other visit is
        in flight.
        """
        in_flight, collect = Signal(range(ARRAY_TILES + 1)), self._collect
        m.submodules.places = places = SyncFIFOBuffered(width=place_layout(self.config).size, depth=ARRAY_TILES)
        place, visit = data.View(place_layout(self.config), places.w_data), self.visits.payload
        taken, room = Signal(), in_flight != ARRAY_TILES
        m.d.comb += [
            setup.visits.payload.eq(visit),
            setup.visits.valid.eq(self.visits.valid & room),
            self.visits.ready.eq(setup.visits.ready & room),
            taken.eq(self.visits.valid & self.visits.ready),
            places.w_en.eq(taken),
            *(place[name].eq(visit[name]) for name in place.shape().members),
            collect.places.payload.eq(places.r_data),
            collect.places.valid.eq(places.r_rdy),
            places.r_en.eq(collect.places.ready),
            state.visit.eq(taken),
            state.sequence.eq(visit.sequence),
        ]
        op, banks = rows[-1].op_out, self.config.level_banks
        whole = op.valid & (op.bank >= (self.config.blocks - 1) * banks)  # of the last block
        loaded, left = to_transmittance(m, Cat(whole & op.load, whole & op.drain))
        known = Signal()
        m.d.sync += [in_flight.eq(in_flight + taken - left), known.eq((known | loaded) & ~left)]
        for level in range(banks):
            stopped = Signal(name=f"stopped_{level}")
            m.d.sync += stopped.eq(Cat(row.stopped[level] for row in rows).all())
            m.d.comb += setup.stopped[level].eq(known & stopped & (in_flight == 1))
        return in_flight
