"""The warp unit: rows of the source eye's frame, as they leave the array, to the target eye's frame in memory.

      rows ─► lanes: RowQueue ─► Disparity ─► StripBank ─► Window ─► Fill ─► Pack ─► writes
              row r of a tile to lane r mod warp_lanes       │                 │
                                                    neighbours and holes       └─► mask: tiles with holes left

Rows of a tile row are scattered into the open strip while the closed one, the tile row before, is filled, written and cleared.
When both are done they swap; rows that come early wait. docs/stereo.md defines the result::

    rows      < tile row 0            >  < tile row 1            >  < tile row 2            >
    open      < strip 0               >  < strip 1               >  < strip 0               >
    closed                               < strip 0    >             < strip 1    >             < strip 0    >
    finished  ____________________________________________________________________________________________~~~~
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.emit import add_shared, to_verilog
from rtl.shapes import layout, shape
from rtl.warp_unit.bank import StripBank
from rtl.warp_unit.delay import Delay
from rtl.warp_unit.disparity import Disparity, carried_cycles, carried_layout, disparity_latency
from rtl.warp_unit.fill import Fill
from rtl.warp_unit.pack import ADDRESS_BITS, Pack
from rtl.warp_unit.queue import RowQueue, column_bits, place_layout, sub_rows
from rtl.warp_unit.window import Window
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BITS, frame_settings, write_request
from spec.queues import COUNTER_BITS
from spec.records import frame_tiles, pixel_row, tile_index

_SETTINGS = ("width", "height", "source_right", "disparity_scale", "target_frame_base")

_TILE_BITS = (TILE - 1).bit_length()

_IN_BANK = 2
"""Cycles from a pixel's arrival at a bank until it is written."""

EVENTS = ("warped", "filled", "invalid_tiles")
"""What is counted, as `spec.registers.STEREO_EVENTS` says."""


