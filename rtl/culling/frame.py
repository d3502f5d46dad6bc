"""Parts that the units of the geometry phase share: ports for the frame's settings, and counts of a frame's items."""

from __future__ import annotations

from collections.abc import Iterable

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import data
from amaranth.lib.wiring import In, Member

from rtl.culling.datapath import Datapath
from rtl.culling.shared_datapath import DatapathSide
from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.memory import frame_settings
from spec.records import INDEX_BITS

COUNTER_BITS = INDEX_BITS
"""Bits of a count of a frame's Gaussians."""


def setting_ports(config: AcceleratorConfig, names: Iterable[str]) -> dict[str, Member]:
    """In ports with the names and shapes of these fields of `frame_settings`."""
    if not isinstance(config, AcceleratorConfig):
        raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
    fields = layout(frame_settings(config))
    return {name: In(fields[name].shape) for name in names}


def connect_settings(m: Module, unit: object, datapath: Datapath | DatapathSide) -> None:
    """Connects the unit's settings to the ports of its datapath that have the same names."""
    for name in datapath.setting_names:
        m.d.comb += getattr(datapath, name).eq(getattr(unit, name))


def count_items(m: Module, moves: Value, end: Value, *counters: tuple[Signal, Value]) -> None:
    """Counts in each of `counters` the frame's items for which the counter's condition holds.

    `moves` is high where an item passes, and `end` where this is the frame's end, which is not counted. The first item after an
    end restarts the counts.
    """
    fresh = Signal(init=1)
    with m.If(moves):
        m.d.sync += fresh.eq(end)
        for counter, condition in counters:
            counts = condition & ~end  # may be on the critical path, so it drives multiplexers and no adder
            m.d.sync += counter.eq(Mux(fresh, counts, Mux(counts, counter + 1, counter)))


def flatten(fields: dict[str, Value | data.View]) -> dict[str, Value]:
    """Splits arrays into one field `name_i` per number, as graphs name their inputs."""
    found = {}
    for name, value in fields.items():
        shape = value.shape()
        if isinstance(shape, data.ArrayLayout):
            found.update({f"{name}_{i}": value[i] for i in range(shape.length)})
        else:
            found[name] = value
    return found

