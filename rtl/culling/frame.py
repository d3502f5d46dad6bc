"""What units of a frame have in common: ports for its settings, and counts of one frame's items."""

from __future__ import annotations

from collections.abc import Iterable

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import data
from amaranth.lib.wiring import In, Member

from rtl.culling.datapath import Datapath
from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.memory import frame_settings
from spec.records import INDEX_BITS

COUNTER_BITS = INDEX_BITS
"""Of a frame's points."""


def setting_ports(config: AcceleratorConfig, names: Iterable[str]) -> dict[str, Member]:
    """In ports named and shaped like those fields of `frame_settings`."""
    if not isinstance(config, AcceleratorConfig):
        raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
    fields = layout(frame_settings(config))
    return {name: In(fields[name].shape) for name in names}


def connect_settings(m: Module, unit: object, datapath: Datapath) -> None:
    """The unit's settings to those ports of its datapath that bear the same names."""
    for name in datapath.setting_names:
        m.d.comb += getattr(datapath, name).eq(getattr(unit, name))


def count_items(m: Module, moves: Value, end: Value, *counters: tuple[Signal, Value]) -> None:
    """Counts, in each of `counters`, the frame's items for which its condition holds.

    `moves` says that an item passes, `end` that it is no item but the frame's end; the first behind an end starts afresh.
    """
    fresh = Signal(init=1)
    with m.If(moves):
        m.d.sync += fresh.eq(end)
        for counter, condition in counters:
            counts = condition & ~end  # it chooses, late as it may come, and is not waited for by a carry
            m.d.sync += counter.eq(Mux(fresh, counts, Mux(counts, counter + 1, counter)))


def flatten(fields: dict[str, Value | data.View]) -> dict[str, Value]:
    """Arrays as `name_i`, one field a number, as graphs name their inputs."""
    found = {}
    for name, value in fields.items():
        shape = value.shape()
        if isinstance(shape, data.ArrayLayout):
            found.update({f"{name}_{i}": value[i] for i in range(shape.length)})
        else:
            found[name] = value
    return found

