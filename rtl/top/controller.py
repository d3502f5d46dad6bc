"""The frame controller: the order of a frame's phases, and the way out of one that fails.

    IDLE ──start──► CLEAR ──► TABLE ──► GEOMETRY ──► RENDER ──► IDLE            finished, error NONE
                      │         │          │            │
                      └─────────┴────┬─────┴────────────┘   a unit fails, or the host aborts
                                     ▼
                                   DRAIN ──bus quiet──► RESET ──► IDLE          finished, error set

CLEAR counts the frame's tiles while every unit forgets the frame before. The phases are separated by barriers: GEOMETRY ends
when all it wrote is in memory, because RENDER reads it. A failed frame is not repaired: the bus takes no more requests, what is
on its way is swallowed, and a reset of all units, bus and registers apart, makes room for the next frame. Broken data cannot
hang a unit, as none waits for anything but counts and answers; a watchdog gives up a frame in which memory moves nothing for
2^WATCHDOG_BITS cycles all the same. Memory that owes an answer and never gives it holds the machine in DRAIN until `rst`.

A frame of two eyes goes through CLEAR to RENDER twice, for the source eye and then for the target eye.
"""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, unsigned
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import shape
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import frame_settings
from spec.queues import WATCHDOG_BITS
from spec.records import frame_tiles
from spec.registers import ErrorCode, Phase

_RESET_CYCLES = 4
_TILE_SHIFT = (TILE - 1).bit_length()


