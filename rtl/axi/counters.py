"""Performance counters: the state of every stage's input stream in every cycle, and the events that the units report."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Signal, Value, unsigned
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from rtl.axi.registers import counters_layout
from spec.codes import Phase
from spec.config import AcceleratorConfig
from spec.queues import COUNTER_BITS
from spec.registers import events, read_clients, stages, write_clients


class StageCounters(wiring.Component):
    """Counts, for each of several streams, the busy, starved and blocked cycles among those in which `active` is high. The
    three counts of a stream add up to the number of these cycles.

    Parameters:
        count: number of streams.

    Ports:
        valid, ready: one bit per stream: its `valid` and `ready`.
        active: the cycle is counted.
        clear: strobe: set all counters to 0; it has priority over counting.
        busy, starved, blocked: for each stream, the cycles in which an item was transferred, in which none was offered, and in
            which one was offered and not taken. The counters have 32 bits and wrap.
    """

    def __init__(self, count: int):
        if not isinstance(count, int) or isinstance(count, bool):
            raise TypeError(f"count must be an integer, not {count!r}")
        if count < 1:
            raise ValueError(f"count must be at least 1, not {count!r}")
        self.count = count
        each = Out(unsigned(COUNTER_BITS)).array(count)
        super().__init__({
            "valid": In(count), "ready": In(count), "active": In(1), "clear": In(1),
            "busy": each, "starved": each, "blocked": each})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        for i in range(self.count):
            happens = {
                "busy": self.valid[i] & self.ready[i], "starved": ~self.valid[i], "blocked": self.valid[i] & ~self.ready[i]}
            for name, condition in happens.items():
                _count(m, getattr(self, name)[i], self.active & condition, self.clear)
        return m


def events_layout(config: AcceleratorConfig) -> data.StructLayout:
    """The number of times that each event happened in a frame."""
    return data.StructLayout(dict.fromkeys(events(config), COUNTER_BITS))


class PerformanceCounters(wiring.Component):
    """All counters of the machine. Cycles and stages are counted in all phases but IDLE, beats are counted always, and events
    are added when a frame, or the pass of one eye, ends.

    The inputs are registered before anything is counted: the `valid` and `ready` of a stage come late in a cycle, through
    several units, and a sum behind them would not fit into the same one.

    Parameters:
        config: the machine; `stereo` matters here.

    Ports:
        phase: the phase of the machine.
        target: level: this is the pass of the target eye; only with stereo.
        clear: strobe: set all counters to 0.
        finished: strobe: a frame has ended.
        first_phase, phase: with overlapped phases, those of the frame in its first phase and of the one in its second.
        busy: level: a frame is in a phase; only with overlapped phases.
        first_finished: strobe: a frame has ended before its second phase; only with overlapped phases.
        next_pass: strobe: the source eye's pass has ended, and `events` are those of this pass; only with stereo.
        stage_valid, stage_ready: `valid` and `ready` of the stages' input streams, in the order of `spec.registers.stages`.
        read_beats, write_beats: one bit per client, strobes.
        events: the events of the frame or pass (`events_layout`), which are final when it ends. Those of a frame are taken in
            the next cycle, because they stay until the next frame; those of a pass are registered with its end, because the
            next pass begins in the next cycle.
        counters: all counters, for the register file; they are delayed by two cycles, and wrap.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        watched = In(len(stages(config)))
        super().__init__({
            "phase": In(unsigned(Phase.width())), "clear": In(1), "finished": In(1),
            "stage_valid": watched, "stage_ready": watched,
            "read_beats": In(len(read_clients(config))), "write_beats": In(len(write_clients(config))),
            "events": In(events_layout(config)), "counters": Out(counters_layout(config)),
            **({"target": In(1), "next_pass": In(1)} if config.stereo else {}),
            **({"first_phase": In(unsigned(Phase.width())), "busy": In(1), "first_finished": In(1)} if config.overlap else {}),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()

        def registered(name: str) -> Signal:
            seen = Signal.like(getattr(self, name), name=f"{name}_seen")
            m.d.sync += seen.eq(getattr(self, name))
            return seen

        names = stages(self.config)
        m.submodules.stages = watch = StageCounters(len(names))
        phase, clear, finished = registered("phase"), registered("clear"), registered("finished")
        read_beats, write_beats = registered("read_beats"), registered("write_beats")
        active = registered("busy") if self.config.overlap else phase != Phase.IDLE
        m.d.comb += [
            watch.valid.eq(registered("stage_valid")), watch.ready.eq(registered("stage_ready")), watch.active.eq(active),
            watch.clear.eq(clear)]
        for i, stage in enumerate(names):
            for what in ("busy", "starved", "blocked"):
                m.d.comb += self.counters[f"{stage}_{what}"].eq(getattr(watch, what)[i])

        steps: dict[str, Value] = {"cycles_total": active, "frames": finished}
        steps |= {f"cycles_{p.name.lower()}": phase == p for p in (Phase.TABLE, Phase.GEOMETRY, Phase.RENDER)}
        if self.config.overlap:
            first = registered("first_phase")
            steps["frames"] = finished + registered("first_finished")
            steps |= {f"cycles_{p.name.lower()}": first == p for p in (Phase.TABLE, Phase.GEOMETRY)}
        steps |= {f"read_beats_{name}": read_beats[i] for i, name in enumerate(read_clients(self.config))}
        steps |= {f"write_beats_{name}": write_beats[i] for i, name in enumerate(write_clients(self.config))}
        final, happened = finished, self.events
        if self.config.stereo:
            final, happened = finished | registered("next_pass"), registered("events")
            steps["cycles_target"] = active & registered("target")
        steps |= {name: Mux(final, happened[name], 0) for name in events(self.config)}
        steps["read_beats"] = read_beats.any()  # the bus moves at most one beat per cycle
        steps["write_beats"] = write_beats.any()
        for name, step in steps.items():
            _count(m, self.counters[name], step, clear)
        return m


def _count(m: Module, counter: Signal, step: Value, clear: Signal) -> None:
    if len(counter) > COUNTER_BITS:
        count_in_halves(m, counter, step, clear)
        return
    with m.If(clear):
        m.d.sync += counter.eq(0)
    with m.Else():
        m.d.sync += counter.eq(counter + step)


def count_in_halves(m: Module, counter: Value, step: Value, clear: Value) -> None:
    """Counts steps of 0 or 1 without a carry chain through the whole counter. `full` tells a cycle ahead that the lower half
    has only ones.

    Both halves change in the same cycle, so the counter is always consistent::

        cycle           0         1         2
        step         ~~~~~~~~~~~~~~~~~~~~________
        counter        0 fffe    0 ffff    1 0000
        full         __________~~~~~~~~~~________

    Raises ValueError where `step` has more than one bit.
    """
    if len(step) != 1:
        raise ValueError(f"a step must have one bit, not {len(step)!r}")
    half, full = len(counter) // 2, Signal()
    low, high = counter[:half], counter[half:]
    with m.If(clear):
        m.d.sync += [low.eq(0), high.eq(0), full.eq(0)]
    with m.Else():
        m.d.sync += [low.eq(low + step), high.eq(high + (full & step))]
        with m.If(step):
            m.d.sync += full.eq(low == (1 << half) - 2)
