"""Counts the values at the limits of their formats in the records that pass a place of the machine."""

from __future__ import annotations

from typing import cast

from amaranth.hdl import Cat, Module, Signal, Value
from amaranth.lib import data, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.formats import Fixed
from spec.queues import COUNTER_BITS
from spec.saturations import STREAMS, WATCHED, Saturation, limits


def at_limit(value: Value, number: Fixed) -> Value:
    """Whether a number of the format counts as saturated."""
    return Cat(value == limit for limit in limits(number)).any()


class SaturationCounters(wiring.Component):
    """Counts the saturated values that `spec.saturations` watches in records. The unit only observes: no other unit waits for
    it. Saturated means are counted by the projection unit, which culls them.

    Parameters:
        config: the machine; formats matter here.

    Ports:
        splats, views: the records of `spec.saturations.STREAMS` that are offered.
        splats_move, views_move: such a record is transferred.
        clear: strobe: set all counts to 0.
        saturated_depths, saturated_keys, saturated_colours: number of records since `clear` with a number at a limit.

    Throughput: one record of each kind per cycle. Latency: a record counts three cycles after its transfer. Comparisons and
    handshakes are registered first, so that they do not lengthen paths of the observed units::

        cycle        0      1      2      3
        splats_move  ~~~~~~~______________
        moved        _______~~~~~~~_______   with a register of the numbers that are at a limit
        step         ______________~~~~~~~
        count        <  n                 ><  n + 1
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        self.config = config
        super().__init__({
            **{name: In(layout(record(config))) for name, record in STREAMS.items()},
            **{f"{name}_move": In(1) for name in STREAMS},
            "clear": In(1), **{saturation.name: Out(COUNTER_BITS) for saturation in WATCHED}})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        moved = {name: Signal(name=f"{name}_moved") for name in STREAMS}
        for name, was in moved.items():
            m.d.sync += was.eq(getattr(self, f"{name}_move"))
        for saturation in WATCHED:
            self._count(m, saturation, moved[saturation.stream])
        return m

    def _count(self, m: Module, saturation: Saturation, moved: Signal) -> None:
        field, value = saturation.field_of(self.config), getattr(self, saturation.stream)[saturation.field]
        numbers = list(value) if isinstance(value, data.View) else [value]
        found = Signal(len(numbers), name=f"{saturation.field}_found", reset_less=True)
        step, count = Signal(name=f"{saturation.field}_step"), getattr(self, saturation.name)
        m.d.sync += [
            found.eq(Cat(at_limit(number, cast(Fixed, field.format)) for number in numbers)), step.eq(moved & found.any()),
            count.eq(count + step)]
        with m.If(self.clear):
            m.d.sync += count.eq(0)
