"""Gives cells that have much to drive a larger size of the same cell.

ABC chooses sizes before the full adders, the flip-flops and the clock gates are in the netlist that it sees, so it takes their
pins for the load that it is told to expect at any output.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping

from synth.loads import Pins

_SIZE = re.compile(r"(?P<base>.+?_?)[xX](?P<whole>\d+)(?:p(?P<tenths>\d))?f?(?P<rest>_.*)?")
"""The name of a cell: INVx4_ASAP7_75t_R, NAND2x1p5_ASAP7_75t_R, BUFx12f_ASAP7_75t_R, INV_X4."""


def sizes(cells: Mapping[str, Pins]) -> dict[str, list[tuple[float, str]]]:
    """By cell: all sizes of it, as (drive, name), the smallest first. They have the same pins."""
    families: dict[object, list[tuple[float, str]]] = defaultdict(list)
    for name, pins in cells.items():
        if found := _SIZE.fullmatch(name):
            key = found["base"], found["rest"], tuple(sorted(pins.inputs)), tuple(sorted(pins.outputs))
            families[key].append((float(f"{found['whole']}.{found['tenths'] or 0}"), name))
    return {name: sorted(family) for family in families.values() for _, name in family}


def resize(module: dict, cells: Mapping[str, Pins], most_ff: float, other_ff: float) -> int:
    """Replaces cells in place, so that they drive at most `most_ff` for each unit of their drive; returns how many.

    Where no size is large enough, the largest is taken. Pins of black boxes count as `other_ff` each, and so do the module's
    outputs.
    """
    loads: dict[int, float] = defaultdict(float)
    for port in module["ports"].values():
        if port["direction"] == "output":
            for bit in port["bits"]:
                loads[bit] += other_ff
    for cell in module["cells"].values():
        pins = cells.get(cell["type"])
        for pin, bits in cell["connections"].items():
            if cell["port_directions"][pin] == "input":
                for bit in bits:
                    loads[bit] += pins.inputs.get(pin, 0.0) if pins else other_ff
    known, changed = sizes(cells), 0
    for cell in module["cells"].values():
        family = known.get(cell["type"], ())
        if len(family) < 2:
            continue
        load = max(loads[bit] for pin, bits in cell["connections"].items() if cell["port_directions"][pin] == "output"
                   for bit in bits)
        drive = next(drive for drive, name in family if name == cell["type"])
        if load > drive * most_ff:
            wanted = next((name for drive, name in family if load <= drive * most_ff), family[-1][1])
            changed += wanted != cell["type"]
            cell["type"] = wanted
    return changed
