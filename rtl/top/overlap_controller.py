"""The frame controller of machines whose phases overlap: two frames in flight, one in each phase.

    first     IDLE ──start──► CLEAR ──► TABLE ──► GEOMETRY ──► WAIT ──hand over──► IDLE
                                                                          │
    second    IDLE ───────────────────────────────────────────────────────┴─► CLEAR ──► RENDER ──► IDLE    finished, error NONE

A frame waits with its lists in memory until the frame before it has left the second phase. When it is handed over, the second
phase takes a copy of its settings, and the first phase is ready for the next frame. What one phase writes and the next one
reads exists twice; `which` says which of the two sets the first phase uses, and the second phase uses the other. It turns with
every frame that is handed over.

A failure of a unit, `abort` and the watchdog end both frames, because they share the bus and a reset:

                 a unit fails, or the host aborts             bus quiet
    running ────────────────────────────────────────► DRAIN ───────────► RESET ──► running      finished, first_finished

The frame whose phase has failed ends with its own code, the other one with ABORTED. A start that comes while frames are being
stopped is kept, and its frame begins after the reset.
"""

from __future__ import annotations

from amaranth.hdl import Const, Module, Mux, Signal, Value, unsigned
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import shape
from rtl.top.controller import check_parameters
from spec.codes import ErrorCode, Phase
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import frame_settings
from spec.queues import WATCHDOG_BITS
from spec.records import frame_tiles

_RESET_CYCLES = 4
_SETTLE_CYCLES = 4  # units of the second phase keep registers of what they derive from settings
_TILE_SHIFT = (TILE - 1).bit_length()


