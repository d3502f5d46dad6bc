"""The volume rendering array: takes intersections in rendering order and delivers finished pixel rows.

    tiles, entries -> SetupUnit -> BlockSequencer -> Expand -> VrcRow x cores_y -> Collect -> pixels
                          ^              ^                          |                 |
                          |              +--------- may_drain ------|-----------------+
                          +----------------- stopped ---------------+

Only the stages before the sequencer's output can wait; from there to the output buffer every latency is fixed. Let E be the
latency of `expand`, and P and L the row's PIPELINE and SUMS_LATER. An op is issued `setup.LATENCY` cycles after the transfer of
its intersection (2 more with several blocks). It enters row r after 1 + E + r more cycles, has changed that row's transmittance
after P more, and its sums after P + L more. The first pixel row of a tile leaves `setup.LATENCY` + E + P + L + 8 cycles after
the slot of the tile's last background op. This is 32 for 16 by 16 cores, and 3 less without levels. A double buffer delivers
that row only when the last row of the tile is in.
"""

from __future__ import annotations

from collections.abc import Sequence

from amaranth.hdl import Cat, Module, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.emit import add_shared
from rtl.shapes import layout, shape
from rtl.vrc_array.blocks import BlockSequencer
from rtl.vrc_array.collect import Collect, place_layout
from rtl.vrc_array.expand import Expand
from rtl.vrc_array.memory_row import MemoryRow
from rtl.vrc_array.row import PIPELINE, VrcRow
from rtl.vrc_array.setup import SetupUnit
from spec.config import AcceleratorConfig
from spec.queues import ARRAY_TILES, COUNTER_BITS
from spec.records import array_splat, pixel_row, tile_header


