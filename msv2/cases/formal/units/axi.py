"""Proofs of the bus, the registers and the control of frames."""

from __future__ import annotations

from amaranth.hdl import Cat, Mux, Signal, Value

from msv2.cases.formal.bench import Bench
from msv2.cases.formal.contract import conserves, keeps
from msv2.cases.formal.proof import SMALL, Proof
from rtl.axi.arbiter import RoundRobin
from rtl.axi.lite import LiteSlave
from rtl.axi.master import AxiMaster
from rtl.axi.registers import RegisterFile
from rtl.top.controller import FrameController
from rtl.top.overlap_controller import OverlapController
from spec.codes import ErrorCode, Phase
from spec.host_settings import limits
from spec.registers import register_map

CLIENTS = 2
IN_FLIGHT = 2
PART = 128
"""Bits of the settings that a claim speaks of: few enough for a proof by property directed reachability."""


def turns(bench: Bench) -> None:
    """A client that asks is served before any other one is served twice."""
    unit, client = bench.unit, bench.some(2, "client")
    bench.assume(client < unit.count)
    bench.assume(~unit.served | unit.asking.any())
    asks = unit.asking.bit_select(client, 1)
    chosen, others = unit.served & (unit.chosen == client), bench.register("others", 3)
    bench.m.d.sync += others.eq(Mux(~asks | chosen, 0, others + (unit.served & (others != 7))))
    bench.never("only a client that asks is chosen", ~unit.asking.bit_select(unit.chosen, 1), when=unit.asking.any())
    bench.never("served after each other client once at most", others >= unit.count, when=asks & unit.served)


def master(bench: Bench) -> None:
    """Of a bus that answers what it was asked for, the requests of each client in their order, and errors as it likes."""
    unit, m = bench.unit, bench.m
    reads, writes = ([bench.sinks[f"{kind}[{n}]"] for n in range(CLIENTS)] for kind in ("reads", "writes"))
    sent = {name: getattr(unit, f"m_axi_{name}valid") & getattr(unit, f"m_axi_{name}ready") for name in ("ar", "aw", "w")}
    read_open, write_open = ([bench.register(f"{kind}_{n}", 3) for n in range(CLIENTS)] for kind in ("read", "write"))
    words = bench.register("words", 4)
    answered, completed = bench.any(1, "answers") & _one(read_open, unit.m_axi_rid), \
        bench.any(1, "completes") & _one(write_open, unit.m_axi_bid) & words.any()
    m.d.comb += [unit.m_axi_rvalid.eq(answered), unit.m_axi_bvalid.eq(completed)]
    m.d.sync += words.eq(words + sent["w"] - completed)
    for n in range(CLIENTS):
        m.d.sync += [
            read_open[n].eq(read_open[n] + (sent["ar"] & (unit.m_axi_arid == n)) - (answered & (unit.m_axi_rid == n))),
            write_open[n].eq(write_open[n] + (sent["aw"] & (unit.m_axi_awid == n)) - (completed & (unit.m_axi_bid == n)))]
    for channel, payload in (("ar", ("id", "addr")), ("aw", ("id", "addr")), ("w", ("data", "strb"))):
        keeps(bench, channel.upper(), getattr(unit, f"m_axi_{channel}valid"), getattr(unit, f"m_axi_{channel}ready"),
              Cat(getattr(unit, f"m_axi_{channel}{name}") for name in payload))
    arrived, client = bench.before(answered), bench.before(unit.m_axi_rid)
    reads_open, writes_open = IN_FLIGHT + CLIENTS, IN_FLIGHT + 2  # with what waits in the clients' registers
    owed_reads = [bench.count(end.moves, arrived & (client == n), reads_open) for n, end in enumerate(reads)]
    owed_writes = [bench.count(end.moves, completed & (unit.m_axi_bid == n), writes_open) for n, end in enumerate(writes)]
    bench.never(f"at most {reads_open} reads in flight", sum(owed_reads) > reads_open, when=sum(owed_reads) == reads_open)
    for n, owed in enumerate(owed_writes):
        bench.never(f"at most {writes_open} writes of client {n} in flight", owed > writes_open, when=owed == writes_open)
        bench.never(f"writes of client {n} idle only if none is in flight", owed != 0,
                    when=unit.writes_idle[n] & bench.seen(writes[n].moves))
    nothing = ~Cat(owed != 0 for owed in (*owed_reads, *owed_writes)).any()
    bench.never("quiet only if nothing is in flight", ~nothing, when=unit.quiet & bench.seen(sent["ar"]))
    bench.never("quiet if nothing is in flight", bench.before(nothing) & nothing & ~unit.quiet, when=nothing)
    for n in range(CLIENTS):
        bench.never(f"answers to client {n} are its own", ~(arrived & (client == n)), when=unit.beats[n].valid)
        bench.never(f"every answer reaches client {n}", ~unit.beats[n].valid, when=arrived & (client == n) & ~unit.abort)
        bench.never(f"client {n} is asked for nothing while the frame ends", reads[n].moves | writes[n].moves, when=unit.abort)
    last = bench.cycles(reads[0].port.valid & ~reads[0].moves & reads[1].moves, 3)
    bench.never("a reader waits for the other one once at most", last > 2, when=reads[0].port.valid & reads[1].moves)
    ahead = bench.count(sent["w"], sent["aw"], 4)
    bench.never("data and addresses of writes are 2 apart at most", (ahead > 2) | (ahead < -2), when=ahead == 2)


