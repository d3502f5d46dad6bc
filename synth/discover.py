"""Finds what the flow must know of a cell library in its liberty file, from the functions of cells instead of their names."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from spec.errors import InputError
from synth.liberty import LIBRARIES, Technology, find_files, kept_lines, write_lines

_OUTPUT_LOAD = 4
"""Load of a unit's outputs, as a number of input pins of the smallest inverter."""

_UNIT_PS = {"ns": 1000.0, "ps": 1.0, "us": 1e6}
_UNIT_FF = {"ff": 1.0, "pf": 1000.0}


@dataclass
class Pin:
    """A pin; `attributes` holds its direction, function, capacitance and all other simple attributes as text."""

    attributes: dict[str, str] = field(default_factory=dict)

    @property
    def is_input(self) -> bool:
        return self.attributes.get("direction") == "input"

    @property
    def function(self) -> str:
        return self.attributes.get("function", "")


@dataclass
class Cell:
    """A cell: its attributes, its pins, and the kinds of groups in it (ff, latch, ...)."""

    name: str
    attributes: dict[str, str] = field(default_factory=dict)
    pins: dict[str, Pin] = field(default_factory=dict)
    groups: set[str] = field(default_factory=set)

    @property
    def area(self) -> float:
        return float(self.attributes.get("area", 0.0))

    @property
    def usable(self) -> bool:
        """Whether the flow may choose the cell. Cells for constants and clock gates are found without this test."""
        return self.attributes.get("dont_use") != "true"

    def split(self) -> tuple[list[str], list[str]]:
        """Names of the input pins, and names of the output pins."""
        inputs = [name for name, pin in self.pins.items() if pin.is_input]
        return inputs, [name for name, pin in self.pins.items() if pin.attributes.get("direction") == "output"]


def discover(name: str, folder: Path) -> tuple[Technology, Path]:
    """The technology of this name, and its merged liberty file in `folder`.

    The name is one of `synth.liberty.LIBRARIES`, or the path of a liberty file.

    Raises:
        InputError: there is no such file, or it lacks a flip-flop, an inverter, a buffer or a two-input NAND.
    """
    known = LIBRARIES.get(name)
    path = find_files(known)[0] if known else Path(name)
    if not path.is_file():
        raise InputError(f"a liberty file is wanted, not {name!r}")
    excluded = known.excluded if known else r"(?!)"
    key = hashlib.sha256(path.read_bytes() + excluded.encode()).hexdigest()[:8]
    merged = folder / f"{path.name.split('.')[0]}-{key}.lib"
    if not merged.exists():
        write_lines(merged, [kept_lines(path, re.compile(excluded), first=True)])
    header, cells = read_cells(merged)
    if not cells:
        raise InputError(f"{name!r} must be a liberty file: no cell was found in it")
    found = _described(name, known.node if known else path.name, header, cells)
    return (replace(found, delay=known.delay) if known else found), merged


def read_cells(path: Path) -> tuple[dict[str, str], list[Cell]]:
    """The attributes of a library itself, and its cells."""
    header: dict[str, str] = {}
    cells: list[Cell] = []
    stack: list[tuple[str, str]] = []
    for kind, name, value in _statements(path.read_text()):
        if kind == "open":
            stack.append((name, value))
            if name == "cell":
                cells.append(Cell(value))
            elif name == "pin" and len(stack) == 3:
                cells[-1].pins[value] = Pin()
            elif len(stack) == 3 and stack[1][0] == "cell":
                cells[-1].groups.add(name)
        elif kind == "close":
            stack.pop()
        elif len(stack) == 1:
            header[name] = value
        elif len(stack) == 2 and stack[1][0] == "cell":
            cells[-1].attributes[name] = value
        elif len(stack) == 3 and stack[2][0] == "pin" and stack[1][0] == "cell":
            cells[-1].pins[stack[2][1]].attributes[name] = value
    return header, cells


def _statements(text: str) -> Iterator[tuple[str, str, str]]:
    """The statements of a liberty text in order: opened and closed groups, and simple attributes."""
    text = re.sub(r"/\*.*?\*/", " ", text, flags=re.DOTALL).replace("\\\n", " ")
    for found in re.finditer(
        r"(\w+)\s*\(([^(){}]*)\)\s*\{|(\})|(\w+)\s*:\s*(\"[^\"]*\"|[^;\n}]+)|(\w+)\s*\(([^(){};]*)\)\s*;", text,
    ):
        group, argument, close, name, value, call, arguments = found.groups()
        if group:
            yield "open", group, argument.strip().strip('"')
        elif close:
            yield "close", "", ""
        elif name:
            yield "set", name, value.strip().strip('"').strip()
        else:
            yield "set", call, arguments


def truth(function: str, inputs: list[str]) -> tuple[int, ...] | None:
    """The truth table of a liberty expression; the first input is the lowest bit of a row's number.

    None if the expression refers to anything but the inputs.
    """
    code = _with_prefix_not(function)
    code = re.sub(r"(?<=[\w)])\s+(?=[\w(!~])", "&", code.strip()).replace("!", "~").replace("*", "&").replace("+", "|")
    code = code.replace(" ", "")
    names = set(re.findall(r"[A-Za-z_]\w*", code))
    if not names <= set(inputs) or re.search(r"[^\w&|^~()]", code):
        return None
    values = []
    for bits in itertools.product((0, 1), repeat=len(inputs)):
        scope = dict(zip(inputs, reversed(bits), strict=True))
        try:
            values.append(eval(code, {"__builtins__": {}}, scope) & 1)
        except (SyntaxError, TypeError):
            return None
    return tuple(values)


