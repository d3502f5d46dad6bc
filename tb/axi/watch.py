"""Checks in every cycle that the AXI master's status outputs agree with what moves at its ports."""

from __future__ import annotations

from cocotb.triggers import FallingEdge, ReadOnly

from tb.axi.device import IN_FLIGHT, READERS, WRITERS


class Watch:
    """Checks `idle`, `quiet`, the error flags and the counters' strobes, and that an abort accepts and delivers nothing.

    Attributes:
        problems: descriptions of the differences.
    """

    def __init__(self, dut: object):
        self._dut, self.problems = dut, []
        self._writes, self._reads = [0] * WRITERS, 0
        self._arrived: tuple[int, bool] | None = None  # the ID and the error of the answer on R one cycle ago
        self._read_errors, self._write_errors = 0, 0

    async def run(self) -> None:
        """Checks without end. It must start in a state in which no transaction is in flight."""
        while True:
            await FallingEdge(self._dut.clk)
            await ReadOnly()
            taken = [i for i in range(READERS) if self._moves(f"read_{i}")]
            stored = [i for i in range(WRITERS) if self._moves(f"write_{i}")]
            self._compare()
            if self._dut.abort.value and taken + stored:
                self.problems.append("a request was taken during an abort")
            self._follow(taken, stored)
            if self._reads > IN_FLIGHT + READERS or max(self._writes) > IN_FLIGHT + 2:  # with those in the clients' registers
                self.problems.append("more transactions wait for answers than may")

    def _moves(self, port: str) -> bool:
        return bool(getattr(self._dut, f"{port}__valid").value) and bool(getattr(self._dut, f"{port}__ready").value)

    def _compare(self) -> None:
        arrived = 0 if self._arrived is None else 1 << self._arrived[0]
        wanted = {
            "idle": sum((count == 0) << i for i, count in enumerate(self._writes)),
            "quiet": int(self._reads == 0 and not any(self._writes)),
            "read_errors": self._read_errors, "write_errors": self._write_errors,
            "read_beats": arrived, "delivered": 0 if self._dut.abort.value else arrived,
            "write_beats": self._left()}
        for name, value in wanted.items():
            if int(getattr(self._dut, name).value) != value:
                self.problems.append(f"{name} is {getattr(self._dut, name).value}, not {value:b}")

    def _left(self) -> int:
        """One bit per client: its write leaves on AW."""
        moves = self._dut.m_axi_awvalid.value and self._dut.m_axi_awready.value
        return 1 << int(self._dut.m_axi_awid.value) if moves else 0

    def _follow(self, taken: list[int], stored: list[int]) -> None:
        if self._dut.clear_errors.value:
            self._read_errors = self._write_errors = 0
        if self._arrived is not None:
            self._reads -= 1
            self._read_errors |= self._arrived[1] << self._arrived[0]
        self._reads += len(taken)
        for i in stored:
            self._writes[i] += 1
        self._arrived = None
        if self._dut.m_axi_rvalid.value:
            self._arrived = int(self._dut.m_axi_rid.value), int(self._dut.m_axi_rresp.value) >= 2
        if self._dut.m_axi_bvalid.value:
            client = int(self._dut.m_axi_bid.value)
            self._writes[client] -= 1
            self._write_errors |= (int(self._dut.m_axi_bresp.value) >= 2) << client
