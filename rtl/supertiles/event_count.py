"""A count of events that need not be exact in every cycle."""

from __future__ import annotations

from amaranth.hdl import Cat, Module, Signal, Value


def count(m: Module, total: Signal, amount: Value, clear: Value) -> None:
    """Adds `amount` to the register `total` in every cycle; `clear` sets it to 0 instead.

    The upper half is added a cycle later, so that no carry passes through both halves: `total` is right two cycles after the
    last change.
    """
    half = len(total) // 2
    carry = Signal(name=f"{total.name}_carry")
    m.d.sync += [Cat(total[:half], carry).eq(total[:half] + amount), total[half:].eq(total[half:] + carry)]
    with m.If(clear):
        m.d.sync += [total.eq(0), carry.eq(0)]
