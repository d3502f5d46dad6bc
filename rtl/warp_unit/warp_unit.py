"""The warp unit: warps rows of the source eye's frame, as they leave the array, into the target eye's frame in memory.

      rows ─► lanes: RowQueue ─► Disparity ─► RingBank ─► Window ─► Fill ─► Pack ─► writes
              row r of a tile to lane r mod warp_lanes      │                 │
                                                   neighbours and holes       └─► mask: tiles with holes left

The target's columns lie in a ring, tile after tile and tile row after tile row. A column is in the ring from the time when the
first pixel may arrive until it is scanned, that is filled, written and cleared. docs/stereo.md defines the result. A pixel
moves by at most `reach`, which is K tiles, to the left if the source is the left eye and to the right otherwise::

    left    ... scanned | complete      | may still get pixels | next tile | later tiles | ... scanned
    right   ... scanned | complete      | next tile | gets its pixels      | later tiles | ... scanned
                          s: next scanned             t: next taken

A tile is settled when all its source pixels are in the ring. Tile s is complete when the tile K later in its row, or the last
tile of the row, has settled (right: when s itself has). Tile t is taken when every column that its pixels may reach is in the
ring: up to t itself (right: up to the tile K later in its row, or the row's last).

The two never wait for each other. Suppose that everything taken has settled and s is still not complete. Then t is at most K
tiles later (right: t is s) and not beyond the last tile of the row, and the ring holds K + 1 tiles or a whole row, so t can be
taken. Rows that arrive early wait::

    rows      < tile row 0            >< tile row 1            >
    scanned        < tile row 0            > < tile row 1            >
    finished  _________________________________________________________~~~~
"""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Mux, Signal, Value
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.emit import add_shared
from rtl.shapes import layout, shape
from rtl.warp_unit.bank import MEMORIES, RingBank, pair_bits
from rtl.warp_unit.delay import Delay
from rtl.warp_unit.disparity import Disparity, carried_cycles, carried_layout, disparity_latency
from rtl.warp_unit.fill import Fill
from rtl.warp_unit.pack import ADDRESS_BITS, Pack
from rtl.warp_unit.queue import RowQueue, column_bits, lane_rows, queue_rows, ring_tiles, sub_rows
from rtl.warp_unit.window import Window
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BITS, frame_settings, write_request
from spec.queues import COUNTER_BITS
from spec.records import frame_tiles, pixel_row, tile_index
from spec.stereo import reach

_SETTINGS = ("width", "height", "source_right", "disparity_scale", "target_frame_base")

_TILE_BITS = (TILE - 1).bit_length()

EVENTS = ("warped", "filled", "invalid_tiles")
"""The events that are counted; `spec.registers.STEREO_EVENTS` describes them."""


