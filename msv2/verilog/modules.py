"""A unit as Verilog modules: logic as Yosys writes it, memories as models of their own."""

from __future__ import annotations

import re
from dataclasses import dataclass

from msv2.document.stream_maps import StreamPort, documented, stream_ports
from msv2.verilog import memories
from msv2.verilog.memories import Placed, Shape
from msv2.verilog.names import rename
from msv2.verilog.ports import port_notes
from msv2.verilog.rtlil import parse
from rtl import units
from rtl.emit import to_rtlil, verilog_of
from spec.config import AcceleratorConfig

_CLEAN = "opt_clean -purge"
"""Wires that nothing reads go, named ones too: Amaranth names every field of every record."""


@dataclass(frozen=True)
class Exported:
    """A unit's modules.

    Attributes:
        top: name of the unit's module.
        ports: name, direction and bits of its ports.
        notes: lines that say what its ports carry.
        streams: its streams with the maps of their payloads.
        logic: Verilog by name of the module, lower ones first.
        models: behavioural models of memories, by name of the module.
        placed: every memory, under the names of the export.
    """

    top: str
    ports: tuple[tuple[str, str, int], ...]
    notes: tuple[str, ...]
    streams: tuple[StreamPort, ...]
    logic: dict[str, str]
    models: dict[str, str]
    placed: tuple[Placed, ...]


def exported(unit: str, config: AcceleratorConfig, prefix: str) -> Exported:
    """The modules of a unit, every name with `prefix`; InputError for an unknown unit."""
    component = units.named(unit).make(config)
    modules = parse(to_rtlil(component, unit))
    found = [place for module in modules for place in memories.take_out(module, prefix)]
    before, = (module.ports() for module in modules if module.name == f"\\{unit}")
    of_modules, inside = rename(modules, prefix)
    names = {name[1:]: inside[f"\\{unit}"][name][1:] for name, *_ in before}
    ports = [(names[name[1:]], way, width) for name, way, width in before]
    placed = tuple(Placed(of_modules[one.parent][1:], inside[one.parent][one.instance][1:], one.shape) for one in found)
    text = verilog_of("\n".join(module.text() for module in modules), _CLEAN)
    logic = {part[1]: part[0] for part in re.finditer(r"module (\w+)\(.*?^endmodule\n", text, re.DOTALL | re.MULTILINE)}
    shapes: list[Shape] = sorted({one.shape for one in placed})
    return Exported(
        of_modules[f"\\{unit}"][1:], tuple(ports), tuple(port_notes(component, config, ports, names)),
        tuple(stream_ports(component, config, documented(component), names)),
        {module.name[1:]: logic[module.name[1:]] for module in modules},
        {prefix + shape.module: memories.model(shape, prefix) for shape in shapes}, placed)
