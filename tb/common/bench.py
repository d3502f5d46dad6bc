"""A component that holds a unit under test and has the ports that `tb.common.playback` plays.

A subclass adds the logic that files cannot replace, such as delays of the memory.
"""

from __future__ import annotations

from collections.abc import Mapping

from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.emit import to_verilog
from rtl.shapes import layout
from spec.records import Record
from tb.common.playback import Playback, Stream


class Bench(wiring.Component):
    """The base class of a bench: a subclass creates the unit, connects it with `join`, and adds its own logic.

    Parameters:
        inputs: the streams into the bench, by name.
        outputs: the streams out of the bench, by name.
        settings: the widths in bits of plain inputs, by name; they are constant during a run.
        observed: the widths in bits of plain outputs, by name; they are read at the end of a run.
    """

    def __init__(
        self, inputs: Mapping[str, Record], outputs: Mapping[str, Record], settings: Mapping[str, int],
        observed: Mapping[str, int],
    ) -> None:
        self.inputs, self.outputs, self.settings, self.observed = inputs, outputs, settings, observed
        super().__init__({
            **{name: In(stream.Signature(layout(record))) for name, record in inputs.items()},
            **{name: Out(stream.Signature(layout(record))) for name, record in outputs.items()},
            **{name: In(bits) for name, bits in settings.items()},
            **{name: Out(bits) for name, bits in observed.items()},
        })

    def join(self, m: Module, unit: wiring.Component, *, apart: tuple[str, ...] = ()) -> None:
        """Connects every port of the unit to the port of the bench with the same name, except for the streams `apart`."""
        own = unit.signature.members.keys() - {*apart}
        for name in [name for name in self.inputs if name in own]:
            wiring.connect(m, wiring.flipped(getattr(self, name)), getattr(unit, name))
        for name in [name for name in self.outputs if name in own]:
            wiring.connect(m, getattr(unit, name), wiring.flipped(getattr(self, name)))
        m.d.comb += [getattr(unit, name).eq(getattr(self, name)) for name in self.settings if name in own]
        m.d.comb += [getattr(self, name).eq(getattr(unit, name)) for name in self.observed if name in own]

    def delay_answers(self, m: Module, unit: wiring.Component, most: int, client: str = "", *, opposite: bool = False,
                      ) -> None:
        """Passes `data` to the unit, each item at the earliest `delay` + 1 cycles after its request left `reads`. A unit with
        several read ports has a `client` behind these names, such as "_colour".

        The requests go to a file, and the answers come from a file. This file can stand for the memory because the requests are
        compared with the golden ones, so it is known in advance which beats they read. `most` is the largest `delay`. With
        `opposite`, data are the opposite of an answer while the memory has none: a unit must not look at them.
        """
        age, due = Signal(most + 1), Signal(16)
        reads, data, to, delay = (getattr(owner, name + client) for owner, name in (
            (self, "reads"), (self, "data"), (unit, "data"), (self, "delay")))
        left, answered = reads.valid & reads.ready, data.valid & data.ready
        answer = data.payload.as_value()
        if opposite:
            answer = Mux(to.valid, answer, ~answer)
        m.d.comb += [
            to.payload.eq(answer), to.valid.eq(data.valid & due.any()), data.ready.eq(to.ready & due.any()),
        ]
        # A request that leaves has age 0 at the next edge. Each request in flight is a bit of this shift register.
        m.d.sync += [age.eq(left << delay | age >> 1), due.eq(due + age[0] - answered)]

    def playback(self, name: str, module: str, verilog: str | None = None, *, busy_watched: bool = False) -> Playback:
        """The bench with a file at each stream.

        Args:
            name: the name of the build folder.
            module: the name of the bench's Verilog module.
            verilog: the bench's Verilog if it has been emitted before; None emits it.
            busy_watched: as in `Playback`; the `busy` of most benches is that of a part, or speaks of a frame.
        """
        return Playback(
            name=name, module=module, verilog=verilog or to_verilog(self, module),
            inputs=tuple(Stream(*item) for item in self.inputs.items()),
            outputs=tuple(Stream(*item) for item in self.outputs.items()),
            settings=tuple(self.settings.items()), observed=tuple(self.observed.items()), busy_watched=busy_watched)
