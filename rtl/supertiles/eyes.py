"""What units of machines with joint frames have in common (`spec.joint`)."""

from __future__ import annotations

from collections.abc import Callable

from amaranth.hdl import Module, Mux, Signal, Value
from amaranth.lib import wiring
from amaranth.lib.wiring import In

from rtl.shapes import shape
from spec.config import AcceleratorConfig
from spec.joint import SHIFT_MOST
from spec.memory import frame_settings


def joint_settings(config: AcceleratorConfig, *names: str) -> dict[str, wiring.Member]:
    """Ports of a unit for these settings, which exist in machines with joint frames alone."""
    if not config.joint:
        return {}
    return {field.name: In(shape(field.format)) for field in frame_settings(config).fields if field.name in names}


def origins(m: Module, joint: Value, shift: Value) -> tuple[Signal, Signal]:
    """The columns of tiles by which the frames of source and target lie right of the first super-tile's left edge; 0 where the
    frame is none of two eyes. They are registered: settings are stable long before they are used."""
    source, target = (Signal(range(SHIFT_MOST + 1), name=f"{eye}_origin", reset_less=True) for eye in ("source", "target"))
    left = shift < 0
    m.d.sync += [source.eq(Mux(joint & ~left, shift, 0)), target.eq(Mux(joint & left, -shift, 0))]
    return source, target


def origin_of(m: Module, joint: Value, shift: Value) -> Callable[[Value], Value]:
    """A function from an eye to its one of `origins`."""
    source, target = origins(m, joint, shift)
    return lambda eye: Mux(eye, target, source)


def columns_apart(joint: Value, shift: Value) -> Value:
    """By how many columns of tiles a frame of both eyes is wider than one of one eye; 0 where the frame is none of two."""
    return Mux(joint, Mux(shift < 0, -shift, shift), 0)[: SHIFT_MOST.bit_length()]
