"""The state of the pixels of a super-tile's tiles, between visits of these tiles.

Two memories hold transmittances and sums of all tiles, a row of the array a word, both level banks side by side. A load reads the
rows of its block one after the other, so that each meets the load in the row of cores (`rtl.vrc_array.batch_row`)::

    cycle from a load's strobe    0   1      E + 1  E + 2  E + 3  E + 4  E + 5
    loading                       ~~~~
    address of row 0                         < T  >        <sums>
    state bus                                              < T  >        <sums>

E is the latency of `expand`. A store's rows come from the collection, and each is written in the cycle in which it comes.

**Hazard.** A tile is *pending* from the strobe of a store to the cycle in which its last row of its last block is written. Loads
of a pending tile are held back. So a row is never read before the last store of its tile has written it, and as stores of a tile
have loads between them, at most one is under way. tests/rtl/vrc_array/test_pixel_state.py proves both.
"""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Module, Mux, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from rtl.pipeline import Pipeline
from rtl.vrc_array import expand
from rtl.vrc_array.batch_collect import stored_row
from rtl.vrc_array.batch_row import state_layout
from rtl.vrc_array.pixel_core import index_shape
from rtl.vrc_array.row import SUMS_LATER
from spec.config import AcceleratorConfig
from spec.constants import SUPER_TILES, TILE
from spec.supertiles import SEQUENCE_BITS, SUPER_PLACES, check_supertiles
from spec.tables import t_stop


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
            stopped. A bit is set when the store's last row is written. It is cleared with the tile's last row of pixels, and
            when `current` changes.
        busy: a store is under way.

    Throughput: a row is loaded and a row is stored per cycle. Loads are held back until `cores_y` cycles after the last one.
    Storage: for 16 x 16 cores with two banks and depth, 256 words of 480 bits and 256 of 2,016.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_supertiles(config)
        self.config = config
        super().__init__({
            "place": In(SUPER_PLACES),
            "fresh": In(1),
            "block": In(index_shape(config.blocks)),
            "may_load": Out(1),
            "loading": In(1),
            "storing": In(1),
            "stored": In(stored_row(config)),
            "state": Out(data.ArrayLayout(state_layout(config), config.cores_x)),
            "visit": In(1),
            "sequence": In(SEQUENCE_BITS),
            "current": Out(SEQUENCE_BITS),
            "done": Out(SUPER_TILES),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        last = Signal()  # the row that comes is the last of its tile
        m.d.comb += last.eq(self.stored.row.all() & (self.stored.column == TILE - self.config.cores_x))
        apart = self._loads(m)
        self._hold(m, apart, last)
        self._judge(m, last)
        return m

    def _hold(self, m: Module, apart: Value, last: Value) -> None:
        """Holds back loads of tiles with a store under way."""
        pending = Signal(SUPER_TILES)
        begins, lands = Signal(SUPER_TILES), Signal(SUPER_TILES)
        m.d.comb += [
            begins.eq(Mux(self.storing, 1 << self.place, 0)),
            lands.eq(Mux(self.stored.valid & last, 1 << self.stored.place, 0)),
            self.may_load.eq(apart & ~Array(pending)[self.place]),
            self.busy.eq(pending.any()),
        ]
        m.d.sync += pending.eq((pending | begins) & ~lands)

    def _loads(self, m: Module) -> Value:
        """Reads the rows of loads and writes those of stores; returns whether the next load may follow."""
        config = self.config
        row, running = Signal(range(config.cores_y)), Signal()
        place, fresh, block = (Signal.like(port, reset_less=True) for port in (self.place, self.fresh, self.block))
        ends = row == config.cores_y - 1
        with m.If(self.loading):
            m.d.sync += [running.eq(1), place.eq(self.place), fresh.eq(self.fresh), block.eq(self.block)]
        with m.Elif(ends):
            m.d.sync += running.eq(0)
        m.d.sync += row.eq(Mux(running & ~ends, row + 1, 0))
        apart = ~running | ends

        across, p = (TILE // config.cores_x - 1).bit_length(), Pipeline(m, load=running)
        address = p.data("address", Cat(row, block[across:] if config.blocks > 1 else Cat(), block[:across], place))
        valid, anew = p.control("load", running), p.data("fresh", fresh)
        written = Cat(self.stored.row, (self.stored.column >> 4 - across)[:across], self.stored.place)
        pixels = [bank for lane in self.stored.pixels for bank in lane]
        loaded = [bank for lane in self.state for bank in lane]
        start = expand.latency(config)
        self._memory(m, "transmittances", written, [pixel.transmittance for pixel in pixels], valid, anew, address, start,
                     [pixel.transmittance for pixel in loaded], 1)
        self._memory(m, "sums", written, [value for pixel in pixels for value in self._sums(pixel)], valid, anew, address,
                     start + SUMS_LATER, [value for pixel in loaded for value in self._sums(pixel)], 0)
        return apart

    def _sums(self, pixel: data.View) -> list[Value]:
        return [*pixel.colour, *([pixel.depth] if self.config.depth else [])]

    def _memory(self, m: Module, name, written, values, valid, anew, address, stage, loaded, new) -> None:
        raise NotImplementedError

    def _judge(self, m: Module, last: Value) -> None:
        raise NotImplementedError
