"""The register file of the host, built from the description in `spec.registers`."""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value, unsigned
from amaranth.lib import data, wiring
from amaranth.lib.memory import Memory
from amaranth.lib.wiring import In, Out

from rtl.axi import bus
from rtl.axi.lite import LiteSlave
from rtl.shapes import layout
from spec.codes import ErrorCode, Phase
from spec.config import AcceleratorConfig
from spec.host_settings import limits, settings
from spec.memory import frame_settings
from spec.register_fields import Access, Bits, Register
from spec.registers import (
    COUNTERS_BASE,
    SETTINGS_BASE,
    counters,
    identity,
    is_signed,
    read_clients,
    register_map,
    write_clients,
)


def counters_layout(config: AcceleratorConfig) -> data.StructLayout:
    """The layout of all counters, by name, in the order of their registers."""
    return data.StructLayout({counter.name: counter.width for counter in counters(config)})


class RegisterFile(wiring.Component):
    """An AXI4-Lite slave with the machine's registers. It also keeps track of the start and the end of frames.

    Parameters:
        config: the machine; formats, `row_width`, `counters`, `bank_memories` matter here.

    Ports:
        s_axi_*: the bus; see `LiteSlave`.
        settings: the settings of the frame, a copy that was taken when the frame began.
        start: strobe: begin a frame; the settings are legal and stable from here to the next start.
        abort: strobe: end the frame; it may also come when no frame is under way.
        clear: strobe: set the counters to 0.
        finished: strobe: the frame that began last has ended; `error` says how (an ErrorCode; NONE: the frame is in memory).
        busy, phase: state of the machine for the status register. The machine also counts as busy from the start of a frame
            until its `finished`.
        read_errors, write_errors: one bit per client: memory answered the client with an error.
        counters: the counters, as `counters_layout`; only where the machine has counters.
        interrupt: level: an enabled interrupt is pending.

    With overlapped phases `start` comes while a frame is in its second phase, and `settings`, `finished`, `error`, `phase` are
    of one phase each:
        settings: those of the frame in its first phase; stable until `hand_over` or `first_finished`.
        hand_over: strobe: the frame in its first phase goes into its second one.
        finished, error, phase: of the frame in its second phase. first_finished, first_error, first_phase: of the one in its
            first, which only ends there if it fails. Frames that end without errors may be told apart by the counter `frames`.
        first_busy: level: no frame may begin.

    Throughput: that of `LiteSlave`. Latency: two cycles from the write of `control.start` to `start`; settings are checked in
    between::

        cycle       0        1        2        3
        write       ~~~~~~~~~_________________________   control.start
        copying     _________~~~~~~~~~________________   settings are copied, `illegal` settles
        checked     __________________~~~~~~~~~_______
        start       __________________~~~~~~~~~_______   or else error BAD_SETTING

    Storage: two copies of the settings, in flip-flops. With `config.bank_memories` the host reads settings from a third one, in
    a memory, because a multiplexer of them all needs more wires in one place than an FPGA has. Settings then outlast a reset.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        super().__init__({
            **bus.axi_lite_slave_ports("s_axi"),
            "settings": Out(layout(frame_settings(config))), "start": Out(1), "abort": Out(1), "clear": Out(1),
            "finished": In(1), "error": In(unsigned(ErrorCode.width())), "busy": In(1), "phase": In(unsigned(Phase.width())),
            "read_errors": In(len(read_clients(config))), "write_errors": In(len(write_clients(config))), "interrupt": Out(1),
            **({"counters": In(counters_layout(config))} if config.counters else {}),
            **({"first_finished": In(1), "first_error": In(unsigned(ErrorCode.width())), "first_busy": In(1),
                "first_phase": In(unsigned(Phase.width())), "hand_over": In(1)} if config.overlap else {}),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.slave = slave = LiteSlave()
        bus.join(m, self, slave, "s_axi")
        self._registers = {r.name: r for r in register_map(self.config)}
        self._numbers = settings(self.config)[-1].number + 1
        lasting = self.config.bank_memories
        written = {s.name: Signal(s.field.format.width, name=s.name, reset_less=lasting) for s in settings(self.config)}
        commands = self._commands(m, slave)
        values = {name: Value.cast(value) for name, value in identity(self.config).items()}
        values |= (self._frames if self.config.overlap else self._frame)(m, slave, commands, written)
        values |= {name: shown.as_signed() if is_signed(self._registers[name].format) else shown
                   for name, shown in (self._copies(m, slave, written) if lasting else written).items()}
        values |= self._counters(m, slave)
        self._write_settings(m, slave, written)
        m.d.comb += slave.write_refused.eq(1)
        with m.Switch(slave.write_index):
            for register in self._registers.values():
                if register.access is not Access.READ_ONLY:
                    with m.Case(register.offset // 4):
                        m.d.comb += slave.write_refused.eq(0)
        m.d.comb += slave.read_refused.eq(1)
        with m.Switch(slave.read_index):
            for name, register in self._registers.items():
                with m.Case(register.offset // 4):
                    m.d.comb += [slave.read_data.eq(values[name]), slave.read_refused.eq(0)]
        return m

    def _is_written(self, slave: LiteSlave, name: str) -> Value:
        return slave.write & (slave.write_index == self._registers[name].offset // 4)

    def _commands(self, m: Module, slave: LiteSlave) -> dict[str, Value]:
        """For every command bit of `control`, by name, whether it is being written as 1."""
        here, found = self._is_written(slave, "control"), {}
        for bits in self._registers["control"].bits:
            if bits.strobe:
                found[bits.name] = here & slave.write_bytes[bits.low // 8] & slave.write_data[bits.low]
        return found

    def _frame(
        self, m: Module, slave: LiteSlave, commands: dict[str, Value], written: dict[str, Signal],
    ) -> dict[str, Value]:
        """The state of a frame from its start to its end. Returns the values of the control registers by name."""
        copying, checked, running, forgetting = Signal(), Signal(), Signal(), Signal()
        done, failed, pending, enabled = Signal(), Signal(), Signal(2), Signal(2)
        code, number = Signal(ErrorCode.width()), Signal(range(self._numbers))
        illegal, first = self._check(m, written)
        busy, ends, begins = Signal(), Signal(), Signal()
        m.d.comb += [
            busy.eq(copying | checked | running | self.busy), begins.eq(commands["start"] & ~busy),
            self.start.eq(checked & ~illegal), ends.eq(self.finished & running & ~forgetting),
        ]
        m.d.sync += [
            copying.eq(begins), checked.eq(copying), self.clear.eq(commands["clear"]),
            self.abort.eq((commands["abort"] | commands["reset"]) & busy), self.interrupt.eq((pending & enabled).any())]
        with m.If(copying):
            m.d.sync += Value.cast(self.settings).eq(Cat(written.values()))
        with m.If(self.start):
            m.d.sync += running.eq(1)
        with m.Elif(self.finished):
            m.d.sync += [running.eq(0), forgetting.eq(0)]

        enables = self._interrupts(m, slave, pending, enabled)
        with m.If(begins):
            m.d.sync += [done.eq(0), failed.eq(0), code.eq(ErrorCode.NONE)]
        with m.If(ends & (self.error == ErrorCode.NONE)):
            m.d.sync += [done.eq(1), pending[0].eq(1)]
        with m.If(ends & (self.error != ErrorCode.NONE)):
            m.d.sync += [failed.eq(1), pending[1].eq(1), code.eq(self.error)]
        with m.If(checked & illegal):
            m.d.sync += [failed.eq(1), pending[1].eq(1), code.eq(ErrorCode.BAD_SETTING), number.eq(first)]
        with m.If(commands["reset"]):
            m.d.sync += [
                checked.eq(0), forgetting.eq((running & ~self.finished) | self.start),
                done.eq(0), failed.eq(0), pending.eq(0), code.eq(ErrorCode.NONE), number.eq(0)]
        return {
            "control": _packed(self._registers["control"], {bits.name: enabled[i] for i, bits in enumerate(enables)}),
            "status": _packed(
                self._registers["status"], {"busy": busy, "done": done, "error": failed, "phase": self.phase}),
            "error": code, "bad_setting": number, "interrupt": pending,
            "error_clients": _packed(
                self._registers["error_clients"], {"read": self.read_errors, "write": self.write_errors})}

    def _interrupts(self, m: Module, slave: LiteSlave, pending: Signal, enabled: Signal) -> list[Bits]:
        """Writes of the enables of interrupts, whose bits of `control` are returned, and of causes that are cleared."""
        enables = [bits for bits in self._registers["control"].bits if not bits.strobe]
        with m.If(self._is_written(slave, "control")):
            for place, bits in enumerate(enables):
                with m.If(slave.write_bytes[bits.low // 8]):
                    m.d.sync += enabled[place].eq(slave.write_data[bits.low])
        with m.If(self._is_written(slave, "interrupt") & slave.write_bytes[0]):
            m.d.sync += pending.eq(pending & ~slave.write_data[:2])
        return enables

    def _frames(
        self, m: Module, slave: LiteSlave, commands: dict[str, Value], written: dict[str, Signal],
    ) -> dict[str, Value]:
        """The same as `_frame` for two frames in flight. What is known of each moves from its first to its second phase with
        `hand_over`."""
        copying, checked = Signal(), Signal()
        running, forgetting = ([Signal(name=f"{name}_{place}") for place in ("first", "second")]
                               for name in ("running", "forgetting"))
        done, failed, pending, enabled = Signal(), Signal(), Signal(2), Signal(2)
        code, first_code, number = Signal(ErrorCode.width()), Signal(ErrorCode.width()), Signal(range(self._numbers))
        illegal, wrong = self._check(m, written)
        busy, taken, ends, first_ends, begins = Signal(), Signal(), Signal(), Signal(), Signal()
        m.d.comb += [
            taken.eq(copying | checked | running[0] | self.first_busy), busy.eq(taken | running[1] | self.busy),
            begins.eq(commands["start"] & ~taken), self.start.eq(checked & ~illegal),
            ends.eq(self.finished & ~forgetting[1]), first_ends.eq(self.first_finished & ~forgetting[0])]
        m.d.sync += [
            copying.eq(begins), checked.eq(copying), self.clear.eq(commands["clear"]),
            self.abort.eq((commands["abort"] | commands["reset"]) & busy), self.interrupt.eq((pending & enabled).any())]
        with m.If(copying):
            m.d.sync += Value.cast(self.settings).eq(Cat(written.values()))
        with m.If(self.finished):
            m.d.sync += [running[1].eq(0), forgetting[1].eq(0)]
        with m.If(self.first_finished | self.hand_over):
            m.d.sync += [running[0].eq(0), forgetting[0].eq(0)]
        with m.If(self.hand_over):
            m.d.sync += [running[1].eq(1), forgetting[1].eq(forgetting[0])]
        with m.If(self.start):
            m.d.sync += running[0].eq(1)

        enables = self._interrupts(m, slave, pending, enabled)
        with m.If(begins):
            m.d.sync += [done.eq(0), failed.eq(0), code.eq(ErrorCode.NONE), first_code.eq(ErrorCode.NONE)]
        with m.If(ends & (self.error == ErrorCode.NONE)):
            m.d.sync += [done.eq(1), pending[0].eq(1)]
        with m.If(ends & (self.error != ErrorCode.NONE)):
            m.d.sync += [failed.eq(1), pending[1].eq(1), code.eq(self.error)]
        with m.If(first_ends):
            m.d.sync += [failed.eq(1), pending[1].eq(1), first_code.eq(self.first_error)]
        with m.If(checked & illegal):
            m.d.sync += [failed.eq(1), pending[1].eq(1), first_code.eq(ErrorCode.BAD_SETTING), number.eq(wrong)]
        with m.If(commands["reset"]):
            m.d.sync += [
                checked.eq(0), done.eq(0), failed.eq(0), pending.eq(0), code.eq(ErrorCode.NONE),
                first_code.eq(ErrorCode.NONE), number.eq(0),
                forgetting[0].eq((running[0] & ~self.first_finished & ~self.hand_over) | self.start),
                forgetting[1].eq((running[1] & ~self.finished) | self.hand_over)]
        return {
            "control": _packed(self._registers["control"], {bits.name: enabled[i] for i, bits in enumerate(enables)}),
            "status": _packed(self._registers["status"], {
                "busy": busy, "done": done, "error": failed, "ready": ~taken, "phase": self.phase,
                "first_phase": self.first_phase}),
            "error": _packed(self._registers["error"], {"code": code, "first_code": first_code}),
            "bad_setting": number, "interrupt": pending,
            "error_clients": _packed(
                self._registers["error_clients"], {"read": self.read_errors, "write": self.write_errors})}

    def _check(self, m: Module, written: dict[str, Signal]) -> tuple[Signal, Signal]:
        """Whether a setting is out of its limits, and the number of the first one that is. Both are registered: they come a
        cycle after the settings."""
        illegal, first = Signal(), Signal(range(self._numbers))
        numbers = {s.name: s.number for s in settings(self.config)}
        m.d.sync += illegal.eq(0)
        for limit in reversed(limits(self.config)):  # the first setting comes last, because the last assignment wins
            value = written[limit.setting]
            below = value < limit.low if limit.low else Const(0)  # patterns are unsigned: none is below 0
            outside = below & (value > limit.high) if limit.low > limit.high else below | (value > limit.high)
            with m.If(outside & written[limit.where] if limit.where else outside):
                m.d.sync += [illegal.eq(1), first.eq(numbers[limit.setting])]
        return illegal, first

    def _write_settings(self, m: Module, slave: LiteSlave, written: dict[str, Signal]) -> None:
        for name, signal in written.items():
            with m.If(self._is_written(slave, name)):
                for byte in range((len(signal) + 7) // 8):
                    with m.If(slave.write_bytes[byte]):
                        m.d.sync += signal[8 * byte : 8 * byte + 8].eq(slave.write_data[8 * byte : 8 * byte + 8])

    def _copies(self, m: Module, slave: LiteSlave, written: dict[str, Signal]) -> dict[str, Value]:
        """The settings as a memory has them that is written with them, by name. It is read in every cycle, one before the
        slave takes the word, and so it is never behind the flip-flops."""
        places = (self._numbers - 1).bit_length()
        m.submodules.copies = copies = Memory(shape=32, depth=1 << places, init=[])
        write = copies.write_port(granularity=8)
        read = copies.read_port(transparent_for=(write,))
        within = (slave.write_index >= SETTINGS_BASE // 4) & (slave.write_index < COUNTERS_BASE // 4)
        m.d.comb += [
            write.addr.eq(slave.write_index), write.data.eq(slave.write_data),
            write.en.eq(Mux(slave.write & within, slave.write_bytes, 0)),
            read.addr.eq(Mux(slave.s_axi_arready, slave.s_axi_araddr[2:], slave.read_index))]
        return {name: read.data[: len(signal)] for name, signal in written.items()}

    def _counters(self, m: Module, slave: LiteSlave) -> dict[str, Value]:
        """The values of the counters' registers. Reading the lower half of a counter stores its upper half for a later read."""
        if not self.config.counters:
            return {r.name: Value.cast(0) for r in self._registers.values() if r.offset >= COUNTERS_BASE}
        upper, values = Signal(32, reset_less=True), {}
        for counter in counters(self.config):
            value = self.counters[counter.name]
            if counter.width == 32:
                values[counter.name] = value
                continue
            values |= {f"{counter.name}_low": value[:32], f"{counter.name}_high": upper}
            with m.If(slave.read & (slave.read_index == self._registers[f"{counter.name}_low"].offset // 4)):
                m.d.sync += upper.eq(value[32:])
        return values


def _packed(register: Register, parts: dict[str, Value]) -> Value:
    """The value of a register, put together from its parts; strobes read 0."""
    places = {bits.name: bits for bits in register.bits}
    value = Value.cast(0)
    for name, part in parts.items():
        value = value | (Value.cast(part)[: places[name].width] << places[name].low)
    return value
