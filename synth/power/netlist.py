"""Mapped modules flattened to arrays of gates, flip-flops, clock gates and memories.

Nets are numbers: 0 and 1 are the constants, and all others are renumbered in the order of evaluation. Every element knows the
module that it is from, so that energy can be reported by module.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from golden.kernels import compiled
from synth.power.cells import Cell
from synth.power.memories import Memory, find_memories

MOST_INPUTS = 10


@dataclass(frozen=True)
class Flat:
    """A flat netlist; each row of an array is one element.

    Attributes:
        nets: number of nets.
        parts: names of modules, which `*_part` index.
        types: (cell, output pin), which `gate_type` indexes.
        gate_type, gate_inputs, gate_output, gate_part: logic in order of evaluation, one element per output pin; unused inputs
            are 0.
        flop_cell, flop_data, flop_output, flop_clock, flop_part: flip-flops; the clock is the number of a clock gate, or -1.
        icg_enable, icg_test, icg_clock, icg_output, icg_part: clock gates.
        cells: names of cells, which `flop_cell` indexes.
        memories: the memories, with nets of this netlist.
        ports: nets of each port by name, including ports that are pins of memories.
        inputs: names of input ports.
    """

    nets: int
    parts: tuple[str, ...]
    types: tuple[tuple[str, str], ...]
    gate_type: np.ndarray
    gate_inputs: np.ndarray
    gate_output: np.ndarray
    gate_part: np.ndarray
    flop_cell: np.ndarray
    flop_data: np.ndarray
    flop_output: np.ndarray
    flop_clock: np.ndarray
    flop_part: np.ndarray
    icg_enable: np.ndarray
    icg_test: np.ndarray
    icg_clock: np.ndarray
    icg_output: np.ndarray
    icg_part: np.ndarray
    cells: tuple[str, ...]
    memories: tuple[Memory, ...]
    ports: dict[str, np.ndarray]
    inputs: tuple[str, ...]


_NETS = ("gate_inputs", "gate_output", "flop_data", "flop_output", "flop_clock", "icg_enable", "icg_test", "icg_clock",
         "icg_output")
_PLAIN = ("gate_type", "gate_part", "flop_cell", "flop_part", "icg_part")


class Flattener:
    """Flattens a hierarchy of mapped modules.

    Parameters:
        netlists: the mapped Verilog of each module; JSON and RTLIL of the same name are expected beside it.
        cells: library cells by name.
    """

    def __init__(self, netlists: Mapping[str, Path], cells: Mapping[str, Cell]):
        self._netlists, self._cells = netlists, cells
        self._parts, self._names = list(netlists), sorted(cells)
        self._types = [(name, pin) for name in self._names for pin in cells[name].outputs]
        self._type = {pair: i for i, pair in enumerate(self._types)}
        self._done: dict[str, tuple[dict, dict, list[Memory], tuple[str, ...]]] = {}

    def flatten(self, top: str) -> Flat:
        """The netlist of a module with everything below it; ValueError if its logic has a loop."""
        arrays, ports, memories, inputs = self._module(top)
        root = _joined(arrays["nets"], arrays["alias"])
        flat = {name: root[arrays[name]] for name in _NETS} | {name: arrays[name] for name in _PLAIN}
        order, levels = _levelled(arrays["nets"], flat["gate_inputs"], flat["gate_output"])
        if len(order) != len(flat["gate_output"]):
            raise ValueError(f"logic of {top} must have no loop, not {len(flat['gate_output']) - len(order)!r} gates in one")
        order = order[np.argsort(levels[order], kind="stable")]
        for name in ("gate_type", "gate_part", "gate_inputs", "gate_output"):
            flat[name] = flat[name][order]
        clocks = np.full(arrays["nets"], -1)
        clocks[flat["icg_output"]] = np.arange(len(flat["icg_output"]))
        flat["flop_clock"] = clocks[flat["flop_clock"]]
        number = _renumbering(arrays["nets"], root, flat)
        for name in _NETS:
            if name != "flop_clock":
                flat[name] = number[flat[name]]
        return Flat(
            nets=int(number.max()) + 1, parts=tuple(self._parts), types=tuple(self._types), cells=tuple(self._names),
            memories=tuple(
                replace(memory, pins={pin: number[root[nets]] for pin, nets in memory.pins.items()}) for memory in memories),
            ports={name: number[root[nets]] for name, nets in ports.items()}, inputs=inputs, **flat)

    def _module(self, name: str) -> tuple[dict, dict, list[Memory], tuple[str, ...]]:
        if name not in self._done:
            self._done[name] = self._read(name)
        return self._done[name]

    def _read(self, name: str) -> tuple[dict, dict, list[Memory], tuple[str, ...]]:
        path = Path(self._netlists[name])
        module = json.loads(path.with_suffix(".json").read_text())["modules"][name]
        boxes = tuple(sorted({cell["type"] for cell in module["cells"].values()} & self._netlists.keys()))
        ports = {port: _bits(p["bits"]) for port, p in module["ports"].items()}
        memories = find_memories(name, path.parent, boxes, module["ports"])
        lists: dict[str, list] = {key: [] for key in (*_NETS, *_PLAIN, "alias")}
        part, below = self._parts.index(name), []
        for cell in module["cells"].values():
            if cell["type"] in self._netlists:
                below.append(cell)
            else:
                self._add(lists, cell, part)
        pins = [bits for cell in module["cells"].values() for bits in cell["connections"].values()]
        # taken from pins, because the nets of inserted buffers have no names
        pins += [port["bits"] for port in module["ports"].values()]
        nets = 1 + max((bit for bits in pins for bit in bits if isinstance(bit, int)), default=1)
        arrays = {key: np.array(rows, np.int64).reshape(-1, MOST_INPUTS) if key == "gate_inputs" else np.array(rows, np.int64)
                  for key, rows in lists.items() if key != "alias"}
        arrays |= {"nets": nets, "alias": np.empty((0, 2), np.int64)}
        arrays, memories = self._with(arrays, below, memories)
        return arrays, ports, memories, tuple(port for port, p in module["ports"].items() if p["direction"] == "input")

    def _add(self, lists: dict[str, list], instance: dict, part: int) -> None:
        """Appends one cell of a module to the lists."""
        cell, pins = self._cells[instance["type"]], {pin: _bits(bits) for pin, bits in instance["connections"].items()}
        at = {pin: int(bits[0]) if len(bits) else 0 for pin, bits in pins.items()}
        if cell.kind == "logic":
            inputs = [at[pin] for pin in cell.inputs]
            for pin in cell.outputs:
                if pin in at:
                    lists["gate_type"].append(self._type[cell.name, pin])
                    lists["gate_inputs"].append(inputs + [0] * (MOST_INPUTS - len(inputs)))
                    lists["gate_output"].append(at[pin])
                    lists["gate_part"].append(part)
        elif cell.kind == "flop":
            (output,) = cell.outputs
            for key, value in (("cell", self._names.index(cell.name)), ("data", at["D"]), ("output", at[output]),
                               ("clock", at["CLK"]), ("part", part)):
                lists[f"flop_{key}"].append(value)
        else:
            (output,) = cell.outputs
            for key, value in (("enable", at["ENA"]), ("test", at["SE"]), ("clock", at["CLK"]), ("output", at[output]),
                               ("part", part)):
                lists[f"icg_{key}"].append(value)

    def _with(self, arrays: dict, below: list[dict], memories: list[Memory]) -> tuple[dict, list[Memory]]:
        """A module and copies of the modules below it; the nets of their ports are tied to its own nets."""
        parts, ties, memories = [arrays], [arrays["alias"]], list(memories)
        nets = arrays["nets"]
        for instance in below:
            child, ports, child_memories, _ = self._module(instance["type"])
            shift = _shifting(child["nets"], nets)
            parts.append({key: shift[child[key]] if key in _NETS else child[key] for key in (*_NETS, *_PLAIN)})
            ties.append(shift[child["alias"]])
            for port, bits in instance["connections"].items():
                used = [i for i, bit in enumerate(bits) if bit != "x"]  # an unconnected bit is tied to nothing
                ties.append(np.stack([_bits(bits)[used], shift[ports[port]][used]], 1))
            memories += [replace(memory, pins={pin: shift[n] for pin, n in memory.pins.items()}) for memory in child_memories]
            nets += child["nets"] - 2
        joined = {key: np.concatenate([part[key] for part in parts]) for key in (*_NETS, *_PLAIN)}
        return {**joined, "nets": nets, "alias": np.concatenate(ties)}, memories


def _bits(bits: list[int | str]) -> np.ndarray:
    return np.array([bit if isinstance(bit, int) else int(bit == "1") for bit in bits], np.int64)


def _shifting(nets: int, base: int) -> np.ndarray:
    """New numbers for the nets of a copy; the constants keep theirs."""
    shift = np.arange(nets) + base - 2
    shift[:2] = 0, 1
    return shift


@compiled
def _joined(nets: int, pairs: np.ndarray) -> np.ndarray:
    """For each net the lowest of all nets that it is tied to, so that constants win."""
    parent = np.arange(nets)
    for k in range(len(pairs)):
        a, b = pairs[k]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        if a < b:
            parent[b] = a
        else:
            parent[a] = b
    for net in range(nets):
        parent[net] = parent[parent[net]]
    return parent


@compiled
def _levelled(nets: int, inputs: np.ndarray, outputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The gates in an order in which inputs come first, and every gate's level; gates in a loop are missing in the order."""
    gates, most = inputs.shape
    driver = np.full(nets, -1, np.int64)
    for g in range(gates):
        driver[outputs[g]] = g
    waits, count = np.zeros(gates, np.int64), np.zeros(gates + 1, np.int64)
    for g in range(gates):
        for j in range(most):
            d = driver[inputs[g, j]]
            if d >= 0:
                waits[g] += 1
                count[d + 1] += 1
    start = np.cumsum(count)
    reader, fill = np.empty(start[-1], np.int64), start.copy()
    for g in range(gates):
        for j in range(most):
            d = driver[inputs[g, j]]
            if d >= 0:
                reader[fill[d]] = g
                fill[d] += 1
    order, levels, head, tail = np.empty(gates, np.int64), np.zeros(gates, np.int64), 0, 0
    for g in range(gates):
        if waits[g] == 0:
            order[tail] = g
            tail += 1
    while head < tail:
        g = order[head]
        head += 1
        for k in range(start[g], start[g + 1]):
            r = reader[k]
            levels[r] = max(levels[r], levels[g] + 1)
            waits[r] -= 1
            if waits[r] == 0:
                order[tail] = r
                tail += 1
    return order[:tail], levels


def _renumbering(nets: int, root: np.ndarray, flat: dict) -> np.ndarray:
    """New numbers by first use: constants, registers, logic in order, then the rest."""
    used = np.concatenate([[0, 1], flat["flop_output"], flat["gate_output"], root])
    first = np.unique(used, return_index=True)
    ranked = first[0][np.argsort(first[1])]
    number = np.zeros(nets, np.int64)
    number[ranked] = np.arange(len(ranked))
    return number