def _with_prefix_not(function: str) -> str:
    """The expression with the postfix complements `A'` and `(...)'` written as `~A` and `~(...)`."""
    code = re.sub(r"(\w+)\s*'", r"~\1", function)
    while found := re.search(r"\)\s*'", code):
        start = found.start()
        while code[start:found.start() + 1].count("(") < code[start:found.start() + 1].count(")"):
            start -= 1
            if start < 0:
                return code  # no matching parenthesis, so this is not an expression
        code = f"{code[:start]}~{code[start:found.start() + 1]}{code[found.end():]}"
    return code


def _described(name: str, node: str, header: dict[str, str], cells: list[Cell]) -> Technology:
    inverter, pins = _find(cells, ["A"], {"Y": (1, 0)}, name, "inverter")
    buffer, buffer_pins = _find(cells, ["A"], {"Y": (0, 1)}, name, "buffer")
    _find(cells, ["A", "B"], {"Y": (1, 1, 1, 0)}, name, "two-input NAND")
    flops = [cell for cell in cells if "ff" in cell.groups and cell.usable and len(cell.split()[0]) == 2]
    if not flops:
        raise InputError(f"{name!r} must have a flip-flop without set and reset")
    farads = _unit(header.get("capacitive_load_unit", "1,ff"), _UNIT_FF)
    pin = float(next(c for c in cells if c.name == inverter).pins[pins["A"]].attributes.get("capacitance", 1.0))
    flop = min(flops, key=lambda cell: (cell.area, cell.name))
    return Technology(
        name=name, node=node, files=(), cell_list=f"all {len(cells)} cells of the file", excluded="(?!)",
        flop=flop.name, clock_gate=_clock_gate(cells), full_adder=_full_adder(cells), adder_inverts=False,
        tie_high=_tie(cells, 1), tie_low=_tie(cells, 0), inverter=inverter, gates={},
        broadcast_buffer=(buffer, buffer_pins["A"], buffer_pins["Y"]),
        driver=(flop.name, flop.split()[1][0]), load=_OUTPUT_LOAD * pin, gate_load_ff=2 * pin * farads,
        time_unit_ps=_unit(header.get("time_unit", "1ns"), _UNIT_PS))


def _unit(text: str, factors: dict[str, float]) -> float:
    number, unit = re.fullmatch(r"\s*([\d.]+)\s*,?\s*\"?(\w+)\"?\s*", text).groups()
    return float(number) * factors[unit.lower()]


def _matches(cell: Cell, count: int, wanted: dict[str, tuple[int, ...]]) -> dict[str, str] | None:
    """The output pin for each wanted truth table if the cell is a plain gate with just these outputs, otherwise None."""
    inputs, outputs = cell.split()
    if cell.groups & {"ff", "latch", "statetable"} or len(inputs) != count or len(outputs) != len(wanted):
        return None
    found = {truth(cell.pins[pin].function, inputs): pin for pin in outputs}
    return {label: found[table] for label, table in wanted.items()} if set(found) == set(wanted.values()) else None


def _find(
    cells: list[Cell], inputs: list[str], wanted: dict[str, tuple[int, ...]], name: str, what: str,
) -> tuple[str, dict[str, str]]:
    """The smallest cell with the wanted outputs, and its pin for each of the names used here; InputError if there is none."""
    for cell in sorted(cells, key=lambda cell: (cell.area, cell.name)):
        outputs = _matches(cell, len(inputs), wanted) if cell.usable else None
        if outputs:
            return cell.name, {**dict(zip(inputs, cell.split()[0], strict=True)), **outputs}
    raise InputError(f"{name!r} must have a cell that is an {what}" if what[0] in "aeiou" else
                     f"{name!r} must have a cell that is a {what}")


def _full_adder(cells: list[Cell]) -> tuple[str, tuple[str, str, str, str, str]] | None:
    carry = tuple(int(i.bit_count() >= 2) for i in range(8))
    try:
        name, pins = _find(cells, ["A", "B", "CI"], {"CO": carry, "S": tuple(i.bit_count() & 1 for i in range(8))}, "", "adder")
    except InputError:
        return None
    return name, (pins["A"], pins["B"], pins["CI"], pins["CO"], pins["S"])


def _tie(cells: list[Cell], value: int) -> tuple[str, str] | None:
    for cell in sorted(cells, key=lambda cell: (cell.area, cell.name)):
        inputs, outputs = cell.split()
        if not inputs and len(outputs) == 1 and cell.pins[outputs[0]].function == str(value):
            return cell.name, outputs[0]
    return None


def _clock_gate(cells: list[Cell]) -> tuple[str, str, str, str, str | None] | None:
    for cell in sorted(cells, key=lambda cell: (cell.area, cell.name)):
        if not cell.attributes.get("clock_gating_integrated_cell", "").startswith("latch_posedge"):
            continue
        pins = {role: next((pin for pin, of in cell.pins.items() if of.attributes.get(f"clock_gate_{role}") == "true"), None)
                for role in ("enable_pin", "clock_pin", "out_pin", "test_pin")}
        if None not in (pins["enable_pin"], pins["clock_pin"], pins["out_pin"]):
            return cell.name, pins["enable_pin"], pins["clock_pin"], pins["out_pin"], pins["test_pin"]
    return None
