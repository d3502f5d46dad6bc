"""What a register map is made of: registers, their bits, and counters."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from spec.codes import Code
from spec.formats import Format


class Access(Enum):
    """What the host may do with a register, and what a write does."""

    READ_ONLY = "read"
    READ_WRITE = "read, write"
    CLEARING = "read, write 1 to clear"


@dataclass(frozen=True)
class Bits:
    """Some bits of a register.

    Attributes:
        name: name of the bits.
        low: position of the lowest bit.
        width: number of bits.
        doc: what the bits mean.
        strobe: whether writing 1 triggers an action; such bits always read 0.
        values: the enumeration that the bits hold, if any.
    """

    name: str
    low: int
    width: int
    doc: str
    strobe: bool = False
    values: type[Code] | None = None

    @property
    def mask(self) -> int:
        """A mask of these bits in the register."""
        return (1 << self.width) - 1 << self.low


@dataclass(frozen=True)
class Register:
    """A register.

    Attributes:
        name: name in lower case, with underscores between words.
        offset: byte address in the register space.
        access: what the host may do with it.
        doc: what it holds.
        bits: its parts; where there are none, all 32 bits are one number.
        format: number format, where the register is a setting.
    """

    name: str
    offset: int
    access: Access
    doc: str
    bits: tuple[Bits, ...] = ()
    format: Format | None = None


@dataclass(frozen=True)
class Counter:
    """A counter: its name, what it counts, and its width in bits, 32 or 64."""

    name: str
    doc: str
    width: int = 32
