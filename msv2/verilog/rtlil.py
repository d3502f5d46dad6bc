"""RTLIL as text, module by module: just enough of its grammar to rename what has a name and to take memories out."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

_NAME = re.compile(r"\\\S+")
_WIRE = re.compile(r"  wire width (\d+) (?:(input|output|inout) (\d+) +)?(?:signed +)?(\\\S+|\$\S+)")
_TERM = re.compile(r"(\d+)'([01xz-]*)|((?:\\|\$)\S+)(?: \[(\d+)(?::(\d+))?\])?")


@dataclass
class Cell:
    """A cell: its type and name, and all lines between the first and the last."""

    kind: str
    name: str
    lines: list[str]

    def parameter(self, name: str) -> str:
        """The text of a parameter; KeyError where the cell has none of that name."""
        return self._value("parameter", name)

    def pin(self, name: str) -> str:
        """What is connected to a pin; KeyError where the cell has none of that name."""
        return self._value("connect", name)

    def _value(self, kind: str, name: str) -> str:
        start = f"    {kind} \\{name} "
        for line in self.lines:
            if line.startswith(start):
                return line[len(start):]
        raise KeyError(f"{self.kind} {self.name} has no {kind} {name}")


@dataclass
class Module:
    """A module in the order of its text: attributes and other single lines, cells, and processes as their lines."""

    name: str
    attributes: list[str]
    items: list[str | Cell | list[str]] = field(default_factory=list)

    def cells(self) -> list[Cell]:
        """The module's cells."""
        return [item for item in self.items if isinstance(item, Cell)]

    def widths(self) -> dict[str, int]:
        """Bits of every wire, by name."""
        return {found[4]: int(found[1]) for item in self.items if isinstance(item, str) and (found := _WIRE.match(item))}

    def ports(self) -> list[tuple[str, str, int]]:
        """Name, direction and bits of every port, in order."""
        found = [match for item in self.items if isinstance(item, str) and (match := _WIRE.match(item)) and match[2]]
        return [(match[4], match[2], int(match[1])) for match in sorted(found, key=lambda match: int(match[3]))]

    def text(self) -> str:
        """The module as RTLIL."""
        lines = [*self.attributes, f"module {self.name}"]
        for item in self.items:
            match item:
                case str():
                    lines.append(item)
                case Cell():
                    lines += [f"  cell {item.kind} {item.name}", *item.lines, "  end"]
                case _:
                    lines += item
        return "\n".join([*lines, "end", ""])


def parse(text: str) -> list[Module]:
    """The modules of RTLIL as Amaranth writes it."""
    modules: list[Module] = []
    attributes: list[str] = []
    lines = iter(text.splitlines())
    for line in lines:
        if line.startswith("attribute "):
            attributes.append(line)
        elif line.startswith("module "):
            modules.append(Module(line.removeprefix("module "), attributes))
            attributes = []
            _parse_body(modules[-1], lines)
        elif line.strip():
            raise ValueError(f"a module must begin here, not {line!r}")
    return modules


def _parse_body(module: Module, lines: object) -> None:
    for line in lines:
        if line == "end":
            return
        if line.startswith("  cell "):
            _, kind, name = line.split()
            module.items.append(Cell(kind, name, list(iter(lambda: next(lines), "  end"))))
        elif line.startswith("  process "):
            module.items.append([line, *iter(lambda: next(lines), "  end"), "  end"])
        elif line.strip():
            module.items.append(line)
    raise ValueError(f"module {module.name} must have an end")


def bits_of(signal: str, widths: Mapping[str, int]) -> list[str]:
    """The bits of a sigspec, lowest first: `0`, `1`, `x`, or a wire and its index as text."""
    found: list[str] = []
    for number, pattern, name, high, low in reversed(_TERM.findall(signal)):
        if name:
            top = int(high) if high else widths[name] - 1
            bottom = int(low or high) if high else 0
            found += [f"{name} [{place}]" for place in range(bottom, top + 1)]
        else:
            found += list(reversed(pattern.rjust(int(number), pattern[0] if pattern else "0")))
    return found


def renamed(line: str, names: Mapping[str, str]) -> str:
    """The line with every public name replaced."""
    return _NAME.sub(lambda found: names[found[0]], line)
