"""AXI ports with their conventional names.

If a component had an AXI interface as one member, its Verilog ports would be named like `m_axi__awaddr`, but tools and people
expect `m_axi_awaddr`. So every signal is a member of its own, and the functions of this module list and connect them.
"""

from __future__ import annotations

from enum import IntEnum

from amaranth.hdl import Module
from amaranth.lib import wiring
from amaranth.lib.wiring import In, Member, Out

from spec.memory import ADDRESS_BITS, BEAT_BYTES
from spec.registers import REGISTER_ADDRESS_BITS

_FROM_MASTER = ("aw", "w", "ar")


class Response(IntEnum):
    """How a transaction ended."""

    OKAY = 0
    EXOKAY = 1
    SLVERR = 2
    DECERR = 3


RESPONSE_BITS = 2
BURST_INCR, BURST_BITS = 1, 2
CACHE_NORMAL, CACHE_BITS = 0b0010, 4
"""Normal, non-cacheable, non-bufferable memory: memory itself answers a write, so an answered write is visible to all
masters."""
LENGTH_BITS, SIZE_BITS, PROTECTION_BITS = 8, 3, 3


def _ports(prefix: str, channels: dict[str, dict[str, int]], master: bool) -> dict[str, Member]:
    members: dict[str, Member] = {}
    for channel, widths in channels.items():
        forward = Out if (channel in _FROM_MASTER) == master else In
        members |= {f"{prefix}_{channel}{name}": forward(width) for name, width in widths.items()}
        members[f"{prefix}_{channel}valid"] = forward(1)
        members[f"{prefix}_{channel}ready"] = forward(1).flip()
    return members


def axi_master_ports(prefix: str, id_bits: int) -> dict[str, Member]:
    """Members of an AXI4 master with ADDRESS_BITS of address and the data of one beat."""
    address = {
        "id": id_bits, "addr": ADDRESS_BITS, "len": LENGTH_BITS, "size": SIZE_BITS, "burst": BURST_BITS, "cache": CACHE_BITS,
        "prot": PROTECTION_BITS}
    channels = {
        "aw": address, "w": {"data": 8 * BEAT_BYTES, "strb": BEAT_BYTES, "last": 1},
        "b": {"id": id_bits, "resp": RESPONSE_BITS}, "ar": address,
        "r": {"id": id_bits, "data": 8 * BEAT_BYTES, "resp": RESPONSE_BITS, "last": 1}}
    return _ports(prefix, channels, True)


def axi_lite_slave_ports(prefix: str) -> dict[str, Member]:
    """Members of an AXI4-Lite slave with REGISTER_ADDRESS_BITS of address and 32 bits of data."""
    address = {"addr": REGISTER_ADDRESS_BITS, "prot": PROTECTION_BITS}
    channels = {
        "aw": address, "w": {"data": 32, "strb": 4}, "b": {"resp": RESPONSE_BITS}, "ar": address,
        "r": {"data": 32, "resp": RESPONSE_BITS}}
    return _ports(prefix, channels, False)


def join(
    m: Module, outer: wiring.Component, inner: wiring.Component, prefix: str, outer_prefix: str | None = None,
) -> None:
    """Connects the ports of a submodule that begin with `prefix_` to those of its parent, which may have another prefix."""
    names = [name for name in inner.signature.members if name.startswith(f"{prefix}_")]
    if not names:
        raise ValueError(f"prefix must begin a port of {type(inner).__name__}, not {prefix!r}")
    for name in names:
        here, there = getattr(outer, (outer_prefix or prefix) + name.removeprefix(prefix)), getattr(inner, name)
        m.d.comb += here.eq(there) if inner.signature.members[name].flow is Out else there.eq(here)
