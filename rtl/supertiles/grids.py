"""Where the tiles of each eye lie in the super-tiles of a joint frame (`spec.joint`, "Grids")."""

from __future__ import annotations

from collections.abc import Callable

from amaranth.hdl import Module, Mux, Signal, Value, ValueLike

from spec.constants import SUPER_X


def grid_apart(joint: Value, shift: Value) -> Value:
    """By how many columns of tiles a frame of both eyes is wider than one of one eye; 0 where `joint` is."""
    return Mux(joint, Mux(shift[-1], -shift, shift), 0)[: SUPER_X.bit_length()]


def grid_origin(m: Module, joint: Value, shift: Value) -> Callable[[ValueLike], Value]:
    """A function from an eye to its O (`spec.joint.grid_origins`), which is valid a cycle after the settings."""
    apart, right = Signal(range(SUPER_X + 1), name="apart"), Signal(name="right")
    m.d.sync += [apart.eq(grid_apart(joint, shift)), right.eq(shift[-1])]  # right: the eye that begins further right
    return lambda eye: Mux(Value.cast(eye) == right, apart, 0)