def _one(counts: list[Signal], number: Value) -> Value:
    """Whether the count of this number is not 0."""
    return Cat((number == n) & (count != 0) for n, count in enumerate(counts)).any()


def slave(bench: Bench) -> None:
    """One answer for each access, no access without a request, and all of it as AXI4-Lite asks for."""
    unit = bench.unit
    keeps(bench, "B", unit.s_axi_bvalid, unit.s_axi_bready, unit.s_axi_bresp)
    keeps(bench, "R", unit.s_axi_rvalid, unit.s_axi_rready, Cat(unit.s_axi_rdata, unit.s_axi_rresp))
    moves = {name: getattr(unit, f"s_axi_{name}valid") & getattr(unit, f"s_axi_{name}ready")
             for name in ("aw", "w", "b", "ar", "r")}
    for asks, name, answers, strobe in (("aw", "addresses of writes", "b", unit.write),
                                        ("w", "data of writes", "b", unit.write), ("ar", "reads", "r", unit.read)):
        conserves(bench, f"{name} until they are performed", moves[asks], strobe, 1)
        conserves(bench, f"{name} until they are answered", moves[asks], moves[answers], 2)
        waits = bench.cycles(~getattr(unit, f"s_axi_{asks}ready") & unit.s_axi_bready & unit.s_axi_rready & unit.s_axi_awvalid
                             & unit.s_axi_wvalid & unit.s_axi_arvalid, 4)
        bench.never(f"{name}: ready within 3 cycles", waits > 3, when=getattr(unit, f"s_axi_{asks}valid"))