class FrameController(wiring.Component):
    """Phases of a frame.

    Parameters:
        config: the machine; `row_width` matters here.
        watchdog_bits: log2 of the cycles without progress that end a frame.

    Ports:
        start: strobe: begin a frame; taken in IDLE only. Settings are stable from then on until `finished`.
        abort: strobe: give the frame up.
        width, height: of the frame, in pixels.
        tiles_x, tile_count: tiles of a row and of the frame, from the table phase on.
        failure: error code of a unit that has failed, 0 for none; a level.
        units_ready: units may be started: their memories are clear.
        table_done, geometry_done, render_done: levels: the phase's work is done, its writes are in memory.
        bus_quiet: nothing is on its way on the bus. progress: a beat moves.
        clear: strobe: units forget the frame before.
        start_table, start_geometry, start_render: strobes.
        abort_bus: level: the bus takes nothing any more.
        reset_units: level.
        phase: as the host sees it; `busy`: not IDLE.
        finished: strobe: the frame has ended.
        error: how it ended, from `finished` to the next start.

    With stereo:
        stereo: the frame is of two eyes.
        target: level: the second pass, from the cycle after its `clear`. After a frame it stays until the next start.
        next_pass: strobe, with `clear`: the first pass has ended, the second begins.

    Latency: tile rows + 2 cycles from start to the table's; one cycle from phase to phase.
    """

    def __init__(self, config: AcceleratorConfig, *, watchdog_bits: int = WATCHDOG_BITS):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if not isinstance(watchdog_bits, int) or isinstance(watchdog_bits, bool):
            raise TypeError(f"watchdog_bits must be an integer, not {watchdog_bits!r}")
        if not 4 <= watchdog_bits <= 32:
            raise ValueError(f"watchdog_bits must be in 4..32, not {watchdog_bits!r}")
        self.config, self._watchdog_bits = config, watchdog_bits
        code, phase = unsigned(ErrorCode.width()), unsigned(Phase.width())
        size = {f.name: In(shape(f.format)) for f in frame_settings(config).fields if f.name in ("width", "height")}
        tiles = range(frame_tiles(config) + 1)
        super().__init__({
            "start": In(1), "abort": In(1), **size, "failure": In(code), "units_ready": In(1), "bus_quiet": In(1),
            "progress": In(1),
            "table_done": In(1), "geometry_done": In(1), "render_done": In(1),
            "tiles_x": Out(tiles), "tile_count": Out(tiles),
            "clear": Out(1), "start_table": Out(1), "start_geometry": Out(1), "start_render": Out(1),
            "abort_bus": Out(1), "reset_units": Out(1), "phase": Out(phase), "busy": Out(1),
            "finished": Out(1), "error": Out(code),
            **({"stereo": In(1), "target": Out(1), "next_pass": Out(1)} if config.stereo else {}),
        })

    def elaborate(self, platform) -> Module:
        m = Module()
        rows, stops, resets = Signal(range(2 * self.config.row_width // TILE)), Signal(), Signal(range(_RESET_CYCLES))
        idle, bites = Signal(self._watchdog_bits), Signal()
        m.d.sync += idle.eq(Mux(self.progress | ~self.busy, 0, idle + 1))
        m.d.comb += [self.busy.eq(1), bites.eq(idle.all()), stops.eq(self.abort | (self.failure != 0) | bites)]
        with m.FSM():
            with m.State("IDLE"):
                m.d.comb += self.busy.eq(0)
                with m.If(self.start):
                    self._begin(m, rows)
                    m.d.sync += self.error.eq(ErrorCode.NONE)
                    if self.config.stereo:
                        m.d.sync += self.target.eq(0)
                    m.next = "CLEAR"
            with m.State("CLEAR"):
                m.d.comb += self.phase.eq(Phase.CLEAR)
                with m.If(rows != 0):
                    m.d.sync += [rows.eq(rows - 1), self.tile_count.eq(self.tile_count + self.tiles_x)]
                with m.Elif(self.units_ready):
                    m.d.comb += self.start_table.eq(1)
                    m.next = "TABLE"
                self._stop(m, stops, bites)
            for name, strobe, done, following in (
                ("TABLE", self.start_geometry, self.table_done, "GEOMETRY"),
                ("GEOMETRY", self.start_render, self.geometry_done, "RENDER"),
                ("RENDER", self.finished, self.render_done, "IDLE"),
            ):
                with m.State(name):
                    m.d.comb += self.phase.eq(Phase[name])
                    with m.If(done & ~stops):
                        m.d.comb += strobe.eq(1)
                        m.next = following
                        if self.config.stereo and name == "RENDER":
                            self._next_pass(m, rows)
                    self._stop(m, stops, bites)
            with m.State("DRAIN"):
                m.d.comb += [self.phase.eq(Phase.DRAIN), self.abort_bus.eq(1)]
                with m.If(self.bus_quiet):
                    m.next = "RESET"
            with m.State("RESET"):
                m.d.comb += [self.phase.eq(Phase.RESET), self.abort_bus.eq(1), self.reset_units.eq(1)]
                m.d.sync += resets.eq(resets + 1)
                with m.If(resets == _RESET_CYCLES - 1):
                    m.d.sync += resets.eq(0)
                    m.d.comb += self.finished.eq(1)
                    m.next = "IDLE"
        return m

    def _begin(self, m: Module, rows: Signal) -> None:
        """Units forget what was before; tiles are counted."""
        m.d.comb += self.clear.eq(1)
        m.d.sync += [
            self.tiles_x.eq((self.width + TILE - 1) >> _TILE_SHIFT), rows.eq((self.height + TILE - 1) >> _TILE_SHIFT),
            self.tile_count.eq(0)]

    def _next_pass(self, m: Module, rows: Signal) -> None:
        """The source eye is in memory: the same again for the target eye."""
        with m.If(self.stereo & ~self.target):
            m.d.comb += [self.finished.eq(0), self.next_pass.eq(1)]
            m.d.sync += self.target.eq(1)
            self._begin(m, rows)
            m.next = "CLEAR"

    def _stop(self, m: Module, stops: Signal, bites: Signal) -> None:
        """Leaves a phase when a unit has failed or the host aborts; the unit's reason goes before the host's."""
        with m.If(stops):
            m.d.sync += self.error.eq(Mux(self.failure != 0, self.failure, Mux(bites, ErrorCode.WATCHDOG, ErrorCode.ABORTED)))
            m.next = "DRAIN"
