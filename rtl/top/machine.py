"""The whole machine: registers, frame controller, the units of both phases, and the memory bus."""

from __future__ import annotations

from typing import Any, TypeAlias

from amaranth.hdl import Cat, ClockDomain, ClockSignal, DomainRenamer, Module, Mux, ResetSignal, Signal, Value
from amaranth.lib import wiring
from amaranth.lib.wiring import Out

from rtl.axi import bus
from rtl.axi.counters import PerformanceCounters
from rtl.axi.master import AxiMaster, id_bits
from rtl.axi.read_port import ReadQueue
from rtl.axi.registers import RegisterFile
from rtl.top import bin_phase, gather_phase, geometry_phase, overlap, render_phase
from rtl.top.bin_phase import BinPhase
from rtl.top.controller import FrameController
from rtl.top.gather_phase import GatherPhase
from rtl.top.geometry_phase import GeometryPhase
from rtl.top.overlap_controller import OverlapController
from rtl.top.render_phase import RenderPhase
from spec.codes import ErrorCode
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.queues import WATCHDOG_BITS, read_depths
from spec.registers import events, read_clients, stages, write_clients

FirstPhase: TypeAlias = GeometryPhase | BinPhase
SecondPhase: TypeAlias = RenderPhase | GatherPhase


def phases(config: AcceleratorConfig) -> tuple[type[FirstPhase], type[SecondPhase]]:
    """The components of both phases in a machine of `config`."""
    return (BinPhase, GatherPhase) if config.supertiles else (GeometryPhase, RenderPhase)


