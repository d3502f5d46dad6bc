"""Memories as modules of their own, which a foundry's macro can replace, and their behavioural models.

Every memory of the machine has one write port and one read port, both at the rising edge of one clock. Memories of one shape
share a module; its name says the shape::

    PREFIXram_1024x24         1,024 words of 24 bits
    PREFIXram_32x200_w8       and its words have 8 parts, written apart
    PREFIXram_16x94_through   and a read of the word that is being written gives the new word; otherwise it gives the old one
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from msv2.verilog.rtlil import Cell, Module, bits_of
from spec.constants import FLIP_FLOP_BITS


@dataclass(frozen=True, order=True)
class Shape:
    """A kind of memory.

    Attributes:
        words, width: rows and bits of a row.
        lanes: parts of a row that are written apart, each with a bit of `wr_en`.
        through: a read of the row that is written in the same cycle gives the new row.
    """

    words: int
    width: int
    lanes: int
    through: bool

    @property
    def bits(self) -> int:
        """Bits of all rows."""
        return self.words * self.width

    @property
    def address_bits(self) -> int:
        """Width of the address ports."""
        return max(1, (self.words - 1).bit_length())

    @property
    def module(self) -> str:
        """Name of the module, without the prefix."""
        lanes = f"_w{self.lanes}" if self.lanes > 1 else ""
        return f"ram_{self.words}x{self.width}{lanes}{'_through' if self.through else ''}"


@dataclass(frozen=True)
class Placed:
    """A memory of the design: the module that it lies in, its instance and its shape."""

    parent: str
    instance: str
    shape: Shape


def take_out(module: Module, prefix: str) -> list[Placed]:
    """Replaces the memories of one module, in place, by instances of modules of their shapes.

    Raises ValueError where a memory is not of the only kind that there is: one write port, one read port, one clock, contents
    that begin at 0.
    """
    declared = [item.split() for item in module.items if isinstance(item, str) and item.startswith("  memory ")]
    memories = {words[-1]: words for words in declared}
    if not memories:
        return []
    widths, placed = module.widths(), []
    parts = {name: {kind: [] for kind in ("$memrd_v2", "$memwr_v2", "$meminit_v2")} for name in memories}
    for cell in module.cells():
        if cell.kind in ("$memrd_v2", "$memwr_v2", "$meminit_v2"):
            parts[f"\\{cell.parameter('MEMID').strip(chr(34)).lstrip(chr(92))}"][cell.kind].append(cell)
    gone = {id(cell) for kinds in parts.values() for cells in kinds.values() for cell in cells}
    module.items = [item for item in module.items if id(item) not in gone
                    and not (isinstance(item, str) and item.startswith("  memory "))]
    for name, (_, _, width, _, words, _) in memories.items():
        shape, cell = _instance(name, int(words), int(width), parts[name], widths, prefix)
        module.items.append(cell)
        placed.append(Placed(module.name, name, shape))
    return placed


def _instance(
    name: str, words: int, width: int, parts: dict[str, list[Cell]], widths: dict[str, int], prefix: str,
) -> tuple[Shape, Cell]:
    if len(parts["$memrd_v2"]) != 1 or len(parts["$memwr_v2"]) != 1:
        raise ValueError(f"memory {name} must have one read port and one write port, not {parts!r}")
    (read,), (write,) = parts["$memrd_v2"], parts["$memwr_v2"]
    clocks = {(port.parameter("CLK_ENABLE"), port.parameter("CLK_POLARITY"), port.pin("CLK")) for port in (read, write)}
    if len(clocks) != 1 or not read.pin("ARST").endswith("'0") or not read.pin("SRST").endswith("'0"):
        raise ValueError(f"memory {name} must have one clock, not {clocks!r}, and a read port without reset")
    if next(iter(clocks))[:2] != ("1", "1") or any("1" in _digits(cell.pin("DATA")) for cell in parts["$meminit_v2"]):
        raise ValueError(f"memory {name} must have ports at rising edges and begin at 0")
    enables = bits_of(write.pin("EN"), widths)
    edges = [place for place in range(1, width) if enables[place] != enables[place - 1]]
    lane = math.gcd(width, *edges)
    shape = Shape(words, width, width // lane, "1" in _digits(read.parameter("TRANSPARENCY_MASK")))
    address = shape.address_bits

    def at_most(pin: str) -> str:
        found = bits_of(pin, widths)[:address]
        return f"{{ {' '.join(reversed([*found, *['0'] * (address - len(found))]))} }}".replace(" 0 ", " 1'0 ")

    pins = {
        "clk": read.pin("CLK"), "wr_addr": at_most(write.pin("ADDR")), "wr_data": write.pin("DATA"),
        "wr_en": _concatenated(enables[::lane]), "rd_en": read.pin("EN"), "rd_addr": at_most(read.pin("ADDR")),
        "rd_data": read.pin("DATA")}
    return shape, Cell(f"\\{prefix}{shape.module}", name, [f"    connect \\{pin} {signal}" for pin, signal in pins.items()])


def _digits(constant: str) -> str:
    return constant.partition("'")[2]


def _concatenated(bits: list[str]) -> str:
    return f"{{ {' '.join(bit if bit.startswith(('$', chr(92))) else chr(49) + chr(39) + bit for bit in reversed(bits))} }}"


_MODEL = """\
// {title}
//
// {bits} bits{made_as}. One clock, one write port, one read port; a macro of this shape may stand in its place.
//   write   {lanes}
//   read    rd_data holds the word at rd_addr from the rising edge at which rd_en is high until the next such edge
//   both    a read of the word that is written at the same edge gives the {which} word
// The contents are unknown until they are written: the machine reads no word that it has not written.
module {name}(
  input  wire clk,
  input  wire {lane_range}wr_en,
  input  wire {address_range}wr_addr,
  input  wire {data_range}wr_data,
  input  wire rd_en,
  input  wire {address_range}rd_addr,
  output reg  {data_range}rd_data
);
  reg {data_range}memory_words [0:{last}];
{body}endmodule
"""


def model(shape: Shape, prefix: str) -> str:
    """The behavioural model of a memory in Verilog-2001."""
    part = shape.width // shape.lanes
    lines = ["  always @(posedge clk) begin"]
    if shape.lanes == 1:
        lines.append("    if (wr_en) memory_words[wr_addr] <= wr_data;")
    for lane in range(shape.lanes if shape.lanes > 1 else 0):
        bits = f"[{(lane + 1) * part - 1}:{lane * part}]" if part > 1 else f"[{lane}]"
        lines.append(f"    if (wr_en[{lane}]) memory_words[wr_addr]{bits} <= wr_data{bits};")
    if shape.through and shape.lanes == 1:
        lines.append("    if (rd_en) rd_data <= (wr_en && wr_addr == rd_addr) ? wr_data : memory_words[rd_addr];")
    elif shape.through:
        raise ValueError(f"a memory with parts must give the old word, not {shape!r}")
    else:
        lines.append("    if (rd_en) rd_data <= memory_words[rd_addr];")
    lines += ["  end", ""]
    several = f"wr_en has a bit for each of the {shape.lanes} parts of {part} bits, the lowest for the lowest"
    return _MODEL.format(
        title=f"Memory of {shape.words} words of {shape.width} bits.", bits=f"{shape.bits:,}", name=prefix + shape.module,
        made_as=", which synthesis makes of flip-flops" if shape.bits <= FLIP_FLOP_BITS else "",
        lanes=several if shape.lanes > 1 else "the word at wr_addr becomes wr_data at a rising edge at which wr_en is high",
        which="new" if shape.through else "old", lane_range=f"[{shape.lanes - 1}:0] " if shape.lanes > 1 else "",
        address_range=f"[{shape.address_bits - 1}:0] ", data_range=f"[{shape.width - 1}:0] ", last=shape.words - 1,
        body="\n".join(lines))
