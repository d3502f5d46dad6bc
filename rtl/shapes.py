"""Amaranth shapes of the number formats and records of `spec`."""

from __future__ import annotations

from amaranth.hdl import Shape, signed, unsigned
from amaranth.lib import data

from spec.formats import Fixed, Format
from spec.records import Record


def shape(number: Format) -> Shape:
    """The shape of one number. It is signed where a fixed-point format is; a SmallFloat is an unsigned bit pattern."""
    return signed(number.width) if isinstance(number, Fixed) and number.signed else unsigned(number.width)


def layout(record: Record) -> data.StructLayout:
    """The layout of `record`, bit for bit as `Record.pack` packs it: field 0 is lowest, and a field of several numbers is an
    array."""
    return data.StructLayout({
        f.name: data.ArrayLayout(shape(f.format), f.count) if f.count > 1 else shape(f.format) for f in record.fields
    })