class WarpUnit(wiring.Component):
    """Turns the source eye's rows into the target eye's frame.

    Parameters:
        config: the machine, with stereo; `cores_x`, `row_width`, `counters` and the settings of warping are used.

    Ports:
        rows: PixelRow items; tiles come in the frame's order, the rows of a tile in any order. None is taken before `begin`.
        writes: the memory's write port; words whose strobe is low are 0.
        writes_idle: the memory has completed all writes that it took.
        width, height, source_right, disparity_scale, target_frame_base: settings of the frame.
        begin: strobe before a frame's first row; clears `finished` and the events.
        finished: all rows of the frame have come since `begin`, and memory has the target's. Stays high until `begin`.
        busy: a pixel is inside or not in memory yet, or the ring is being cleared after a reset.
        tile: the number of a tile.
        invalid: one cycle after `tile`: holes are left in that tile. Valid while `finished` is high.
        warped, filled, invalid_tiles: events since `begin`; always 0 without `config.counters`.

    Storage in bits, with C = warp_columns and keys of k = 8 + bits of `reach`: the ring 16 C (25 + k), 344,064 for PAPER;
    queues of one tile, or of two rows per lane if that is more, with 79 bits per pixel, 20,336; beats 6,400; pixels in division
    3,240; the mask 1 per tile, 14,400.
    Throughput: warp_lanes pixels per cycle into the ring. The scan delivers as many, but at most 8, that is one beat, and it
    takes one more cycle for every filled hole beyond the first of a group. With PAPER's lanes a strip of width w takes 4 w
    cycles in, plus one per tile if tiles come without a pause, and 4 w + 20 cycles out.
    Latency for PAPER: 25 cycles from a row's arrival to the ring, and 44 from a tile's last pixel in the ring to the first
    write, if that pixel makes columns complete. After a reset the ring is cleared first, which takes 8 C / warp_lanes cycles.
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
            **self._mask_ports(),
            **{name: Out(COUNTER_BITS) for name in EVENTS},
        })

    def _mask_ports(self) -> dict[str, wiring.Member]:
        """The ports by which others learn which tiles have holes."""
        return {"tile": In(shape(tile_index(self.config))), "invalid": Out(1)}

    def _packer(self) -> Pack:
        """The unit that makes beats of pixels."""
        return Pack(self.config)

    def _own_rows(self) -> tuple[Value, Value, int]:
        """Rows of pixels from the first strip on, the address of its first pixel in words, and log2 of the distance between two
        strips, in strips."""
        return self.height, self.target_frame_base << ADDRESS_BITS - BEAT_BITS, 0

    def elaborate(self, platform: object) -> Module:
        m = Module()
        carries: list[Value] = []
        self._last = Signal(column_bits(self.config), name="last")
        self._width, scale = Signal.like(self.width, name="frame_width"), Signal.like(self.disparity_scale, name="scale")
        m.d.sync += [  # these are stable from `begin` on, and the first row comes later
            self._last.eq(self.width - 1), self._width.eq(self.width), scale.eq(self.disparity_scale)]
        self._wiping, self._accepts = Signal(init=1, name="wiping"), Signal(name="accepts")
        queues, banks, carried = [], [], data.ArrayLayout(carried_layout(self.config), self.config.warp_lanes)
        m.submodules.delay = delay = Delay(carried, carried_cycles(self.config))
        for lane in range(self.config.warp_lanes):
            queues.append(add_shared(m, platform, f"queue_{lane}", "warp_queue", RowQueue, self.config))
            disparity = add_shared(m, platform, f"disparity_{lane}", "warp_disparity", Disparity, self.config)
            banks.append(add_shared(m, platform, f"bank_{lane}", "warp_bank", RingBank, self.config))
            m.d.comb += [
                delay.early[lane].eq(disparity.early), disparity.late.eq(delay.late[lane]),
                disparity.load.eq(queues[lane].valid), disparity.place.eq(queues[lane].place),
                disparity.pixel.eq(queues[lane].pixel), disparity.last.eq(self._last),
                disparity.disparity_scale.eq(scale), disparity.source_right.eq(self.source_right),
                banks[lane].moved.eq(disparity.moved)]
            carries.append(disparity.carries)
        m.d.comb += delay.load.eq(Cat(carries).any())
        m.submodules.window = window = Window(self.config)
        m.submodules.fill = fill = Fill(self.config)
        m.submodules.pack = pack = self._packer()
        wiring.connect(m, window.slots, fill.slots)
        wiring.connect(m, fill.filled, pack.filled)
        wiring.connect(m, pack.writes, wiring.flipped(self.writes))

        row_taken, held = self._take(m, queues, window.tile_ends)
        starts, scans, limits = self._complete(m, self._settles(m, queues))
        self._strips(m, row_taken, held, starts, scans, pack)
        self._scan(m, starts, scans, limits, banks, window, pack)
        tile_ends, left = self._mask(m, pack)
        if self.config.counters:
            self._count(m, pack, tile_ends & left)
        return m

    def _take(self, m: Module, queues: list[RowQueue], scanned: Value) -> tuple[Value, Value]:
        """Passes rows to their lanes. Returns whether the last row of a tile row is taken, and whether any tile has begun to
        arrive and has not been scanned."""
        row, lane_bits = self.rows.payload, (self.config.warp_lanes - 1).bit_length()
        x, y, lane = Cat(row.column, row.tile_x), Cat(row.row, row.tile_y), row.row[:lane_bits]
        # `behind`: pixels of the frame to the right of the row's first
        taken, behind, in_row = Signal(), Signal.like(self._width), Signal()
        inside, slot = Signal(), Signal(range(ring_tiles(self.config)))
        m.d.comb += [
            taken.eq(self.rows.valid & self.rows.ready), Cat(behind, in_row).eq(self._width + ~x[: len(behind)]),
            inside.eq(in_row & (y < self.height))]
        for number, queue in enumerate(queues):
            m.d.comb += [
                queue.push.eq(taken & (lane == number)), queue.row.inside.eq(inside), queue.row.place.x.eq(x),
                queue.row.place.sub.eq(row.row[lane_bits:]), queue.row.place.slot.eq(slot),
                queue.row.last.eq(Mux(inside, Mux(behind < self.config.cores_x, behind, self.config.cores_x - 1), 0))]
            for i in range(self.config.cores_x):
                pixel = queue.row.pixels[i]
                m.d.comb += [pixel.depth.eq(row.depth[i]), pixel.transmittance.eq(row.transmittance[i])]
                m.d.comb += [pixel.colour[c].eq(row.colour[3 * i + c]) for c in range(3)]

        count, column = Signal(range(TILE * TILE // self.config.cores_x)), Signal(range(-(-self.config.row_width // TILE)))
        # `held`: tiles from the next scanned to the next taken
        held, ends, opened = Signal(range(ring_tiles(self.config) + 1)), Signal(), Signal()
        room, ahead = Cat(queue.room for queue in queues), Mux(self.source_right, self._reached(column), 0)
        m.d.comb += [
            ends.eq(taken & count.all()),  # a tile has a power of two of rows
            self.rows.ready.eq(self._accepts & opened & room.bit_select(lane, 1))]
        gone = Signal()
        # once high, it stays so for a whole tile
        m.d.sync += [gone.eq(scanned), opened.eq((held + ahead < ring_tiles(self.config)) & ~ends)]
        with m.If(ends & ~gone):
            m.d.sync += held.eq(held + 1)
        with m.Elif(gone & ~ends):
            m.d.sync += held.eq(held - 1)
        row_ends = column == self._last[_TILE_BITS:]
        with m.If(taken):
            m.d.sync += count.eq(count + 1)
        with m.If(ends):
            m.d.sync += [slot.eq(slot + 1), column.eq(Mux(row_ends, 0, column + 1))]
        with m.If(self.begin):
            m.d.sync += [count.eq(0), column.eq(0)]
        return ends & row_ends, held.any() | count.any()

    def _reached(self, column: Value) -> Value:
        """The number of tiles that `reach` extends to the right of a tile, within its row."""
        most, behind = -(-reach(self.config) // TILE), (self._last[_TILE_BITS:] - column)[: len(column)]
        return Mux(behind < most, behind, most)

    def _settles(self, m: Module, queues: list[RowQueue]) -> Value:
        """Strobe: a tile has settled. Its pixels have left the queues of all lanes and had the time to reach the ring."""
        most = 1 - -(queue_rows(self.config) + 1) // lane_rows(self.config)  # tiles that a lane may be ahead of another
        left = [Signal(range(most + 1), name=f"left_{lane}") for lane in range(len(queues))]
        every, way = Signal(), Signal(disparity_latency(self.config))  # the scan begins only after the last pixel has arrived
        m.d.comb += every.eq(Cat(count.any() for count in left).all())
        m.d.sync += [way.eq(Cat(every, way)), *(
            count.eq(count + queue.tile_ends - every) for count, queue in zip(left, queues, strict=True))]
        return way[-1]

    def _complete(self, m: Module, settles: Value) -> tuple[Signal, Signal, list[Value]]:
        """Opens columns to the scan, tile by tile, once no further pixel can reach them.

        Returns a strobe before a strip, whether a strip is being scanned, and the `limits` of the scan for each memory.
        """
        tiles, pairs = ring_tiles(self.config), TILE * sub_rows(self.config) // MEMORIES
        # tiles settled and not yet open; the slot of the next tile to open
        settled, slot = Signal(range(tiles + 1)), Signal(range(tiles))
        column, more, starts, scans = Signal(range(-(-self.config.row_width // TILE))), Signal(), Signal(), Signal()
        goes, opens, ends = Signal(), Signal(), Signal()
        limits = [Signal(pair_bits(self.config) + 1, name=f"limit_{i}") for i in range(MEMORIES)]
        m.d.comb += [
            goes.eq(settled.any() & ~scans & ~starts), ends.eq(column == self._last[_TILE_BITS:]),
            opens.eq(scans & more & (settled > Mux(self.source_right, 0, self._reached(column))))]
        m.d.sync += starts.eq(goes)
        with m.If(settles & ~opens):  # `opens` is on the critical path, so it only selects: no adder waits for it
            m.d.sync += settled.eq(settled + 1)
        with m.Elif(opens & ~settles):
            m.d.sync += settled.eq(settled - 1)
        with m.If(starts):
            m.d.sync += [scans.eq(1), more.eq(1), column.eq(0)]
        with m.If(opens):
            m.d.sync += [slot.eq(slot + 1), column.eq(column + 1), more.eq(~ends)]
        places = (self._last[:_TILE_BITS] + 1) * sub_rows(self.config)  # places of a lane in the last tile of a tile row
        for number, limit in enumerate(limits):
            with m.If(goes):
                m.d.sync += limit.eq(slot * pairs)
            with m.Elif(opens):
                m.d.sync += limit.eq(limit + Mux(ends, places + (MEMORIES - 1 - number) >> 1, pairs))
        return starts, scans, limits

    def _strips(
        self, m: Module, row_taken: Value, held: Value, starts: Signal, scans: Signal, pack: Pack,
    ) -> None:
        """Tracks the strips of a frame, in order, and the end of the frame."""
        height, _, apart = self._own_rows()
        strips = (height + ((TILE << apart) - 1)) >> (_TILE_BITS + apart)
        to_take, to_scan, ended, written = Signal.like(strips), Signal.like(strips), Signal(), Signal()
        m.d.comb += [
            self._accepts.eq(to_take.any() & ~self._wiping), self.finished.eq(written & self.writes_idle),
            self.busy.eq(self._wiping | held | starts | scans)]
        with m.If(row_taken):
            m.d.sync += to_take.eq(to_take - 1)
        with m.If(starts):
            m.d.sync += to_scan.eq(to_scan - 1)
        with m.If(pack.strip_ends):
            m.d.sync += ended.eq(1)
        with m.If(scans & ended & ~pack.busy):
            m.d.sync += [scans.eq(0), ended.eq(0), written.eq(~to_scan.any())]
        with m.If(self.begin):
            m.d.sync += [to_take.eq(strips), to_scan.eq(strips), written.eq(0)]

    def _scan(
        self, m: Module, starts: Signal, scans: Signal, limits: list[Value], banks: list[RingBank], window: Window, pack: Pack,
    ) -> None:
        """Tracks the strip that is scanned and its place in the frame, and clears the ring after a reset."""
        rows, left = Signal(range(TILE + 1)), Signal.like(self.height)
        base, pair = Signal(ADDRESS_BITS, reset_less=True), Signal(pair_bits(self.config))
        for number, bank in enumerate(banks):
            m.d.comb += [
                bank.start.eq(starts), *(bank.limits[i].eq(limit) for i, limit in enumerate(limits)),
                bank.which.eq(window.which), bank.take.eq(window.take),
                window.kept_valid[number].eq(bank.kept_valid), window.kept[number].eq(bank.kept),
                bank.wipe.eq(self._wiping), bank.wipe_pair.eq(pair)]
        m.d.comb += [
            window.start.eq(starts), window.run.eq(scans), window.last.eq(self._last), window.rows.eq(rows),
            pack.start.eq(starts), pack.base.eq(base), pack.width.eq(self._width), pack.last.eq(self._last),
            pack.rows.eq(rows)]
        height, first, apart = self._own_rows()
        with m.If(self.begin):
            m.d.sync += [left.eq(height), base.eq(first)]
        with m.If(starts):
            m.d.sync += [
                rows.eq(Mux(left > TILE, TILE, left)), left.eq(left - (TILE << apart)),
                base.eq(base + (self._width << _TILE_BITS + apart))]
        with m.If(self._wiping):
            m.d.sync += [pair.eq(pair + 1), self._wiping.eq(~pair.all())]

    def _mask(self, m: Module, pack: Pack) -> tuple[Signal, Signal]:
        """Adds the memory of one bit per tile; returns the strobe that writes it, and the value written: holes are left."""
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