class WarpUnit(wiring.Component):
    """The source eye's rows to the target eye's frame.

    Parameters:
        config: the machine, with stereo; `cores_x`, `row_width`, `counters` and those of warping matter here.

    Ports:
        rows: PixelRow items; those of a tile row in any order, tile rows from the top. Nothing is taken before `begin`.
        writes: the memory's; words whose strobe is low are 0.
        writes_idle: the memory has all writes that were taken.
        width, height, source_right, disparity_scale, target_frame_base: settings of the frame.
        begin: strobe before a frame's first row: `finished` falls, events are 0 again.
        finished: all rows of the frame have come since `begin`, and memory has the target's. Stays until `begin`.
        busy: a pixel is on its way, or the strips are being cleared after a reset.
        tile: a tile's number; `invalid`, a cycle later: holes are left in it. Right while `finished`.
        warped, filled, invalid_tiles: events since `begin`; 0 for ever without `config.counters`.

    Storage in bits, of W = row_width and keys of k = 8 + bits of W: strips 16 W (2 * 26 + k), 2,181,120 for PAPER; queues of a
    tile, or two rows a lane, of 78 a pixel, 20,240; beats 6,400; pixels in division 3,040; mask 1 a
    tile, 14,400.
    Throughput: warp_lanes pixels a cycle into the open strip; as many out of the closed one, but 8 at most, a beat a cycle, and
    a cycle more for every hole that is filled beyond a group's first. For PAPER's lanes a strip of width w takes 4 w + 27
    cycles in, and from the swap to the last write 4 w + 26. Latency for PAPER: 27 cycles from a row's arrival to the strip, 42
    from the swap to the first write. After a reset the strips are cleared first: 16 W / warp_lanes cycles.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if not config.stereo:
            raise ValueError(f"config must be a machine with stereo, not {config!r}")
        self.config = config
        settings = {f.name: In(shape(f.format)) for f in frame_settings(config).fields if f.name in _SETTINGS}
        super().__init__({
            "rows": In(stream.Signature(layout(pixel_row(config)))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            "writes_idle": In(1),
            **settings,
            "begin": In(1), "finished": Out(1), "busy": Out(1),
            "tile": In(shape(tile_index(config))), "invalid": Out(1),
            **{name: Out(COUNTER_BITS) for name in EVENTS},
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        carries: list[Value] = []
        self._last = Signal(column_bits(self.config), name="last")
        self._width, scale = Signal.like(self.width, name="frame_width"), Signal.like(self.disparity_scale, name="scale")
        m.d.sync += [  # stable since `begin`, and a row comes after it
            self._last.eq(self.width - 1), self._width.eq(self.width), scale.eq(self.disparity_scale)]
        self._wiping, self._accepts = Signal(init=1, name="wiping"), Signal(name="accepts")
        queues, banks, carried = [], [], data.ArrayLayout(carried_layout(self.config), self.config.warp_lanes)
        m.submodules.delay = delay = Delay(carried, carried_cycles(self.config))
        for lane in range(self.config.warp_lanes):
            queues.append(add_shared(m, platform, f"queue_{lane}", "warp_queue", RowQueue, self.config))
            disparity = add_shared(m, platform, f"disparity_{lane}", "warp_disparity", Disparity, self.config)
            banks.append(add_shared(m, platform, f"bank_{lane}", "warp_bank", StripBank, self.config))
            m.d.comb += [
                delay.early[lane].eq(disparity.early), disparity.late.eq(delay.late[lane]),
                disparity.load.eq(queues[lane].valid), disparity.place.eq(queues[lane].place),
                disparity.pixel.eq(queues[lane].pixel), disparity.width.eq(self._width),
                disparity.disparity_scale.eq(scale), disparity.source_right.eq(self.source_right),
                banks[lane].moved.eq(disparity.moved)]
            carries.append(disparity.carries)
        m.d.comb += delay.load.eq(Cat(carries).any())
        m.submodules.window = window = Window(self.config)
        m.submodules.fill = fill = Fill(self.config)
        m.submodules.pack = pack = Pack(self.config)
        wiring.connect(m, window.slots, fill.slots)
        wiring.connect(m, fill.filled, pack.filled)
        wiring.connect(m, pack.writes, wiring.flipped(self.writes))

        whole = self._take(m, queues)
        moving = Cat(queue.busy for queue in queues).any()
        swap, scans = self._strips(m, whole, moving, pack)
        self._scan(m, swap, scans, banks, window, pack)
        tile_ends, left = self._mask(m, pack)
        if self.config.counters:
            self._count(m, pack, tile_ends & left)
        return m

    def _take(self, m: Module, queues: list[RowQueue]) -> Value:
        """Rows to their lanes, those outside the frame to nowhere; whether a tile row's last row is taken."""
        row, lane_bits = self.rows.payload, (self.config.warp_lanes - 1).bit_length()
        x, y, lane = Cat(row.column, row.tile_x), Cat(row.row, row.tile_y), row.row[:lane_bits]
        taken, behind, inside = Signal(), Signal.like(self._width), Signal()  # pixels of the frame behind the row's first
        m.d.comb += [taken.eq(self.rows.valid & self.rows.ready), Cat(behind, inside).eq(self._width + ~x[: len(behind)])]
        for number, queue in enumerate(queues):
            m.d.comb += [
                queue.push.eq(taken & (lane == number) & inside & (y < self.height)),
                queue.row.place.x.eq(x), queue.row.place.sub.eq(row.row[lane_bits:]),
                queue.row.last.eq(Mux(behind < self.config.cores_x, behind, self.config.cores_x - 1))]
            for i in range(self.config.cores_x):
                pixel = queue.row.pixels[i]
                m.d.comb += [pixel.depth.eq(row.depth[i]), pixel.transmittance.eq(row.transmittance[i])]
                m.d.comb += [pixel.colour[c].eq(row.colour[3 * i + c]) for c in range(3)]
        room = Cat(queue.room for queue in queues)
        m.d.comb += self.rows.ready.eq(self._accepts & room.bit_select(lane, 1))

        count, column = Signal(range(TILE * TILE // self.config.cores_x)), Signal(range(-(-self.config.row_width // TILE)))
        whole = Signal()
        m.d.comb += whole.eq(taken & count.all() & (column == self._last[_TILE_BITS:]))
        with m.If(self.begin | whole):
            m.d.sync += [count.eq(0), column.eq(0)]
        with m.Elif(taken):
            m.d.sync += [count.eq(count + 1), column.eq(column + count.all())]  # a power of two to a tile
        return whole

    def _strips(self, m: Module, whole: Value, moving: Value, pack: Pack) -> tuple[Signal, Signal]:
        """The order of a frame's strips: when they swap, and while one is scanned."""
        strips = (self.height + (TILE - 1)) >> _TILE_BITS
        to_take, full, scans, ended, written = Signal.like(strips), Signal(), Signal(), Signal(), Signal()
        settle, swap = Signal(range(disparity_latency(self.config) + _IN_BANK + 1)), Signal()
        with m.If(moving):
            m.d.sync += settle.eq(disparity_latency(self.config) + _IN_BANK)
        with m.Elif(settle.any()):
            m.d.sync += settle.eq(settle - 1)
        m.d.comb += [
            self._accepts.eq(to_take.any() & ~full & ~self._wiping),
            swap.eq(full & ~moving & ~settle.any() & ~scans),
            self.finished.eq(written & self.writes_idle),
            self.busy.eq(self._wiping | moving | settle.any() | scans)]
        with m.If(whole):
            m.d.sync += [full.eq(1), to_take.eq(to_take - 1)]
        with m.If(pack.strip_ends):
            m.d.sync += ended.eq(1)
        with m.If(scans & ended & ~pack.busy):
            m.d.sync += [scans.eq(0), ended.eq(0), written.eq(~full & ~to_take.any())]
        with m.If(swap):
            m.d.sync += [full.eq(0), scans.eq(1)]
        with m.If(self.begin):
            m.d.sync += [to_take.eq(strips), written.eq(0)]
        return swap, scans

    def _scan(
        self, m: Module, swap: Signal, scans: Signal, banks: list[StripBank], window: Window, pack: Pack,
    ) -> None:
        """The strip that is scanned, its place in the frame, and the clearing of both after a reset."""
        open_, rows, left = Signal(), Signal(range(TILE + 1)), Signal.like(self.height)
        base, place = Signal(ADDRESS_BITS, reset_less=True), Signal(place_layout(self.config))
        for number, bank in enumerate(banks):
            m.d.comb += [
                bank.open.eq(open_), bank.read.eq(window.read), bank.place.eq(window.place), window.kept[number].eq(bank.kept),
                bank.wipe.eq(self._wiping), bank.clear.eq(window.clear | self._wiping),
                bank.clear_place.eq(Mux(self._wiping, place, window.clear_place))]
        m.d.comb += [
            window.start.eq(swap), window.run.eq(scans), window.last.eq(self._last), window.rows.eq(rows),
            pack.start.eq(swap), pack.base.eq(base), pack.width.eq(self._width), pack.last.eq(self._last),
            pack.rows.eq(rows)]
        with m.If(self.begin):
            m.d.sync += [left.eq(self.height), base.eq(self.target_frame_base << ADDRESS_BITS - BEAT_BITS)]
        with m.If(swap):
            m.d.sync += [
                open_.eq(~open_), rows.eq(Mux(left > TILE, TILE, left)), left.eq(left - TILE),
                base.eq(base + (self._width << _TILE_BITS))]
        with m.If(self._wiping):
            last = place.sub == sub_rows(self.config) - 1
            m.d.sync += [
                place.sub.eq(place.sub + 1), place.x.eq(place.x + last),
                self._wiping.eq(~(last & (place.x == self.config.row_width - 1)))]

    def _mask(self, m: Module, pack: Pack) -> tuple[Signal, Signal]:
        """The tiles' bits: when one is written, and what."""
        m.submodules.mask = mask = memory.Memory(shape=1, depth=frame_tiles(self.config), init=[])
        read, write = mask.read_port(), mask.write_port()
        before, left, tile_ends, tile = Signal(), Signal(), Signal(), Signal.like(self.tile)
        m.d.comb += [
            left.eq(before | pack.filled.payload.left),
            tile_ends.eq(pack.column_ends & pack.column[:_TILE_BITS].all() | pack.strip_ends),
            write.en.eq(tile_ends), write.addr.eq(tile), write.data.eq(left),
            read.addr.eq(self.tile), self.invalid.eq(read.data)]
        with m.If(pack.commits):
            m.d.sync += before.eq(left & ~tile_ends)
        with m.If(tile_ends):
            m.d.sync += tile.eq(tile + 1)
        with m.If(self.begin):
            m.d.sync += tile.eq(0)
        return tile_ends, left

    def _count(self, m: Module, pack: Pack, invalid: Value) -> None:
        group = pack.filled
        filled = group.valid & group.ready & group.payload.fills
        for name, more in zip(EVENTS, (Mux(pack.commits, group.payload.warped, 0), filled, invalid), strict=True):
            step, total = Signal(Value.cast(more).shape(), name=f"{name}_step"), getattr(self, name)
            m.d.sync += [step.eq(more), total.eq(total + step)]
            with m.If(self.begin):
                m.d.sync += total.eq(0)


def emit_warp_unit(config: AcceleratorConfig) -> str:
    """Verilog of module `warp_unit`."""
    return to_verilog(WarpUnit(config), "warp_unit")
