"""Sources and sinks of streams that are driven from Python, cycle by cycle. They suit small units and unusual protocols.

They are slower than `tb.common.playback` by an order of magnitude but have all of Python's freedom. Both pause according to the
same tables. Ports have Amaranth's names (`NAME__payload`, `NAME__valid`, `NAME__ready`). The drivers change wires at falling
edges and read them after they have settled there, so that they see what the unit sees at its next rising edge.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from cocotb.triggers import FallingEdge, ReadOnly

from spec.records import Record
from tb.common.patterns import PERIOD, Pattern


class _Port:
    """The three wires of a stream, and the cycles in which this side pauses."""

    def __init__(self, dut: object, name: str, record: Record, pattern: Pattern = Pattern.NEVER, seed: int = 0):
        self.name, self._record, self._clk = name, record, dut.clk
        self._payload, self._valid, self._ready = (getattr(dut, f"{name}__{wire}") for wire in ("payload", "valid", "ready"))
        self._pauses, self._cycle = pattern.pauses(seed), 0

    def _pausing(self) -> bool:
        self._cycle += 1
        return bool(self._pauses[(self._cycle - 1) % PERIOD])


class Source(_Port):
    """Offers items to a stream. An item stays until it is accepted; pauses come between items.

    Attributes:
        sent: the number of items accepted so far.
    """

    sent = 0

    async def send(self, rows: Iterable[Mapping[str, object] | np.void]) -> None:
        """Sends the rows. Returns at the falling edge after the one at which the last row was seen to be accepted."""
        for row in rows:
            await FallingEdge(self._clk)
            self._valid.value = 0
            while self._pausing():
                await FallingEdge(self._clk)
            self._payload.value, self._valid.value = self._record.pack(row), 1
            await ReadOnly()
            while not self._ready.value:
                await FallingEdge(self._clk)
                await ReadOnly()
            self.sent += 1
        await FallingEdge(self._clk)
        self._valid.value = 0


class Sink(_Port):
    """Accepts items from a stream.

    Attributes:
        rows: the accepted items, as `Record.unpack` gives them.
    """

    async def run(self) -> None:
        """Accepts items without end. Raises AssertionError where the unit withdraws or changes an offered item."""
        self.rows: list[dict] = []
        offered: int | None = None
        while True:
            await FallingEdge(self._clk)
            ready = not self._pausing()
            self._ready.value = ready
            await ReadOnly()
            payload = int(self._payload.value) if self._valid.value else None
            assert offered is None or payload == offered, f"{self.name}: changed an offer that was not taken"
            if ready and payload is not None:
                self.rows.append(self._record.unpack(payload))
            offered = None if ready else payload
