"""The energy of DRAM, by the currents in its data sheet and by the load of its pins.

    activate  a row is opened and closed again: IDD0 over tRC, less the standby current of the same time
    read      a burst: IDD4R less IDD3N; write: IDD4W less IDD3N
    refresh   all banks: IDD5AB less IDD2N over tRFC
    standby   IDD3N; IDD2N while a channel refreshes, because its rows are closed then
    I/O       the wires' capacitances at VDDQ, and the current through the receiver's termination

This is how Micron (TN-41-01, Calculating Memory System Power for DDR3) and DRAMPower compute it. A channel that has a row open
in any bank is in active standby; data sheets give no current by the number of open banks. Rows count as open from one refresh
to the next, which is a little too much.

Not counted are power-down and self-refresh (the memory is never idle for long within a frame), the input buffers' currents, and
controller and PHY on the side of the chip.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

BURST_BITS = 256
"""Bits that a read or write command moves: a burst of 8 over 32 wires, which is a beat of the machine's bus."""

GROUPS = ("activates", "reads", "writes", "refresh", "standby", "I/O", "termination")
"""What the parts of the energy are for."""

LINES_OF_STROBE = 2
"""Wires of a strobe, and of the clock: they are differential, so that one of the two is always low."""


class Supply(NamedTuple):
    """The currents of a channel's device from one supply, in mA.

    Attributes:
        volts: the supply's voltage.
        idd0: one bank is activated and precharged every tRC. idd2n: standby, all banks closed. idd3n: standby, a bank open.
        idd4r, idd4w: bursts without a gap. idd5: all banks are refreshed, one refresh after the other.
    """

    volts: float
    idd0: float
    idd2n: float
    idd3n: float
    idd4r: float
    idd4w: float
    idd5: float


@dataclass(frozen=True)
class Interface:
    """The wires between the chip and one channel.

    Attributes:
        volts: the supply of the drivers.
        clock_hz: the clock; data and commands move at both of its edges.
        data_pf: the capacitance of a data or strobe wire with the pins at both ends.
        command_pf: the same of a command or clock wire.
        toggles: the share of the bits in which a data or command wire changes.
        bits_of_strobe: data wires that share a strobe.
        command_wires: command and address wires, beside the chip select.
        termination_ohm: on-die termination of the receiver of data, to the supply; None without.
        drives_ohm: the drivers' impedances: the DRAM's, and the chip's.
    """

    volts: float
    clock_hz: float
    data_pf: float
    command_pf: float
    toggles: float
    bits_of_strobe: int
    command_wires: int
    termination_ohm: float | None
    drives_ohm: tuple[float, float]

    def edge_pj(self, capacitance_pf: float) -> float:
        """The energy of one change of a wire: half of C V²."""
        return 0.5 * capacitance_pf * self.volts**2

    @property
    def data_pj_per_bit(self) -> float:
        """Energy of moving a bit: the data wire, and its share of a strobe, whose two wires change with every bit."""
        return self.edge_pj(self.data_pf) * (self.toggles + LINES_OF_STROBE / self.bits_of_strobe)

    @property
    def command_pj(self) -> float:
        """Energy of a command: two bits on every command wire, and a chip select that falls and rises."""
        return self.edge_pj(self.command_pf) * (2 * self.command_wires * self.toggles + 2)

    @property
    def clock_mw(self) -> float:
        """Power of the clock's wires, which change twice in a period."""
        return LINES_OF_STROBE * 2 * self.edge_pj(self.command_pf) * self.clock_hz * 1e-9

    def termination_pj_per_bit(self, write: bool) -> float:
        """Energy that the current through driver and termination takes for a bit.

        Current flows while a wire is low: half of the time on a data wire, always on one of a strobe's two wires.
        """
        if self.termination_ohm is None:
            return 0.0
        low_mw = 1e3 * self.volts**2 / (self.termination_ohm + self.drives_ohm[write])
        return low_mw * (0.5 + 1 / self.bits_of_strobe) * 1e9 / (2 * self.clock_hz)


class Part(NamedTuple):
    """A part of DRAM's energy.

    Attributes:
        group: one of GROUPS. name: what happens. count: how often it happens, or for how many ns.
        pj: the energy of one of them. source: where the number comes from.
    """

    group: str
    name: str
    count: float
    pj: float
    source: str


