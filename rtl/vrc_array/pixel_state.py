"""The state of the pixels of a super-tile's tiles, between visits of these tiles.

Two memories hold transmittances and sums of all tiles: in each word those of a row of the array, both level banks side by side.
A load reads the rows of its block one after the other, so that each meets the load in its row of cores
(`rtl.vrc_array.batch_row`)::

    cycle from a load's strobe    0   1      E + 1  E + 2  E + 3  E + 4  E + 5
    loading                       ~~~~
    address of row 0                         < T  >        <sums>
    state bus                                              < T  >        <sums>

E is the latency of `expand`. A store's rows come from the collection, and each is written in the cycle in which it comes.

**Hazard.** A tile is *pending* from the strobe of a store to the cycle in which the last row of its last block is written.
Loads of a pending tile are held back. So a row is never read before the last store of its tile has written it, and as stores of
a tile have loads between them, at most one is under way. tests/rtl/vrc_array/test_pixel_state.py proves both.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from rtl.pipeline import Pipeline, Staged
from rtl.vrc_array import expand
from rtl.vrc_array.batch_collect import stored_row
from rtl.vrc_array.batch_row import state_layout
from rtl.vrc_array.pixel_core import index_shape
from rtl.vrc_array.row import SUMS_LATER
from spec.config import AcceleratorConfig
from spec.supertiles import SEQUENCE_BITS, batch_tile_bits, batch_tiles, check_supertiles
from spec.tables import t_stop


class StateMemory(wiring.Component):
    """A part of the state: rows of numbers in a memory, or as they are at the start.

    Parameters:
        width: bits of a row.
        depth: number of rows.
        start: a row of a fresh state.

    Ports:
        write, row, data: strobe, address and bits of a row to write.
        read, fresh, address: strobe; the row at `address` is read, or a fresh one is given instead.
        state: the row, two cycles later. It stays until the next one.

    Throughput: one row read and one row written per cycle. A row that is read in the cycle in which it is written is undefined.
    """

    def __init__(self, width: int, depth: int, start: int):
        self._depth, self._start = depth, start
        address = (depth - 1).bit_length()
        super().__init__({
            "write": In(1), "row": In(address), "data": In(width),
            "read": In(1), "fresh": In(1), "address": In(address), "state": Out(width),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.memory = memory = Memory(shape=len(self.data), depth=self._depth, init=[])
        write, read = memory.write_port(), memory.read_port()
        shows, fresh = Signal(), Signal(reset_less=True)
        state = Signal(len(self.data), reset_less=True)
        m.d.comb += [
            write.en.eq(self.write), write.addr.eq(self.row), write.data.eq(self.data),
            read.en.eq(self.read & ~self.fresh), read.addr.eq(self.address), self.state.eq(state)]
        m.d.sync += [shows.eq(self.read), fresh.eq(self.fresh)]
        with m.If(shows):
            m.d.sync += state.eq(Mux(fresh, Const(self._start, len(self.data)), read.data))
        return m


class PixelState(wiring.Component):
    """Stores and loads the state of pixels, and tells which tiles have stopped.

    Parameters:
        config: the machine.

    Ports:
        place, fresh, block: see BatchSequencer.
        may_load: a load of tile `place` may be issued in this cycle.
        loading, storing: strobes; a load, or a store, of tile `place` is issued. `may_load` must be high for a load.
        stored: a row from the collection, for the memory or as news that a last visit ends.
        state: the state bus, for each column; see the module.
        visit, sequence: strobe; a visit of this super-tile has been taken.
        current: the super-tile of the last visit taken.
        done: one bit per tile of super-tile `current`: after a store all of its pixels, in every bank that the tile uses, have
            stopped. A bit is set two cycles after the store's last row has come. It is cleared with the tile's last row of
            pixels, and when `current` changes.
        pending: one bit per tile: a store is under way, so that its loads are held back.

    Throughput: a row is loaded and a row is stored per cycle. Loads are held back until `cores_y` cycles after the last one.
    Storage: for 16 x 16 cores with two banks and depth, 256 words of 480 bits and 256 of 2,016; in machines with joint frames
    twice as many.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_supertiles(config)
        self.config, tiles = config, batch_tiles(config)
        super().__init__({
            "place": In(batch_tile_bits(config)),
            "fresh": In(1),
            "block": In(index_shape(config.blocks)),
            "may_load": Out(1),
            "loading": In(1),
            "storing": In(1),
            "stored": In(stored_row(config)),
            "state": Out(data.ArrayLayout(state_layout(config), config.array_x)),
            "visit": In(1),
            "sequence": In(SEQUENCE_BITS),
            "current": Out(SEQUENCE_BITS),
            "done": Out(tiles),
            "pending": Out(tiles),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        last = Signal()  # the row that comes is the last of its tile
        m.d.comb += last.eq(self._within(self.stored.row).all() & (self._within(self.stored.column) == self._last_column))
        apart = self._loads(m)
        self._hold(m, apart, last)
        self._judge(m, last)
        return m

    def _hold(self, m: Module, apart: Value, last: Value) -> None:
        """Holds back loads of tiles with a store under way."""
        begins, lands = Signal(len(self.pending)), Signal(len(self.pending))
        m.d.comb += [
            begins.eq(Mux(self.storing, 1 << self.place, 0)),
            lands.eq(Mux(self.stored.valid & last, 1 << self.stored.place, 0)),
            self.may_load.eq(apart & ~self.pending.bit_select(self.place, 1)),
        ]
        m.d.sync += self.pending.eq((self.pending | begins) & ~lands)

    def _loads(self, m: Module) -> Value:
        """Reads the rows of loads; returns whether the next load may follow."""
        config, row, running = self.config, Signal(range(self.config.array_y)), Signal()
        place, fresh, block = (Signal.like(port, reset_less=True) for port in (self.place, self.fresh, self.block))
        ends = row == config.array_y - 1
        with m.If(self.loading):
            m.d.sync += [running.eq(1), place.eq(self.place), fresh.eq(self.fresh), block.eq(self.block)]
        with m.Elif(ends):
            m.d.sync += running.eq(0)
        m.d.sync += row.eq(Mux(running & ~ends, row + 1, 0))

        across, p = self._across, Pipeline(m, load=running)
        down = block[across:] if config.blocks > 1 else Cat()
        address = p.data("address", Cat(row, down, block[:across], place))
        load, new = p.control("load", running), p.data("new", fresh)
        t_width = config.formats.transmittance.width
        lanes = config.array_x * config.level_banks
        pixels, state = ([bank for lane in port for bank in lane] for port in (self.stored.pixels, self.state))
        begin = expand.latency(config)
        self._part(m, "transmittances", (1 << t_width * lanes) - 1, (load, new, address), begin,
                   [pixel.transmittance for pixel in pixels], [pixel.transmittance for pixel in state])
        self._part(m, "sums", 0, (load, new, address), begin + SUMS_LATER,
                   [value for pixel in pixels for value in self._sums(pixel)],
                   [value for pixel in state for value in self._sums(pixel)])
        return ~running | ends

    @property
    def _region_bits(self) -> int:
        """Bits of a row's or a column's number in the region of the array."""
        return (self.config.region - 1).bit_length()

    @property
    def _last_column(self) -> int:
        """First column of a region's last block."""
        return self.config.region - self.config.array_x

    def _within(self, place: Value) -> Value:
        """A row or column of the tile as one of the region."""
        return place[: self._region_bits]

    @property
    def _across(self) -> int:
        """Bits of a block's column."""
        return (self.config.region // self.config.array_x - 1).bit_length()

    def _sums(self, pixel: data.View) -> list[Value]:
        return [*pixel.colour, *([pixel.depth] if self.config.depth else [])]

    def _part(
        self, m: Module, name: str, start: int, read: tuple[Staged, Staged, Staged], stage: int, stored: list[Value],
        state: list[Value],
    ) -> None:
        """Adds the memory of a part of the state, which is read at `stage` of the addresses."""
        load, new, address = (part.at(stage) for part in read)
        rows = batch_tiles(self.config) * self.config.region**2 // self.config.array_x
        m.submodules[name] = memory = StateMemory(sum(map(len, stored)), rows, start)
        m.d.comb += [
            memory.read.eq(load), memory.fresh.eq(new), memory.address.eq(address), Cat(*state).eq(memory.state),
            memory.write.eq(self.stored.valid), memory.data.eq(Cat(*stored)),
            memory.row.eq(Cat(
                self._within(self.stored.row), self._within(self.stored.column)[self._region_bits - self._across:],
                self.stored.place))]

    def _judge(self, m: Module, last: Value) -> None:
        """Finds out whether all pixels of a stored tile have stopped, a cycle after its rows."""
        row, limit = self.stored, t_stop(self.config.formats)
        here, so_far, ends = Signal(), Signal(init=1), Signal()
        final, place, sequence = Signal(), Signal.like(row.place), Signal.like(row.sequence)
        levels = range(self.config.level_banks)
        below = [Cat(lane[level].transmittance < limit for lane in row.pixels).all() for level in levels]
        m.d.sync += [
            here.eq(below[0] & (below[-1] | ~row.blend)), ends.eq((row.valid | row.final) & last),
            final.eq(row.final), place.eq(row.place), sequence.eq(row.sequence)]
        rows = Signal()  # a row of a store is judged
        m.d.sync += rows.eq(row.valid)
        with m.If(rows):
            m.d.sync += so_far.eq(ends | so_far & here)
        with m.If(ends & final):
            m.d.sync += self.done.bit_select(place, 1).eq(0)
        with m.Elif(ends & so_far & here & (sequence == self.current)):
            m.d.sync += self.done.bit_select(place, 1).eq(1)
        with m.If(self.visit):
            m.d.sync += self.current.eq(self.sequence)
            with m.If(self.sequence != self.current):
                m.d.sync += self.done.eq(0)
