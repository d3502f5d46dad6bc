"""Inserts buffers between the registers of a row and its cores: a net that feeds many black boxes gets a buffer per few."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

BOXES_PER_BUFFER = 4


def buffer_broadcasts(module: dict, boxes: Sequence[str], buffer: tuple[str, str, str]) -> int:
    """Insert buffers (cell, input pin, output pin) in place; returns their number. Clock and reset are left as they are."""
    sinks: dict[int, list[tuple[str, str, int]]] = defaultdict(list)
    for name, cell in module["cells"].items():
        if cell["type"] in boxes:
            for pin, bits in cell["connections"].items():
                if cell["port_directions"][pin] == "input" and pin not in ("clk", "rst"):
                    for i, bit in enumerate(bits):
                        if isinstance(bit, int):
                            sinks[bit].append((name, pin, i))
    next_net = 1 + max((bit for wire in module["netnames"].values() for bit in wire["bits"] if isinstance(bit, int)), default=1)
    count, (cell_name, given, driven) = 0, buffer
    for net, pins in sinks.items():
        if len(pins) <= BOXES_PER_BUFFER:
            continue
        for start in range(0, len(pins), BOXES_PER_BUFFER):
            module["cells"][f"broadcast{count}"] = {
                "hide_name": 0, "type": cell_name, "parameters": {}, "attributes": {},
                "port_directions": {given: "input", driven: "output"}, "connections": {given: [net], driven: [next_net]},
            }
            for name, pin, i in pins[start:start + BOXES_PER_BUFFER]:
                module["cells"][name]["connections"][pin][i] = next_net
            next_net, count = next_net + 1, count + 1
    return count