@dataclass(frozen=True)
class Dram:
    """A memory of several channels of one device each.

    Attributes:
        name: the memory's name.
        channels: the number of channels.
        supplies: the currents of a channel by supply.
        burst_ns: the time of a burst without a gap.
        ras_ns, rp_ns: tRAS and tRP of the measurement of IDD0, whose tRC is their sum. rfc_ns: tRFC of all banks.
        interface: the wires of a channel.
        currents, wires, terminated: the sources of the currents, of the capacitances and of the termination.
    """

    name: str
    channels: int
    supplies: tuple[Supply, ...]
    burst_ns: float
    ras_ns: float
    rp_ns: float
    rfc_ns: float
    interface: Interface
    currents: str
    wires: str
    terminated: str

    @property
    def activate_pj(self) -> float:
        """Energy of opening and closing a row, in addition to standby."""
        return sum(s.volts * (s.idd0 * (self.ras_ns + self.rp_ns) - s.idd3n * self.ras_ns - s.idd2n * self.rp_ns)
                   for s in self.supplies)

    @property
    def read_pj_per_bit(self) -> float:
        """Energy of reading a bit inside the device, in addition to standby."""
        return sum(s.volts * (s.idd4r - s.idd3n) for s in self.supplies) * self.burst_ns / BURST_BITS

    @property
    def write_pj_per_bit(self) -> float:
        """Energy of writing a bit inside the device, in addition to standby."""
        return sum(s.volts * (s.idd4w - s.idd3n) for s in self.supplies) * self.burst_ns / BURST_BITS

    @property
    def refresh_pj(self) -> float:
        """Energy of refreshing all banks of a channel once, in addition to standby with closed rows."""
        return sum(s.volts * (s.idd5 - s.idd2n) for s in self.supplies) * self.rfc_ns

    @property
    def open_mw(self) -> float:
        """Standby power of a channel with open rows."""
        return sum(s.volts * s.idd3n for s in self.supplies)

    @property
    def closed_mw(self) -> float:
        """Standby power of a channel whose rows are all closed."""
        return sum(s.volts * s.idd2n for s in self.supplies)

    def parts(
        self, seconds: float, read_beats: int, write_beats: int, activates: int | None, refreshes: int | None,
    ) -> Iterator[Part]:
        """The parts of the energy of a frame.

        Args:
            seconds: the frame's time.
            read_beats, write_beats: bursts.
            activates, refreshes: commands of all channels; None where they are not known, and then not counted.
        """
        read, written, wires = BURST_BITS * read_beats, BURST_BITS * write_beats, self.interface
        time = self.channels * seconds * 1e9
        closed = min(time, (refreshes or 0) * self.rfc_ns)
        if activates is not None:
            yield Part("activates", "activates", activates, self.activate_pj, self.currents)
        yield Part("reads", "bits read", read, self.read_pj_per_bit, self.currents)
        yield Part("writes", "bits written", written, self.write_pj_per_bit, self.currents)
        if refreshes is not None:
            yield Part("refresh", "refreshes", refreshes, self.refresh_pj, self.currents)
        yield Part("standby", "ns of a channel with open rows", time - closed, self.open_mw, self.currents)
        if refreshes is not None:
            yield Part("standby", "ns of a channel with closed rows", closed, self.closed_mw, self.currents)
        yield Part("I/O", "bits over wires", read + written, wires.data_pj_per_bit, self.wires)
        yield Part("I/O", "commands over wires", read_beats + write_beats + 2 * (activates or 0) + (refreshes or 0),
                   wires.command_pj, self.wires)
        yield Part("I/O", "ns of a channel's clock wires", time, wires.clock_mw, self.wires)
        if wires.termination_ohm is not None:
            yield Part("termination", "bits read with termination", read, wires.termination_pj_per_bit(False), self.terminated)
            yield Part("termination", "bits written with termination", written, wires.termination_pj_per_bit(True),
                       self.terminated)


LPDDR3 = Dram(
    name="4 x LPDDR3-1600 x32", channels=4,
    supplies=(Supply(1.8, idd0=8, idd2n=0.8, idd3n=2, idd4r=2, idd4w=2, idd5=28),
              Supply(1.2, idd0=60, idd2n=26, idd3n=34, idd4r=230, idd4w=190, idd5=150)),
    burst_ns=5.0, ras_ns=42.0, rp_ns=18.0, rfc_ns=210.0,
    interface=Interface(
        volts=1.2, clock_hz=8e8, data_pf=2 + 1.5 + 3, command_pf=2 + 0.75 + 3, toggles=0.5, bits_of_strobe=8, command_wires=10,
        termination_ohm=240.0, drives_ohm=(34.0, 40.0)),
    currents="Micron EDF8132A1MC (LPDDR3-1600, dies of 4 Gb), its data sheet's currents as in gem5's LPDDR3_1600_1x32: at "
             "VDD1 1.8 V and VDD2 1.2 V, IDD0 8 and 60 mA, IDD2N 0.8 and 26, IDD3N 2 and 34, IDD4R 2 and 230, IDD4W 2 and 190, "
             "IDD5 28 and 150; tRAS 42 ns, tRP 18 ns; tRFC 210 ns of the 8 Gb device that is simulated (JEDEC JESD209-3)",
    wires="half of C V² at VDDQ 1.2 V (JEDEC JESD209-3, HSUL_12) for each change of a wire; half of the bits are changes. Pins "
          "by CACTI-IO (Jouppi et al., IEEE TVLSI 23(7), 2015; its LPDDR2): chip 2 pF, DRAM 1.5 pF for data and 0.75 pF for "
          "commands and clock. Assumed: a line of 3 pF (150 ps at 50 ohm, package on package)",
    terminated="on-die termination of 240 ohm (RZQ/1 of JEDEC JESD209-3, which leaves its use open) at the receiver; the DRAM "
               "drives with 34 ohm, the chip with 40: the defaults for LPDDR3 of Rockchip's RK3399, which terminates above "
               "333 MHz (Linux, rockchip,rk3399-dmc.yaml)")
"""Four channels of LPDDR3-1600, as the paper has them."""