class OverlapController(wiring.Component):
    """Runs the phases of two frames.

    Parameters:
        config: the machine, with overlapped phases; `row_width` is used.
        watchdog_bits: log2 of the number of cycles without progress that end all frames.

    Ports:
        start: strobe that begins a frame; it must not come while `first_busy` is high, unless frames are being stopped. The
            first phase's settings must be stable from then on until `hand_over` or `first_finished`.
        abort: strobe that ends all frames early.
        width, height: size in pixels of the frame in its first phase.
        tiles_x, tile_count: tiles of a row and of the frame in its first phase; valid from the table phase on. second_tiles_x,
            second_tile_count: those of the frame in its second phase.
        first_failure, failure: error code of a unit of the first or of the second phase that has failed, 0 for none; levels.
        first_ready: the units of the first phase may be started, because their memories are clear.
        table_done, geometry_done, render_done: levels; the phase has done its work and its writes are in memory.
        bus_quiet: the bus has no outstanding transaction.
        progress: a beat moves on the bus.
        clear: strobe; every unit of the first phase clears its state of the previous frame. Those of the second phase do so
            with `hand_over`.
        start_table, start_geometry, start_render: strobes that start the phases.
        hand_over: strobe; the frame in its first phase goes into the second one. Its settings are copied in this cycle.
        which: the set that the first phase uses, 0 or 1; it changes in the cycle after `hand_over`.
        abort_bus: level; the bus takes no more requests.
        reset_units: level; resets the units.
        first_phase, phase: what is done for the frames in their first and second phases, as the host reads it.
        first_busy: a frame is in its first phase, frames are being stopped, or a start is kept. busy: the same of any phase.
        finished: strobe; the frame in its second phase has ended, and `error` says how. first_finished: strobe; a frame has
            ended before its second phase, and `first_error` says how.

    Latency: the number of tile rows + 2 cycles from `start` to `start_table`; one cycle from the end of a phase of the first
    frame to the next one, and 5 from the end of its lists to `start_render` where the second phase is free. A frame that waits
    is handed over in the cycle after `finished`.
    """

    def __init__(self, config: AcceleratorConfig, *, watchdog_bits: int = WATCHDOG_BITS):
        check_parameters(config, watchdog_bits)
        if not config.overlap:
            raise ValueError(f"overlap must be True, not {config.overlap!r}")
        self.config, self._watchdog_bits = config, watchdog_bits
        code, phase = unsigned(ErrorCode.width()), unsigned(Phase.width())
        size = {f.name: In(shape(f.format)) for f in frame_settings(config).fields if f.name in ("width", "height")}
        tiles = range(frame_tiles(config) + 1)
        super().__init__({
            "start": In(1), "abort": In(1), **size, "first_failure": In(code), "failure": In(code), "first_ready": In(1),
            "bus_quiet": In(1), "progress": In(1), "table_done": In(1), "geometry_done": In(1), "render_done": In(1),
            **dict.fromkeys(("tiles_x", "tile_count", "second_tiles_x", "second_tile_count"), Out(tiles)),
            **dict.fromkeys((
                "clear", "start_table", "start_geometry", "start_render", "hand_over", "which", "abort_bus",
                "reset_units", "first_busy", "busy", "first_finished", "finished"), Out(1)),
            "first_phase": Out(phase), "phase": Out(phase), "first_error": Out(code), "error": Out(code)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        first, second = Signal(Phase.width(), name="first_state"), Signal(Phase.width(), name="second_state")
        stopping, ends, over = self._stop(m, first, second)
        runs, kept = Signal(), Signal()  # kept: a start that came while frames were being stopped
        m.d.comb += runs.eq(~stopping.any() & ~ends)
        self._first(m, first, second, runs, kept)
        self._second(m, second, runs)
        with m.If(over):
            m.d.sync += [first.eq(Phase.IDLE), second.eq(Phase.IDLE), self.which.eq(0)]
        m.d.comb += [
            self.first_busy.eq((first != Phase.IDLE) | stopping.any() | kept),
            self.busy.eq(self.first_busy | (second != Phase.IDLE)),
            self.first_phase.eq(Mux(stopping.any() & (first != Phase.IDLE), stopping, first)),
            self.phase.eq(Mux(stopping.any(), stopping, second))]
        return m

    def _first(self, m: Module, first: Signal, second: Signal, runs: Value, kept: Signal) -> None:
        """The phases up to the lists; nothing moves unless `runs`."""
        rows = Signal(range(2 * self.config.row_width // TILE))
        m.d.sync += kept.eq(kept | self.start)
        with m.If(runs):
            with m.Switch(first):
                with m.Case(Phase.IDLE):
                    with m.If(self.start | kept):
                        m.d.comb += self.clear.eq(1)
                        m.d.sync += [
                            kept.eq(0), first.eq(Phase.CLEAR), self.tile_count.eq(0),
                            self.tiles_x.eq((self.width + TILE - 1) >> _TILE_SHIFT),
                            rows.eq((self.height + TILE - 1) >> _TILE_SHIFT)]
                with m.Case(Phase.CLEAR):
                    with m.If(rows != 0):
                        m.d.sync += [rows.eq(rows - 1), self.tile_count.eq(self.tile_count + self.tiles_x)]
                    with m.Elif(self.first_ready):
                        m.d.comb += self.start_table.eq(1)
                        m.d.sync += first.eq(Phase.TABLE)
                with m.Case(Phase.TABLE):
                    with m.If(self.table_done):
                        m.d.comb += self.start_geometry.eq(1)
                        m.d.sync += first.eq(Phase.GEOMETRY)
                with m.Case(Phase.GEOMETRY):
                    with m.If(self.geometry_done):
                        m.d.sync += first.eq(Phase.WAIT)
                with m.Case(Phase.WAIT):
                    with m.If(second == Phase.IDLE):
                        m.d.comb += self.hand_over.eq(1)
                        m.d.sync += [
                            first.eq(Phase.IDLE), self.which.eq(~self.which), self.second_tiles_x.eq(self.tiles_x),
                            self.second_tile_count.eq(self.tile_count)]

    def _second(self, m: Module, second: Signal, runs: Value) -> None:
        """The phase that renders; nothing moves unless `runs`."""
        settles = Signal(range(_SETTLE_CYCLES))
        with m.If(runs):
            with m.Switch(second):
                with m.Case(Phase.IDLE):
                    with m.If(self.hand_over):
                        m.d.sync += [second.eq(Phase.CLEAR), settles.eq(0)]
                with m.Case(Phase.CLEAR):
                    m.d.sync += settles.eq(settles + 1)
                    with m.If(settles == _SETTLE_CYCLES - 1):
                        m.d.comb += self.start_render.eq(1)
                        m.d.sync += second.eq(Phase.RENDER)
                with m.Case(Phase.RENDER):
                    with m.If(self.render_done):
                        m.d.comb += self.finished.eq(1)
                        m.d.sync += second.eq(Phase.IDLE)

    def _stop(self, m: Module, first: Signal, second: Signal) -> tuple[Signal, Signal, Signal]:
        """Stops frames: returns the phase of stopping, IDLE where none is stopped; whether one is from the next cycle on; and
        whether this is the last cycle of stopping."""
        idle, bites, ends, over = Signal(self._watchdog_bits), Signal(), Signal(), Signal()
        stopping, resets = Signal(Phase.width()), Signal(range(_RESET_CYCLES))
        codes = {"first_error": self.first_failure, "error": self.failure}
        held = {name: Signal(ErrorCode.width(), name=f"held_{name}") for name in codes}
        in_flight = Signal()
        m.d.sync += idle.eq(Mux(self.progress | ~self.busy, 0, idle + 1))
        m.d.comb += [
            in_flight.eq((first != Phase.IDLE) | (second != Phase.IDLE)), bites.eq(idle.all()),
            ends.eq(in_flight & ~stopping.any() & (
                self.abort | bites | (self.first_failure != 0) | (self.failure != 0)))]
        with m.If(ends):
            m.d.sync += stopping.eq(Phase.DRAIN)
            m.d.sync += [held[name].eq(Mux(code != 0, code, Mux(bites, Const(ErrorCode.WATCHDOG), ErrorCode.ABORTED)))
                         for name, code in codes.items()]
        with m.If(stopping == Phase.DRAIN):
            m.d.comb += self.abort_bus.eq(1)
            with m.If(self.bus_quiet):
                m.d.sync += stopping.eq(Phase.RESET)
        with m.If(stopping == Phase.RESET):
            m.d.comb += [self.abort_bus.eq(1), self.reset_units.eq(1)]
            m.d.sync += resets.eq(resets + 1)
            with m.If(resets == _RESET_CYCLES - 1):
                m.d.comb += [
                    over.eq(1), self.finished.eq(second != Phase.IDLE), self.first_finished.eq(first != Phase.IDLE),
                    *(getattr(self, name).eq(held[name]) for name in codes)]
                m.d.sync += [resets.eq(0), stopping.eq(Phase.IDLE)]
        return stopping, ends, over
