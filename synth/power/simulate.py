"""Two-valued simulation of the cycles of a flat netlist: settled values, toggles and, with delays, glitches.

In a cycle inputs are set, the logic settles, outputs are read, and the clock edge follows. Without delays every gate is
evaluated once, in order, and a net toggles at most once. With delays (`timed`) the same cycle runs event by event. A gate whose
inputs change is evaluated again, and a change that is undone before the gate's delay has passed does not happen (inertial
delay). Both must settle at the same values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from golden.kernels import compiled
from synth.power.cells import Cell
from synth.power.memories import Contents
from synth.power.netlist import Flat

WHEEL = 1 << 14
"""Longest time in ps that the events of a cycle may take."""


@dataclass(frozen=True)
class Counts:
    """The activity of some cycles.

    Attributes:
        toggles: toggles of every net.
        gated: for each clock gate, the number of cycles in which it passed the clock.
        cycles: number of clock edges.
        accesses: (memories, 2) reads and writes of each memory.
    """

    toggles: np.ndarray
    gated: np.ndarray
    cycles: int
    accesses: np.ndarray


@dataclass(frozen=True)
class Delays:
    """Delays in whole picoseconds.

    Attributes:
        gates: delay of each gate.
        flops: delay of each flip-flop from the clock edge to the output.
        inputs, memories: times after the clock edge at which inputs and data of memories arrive.
    """

    gates: np.ndarray
    flops: np.ndarray
    inputs: int
    memories: int


class Simulation:
    """The state of a netlist. All flip-flops begin at 0.

    Parameters:
        flat: the netlist.
        cells: library cells by name.
        delays: None to simulate settled values only.

    Attributes:
        values: the value of every net.
        timed: whether cycles run with delays; may change between cycles, but stays False without `delays`.
    """

    def __init__(self, flat: Flat, cells: dict[str, Cell], delays: Delays | None = None):
        self.flat, self._delays = flat, delays
        self._luts, self._lut = _tables(flat, cells)
        self._inputs = np.array([len(cells[cell].inputs) for cell, _ in flat.types], np.int64)[flat.gate_type]
        self._inverted = np.array([cells[name].inverted for name in flat.cells], np.uint8)[flat.flop_cell]
        self.values = np.zeros(flat.nets, np.uint8)
        self.values[1] = 1
        self.values[flat.flop_output] = self._inverted
        self._memories = [Contents(memory) for memory in flat.memories]
        self._memory_nets = np.concatenate([m.pins["RD_DATA"] for m in flat.memories] or [np.empty(0, np.int64)])
        self._late: list[tuple[np.ndarray, np.ndarray, int]] = []
        self._wheel, self.timed = _Wheel(flat) if delays else None, False
        self.forget()
        self.settle()
        self.forget()
        self.timed = delays is not None

    def forget(self) -> None:
        """Resets all counts to 0."""
        self._toggles = np.zeros(self.flat.nets, np.int64)
        self._gated = np.zeros(len(self.flat.icg_output), np.int64)
        self._cycles = 0
        for memory in self._memories:
            memory.accesses = [0, 0]

    def counts(self) -> Counts:
        """The activity since the counts were last reset."""
        accesses = np.array([memory.accesses for memory in self._memories], np.int64).reshape(-1, 2)
        return Counts(self._toggles.copy(), self._gated.copy(), self._cycles, accesses)

    def set(self, port: str, bits: np.ndarray | int) -> None:
        """Sets an input port from this cycle on, to an array of bits, lowest first, or to a number."""
        nets = self.flat.ports[port]
        if not isinstance(bits, np.ndarray):
            bits = np.array([int(bits) >> i & 1 for i in range(len(nets))], np.uint8)
        self._late.append((nets, bits, self._delays.inputs if self._delays else 0))

    def get(self, port: str) -> np.ndarray:
        """The settled bits of a port, lowest first."""
        return self.values[self.flat.ports[port]]

    def number(self, port: str) -> int:
        """The settled value of a port as a number."""
        return int.from_bytes(np.packbits(self.get(port), bitorder="little").tobytes(), "little")

    def settle(self) -> None:
        """Lets the logic settle after inputs were set."""
        late, self._late, f = self._late, [], self.flat
        if self.timed:
            self._wheel.run(self, self._toggles, late)
            return
        for nets, bits, _ in late:
            self._toggles[nets] += self.values[nets] != bits
            self.values[nets] = bits
        _evaluate(self.values, self._toggles, f.gate_inputs, self._inputs, f.gate_output, self._lut, self._luts)

    def edge(self) -> None:
        """Applies a clock edge; its effects are visible once the next cycle has settled."""
        f = self.flat
        data = [memory.edge(self.values) for memory in self._memories]
        enabled = self.values[f.icg_enable] | self.values[f.icg_test]
        self._gated += enabled
        clocked = np.where(f.flop_clock < 0, 1, enabled[f.flop_clock]) if len(enabled) else np.ones(len(f.flop_data), np.uint8)
        after = np.where(clocked, self.values[f.flop_data] ^ self._inverted, self.values[f.flop_output]).astype(np.uint8)
        self._late.append((f.flop_output, after, -1))
        if data:
            self._late.append((self._memory_nets, np.concatenate(data), self._delays.memories if self._delays else 0))
        self._cycles += 1

    def check(self) -> int:
        """The number of gates whose output contradicts their inputs; 0 once everything has settled."""
        values = self.values.copy()
        f = self.flat
        _evaluate(values, np.zeros_like(self._toggles), f.gate_inputs, self._inputs, f.gate_output, self._lut, self._luts)
        return int((values != self.values).sum())


def _tables(flat: Flat, cells: dict[str, Cell]) -> tuple[np.ndarray, np.ndarray]:
    """All truth tables in one array, and for each gate the place where its table begins."""
    tables, starts = [], []
    for cell, pin in flat.types:
        truth = cells[cell].outputs[pin].truth
        starts.append(sum(map(len, tables)))
        tables.append(np.zeros(1, np.uint8) if truth is None else truth)
    return np.concatenate(tables), np.array(starts, np.int64)[flat.gate_type]


@compiled
def _evaluate(values, toggles, inputs, counts, outputs, lut, luts) -> None:
    for g in range(len(outputs)):
        row = lut[g]
        for j in range(counts[g]):
            row += values[inputs[g, j]] << j
        value, net = luts[row], outputs[g]
        if value != values[net]:
            values[net] = value
            toggles[net] += 1


class _Wheel:
    """The events of a cycle, in one list for each picosecond."""

    def __init__(self, flat: Flat):
        self._start, self._readers = _fanout(flat.nets, flat.gate_inputs)
        gates = len(flat.gate_output)
        self._heads = np.full(WHEEL, -1, np.int64)
        self._pending, self._serial = np.zeros(gates, np.int8), np.zeros(gates, np.int64)
        self._pool = np.empty((6 * gates + 4096, 3), np.int64)

    def run(self, s: Simulation, toggles: np.ndarray, late: list[tuple[np.ndarray, np.ndarray, int]]) -> None:
        """Runs a cycle of a simulation; RuntimeError if its events are too many or too late for the lists."""
        nets = np.concatenate([nets for nets, _, _ in late] or [np.empty(0, np.int64)])
        bits = np.concatenate([bits for _, bits, _ in late] or [np.empty(0, np.uint8)]).astype(np.int64)
        times = np.concatenate([
            s._delays.flops if time < 0 else np.full(len(nets), time, np.int64) for nets, _, time in late]
            or [np.empty(0, np.int64)])
        left = _play(
            s.values, toggles, s.flat.gate_inputs, s._inputs, s.flat.gate_output, s._lut, s._luts, s._delays.gates, nets, bits,
            times, self._start, self._readers, self._heads, self._pending, self._serial, self._pool)
        if left:
            raise RuntimeError(f"a cycle's events must fit {WHEEL} ps and {len(self._pool)} places")


@compiled
def _fanout(nets: int, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    count = np.zeros(nets + 1, np.int64)
    for g in range(inputs.shape[0]):
        for j in range(inputs.shape[1]):
            if inputs[g, j] > 1:
                count[inputs[g, j] + 1] += 1
    start = np.cumsum(count)
    readers, fill = np.empty(start[-1], np.int64), start.copy()
    for g in range(inputs.shape[0]):
        for j in range(inputs.shape[1]):
            net = inputs[g, j]
            if net > 1:
                readers[fill[net]] = g
                fill[net] += 1
    return start, readers


@compiled
def _play(
    values, toggles, inputs, counts, outputs, lut, luts, delays, nets, bits, times, start, readers, heads, pending, serial,
    pool,
) -> bool:
    """One cycle; returns whether its events did not fit.

    An event is (gate, or -1 - place in `nets`; serial number; next event of the same picosecond).
    """
    used, last, wheel, room = 0, 0, len(heads), len(pool)
    for k in range(len(nets)):
        if values[nets[k]] != bits[k]:
            pool[used, 0], pool[used, 1], pool[used, 2] = -1 - k, 0, heads[times[k]]
            heads[times[k]] = used
            used += 1
            last = max(last, times[k])
    now = 0
    while now <= last:
        while heads[now] >= 0:
            event = heads[now]
            heads[now] = pool[event, 2]
            who = pool[event, 0]
            if who < 0:
                net = nets[-1 - who]
                value = bits[-1 - who]
                if values[net] == value:
                    continue
            else:
                if pending[who] == 0 or serial[who] != pool[event, 1]:
                    continue
                pending[who] = 0
                net = outputs[who]
                value = 1 - values[net]
            values[net] = value
            toggles[net] += 1
            for r in range(start[net], start[net + 1]):
                g = readers[r]
                row = lut[g]
                for j in range(counts[g]):
                    row += values[inputs[g, j]] << j
                if luts[row] == values[outputs[g]]:
                    pending[g] = 0
                elif pending[g] == 0:
                    at = now + max(delays[g], 1)
                    if at >= wheel or used >= room:
                        return True
                    pending[g] = 1
                    serial[g] += 1
                    pool[used, 0], pool[used, 1], pool[used, 2] = g, serial[g], heads[at]
                    heads[at] = used
                    used += 1
                    last = max(last, at)
        now += 1
    return False
