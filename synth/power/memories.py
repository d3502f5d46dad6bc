"""The memories that synthesis takes out of the logic: their pins, the nets of these in the netlist, and their contents.

`synth.memories.take_out` turns the pins of a memory into ports in which each net appears once. Which bit of a pin is which net,
and which bits are constant, is read from the module as it was before.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from synth import flow
from synth.memories import LIMIT, take_out

PINS = ("RD_ADDR", "RD_EN", "WR_ADDR", "WR_EN", "WR_DATA")


@dataclass(frozen=True)
class Memory:
    """A memory beside a netlist.

    Attributes:
        words, width: its words and their width in bits.
        reads, writes: its numbers of read ports and write ports.
        pins: nets of each pin by the pin's name, including RD_DATA; the bits of one port follow those of the one before.
        transparent: (reads, writes) bool: the read port sees what the write port writes in the same cycle.
    """

    words: int
    width: int
    reads: int
    writes: int
    pins: dict[str, np.ndarray]
    transparent: np.ndarray


def find_memories(module: str, folder: Path, boxes: tuple[str, ...], ports: dict[str, dict]) -> list[Memory]:
    """The memories that were taken out of a module.

    The module's RTLIL and netlist are in `folder`; `ports` are the ports of its netlist.
    """
    if "memory0_rd_data" not in ports:
        return []
    description = folder / f"{module}-memories.json"
    if not description.exists():
        log = folder / "memories.log"
        design = flow.run(
            f"read_rtlil {folder / module}.il", *(f"blackbox {box}" for box in boxes), f"hierarchy -top {module}", "proc",
            "attrmap -remove init", "flatten", "opt", "memory_collect", log=log)
        scratch = description.with_suffix(".tmp")
        flow.run("alumacc", "opt_clean", f"write_json {scratch}", log=log, design=design)
        scratch.replace(description)
    before = json.loads(description.read_text())["modules"][module]
    cells, found = dict(before["cells"]), []
    take_out(before, LIMIT)
    for name, cell in cells.items():
        if name not in before["cells"]:
            found.append(_memory(cell, f"memory{len(found)}", ports))
    return found


def _memory(cell: dict, label: str, ports: dict[str, dict]) -> Memory:
    pins = {"RD_DATA": _nets(ports[f"{label}_rd_data"]["bits"])}
    for pin in PINS:
        wanted = cell["connections"][pin]
        names = list(dict.fromkeys(bit for bit in wanted if isinstance(bit, int)))
        bits = ports[f"{label}_{pin.lower()}"]["bits"] if names else []
        if len(bits) != len(names):
            raise ValueError(f"{label}'s {pin} must have {len(names)} nets as before synthesis, not {len(bits)!r}")
        place = dict(zip(names, bits, strict=True))
        pins[pin] = _nets([place.get(bit, bit) for bit in wanted])

    def number(key: str) -> int:
        return int(cell["parameters"][key], 2)

    reads, writes = number("RD_PORTS"), number("WR_PORTS")
    mask = np.array([bit == "1" for bit in cell["parameters"]["RD_TRANSPARENCY_MASK"][::-1]])[:reads * writes]
    return Memory(number("SIZE"), number("WIDTH"), reads, writes, pins, mask.reshape(reads, writes))


def _nets(bits: list[int | str]) -> np.ndarray:
    """Numbers of nets; those of a JSON netlist begin with 2, and 0 and 1 stand for the constants."""
    return np.array([bit if isinstance(bit, int) else int(bit == "1") for bit in bits], np.int64)


class Contents:
    """A memory's contents, and what its ports do at a clock edge.

    Attributes:
        accesses: numbers of reads and of writes so far.
    """

    def __init__(self, memory: Memory):
        self.memory, self.accesses = memory, [0, 0]
        self._words = np.zeros((memory.words, memory.width), np.uint8)
        self._address = memory.pins["RD_ADDR"].size // memory.reads
        self._powers = 1 << np.arange(self._address, dtype=np.int64)
        self._read = np.zeros((memory.reads, memory.width), np.uint8)

    def edge(self, values: np.ndarray) -> np.ndarray:
        """Applies a clock edge with the nets' values before it; returns (reads * width,) data after it."""
        m, old = self.memory, self._words
        address = values[m.pins["RD_ADDR"]].reshape(m.reads, -1) @ self._powers
        to = values[m.pins["WR_ADDR"]].reshape(m.writes, -1) @ self._powers
        enable = values[m.pins["WR_EN"]].reshape(m.writes, -1).astype(bool)
        data = values[m.pins["WR_DATA"]].reshape(m.writes, -1)
        for port in np.flatnonzero(values[m.pins["RD_EN"]]):
            self.accesses[0] += 1
            row = old[address[port]].copy() if address[port] < m.words else np.zeros(m.width, np.uint8)
            for w in range(m.writes):
                if m.transparent[port, w] and to[w] == address[port]:
                    row[enable[w]] = data[w][enable[w]]
            self._read[port] = row
        for w in np.flatnonzero(enable.any(axis=1)):
            self.accesses[1] += 1
            if to[w] < m.words:
                self._words[to[w]][enable[w]] = data[w][enable[w]]
        return self._read.ravel()
