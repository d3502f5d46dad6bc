"""Reads the names in a wave file (FST): scopes and signals, not values.

The hierarchy of an FST file is one block, compressed with LZ4 or gzip. Verilator's writer uses LZ4, for which Python has no
module, so the few lines of its block format are decoded here. Source: `fstapi.c` of GTKWave.
"""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_HIER_GZIP, _HIER_LZ4, _HIER_LZ4_TWICE = 4, 6, 7
_SCOPE, _UPSCOPE, _ATTRIBUTE, _ATTRIBUTE_END = 254, 255, 252, 253
_DIRECTIONS = {1: "input", 2: "output"}


@dataclass(frozen=True)
class Signal:
    """A signal of a trace.

    Attributes:
        scope: the names of the scopes around it, outermost first.
        name: its name, without the range of bits.
        bits: the range as in the file, `[10:0]`, or empty for a single bit.
        way: "input" or "output" for a port of its scope, otherwise empty.
    """

    scope: tuple[str, ...]
    name: str
    bits: str
    way: str

    @property
    def path(self) -> str:
        """The full name as GTKWave writes it."""
        return ".".join((*self.scope, self.name)) + self.bits


def signals(path: Path) -> list[Signal]:
    """All signals of a wave file, in its order.

    Raises:
        ValueError: the file is no FST file, or it has no hierarchy.
    """
    for kind, body in _blocks(path.read_bytes()):
        size = int.from_bytes(body[:8], "big")
        if kind == _HIER_GZIP:
            return list(_entries(gzip.decompress(body[8:])))
        if kind == _HIER_LZ4:
            return list(_entries(lz4_block(body[8:], size)))
        if kind == _HIER_LZ4_TWICE:
            once = int.from_bytes(body[8:16], "big")
            return list(_entries(lz4_block(lz4_block(body[16:], once), size)))
    raise ValueError(f"{path.name} must be an FST file with a hierarchy")


def _blocks(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Type and content of each block. Its length counts its own 8 bytes."""
    place = 0
    while place + 9 <= len(data):
        length = int.from_bytes(data[place + 1:place + 9], "big")
        if length < 8:
            return
        yield data[place], data[place + 9:place + 1 + length]
        place += 1 + length


def lz4_block(data: bytes, size: int) -> bytes:
    """Decompresses one LZ4 block to `size` bytes; ValueError where it has another size."""
    out, place = bytearray(), 0

    def length(start: int) -> int:
        nonlocal place
        total = start
        while start == 15:
            total += data[place]
            place += 1
            if data[place - 1] != 255:
                break
        return total

    while place < len(data):
        token = data[place]
        place += 1
        count = length(token >> 4)
        out += data[place:place + count]
        place += count
        if place >= len(data):  # the last sequence has literals only
            break
        back = int.from_bytes(data[place:place + 2], "little")
        place += 2
        for _ in range(length(token & 15) + 4):
            out.append(out[-back])
    if len(out) != size:
        raise ValueError(f"an LZ4 block must have {size} bytes, not {len(out)}")
    return bytes(out)


def _entries(data: bytes) -> Iterator[Signal]:
    scope: list[str] = []
    place = 0

    def text() -> str:
        nonlocal place
        end = data.index(0, place)
        found = data[place:end].decode()
        place = end + 1
        return found

    def number() -> None:
        nonlocal place
        while data[place] & 128:
            place += 1
        place += 1

    while place < len(data):
        kind = data[place]
        if kind == _SCOPE:
            place += 2
            scope.append(text())
            text()
        elif kind == _UPSCOPE:
            place += 1
            scope.pop()
        elif kind == _ATTRIBUTE:
            place += 3
            text()
            number()
        elif kind == _ATTRIBUTE_END:
            place += 1
        else:
            way = _DIRECTIONS.get(data[place + 1], "")
            place += 2
            name, _, bits = text().partition(" ")
            number()
            number()
            yield Signal(tuple(scope), name, bits, way)
