"""Reads the mapped netlists of the flow: structural Verilog, one module a file, as Yosys writes it (`synth.flow.synthesise`).

Only what the flow writes is understood: port lists, declarations of ports and wires, instances with named pins, and assignments
of nets to nets. A bit is its Verilog text (`net`, `net[3]`, or an escaped name and a space), and a constant is "0", "1" or "x".
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

_NAME = r"(?:\\\S+ |[A-Za-z_][\w$]*)"
_INSTANCE = re.compile(rf"  ({_NAME}) ?({_NAME}) ?\($")
_PIN = re.compile(rf"    \.({_NAME}) ?\((.*)\),?$")
_DECLARED = re.compile(rf"  (input|output|wire) (?:\[(\d+):(\d+)\] )?({_NAME}) ?;$")
_ASSIGNED = re.compile(r"  assign (.*) = (.*);$")
_TERM = re.compile(rf"({_NAME}) ?(?:\[(\d+)(?::(\d+))?\])?|(\d+)'(h|d|b)([0-9a-fxz]+)")

CONSTANTS = ("0", "1", "x")


@dataclass(frozen=True)
class Instance:
    """A cell or a module inside another one: its name, its kind, and the bits at each pin, lowest first."""

    name: str
    kind: str
    pins: Mapping[str, tuple[str, ...]]


@dataclass
class Netlist:
    """A module.

    Attributes:
        name: its name.
        ports: direction ("input" or "output") and width of each port.
        widths: width of each vector among its ports and wires.
        instances: what it is made of.
        assigns: pairs of a bit and the bit from which it is driven.
    """

    name: str
    ports: dict[str, tuple[str, int]] = field(default_factory=dict)
    widths: dict[str, int] = field(default_factory=dict)
    instances: list[Instance] = field(default_factory=list)
    assigns: list[tuple[str, str]] = field(default_factory=list)

    def bits(self, expression: str) -> tuple[str, ...]:
        """The bits of a net, a part of a net, a constant, or a concatenation, lowest first.

        Raises:
            ValueError: the expression is none of these.
        """
        found: list[str] = []
        terms = _terms(expression)
        for name, high, low, size, base, digits in reversed(list(terms)):
            if size:
                found += _constant(int(size), base, digits)
            elif high:
                found += [f"{name}[{i}]" for i in range(int(low or high), int(high) + 1)]
            else:
                width = self.widths.get(name)
                found += [name] if width is None else [f"{name}[{i}]" for i in range(width)]
        return tuple(found)


def _terms(expression: str) -> Iterator[tuple[str, str, str, str, str, str]]:
    text = expression.lstrip()
    text = text[1:text.rindex("}")] if text.startswith("{") else text
    while text := text.lstrip(", "):
        found = _TERM.match(text)
        if found is None:
            raise ValueError(f"an expression of nets is wanted, not {expression!r}")
        yield found.groups("")
        text = text[found.end():]


def _constant(size: int, base: str, digits: str) -> list[str]:
    if base == "d":
        digits, base = f"{int(digits):b}", "b"
    bits = "".join(digit * 4 if digit in "xz" else f"{int(digit, 16):04b}" for digit in digits) if base == "h" else digits
    bits = bits.rjust(size, "0")[-size:].replace("z", "x")
    return list(reversed(bits))


def parse(text: str) -> Netlist:
    """The module of a netlist's text.

    Raises:
        ValueError: a line is not understood.
    """
    lines = iter(text.splitlines())
    found: Netlist | None = None
    for line in lines:
        if not line.strip() or line.startswith("/*"):
            continue
        if found is None:
            found = Netlist(re.match(rf"module ({_NAME})", line)[1])
            while not line.endswith(");"):
                line = next(lines)
        elif declared := _DECLARED.match(line):
            direction, high, low, name = declared.groups()
            if high is not None:
                if low != "0":
                    raise ValueError(f"vectors must begin at bit 0, not so {line!r}")
                found.widths[name] = int(high) + 1
            if direction != "wire":
                found.ports[name] = direction, 1 if high is None else int(high) + 1
        elif begins := _INSTANCE.match(line):
            found.instances.append(Instance(begins[2].strip(), begins[1].strip(), dict(_pins(found, lines))))
        elif assigned := _ASSIGNED.match(line):
            left, right = map(found.bits, assigned.groups())
            found.assigns += zip(left, right, strict=True)
        elif line.strip() != "endmodule":
            raise ValueError(f"{found.name}: a line is not understood: {line!r}")
    if found is None:
        raise ValueError("the text has no module")
    return found


def _pins(module: Netlist, lines: Iterator[str]) -> Iterator[tuple[str, tuple[str, ...]]]:
    for line in lines:
        if line == "  );":
            return
        pin = _PIN.match(line)
        if pin is None:
            raise ValueError(f"{module.name}: a pin is wanted, not {line!r}")
        yield pin[1].strip(), module.bits(pin[2])


def read(path: Path) -> Netlist:
    """The module of a netlist file."""
    return parse(path.read_text())