def registers(bench: Bench) -> None:
    """A frame is begun once, with settings that do not change until it has ended, whatever the host writes."""
    unit = bench.unit
    settings, running = Value.cast(unit.settings), bench.register("running")
    with bench.m.If(unit.start):
        bench.m.d.sync += running.eq(1)
    with bench.m.Elif(unit.finished):
        bench.m.d.sync += running.eq(0)
    bench.assume(~unit.finished | running)
    keeps(bench, "B", unit.s_axi_bvalid, unit.s_axi_bready, unit.s_axi_bresp)
    keeps(bench, "R", unit.s_axi_rvalid, unit.s_axi_rready, Cat(unit.s_axi_rdata, unit.s_axi_rresp))
    for low in range(0, len(settings), PART):
        part = settings[low:low + PART]
        bench.never(f"settings do not change in a frame: bits {low} to {low + len(part) - 1}", part != bench.before(part),
                    when=running)
    outside = []
    for limit in limits(unit.config):
        value = Value.cast(unit.settings[limit.setting]).as_unsigned()
        below, above = value < limit.low, value > limit.high
        wrong = below & above if limit.low > limit.high else below | above
        outside.append(wrong & Value.cast(unit.settings[limit.where]) if limit.where else wrong)
    bench.never("no start with a setting beyond its limits", Cat(outside).any(), when=unit.start)
    bench.never("no start in a frame", unit.start, when=running)
    bench.never("a start is one cycle long", unit.start, when=bench.before(unit.start))
    written = bench.register("written")
    control = next(register for register in register_map(unit.config) if register.name == "control").offset
    with bench.m.If(unit.s_axi_awvalid & unit.s_axi_awready & (unit.s_axi_awaddr[2:] == control // 4)):
        bench.m.d.sync += written.eq(1)
    for name, strobe in (("start", unit.start), ("abort", unit.abort), ("clear", unit.clear)):
        bench.never(f"no {name} unless the host wrote to control", ~written, when=strobe)


def control(bench: Bench) -> None:
    """Every frame ends, once, and leaves the machine as it was before."""
    unit = bench.unit
    done = unit.table_done & unit.geometry_done & unit.render_done
    begun = bench.before(unit.busy)
    pushed = bench.before(unit.finished)
    for name, condition, within in (
        ("without progress on the bus", ~unit.progress & unit.bus_quiet, 40),
        ("when all units are done", unit.bus_quiet & unit.units_ready & done, 20),
        ("after an abort", unit.abort & unit.bus_quiet, 8),
        ("after a failure", (unit.failure != 0) & unit.bus_quiet, 8),
    ):
        waits = bench.cycles(unit.busy & condition, within + 1)
        bench.never(f"a frame ends {name} within {within} cycles", waits > within, when=begun & unit.finished & condition)
    bench.never("finished only while busy", ~unit.busy, when=unit.finished)
    bench.never("finished for one cycle", unit.finished, when=pushed)
    bench.never("busy ends with finished alone", ~pushed, when=begun & ~unit.busy)
    starts = Cat(unit.start_table, unit.start_geometry, unit.start_render)
    bench.never("one phase starts at a time", (starts & (starts - 1)) != 0, when=starts.any())
    bench.never("no phase starts while the bus drains", starts.any(), when=unit.abort_bus)
    bench.never("units are reset only while the bus takes nothing", ~unit.abort_bus, when=unit.reset_units)
    drained = bench.register("drained")
    bench.m.d.sync += drained.eq(Mux(unit.busy, drained | unit.bus_quiet & unit.abort_bus, 0))
    bench.never("units are reset only after the bus was quiet", ~drained, when=unit.reset_units)
    failed = bench.register("failed")
    bench.m.d.sync += failed.eq(Mux(unit.busy, failed | unit.abort | (unit.failure != 0), 0))
    bench.never("a frame that failed says so", pushed & bench.before(failed) & (unit.error == ErrorCode.NONE),
                when=pushed & bench.before(failed))
    order = bench.register("order", 2)
    begins = ~unit.busy | unit.next_pass if hasattr(unit, "next_pass") else ~unit.busy
    phases = {"table": unit.start_table, "geometry": unit.start_geometry, "render": unit.start_render}
    for place, (name, strobe) in enumerate(phases.items()):
        bench.never(f"{name} starts in its turn", order != place, when=strobe)
        with bench.m.If(strobe):
            bench.m.d.sync += order.eq(place + 1)
    with bench.m.If(begins):
        bench.m.d.sync += order.eq(0)
    ends_well = unit.finished & ~unit.reset_units
    bench.never("a frame ends well only in its last phase", unit.phase != Phase.RENDER, when=ends_well)


def two_frames(bench: Bench) -> None:
    """Every frame of two in flight ends, once."""
    unit, m = bench.unit, bench.m
    bench.assume(~unit.start | ~unit.first_busy)
    inside, ends = bench.register("inside", 2), unit.finished | unit.first_finished
    m.d.sync += inside.eq(inside + unit.start - unit.finished - unit.first_finished)
    begun, quiet = bench.before(unit.busy), unit.bus_quiet & ~ends
    done = unit.first_ready & unit.table_done & unit.geometry_done & unit.render_done
    for name, condition, within in (
        ("without progress on the bus", ~unit.progress & quiet, 40),
        ("when all units are done", quiet & done, 30),
        ("after an abort", unit.abort & quiet, 8),
        ("after a failure", ((unit.failure != 0) | (unit.first_failure != 0)) & quiet, 8),
    ):
        waits = bench.cycles(unit.busy & condition, within + 1)
        bench.never(f"a frame ends {name} within {within} cycles", waits > within, when=begun & condition)
    bench.never("two frames at most", inside == 3, when=inside == 2)
    bench.never("only what began ends", inside < unit.finished + unit.first_finished, when=ends)
    bench.never("no frame is left where the machine is not busy", inside != 0, when=~unit.busy & ~begun)
    bench.never("a frame is handed over only while it is in its first phase", ~unit.first_busy, when=unit.hand_over)
    bench.never("the sets are exchanged after a hand-over or a reset alone",
                ~bench.before(unit.hand_over) & ~bench.before(unit.reset_units),
                when=unit.which != bench.before(unit.which))
    starts = Cat(unit.start_table, unit.start_geometry, unit.start_render)
    bench.never("no phase starts while the bus drains", starts.any(), when=unit.abort_bus)
    bench.never("units are reset only while the bus takes nothing", ~unit.abort_bus, when=unit.reset_units)


def _free(*names: str) -> dict[str, object]:
    return {"free": names}


BUS = tuple(f"m_axi_{name}" for name in ("arready", "awready", "wready", "rid", "rdata", "rresp", "bid", "bresp"))
LITE = tuple(f"s_axi_{name}" for name in (
    "awaddr", "wdata", "wstrb", "araddr", "awvalid", "wvalid", "arvalid", "bready", "rready"))


def lite_host(bench: Bench) -> None:
    """The host holds what it offers, as AXI asks."""
    unit = bench.unit
    for channel, parts in (("aw", ("addr",)), ("w", ("data", "strb")), ("ar", ("addr",))):
        valid, ready = (getattr(unit, f"s_axi_{channel}{name}") for name in ("valid", "ready"))
        payload = Cat(getattr(unit, f"s_axi_{channel}{name}") for name in parts)
        waits = bench.before(valid & ~ready)
        bench.assume(~waits | (valid & (payload == bench.before(payload))))


PROOFS = (
    Proof(RoundRobin, lambda: RoundRobin(3), (turns,), "3 clients", _free("asking", "served"), quick=True),
    Proof(AxiMaster, lambda: AxiMaster(SMALL, CLIENTS, CLIENTS, in_flight=IN_FLIGHT), (master,), "2 and 2 clients, 2 in flight",
          {"free": (*BUS, "abort"), "own": ("m_axi_rvalid", "m_axi_bvalid"), "held": {"m_axi_rlast": 1},
           "narrow": {f"{kind}[{n}]": {"beat": 2} for kind in ("reads", "writes") for n in range(CLIENTS)}}, seconds=60),
    Proof(LiteSlave, LiteSlave, (lite_host, slave), "", _free(*LITE, "write_refused", "read_data", "read_refused"), quick=True),
    Proof(RegisterFile, lambda: RegisterFile(SMALL), (lite_host, registers), "",
          _free(*LITE, "finished", "error", "busy", "phase", "read_errors", "write_errors")),
    Proof(FrameController, lambda: FrameController(SMALL, watchdog_bits=4), (control,), "watchdog of 16 cycles",
          {"free": ("start", "abort", "failure", "units_ready", "bus_quiet", "progress", "table_done", "geometry_done",
                    "render_done"), "held": {"width": 32, "height": 32}}, quick=True),
    Proof(FrameController, lambda: FrameController(SMALL.with_(stereo=True, fine_depth=False), watchdog_bits=4), (control,),
          "two eyes, watchdog of 16 cycles",
          {"free": ("start", "abort", "failure", "units_ready", "bus_quiet", "progress", "table_done", "geometry_done",
                    "render_done"), "held": {"width": 32, "height": 32}}),
    Proof(OverlapController, lambda: OverlapController(SMALL.with_(
        order="spatial", chunks=True, records="compact", lists="supertile", overlap=True), watchdog_bits=4), (two_frames,),
        "watchdog of 16 cycles",
        {"free": ("start", "abort", "failure", "first_failure", "first_ready", "bus_quiet", "progress", "table_done",
                  "geometry_done", "render_done"), "held": {"width": 32, "height": 32}}, quick=True),
)
