"""Reads what a placement needs of a LEF file: the size of each cell, and where its pins are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from spec.errors import InputError

NM = 1000
"""Nanometres in a LEF file's unit: all lengths here are whole nanometres."""


@dataclass(frozen=True)
class Pin:
    """A pin: whether it is an output, and the centre of its shapes in nm from the cell's lower left corner."""

    is_output: bool
    x: int
    y: int


@dataclass
class CellShape:
    """A cell: its width and height in nm, and its signal pins by name."""

    width: int = 0
    height: int = 0
    pins: dict[str, Pin] = field(default_factory=dict)


def read_lef(path: Path) -> dict[str, CellShape]:
    """The cells of a LEF file. Pins of supplies are left out.

    Raises:
        InputError: the file is not there, or it describes no cells.
    """
    if not path.is_file():
        raise InputError(f"a LEF file of the cells is wanted, and {str(path)!r} is none")
    cells = dict(_cells(path))
    if not cells:
        raise InputError(f"{str(path)!r} has no MACRO, so it describes no cells")
    return cells


def _cells(path: Path) -> Iterator[tuple[str, CellShape]]:
    cell, name, pin = CellShape(), "", ""
    direction, use, boxes, in_pin = "", "", [], False
    with path.open() as lines:
        for line in lines:
            words = line.split()
            match words:
                case ["MACRO", name]:
                    cell = CellShape()
                case ["SIZE", width, "BY", height, *_] if name:
                    cell.width, cell.height = _nm(width), _nm(height)
                case ["PIN", pin]:
                    direction, use, boxes, in_pin = "", "SIGNAL", [], True
                case ["DIRECTION", direction, *_]:
                    pass
                case ["USE", use, *_] if in_pin:
                    pass
                case ["RECT", *corners] if in_pin:
                    boxes.append([float(corner) * NM for corner in corners[:4]])
                case ["END", ended] if in_pin and ended == pin:
                    in_pin = False
                    if use in ("SIGNAL", "CLOCK") and boxes:
                        cell.pins[pin] = _pin(direction, boxes)
                case ["END", ended] if name and ended == name:
                    yield name, cell
                    name = ""


def _nm(text: str) -> int:
    return round(float(text) * NM)


def _pin(direction: str, boxes: list[list[float]]) -> Pin:
    x = sum(left + right for left, _, right, _ in boxes) / (2 * len(boxes))
    y = sum(bottom + top for _, bottom, _, top in boxes) / (2 * len(boxes))
    return Pin(direction == "OUTPUT", round(x), round(y))
