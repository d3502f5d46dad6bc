"""The frame controller: runs the phases of a frame in order, and recovers from a frame that fails.

    IDLE ──start──► CLEAR ──► TABLE ──► GEOMETRY ──► RENDER ──► IDLE            finished, error NONE
                      │         │          │            │
                      └─────────┴────┬─────┴────────────┘   a unit fails, or the host aborts
                                     ▼
                                   DRAIN ──bus quiet──► RESET ──► IDLE          finished, error set

CLEAR counts the tiles of the frame while every unit clears its state of the previous frame. The phases are separated by
barriers: GEOMETRY ends when everything that it wrote is in memory, because RENDER reads it.

A failed frame is not repaired. The bus takes no more requests, outstanding answers are discarded, and a reset of all units
except bus and registers prepares for the next frame. Units wait only for counts and for answers of memory. Where memory
contradicts itself, a count may promise what never comes: in machines with super-tiles, a Gaussian that was counted as visible
may be culled by another copy of it in the second phase. So a watchdog ends a frame in which no beat moves on the bus for
2^WATCHDOG_BITS cycles. If memory never gives an answer that it owes, the machine stays in DRAIN until `rst`.

A frame of two eyes passes from CLEAR to RENDER twice, first for the source eye and then for the target eye.
"""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, unsigned
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import shape
from spec.codes import ErrorCode, Phase
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.memory import frame_settings
from spec.queues import WATCHDOG_BITS
from spec.records import frame_tiles

_RESET_CYCLES = 4
_TILE_SHIFT = (TILE - 1).bit_length()


def check_parameters(config: AcceleratorConfig, watchdog_bits: int) -> None:
    """Raises TypeError or ValueError where a frame controller cannot be made with these parameters."""
    if not isinstance(config, AcceleratorConfig):
        raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
    if not isinstance(watchdog_bits, int) or isinstance(watchdog_bits, bool):
        raise TypeError(f"watchdog_bits must be an integer, not {watchdog_bits!r}")
    if not 4 <= watchdog_bits <= 32:
        raise ValueError(f"watchdog_bits must be in 4..32, not {watchdog_bits!r}")


class FrameController(wiring.Component):
    """Runs the phases of a frame.

    Parameters:
        config: the machine; `row_width` is used.
        watchdog_bits: log2 of the number of cycles without progress that end a frame.

    Ports:
        start: strobe that begins a frame; taken in IDLE only. Settings must be stable from then on until `finished`.
        abort: strobe that ends the frame early.
        width, height: size of the frame in pixels.
        tiles_x, tile_count: tiles of a row and of the frame; valid from the table phase on.
        failure: error code of a unit that has failed, 0 for none; a level.
        units_ready: the units may be started, because their memories are clear.
        table_done, geometry_done, render_done: levels; the phase has done its work and its writes are in memory.
        bus_quiet: the bus has no outstanding transaction.
        progress: a beat moves on the bus.
        clear: strobe; every unit clears its state of the previous frame.
        start_table, start_geometry, start_render: strobes that start the phases.
        abort_bus: level; the bus takes no more requests.
        reset_units: level; resets the units.
        phase: the phase as the host reads it.
        busy: the controller is not in IDLE.
        finished: strobe; the frame has ended.
        error: how the frame ended; valid from `finished` to the next start.

    With stereo, but not with joint frames:
        stereo: the frame has two eyes.
        target: level; the second pass, from the cycle after its `clear`. After a frame it stays until the next start.
        next_pass: strobe, together with `clear`; the first pass has ended and the second begins.

    Latency: the number of tile rows + 2 cycles from `start` to `start_table`; one cycle from the end of a phase to the next.
    """

    def __init__(self, config: AcceleratorConfig, *, watchdog_bits: int = WATCHDOG_BITS):
        check_parameters(config, watchdog_bits)
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
            **({"stereo": In(1), "target": Out(1), "next_pass": Out(1)} if config.two_passes else {}),
        })

    def elaborate(self, platform: object) -> Module:
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
                    if self.config.two_passes:
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
                        if self.config.two_passes and name == "RENDER":
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
        """Clears the units and starts to count the tiles."""
        m.d.comb += self.clear.eq(1)
        m.d.sync += [
            self.tiles_x.eq((self.width + TILE - 1) >> _TILE_SHIFT), rows.eq((self.height + TILE - 1) >> _TILE_SHIFT),
            self.tile_count.eq(0)]

    def _next_pass(self, m: Module, rows: Signal) -> None:
        """Begins the second pass, for the target eye, once the source eye is in memory."""
        with m.If(self.stereo & ~self.target):
            m.d.comb += [self.finished.eq(0), self.next_pass.eq(1)]
            m.d.sync += self.target.eq(1)
            self._begin(m, rows)
            m.next = "CLEAR"

    def _stop(self, m: Module, stops: Signal, bites: Signal) -> None:
        """Leaves a phase if a unit has failed or the host aborts. The failure of a unit takes precedence in `error`."""
        with m.If(stops):
            m.d.sync += self.error.eq(Mux(self.failure != 0, self.failure, Mux(bites, ErrorCode.WATCHDOG, ErrorCode.ABORTED)))
            m.next = "DRAIN"
