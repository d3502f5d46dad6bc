"""The streams of an exported unit, as a page beside the Verilog and as lists for its JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from msv2.document.stream_maps import FieldBits, StreamPort
from msv2.document.text import one_line, table


def as_json(streams: Sequence[StreamPort]) -> list[dict[str, object]]:
    """The streams for scripts; each field with its highest and lowest bit."""
    return [{
        **{key: value for key, value in asdict(one).items() if key != "fields"},
        "fields": [{"name": f.name, "high": f.low + f.width - 1, "low": f.low, "format": f.format, "doc": f.doc}
                   for f in one.fields]} for one in streams]


def streams_page(top: str, origin: str, streams: Sequence[StreamPort]) -> str:
    """The page beside the Verilog: a table for each stream. Streams of one record share a table."""
    lines = [f"# Streams of {top}", "", f"{origin} Written by `msv2 verilog`: do not edit.", "",
             "An item of the stream NAME moves at each rising edge of clk at which `NAME__valid` and `NAME__ready` are high.",
             "`NAME__payload` holds it. A field of several numbers has the first one lowest.", ""]
    rows = [[f"`{one.name}`", one.way, one.record or "-", one.bits, one_line(one.doc) or "-"] for one in streams]
    lines += table(("stream", "direction", "record", "bits", "carries"), rows)
    same: dict[tuple[FieldBits, ...], list[StreamPort]] = {}
    for one in streams:
        same.setdefault(one.fields, []).append(one)
    for fields, those in same.items():
        lines += [f"## {', '.join(f'`{one.name}__payload[{one.bits - 1}:0]`' for one in those)}", "", *field_table(fields)]
    return "\n".join(lines).rstrip() + "\n"


def field_table(fields: Sequence[FieldBits]) -> list[str]:
    """The map of a payload in Markdown."""
    if not fields:
        return ["It is one number without fields.", ""]
    return table(("bits", "field", "format", "holds"),
                 ([f.span, f"`{f.name}`", f.format, one_line(f.doc) or "-"] for f in fields))
