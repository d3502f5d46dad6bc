"""The streams of a unit and the maps of their payloads: which bits hold which field, in which format.

The maps follow the layouts that the RTL itself uses, and take formats and meanings from the records of `spec`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from amaranth.hdl import Shape, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In

from msv2.document.formats import field_format
from msv2.document.text import doc_of
from rtl.shapes import layout
from spec.chunks import CHUNK_RECORDS
from spec.compact import with_compact_records
from spec.config import AcceleratorConfig
from spec.memory import MEMORY_RECORDS
from spec.packed import PACKED_RECORDS
from spec.records import RECORDS, Record, list_group
from spec.supertiles import SUPERTILE_RECORDS

Records = Sequence[tuple[data.StructLayout, Record]]


@dataclass(frozen=True)
class FieldBits:
    """A field of a payload.

    Attributes:
        name: its name.
        low, width: its lowest bit in the payload, and how many bits it has.
        format: that of its numbers as in docs/formats.md, such as UQ1.8; `uN` and `sN` are integers of N bits. A field of
            several numbers has their count before it, and the first number lies lowest.
        doc: what it holds; empty where no record of `spec` says it.
    """

    name: str
    low: int
    width: int
    format: str
    doc: str

    @property
    def span(self) -> str:
        """The bits, highest first: `43:34`, or `44` for a single one."""
        return f"{self.low + self.width - 1}:{self.low}" if self.width > 1 else f"{self.low}"


@dataclass(frozen=True)
class StreamPort:
    """A stream of a unit.

    Attributes:
        name: what its Verilog ports begin with, before `__payload`, `__valid` and `__ready`.
        way: "input" or "output", as the payload goes.
        record: name of its record in docs/formats.md, or empty.
        bits: width of the payload.
        fields: all fields, lowest first; none where the payload is a plain number.
        doc: what it carries, as the unit's docstring says.
    """

    name: str
    way: str
    record: str
    bits: int
    fields: tuple[FieldBits, ...]
    doc: str


def documented(component: wiring.Component) -> dict[str, str]:
    """What the docstring of the component's class says of its ports, by name."""
    _, _, listed = doc_of(type(component)).partition("Ports:\n")
    found, listed = {}, listed.partition("\n\n")[0]
    for names, text in re.findall(r"^    ([\w*]+(?:, [\w*]+)*): (.*(?:\n {8}.*)*)", listed, re.MULTILINE):
        found |= {name: " ".join(text.split()) for name in names.split(", ")}
    return found


def known_records(config: AcceleratorConfig) -> list[tuple[data.StructLayout, Record]]:
    """Layouts and their records; those of machines with stereo, with compact chunks and with lists by super-tile too, as some
    of their units can be made by themselves."""
    configs = [config]
    if config.depth and not config.stereo and not config.supertiles:
        configs.append(config.with_(stereo=True, lockstep=False))
    if not config.compact:
        configs.append(with_compact_records(config))
    if not config.supertiles:
        configs.append(with_compact_records(
            config, lists="supertile", stereo=False, lockstep=False, bank_memories=False))
    makers = [(make, one) for one in configs for make in (*RECORDS, *MEMORY_RECORDS, *CHUNK_RECORDS, *PACKED_RECORDS)]
    makers += [(make, one) for one in configs if one.supertiles for make in (*SUPERTILE_RECORDS, list_group)]
    return [(layout(record), record) for record in (make(one) for make, one in makers)]


def record_of(shape: object, records: Records) -> Record | None:
    """The record with this layout; None where there is none."""
    return next((record for known, record in records if known == shape), None) if isinstance(shape, data.Layout) else None


def fields_of(shape: object, records: Records) -> tuple[FieldBits, ...]:
    """The fields of a payload, lowest first; none where it is a plain number."""
    record = record_of(shape, records)
    if record:
        found, low = [], 0
        for f in record.fields:
            found.append(FieldBits(f.name, low, f.width, field_format(f), " ".join(f.doc.split())))
            low += f.width
        return tuple(found)
    if isinstance(shape, data.StructLayout):
        return tuple(FieldBits(str(name), f.offset, f.width, integer_format(f.shape), "") for name, f in shape)
    return ()


def integer_format(shape: object) -> str:
    """The format of a field that no record describes: integers, or a structure's bits as one unsigned number."""
    if isinstance(shape, data.ArrayLayout):
        return f"{shape.length} × {integer_format(shape.elem_shape)}"
    plain = unsigned(Shape.cast(shape).width) if isinstance(shape, data.Layout) else Shape.cast(shape)
    return f"{'s' if plain.signed else 'u'}{plain.width}"


def stream_ports(
    component: wiring.Component, config: AcceleratorConfig, docs: Mapping[str, str] | None = None,
    names: Mapping[str, str] | None = None,
) -> list[StreamPort]:
    """The streams of a component in the order of its signature, those inside other interfaces too.

    Args:
        component: the unit.
        config: its configuration.
        docs: what streams carry, by their names in Amaranth.
        names: Verilog's name of each port by Amaranth's; they differ where that is a keyword of Verilog.
    """
    records, known = known_records(config), names or {}
    found = []
    for path, signature, flipped in _streams(component.signature, "", False):
        shape = signature.members["payload"].shape
        record, payload = record_of(shape, records), known.get(f"{path}__payload", f"{path}__payload")
        found.append(StreamPort(
            payload.removesuffix("__payload"), "input" if flipped else "output", record.name if record else "",
            Shape.cast(shape).width, fields_of(shape, records), (docs or {}).get(path.partition("__")[0], "")))
    return found


def _streams(signature: wiring.Signature, before: str, flipped: bool) -> Iterator[tuple[str, wiring.Signature, bool]]:
    """Path and signature of each stream, and whether its payload comes in. A path has the numbers of a stream in an array."""
    for name, member in signature.members.items():
        if member.is_port:
            continue
        inward = (member.flow is In) != flipped
        paths = [f"{before}{name}"]
        for count in member.dimensions:
            paths = [f"{path}__{number}" for path in paths for number in range(count)]
        for path in paths:
            if isinstance(member.signature, stream.Signature):
                yield path, member.signature, inward
            else:
                yield from _streams(member.signature, f"{path}__", inward)
