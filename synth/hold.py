"""Hold at memories: a macro wants its inputs to stay for a while after the clock's edge, and what comes straight from another
memory or a register changes sooner. As after a clock tree, buffers are put before the pins that are too early.

    held = more({}, timing.early)               # after a run that says which pins are too early
    with_memories(text, cells, held, buffer)    # the netlist with these buffers, for the next run

A pin of a module's memory is named by the module and the port that the memory was taken out by (`memory0_wr_data`). All bits
of a pin get the same number of buffers, in all instances of the module.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from synth.netlist import Netlist

MemoryPort = tuple[str, str]
"""A module, and a port to one of its memories."""

_PREFIX = "hold_"

ROUNDS = 4
"""Most buffers in a row."""


def more(held: Mapping[MemoryPort, int], early: Iterable[MemoryPort]) -> dict[MemoryPort, int]:
    """The buffers in a row before each port, with one more before each that is still too early."""
    return {**held, **{port: held.get(port, 0) + 1 for port in early}}


def buffers(port: str, width: int, count: int, buffer: tuple[str, str, str]) -> tuple[str, str]:
    """The net behind `count` buffers in a row before each bit of a port, and the wires and cells in Verilog.

    `buffer`: the cell, and its input and output pin.
    """
    cell, source, output = buffer
    lines, net = "", port
    for number in range(count):
        after = f"{port}_held{number}"
        lines += f"  wire [{width - 1}:0] {after};\n" if width > 1 else f"  wire {after};\n"
        for bit in range(width):
            index = f"[{bit}]" if width > 1 else ""
            lines += f"  {cell} {_PREFIX}{after}_{bit} (\n    .{source}({net}{index}),\n    .{output}({after}{index})\n  );\n"
        net = after
    return net, lines


def added(netlists: Iterable[Netlist], counts: Mapping[str, int]) -> int:
    """How many of these buffers a machine has. `counts`: the instances of each module."""
    return sum(counts[module.name] * sum(cell.name.startswith(_PREFIX) for cell in module.instances) for module in netlists)
