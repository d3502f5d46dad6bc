"""How the machine's parts are connected where the phases of two frames overlap (`rtl.top.machine`)."""

from __future__ import annotations

from amaranth.hdl import Const, DomainRenamer, Module, Mux, Signal, Value
from amaranth.lib import data, wiring

from rtl.axi.counters import PerformanceCounters
from rtl.axi.master import AxiMaster
from rtl.axi.registers import RegisterFile
from rtl.top import bin_phase
from rtl.top.bin_phase import BinPhase
from rtl.top.gather_phase import GatherPhase
from rtl.top.overlap_controller import OverlapController
from spec.codes import ErrorCode
from spec.config import AcceleratorConfig
from spec.queues import COUNTER_BITS
from spec.registers import OVERLAP_READ_CLIENTS, events, read_clients, write_clients

FIRST_READERS = ("geometry", *OVERLAP_READ_CLIENTS)
"""Read clients of the first phase; its write clients are `bin_phase.WRITERS`."""


def users(name: str, first: BinPhase, second: GatherPhase) -> list[tuple[wiring.PureInterface, wiring.PureInterface]]:
    """The requests and answers that a read client serves. The first phase reads its table before any header."""
    ports = {"geometry": (first, ("geometry",)), **dict.fromkeys(OVERLAP_READ_CLIENTS, (first, ("tiles", "chunks")))}
    unit, names = ports.get(name, (second, (name,)))
    return [(getattr(unit, f"reads_{port}"), getattr(unit, f"data_{port}")) for port in names]


def control(
    m: Module, config: AcceleratorConfig, registers: RegisterFile, controller: OverlapController, master: AxiMaster,
    first: BinPhase, second: GatherPhase,
) -> None:
    """Connects control signals, and gives each phase the settings of its frame: the first one those of the register file, the
    second one a copy of these from when the frame was handed over. Ranks the failures of each phase; bus errors come first,
    because they may cause the others."""
    settings = Signal(registers.settings.shape(), name="second_settings")
    with m.If(controller.hand_over):
        m.d.sync += settings.eq(registers.settings)
    m.d.comb += [
        first.settings.eq(registers.settings), first.second_settings.eq(settings), second.settings.eq(settings),
        first.which.eq(controller.which),
        first.tiles_x.eq(controller.tiles_x), first.tile_count.eq(controller.tile_count),
        second.tiles_x.eq(controller.second_tiles_x), second.tile_count.eq(controller.second_tile_count),
        first.clear.eq(controller.clear), second.clear.eq(controller.hand_over),
        first.start_table.eq(controller.start_table), first.start.eq(controller.start_geometry),
        second.start.eq(controller.start_render),
        first.sorted_item.eq(second.sorted_item), first.sorted_taken.eq(second.sorted_taken),
        controller.start.eq(registers.start), controller.abort.eq(registers.abort),
        controller.width.eq(registers.settings.width), controller.height.eq(registers.settings.height),
        controller.first_ready.eq(first.ready), controller.table_done.eq(first.table_done),
        controller.geometry_done.eq(first.done), controller.render_done.eq(second.done),
        controller.bus_quiet.eq(master.quiet),
        controller.progress.eq(master.read_beats.any() | master.write_beats.any()),
        master.abort.eq(controller.abort_bus), master.clear_errors.eq(controller.clear),
        registers.finished.eq(controller.finished), registers.error.eq(controller.error),
        registers.first_finished.eq(controller.first_finished), registers.first_error.eq(controller.first_error),
        registers.busy.eq(controller.busy), registers.first_busy.eq(controller.first_busy),
        registers.phase.eq(controller.phase), registers.first_phase.eq(controller.first_phase),
        registers.hand_over.eq(controller.hand_over),
        registers.read_errors.eq(master.read_errors), registers.write_errors.eq(master.write_errors)]
    for name in ("gathered", "supertiles"):
        wiring.connect(m, getattr(second, name), getattr(first, name))
    for name in ("listed", "tested"):
        wiring.connect(m, getattr(first, name), getattr(second, name))
    own = ((FIRST_READERS, bin_phase.WRITERS, controller.first_failure, (
        (first.full, ErrorCode.ENTRIES_FULL), (first.saturated, ErrorCode.COUNT_SATURATED))),
        (_others(read_clients(config), FIRST_READERS), _others(write_clients(config), bin_phase.WRITERS), controller.failure,
         ((second.overflow, ErrorCode.SPILL_FULL),)))
    for readers, writers, failure, failures in own:
        code: Value = Const(ErrorCode.NONE, ErrorCode.width())
        reads, writes = _mask(read_clients(config), readers), _mask(write_clients(config), writers)
        for condition, why in reversed((
                ((master.read_errors & reads).any(), ErrorCode.READ_ERROR),
                ((master.write_errors & writes).any(), ErrorCode.WRITE_ERROR), *failures)):
            code = Mux(condition, Const(why, ErrorCode.width()), code)
        m.d.comb += failure.eq(code)


def _others(clients: tuple[str, ...], without: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for name in clients if name not in without)


def _mask(clients: tuple[str, ...], own: tuple[str, ...]) -> int:
    return sum(1 << place for place, name in enumerate(clients) if name in own)


class KeptCounts(wiring.Component):
    """Keeps what a frame counted in its first phase until its second phase has ended.

    Parameters:
        names: the counts.

    Ports:
        counts: those of the first phase. kept: those of the frame in its second phase.
        hand_over: strobe; `kept` takes the values of `counts`.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        counts = data.StructLayout(dict.fromkeys(names, COUNTER_BITS))
        super().__init__({"counts": wiring.In(counts), "kept": wiring.Out(counts), "hand_over": wiring.In(1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        with m.If(self.hand_over):
            m.d.sync += self.kept.eq(self.counts)
        return m


def count(
    m: Module, config: AcceleratorConfig, renamed: DomainRenamer, counters: PerformanceCounters, controller: OverlapController,
    first: BinPhase, second: GatherPhase,
) -> None:
    """Connects the counters to the events of the frame that ends, and to both phases."""
    names = tuple(name for name in events(config) if hasattr(first, name))
    kept = KeptCounts(names)
    m.submodules.kept_counts = renamed(kept)
    m.d.comb += [
        kept.hand_over.eq(controller.hand_over), *(kept.counts[name].eq(getattr(first, name)) for name in names),
        counters.first_phase.eq(controller.first_phase), counters.busy.eq(controller.busy),
        counters.first_finished.eq(controller.first_finished),
        *(counters.events[name].eq(kept.kept[name] if name in names else getattr(second, name)) for name in events(config))]