class Machine(wiring.Component):
    """The accelerator: an AXI4-Lite slave for commands, an AXI4 master to memory, and an interrupt.

    A frame passes the phases of `FrameController`, or where the phases of two frames overlap those of `OverlapController`.
    Machines with lists by super-tile have other units in both phases: `BinPhase`, `GatherPhase`. docs/machine.md describes
    what the host does, docs/registers.md the registers. Only `rst` resets bus and registers; the other units are also reset
    after a failed frame.

    Parameters:
        config: the machine.
        watchdog_bits: log2 of the number of cycles without a beat that end a frame.

    Ports:
        s_axil_*: AXI4-Lite slave, 32 bits.
        m_axi_*: AXI4 master, 256 bits; every transaction is a single 32-byte beat.
        interrupt: level.
    """

    def __init__(self, config: AcceleratorConfig, *, watchdog_bits: int = WATCHDOG_BITS):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if config.supertiles and config.row_width <= 2 * TILE:  # numbers of super-tiles would have no bit
            raise ValueError(f"row_width must be more than {2 * TILE} in a machine with lists by super-tile, not "
                             f"{config.row_width!r}")
        self.config, self._watchdog_bits = config, watchdog_bits
        super().__init__({
            **bus.axi_lite_slave_ports("s_axil"),
            **bus.axi_master_ports("m_axi", id_bits(len(read_clients(config)), len(write_clients(config)))),
            "interrupt": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.registers = registers = RegisterFile(self.config)
        control = OverlapController if self.config.overlap else FrameController
        m.submodules.controller = controller = control(self.config, watchdog_bits=self._watchdog_bits)
        m.submodules.master = master = AxiMaster(self.config, len(read_clients(self.config)), len(write_clients(self.config)))
        m.domains.units = ClockDomain(local=True)
        m.d.comb += [ClockSignal("units").eq(ClockSignal()), ResetSignal("units").eq(ResetSignal() | controller.reset_units)]
        renamed = DomainRenamer("units")
        first, second = phases(self.config)
        geometry, render = first(self.config), second(self.config)
        m.submodules.geometry, m.submodules.render = renamed(geometry), renamed(render)

        bus.join(m, self, registers, "s_axi", "s_axil")
        bus.join(m, self, master, "m_axi")
        m.d.comb += self.interrupt.eq(registers.interrupt)
        if self.config.overlap:
            overlap.control(m, self.config, registers, controller, master, geometry, render)
        else:
            self._control(m, registers, controller, master, geometry, render)
        if self.config.two_passes:
            self._two_eyes(m, registers, controller, geometry, render)
        if self.config.supertiles and not self.config.overlap:
            self._super_tiles(m, controller, geometry, render)
        self._memory(m, renamed, master, geometry, render)
        if self.config.counters:
            self._count(m, renamed, registers, controller, master, geometry, render)
        return m

    def _control(
        self, m: Module, registers: RegisterFile, controller: FrameController, master: AxiMaster,
        geometry: FirstPhase, render: SecondPhase,
    ) -> None:
        """Connects control signals and ranks failures; bus errors come first, because they may cause the other failures."""
        for unit in (geometry, render):
            m.d.comb += [
                unit.settings.eq(registers.settings), unit.tiles_x.eq(controller.tiles_x),
                unit.tile_count.eq(controller.tile_count), unit.clear.eq(controller.clear)]
        wiring.connect(m, geometry.hits, render.hits)
        # The bus knows whose request failed. The units' own error flags are for designs that use a unit without this bus.
        failures = [
            (master.read_errors.any(), ErrorCode.READ_ERROR), (master.write_errors.any(), ErrorCode.WRITE_ERROR),
            (geometry.full, ErrorCode.ENTRIES_FULL), (render.saturated, ErrorCode.COUNT_SATURATED),
            (render.overflow, ErrorCode.SPILL_FULL)]
        failure: Value | int = ErrorCode.NONE
        for condition, code in reversed(failures):
            failure = Mux(condition, code, failure)
        m.d.comb += [
            controller.start.eq(registers.start), controller.abort.eq(registers.abort), controller.failure.eq(failure),
            controller.width.eq(registers.settings.width), controller.height.eq(registers.settings.height),
            controller.units_ready.eq(geometry.ready & render.ready), controller.bus_quiet.eq(master.quiet),
            controller.progress.eq(master.read_beats.any() | master.write_beats.any()),
            controller.table_done.eq(geometry.table_done), controller.geometry_done.eq(geometry.done & render.counted),
            controller.render_done.eq(render.done),
            geometry.start_table.eq(controller.start_table), geometry.start.eq(controller.start_geometry),
            render.start.eq(controller.start_render),
            master.abort.eq(controller.abort_bus), master.clear_errors.eq(controller.clear),
            registers.finished.eq(controller.finished), registers.error.eq(controller.error),
            registers.busy.eq(controller.busy), registers.phase.eq(controller.phase),
            registers.read_errors.eq(master.read_errors), registers.write_errors.eq(master.write_errors),
        ]

    def _super_tiles(self, m: Module, controller: FrameController, bin_: BinPhase, gather: GatherPhase) -> None:
        """Connects what both phases use. `rendering` changes while nothing of a frame is in the units of the first phase."""
        rendering = Signal()
        with m.If(controller.start_render):
            m.d.sync += rendering.eq(1)
        with m.Elif(controller.clear):
            m.d.sync += rendering.eq(0)
        for name in ("merged", "gathered", "supertiles"):
            wiring.connect(m, getattr(gather, name), getattr(bin_, name))
        for name in ("listed", "tested"):
            wiring.connect(m, getattr(bin_, name), getattr(gather, name))
        m.d.comb += [
            bin_.rendering.eq(rendering), gather.list_count.eq(bin_.list_count),
            bin_.sorted_item.eq(gather.sorted_item), bin_.sorted_taken.eq(gather.sorted_taken)]
        if self.config.stereo:
            m.d.comb += [bin_.second.eq(gather.second), gather.known.eq(bin_.known),
                         gather.rendered_tiles.eq(bin_.rendered_tiles)]

    def _two_eyes(
        self, m: Module, registers: RegisterFile, controller: FrameController, geometry: GeometryPhase, render: RenderPhase,
    ) -> None:
        """Selects position, table and frame of the target eye in its pass, and connects the mask of its tiles.

        The selected settings are registered, because no phase begins sooner than two cycles after its pass.
        """
        settings, target = registers.settings, controller.target
        for name, others in (("position", "target_position"), ("tiles_base", "target_tiles_base"),
                             ("frame_base", "target_frame_base")):
            now = Signal.like(settings[name], name=name, reset_less=True)
            m.d.sync += now.eq(Mux(target, settings[others], settings[name]))
            m.d.comb += [unit.settings[name].eq(now) for unit in (geometry, render)]
        m.d.comb += [
            controller.stereo.eq(settings.stereo), geometry.target.eq(target), render.target.eq(target),
            render.mask_tile.eq(geometry.mask_tile), geometry.mask.eq(render.mask),
            render.rendered_tiles.eq(geometry.rendered_tiles)]

    def _memory(
        self, m: Module, renamed: DomainRenamer, master: AxiMaster,
        geometry: FirstPhase, render: SecondPhase,
    ) -> None:
        """Connects clients to the bus. Some regions are read in both phases, the one after the other, so these share a client:
        the table of tiles and, with super-tiles, the headers of chunks. Where the phases of two frames overlap, the first one
        has a client of its own for both."""
        first, second, own_writers = (
            (bin_phase.READERS, gather_phase.READERS, bin_phase.WRITERS) if self.config.supertiles else
            (geometry_phase.readers(self.config), render_phase.READERS, geometry_phase.WRITERS))
        phases = ((geometry, first), (render, second))
        depths = read_depths(self.config)
        for place, name in enumerate(read_clients(self.config)):
            queue = ReadQueue(self.config, depths[name])
            m.submodules[f"queue_{name}"] = renamed(queue)
            users = overlap.users(name, geometry, render) if self.config.overlap else [
                (getattr(unit, f"reads_{name}"), getattr(unit, f"data_{name}")) for unit, names in phases if name in names]
            self._connect_readers(m, name, queue, users)
            wiring.connect(m, queue.requests, master.reads[place])
            wiring.connect(m, master.beats[place], queue.beats)
        for place, name in enumerate(write_clients(self.config)):
            unit = geometry if name in own_writers else render
            wiring.connect(m, getattr(unit, f"writes_{name}"), master.writes[place])
            m.d.comb += getattr(unit, f"idle_{name}").eq(master.writes_idle[place])

    def _connect_readers(self, m: Module, name: str, queue: ReadQueue, users: list[tuple[Any, Any]]) -> None:
        if len(users) == 1:
            wiring.connect(m, users[0][0], queue.reads)
            wiring.connect(m, queue.data, users[0][1])
            return
        first, second = (reads for reads, _ in users)
        late = Signal(name=f"{name}_second")  # who gets the beats; all beats of the first user have come before the second asks
        m.d.comb += [
            queue.reads.valid.eq(first.valid | second.valid),
            queue.reads.payload.eq(Mux(first.valid, first.payload, second.payload)),
            first.ready.eq(queue.reads.ready), second.ready.eq(queue.reads.ready & ~first.valid)]
        with m.If(first.valid | second.valid):
            m.d.sync += late.eq(~first.valid)
        ports = [answers for _, answers in users]
        m.d.comb += [queue.data.ready.eq(Mux(late, ports[1].ready, ports[0].ready))]
        for port, mine in zip(ports, (~late, late), strict=True):
            m.d.comb += [port.payload.eq(queue.data.payload), port.valid.eq(queue.data.valid & mine)]

    def _count(
        self, m: Module, renamed: DomainRenamer, registers: RegisterFile, controller: FrameController, master: AxiMaster,
        geometry: FirstPhase, render: SecondPhase,
    ) -> None:
        m.submodules.counters = counters = PerformanceCounters(self.config)
        own = (bin_phase.STAGES + gather_phase.stages(self.config) if self.config.supertiles else
               geometry_phase.STAGES + render_phase.stages(self.config))
        if stages(self.config) != own:
            raise ValueError(f"stages must be those of both phases, in order, not {stages(self.config)!r}")
        if self.config.two_passes:
            m.d.comb += [counters.target.eq(controller.target), counters.next_pass.eq(controller.next_pass)]
        elif self.config.stereo:
            m.d.comb += counters.target.eq(render.second)
        m.d.comb += [
            counters.phase.eq(controller.phase), counters.clear.eq(registers.clear),
            counters.finished.eq(controller.finished),
            counters.stage_valid.eq(Cat(geometry.stage_valid, render.stage_valid)),
            counters.stage_ready.eq(Cat(geometry.stage_ready, render.stage_ready)),
            counters.read_beats.eq(master.read_beats), counters.write_beats.eq(master.write_beats),
            registers.counters.eq(counters.counters)]
        if self.config.overlap:
            overlap.count(m, self.config, renamed, counters, controller, geometry, render)
            return
        m.d.comb += [
            *(counters.events[name].eq(getattr(geometry if hasattr(geometry, name) else render, name))
              for name in events(self.config))]