class VrcArray(wiring.Component):
    """The array with its setup unit and output buffer.

    Parameters:
        config: the machine.
        lines: rows of the line buffer; None stands for the minimum (see `rtl.vrc_array.collect`).

    Ports:
        tiles: one header per tile, in the order in which its pixels shall leave.
        entries: the intersections of each tile, as many as its header's count, in rendering order.
        background: r, g, b behind everything; must be stable during a frame.
        pixels: all pixel rows of every tile, ordered by tile, then block (row-major), then row.
        ops: ops issued to the cores since reset; an op counts once for each block.
        skipped: intersections skipped since reset because all pixels of their tile had stopped.
        waits: cycles since reset in which an op that ends a block waited for free space in the output buffer, and the array
            with it.
        busy: a tile or its pixels are inside.

    Throughput: one intersection per cycle; two cycles if both levels of a blend tile use it, and `config.blocks` times as many
    if the array is smaller than a tile. Every tile adds one background op for each level, and takes at least `cores_y` cycles
    per block. Order is kept. Latency: see the module.
    """

    def __init__(self, config: AcceleratorConfig, *, lines: int | None = None):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config, self._collect = config, Collect(config, lines=lines)
        super().__init__({
            "tiles": In(stream.Signature(layout(tile_header(config)))),
            "entries": In(stream.Signature(layout(array_splat(config)))),
            "background": In(data.ArrayLayout(shape(config.formats.colour), 3)),
            "pixels": Out(stream.Signature(layout(pixel_row(config)))),
            "ops": Out(COUNTER_BITS),
            "skipped": Out(COUNTER_BITS),
            "waits": Out(COUNTER_BITS),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.setup = setup = SetupUnit(self.config)
        m.submodules.sequencer = sequencer = BlockSequencer(self.config)
        m.submodules.expand = expand = Expand(self.config)
        m.submodules.collect = collect = self._collect
        kind = ("memory_row", MemoryRow) if self.config.bank_memories else ("vrc_row", VrcRow)
        rows = [add_shared(m, platform, f"row{y}", *kind, self.config) for y in range(self.config.cores_y)]
        wiring.connect(m, wiring.flipped(self.entries), setup.entries)
        wiring.connect(m, setup.ops, sequencer.ops)
        wiring.connect(m, collect.pixels, wiring.flipped(self.pixels))
        m.d.comb += [
            setup.background.eq(self.background),
            sequencer.may_drain.eq(collect.may_drain),
            collect.draining.eq(sequencer.draining),
            expand.issue.eq(sequencer.issue),
        ]
        chain(m, expand, rows, collect)
        in_flight = self._take_tiles(m, setup, collect, rows)
        m.d.comb += self.busy.eq(in_flight.any() | collect.busy)
        m.d.sync += [
            self.ops.eq(self.ops + sequencer.issued), self.skipped.eq(self.skipped + setup.skipped),
            self.waits.eq(self.waits + sequencer.waits)]
        return m

    def _take_tiles(self, m: Module, setup: SetupUnit, collect: Collect, rows: list[VrcRow]) -> Signal:
        """Passes headers to the setup unit and their places to the collection; returns the number of tiles in flight.

        Whether the pixels of a level have stopped is known only after the first op of the tile in that level has left the last
        row. The result concerns the tile in the setup unit only if no other tile is in flight.
        """
        in_flight = Signal(range(ARRAY_TILES + 1))
        m.submodules.places = places = SyncFIFOBuffered(width=place_layout(self.config).size, depth=ARRAY_TILES)
        place, header = data.View(place_layout(self.config), places.w_data), self.tiles.payload
        taken, room = Signal(), in_flight != ARRAY_TILES
        m.d.comb += [
            setup.tiles.payload.eq(header),
            setup.tiles.valid.eq(self.tiles.valid & room),
            self.tiles.ready.eq(setup.tiles.ready & room),
            taken.eq(self.tiles.valid & self.tiles.ready),
            places.w_en.eq(taken),
            *(place[name].eq(header[name]) for name in ("tile_x", "tile_y", "blend", "plane")),
            collect.places.payload.eq(places.r_data),
            collect.places.valid.eq(places.r_rdy),
            places.r_en.eq(collect.places.ready),
        ]
        first, left = self._leaving(m, rows[-1].op_out)
        m.d.sync += in_flight.eq(in_flight + taken - left)
        for level in range(self.config.level_banks):
            known, stopped = Signal(name=f"known_{level}"), Signal(name=f"stopped_{level}")
            m.d.sync += [
                known.eq((known | first[level]) & ~left),
                stopped.eq(Cat(row.stopped[level] for row in rows).all()),
            ]
            m.d.comb += setup.stopped[level].eq(known & stopped & (in_flight == 1))
        return in_flight

    def _leaving(self, m: Module, op: data.View) -> tuple[Signal, Signal]:
        """Strobes of the last block, a cycle before `stopped` shows them: each level's first op, and the tile's last op."""
        last_block = (self.config.blocks - 1) * self.config.level_banks
        whole = op.valid & (op.bank >= last_block) if last_block else op.valid
        level = op.bank[0] if self.config.level_banks == 2 else 0
        strobes: Value = Cat(whole & op.drain, *(whole & op.first & (level == i) for i in range(self.config.level_banks)))
        strobes = to_transmittance(m, strobes)
        return strobes[1:], strobes[0]


def chain(m: Module, expand: Expand, rows: Sequence[VrcRow], collect: Collect) -> None:
    """Connects each row to the row below it and to the collection."""
    op, exponents, slopes = expand.op, expand.exponents, expand.slopes
    for row, finished in zip(rows, collect.rows, strict=True):
        m.d.comb += [
            row.op_in.eq(op),
            row.exponent_in.eq(exponents),
            row.slope_in.eq(slopes),
            finished.draining.eq(row.draining),
            finished.drained.eq(row.drained),
            finished.pixels.eq(row.pixels),
        ]
        op, exponents, slopes = row.op_out, row.exponent_out, row.slope_out


def to_transmittance(m: Module, strobes: Value) -> Value:
    """Strobes made from a row's `op_out`, delayed to the transmittance after that op."""
    for i in range(PIPELINE - 1):
        later = Signal(len(strobes), name=f"leaving_{i}")
        m.d.sync += later.eq(strobes)
        strobes = later
    return strobes
