"""What a module's ports carry, as comments: streams with their records field by field, all others with a line each."""

from __future__ import annotations

from collections.abc import Iterator

from amaranth.hdl import Shape
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In

from msv2.document.stream_maps import Records, documented, fields_of, known_records, record_of
from spec.config import AcceleratorConfig

HANDSHAKE = (
    "The sender of a stream NAME drives NAME__payload and NAME__valid, its receiver drives NAME__ready.",
    "An item moves at each rising edge of clk at which valid and ready are high. Once valid is high, valid and",
    "payload stay as they are until the item has moved; valid does not wait for ready.")

_CLOCKS = {"clk": "clock; everything happens at its rising edge", "rst": "synchronous reset, active high"}


def port_notes(
    component: wiring.Component, config: AcceleratorConfig, ports: list[tuple[str, str, int]], names: dict[str, str],
) -> list[str]:
    """Lines about all ports of a component.

    Args:
        component: the unit.
        config: its configuration.
        ports: name, direction and bits of its Verilog ports.
        names: Verilog's name of each port by Amaranth's; they differ where that is a keyword of Verilog.
    """
    docs, records = documented(component), known_records(config)
    lines = [f"{name}: {way}, {_bits(width)}: {_CLOCKS[name]}" for name, way, width in ports if name in _CLOCKS]
    notes = list(_notes(component.signature, "", docs, records))
    changed = {old: new for old, new in names.items() if old != new}
    notes = [(is_stream, [_renamed(line, changed) for line in group]) for is_stream, group in notes]
    if any(is_stream for is_stream, _ in notes):
        lines += ["", *HANDSHAKE]
    together = {pattern[:-1]: text for pattern, text in docs.items() if pattern.endswith("*")}
    lines.append("")
    for start, text in together.items():
        lines += [f"{start}*: {text}", *(f"    {line}" for _, group in notes for line in group if line.startswith(start)), ""]
    return [*lines, *(line for _, group in notes for line in group if not line.startswith(tuple(together)))]


def _doc(name: str, docs: dict[str, str]) -> str:
    return f": {docs[name]}" if docs.get(name) else ""


def _notes(
    signature: wiring.Signature, before: str, docs: dict[str, str], records: Records, *, flipped: bool = False,
) -> Iterator[tuple[bool, list[str]]]:
    """Whether it is a stream, and lines, of each member."""
    for name, member in signature.members.items():
        path, inward = before + name, (member.flow is In) != flipped
        way = "input" if inward else "output"
        several = "".join(f"[0..{count - 1}]" for count in member.dimensions)
        doc = _doc(path, docs)
        if member.is_port:
            width = Shape.cast(member.shape).width
            yield False, [f"{path}{several}: {way}, {_bits(width)}{doc}", *_map(member.shape, records)]
        elif isinstance(member.signature, stream.Signature):
            payload = member.signature.members["payload"].shape
            record, bits = record_of(payload, records), _bits(Shape.cast(payload).width)
            of = f"of {record.name}, {bits}" if record else f"of {bits}"
            yield True, [f"{path}{several}: {way} stream {of}{doc}", *_map(payload, records)]
        else:
            yield from _notes(member.signature, f"{path}__", docs, records, flipped=inward)


def _renamed(line: str, names: dict[str, str]) -> str:
    name, colon, rest = line.partition(":")
    return f"{names.get(name, name)}{colon}{rest}"


def _map(shape: object, records: Records) -> list[str]:
    """A line for each field of a payload: bits, name, format and meaning, lowest first."""
    fields = fields_of(shape, records)
    if not fields:
        return []
    widest = [max(map(len, column)) for column in zip(*((f"[{f.span}]", f.name, f.format) for f in fields), strict=True)]
    return [f"    {f'[{f.span}]':>{widest[0]}}  {f.name:{widest[1]}}  {f.format:{widest[2]}}  {f.doc}".rstrip() for f in fields]


def _bits(width: int) -> str:
    return f"{width} bit{'s' if width != 1 else ''}"
