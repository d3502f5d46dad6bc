"""The maps of payloads, read as a user reads them, cut the fields out of items that the project packs."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from amaranth.hdl import signed, unsigned
from amaranth.lib import data

from msv2.document import streams as streams_document
from msv2.document.stream_maps import StreamPort, fields_of, integer_format, known_records, stream_ports
from msv2.verilog.export import Export, export
from rtl.emit import to_rtlil
from rtl.units import TOP, UNITS
from spec.chunks import CHUNK_RECORDS
from spec.config import MACHINES, PAPER, TINY, V3, AcceleratorConfig
from spec.formats import Fixed
from spec.memory import MEMORY_RECORDS
from spec.packed import PACKED_RECORDS
from spec.paths import ROOT
from spec.records import RECORDS, Record, list_group
from spec.supertiles import SUPERTILE_RECORDS

Map = dict[str, tuple[int, int, str]]
"""Highest bit, lowest bit and format of each field."""


def record_named(name: str, config: AcceleratorConfig, bits: int) -> Record:
    """The record of that name, and of that width where it is not 0. Units of chunks and compact records are made of a machine
    that has both, and those of super-tiles of one that has these too."""
    chunked = config.with_(order="spatial", chunks=True, records="compact")
    makers = [(make, one) for one in (config, chunked)
              for make in (*RECORDS, *MEMORY_RECORDS, *CHUNK_RECORDS, *PACKED_RECORDS)]
    supertiles = chunked.with_(lists="supertile", stereo=False, bank_memories=False)
    makers += [(make, supertiles) for make in (*RECORDS, *SUPERTILE_RECORDS, list_group)]
    return next(record for make, one in makers if (record := make(one)).name == name and bits in (0, record.width))


@pytest.mark.parametrize("config", MACHINES.values(), ids=MACHINES)
def test_every_machine_has_records_for_its_streams(config: AcceleratorConfig) -> None:
    """Those of machines that it cannot be changed into are left out, so that the Verilog of each can be written."""
    names = {record.name for _, record in known_records(config)}
    assert {make(config).name for make in RECORDS} | {make(V3).name for make in SUPERTILE_RECORDS} <= names


def known_row(record: Record, seed: int) -> np.ndarray:
    """A row whose numbers are random, the extremes of their formats among them."""
    rng, row = random.Random(seed), np.zeros((), record.dtype)
    for f in record.fields:
        low, high = f.raw_range
        numbers = [rng.choice((low, high, rng.randint(low, high))) for _ in range(f.count)]
        row[f.name] = numbers if f.count > 1 else numbers[0]
    return row


def cut(word: int, high: int, low: int, form: str) -> list[int]:
    """The numbers of a field by its map: the format says how many there are and whether they are signed."""
    count, _, one = form.rpartition(" × ")
    numbers, width = int(count or 1), high - low + 1
    size, bits = width // numbers, word >> low & (1 << width) - 1
    assert width == size * numbers
    found = [bits >> size * number & (1 << size) - 1 for number in range(numbers)]
    signed = one.startswith(("s", "SQ"))
    return [number - (1 << size) if signed and number >> size - 1 else number for number in found]


def table_rows(text: str) -> list[list[str]]:
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    rows = [[cell.strip().strip("`") for cell in line.strip("|").split(" | ")] for line in lines]
    return [row for row in rows if row[0] != "---" and "bits" not in row[0]]


def span(text: str) -> tuple[int, int]:
    high, _, low = text.strip("[]").partition(":")
    return int(high), int(low or high)


def from_page(one: Export, stream: str) -> Map:
    """The map in the page beside the Verilog."""
    text = (one.folder / f"{one.top}_streams.md").read_text()
    part = next(part for part in text.split("\n## ")[1:] if f"`{stream}__payload[" in part.splitlines()[0])
    return {name: (*span(bits), form) for bits, name, form, _ in table_rows(part)}


def from_comments(one: Export, stream: str) -> Map:
    """The map in the comments at the head of the Verilog."""
    lines = (one.folder / f"{one.top}.v").read_text().partition("\nmodule ")[0].splitlines()
    start = next(place for place, line in enumerate(lines) if re.match(rf"// {stream}(\[.*\])?: \w+ stream", line))
    found: Map = {}
    for line in lines[start + 1:]:
        if re.match(r"// \w", line):
            break
        if match := re.match(r"//\s+(\[\d+(?::\d+)?\])\s+(\w+)\s+(\d+ × \S+|\S+)", line):
            found[match[2]] = (*span(match[1]), match[3])
    return found


def from_json(one: Export, stream: str) -> Map:
    """The map in the description for scripts."""
    said = json.loads(one.description.read_text())["streams"]
    fields = next(entry["fields"] for entry in said if entry["name"] == stream)
    return {f["name"]: (f["high"], f["low"], f["format"]) for f in fields}


READERS: tuple[Callable[[Export, str], Map], ...] = (from_page, from_comments, from_json)
EXPORTED = [("tile_merge_unit", "groups", "TileGroup"), ("line_buffer", "sink", "ChunkItem"),
            ("splat_fetch", "entries", "ArraySplat"), ("pixel_writer", "rows", "PixelRow"),
            ("table_loader", "reads", "ReadRequest")]


@pytest.fixture(scope="module")
def exports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Export]:
    return {unit: export(TINY, tmp_path_factory.mktemp(unit), unit) for unit, _, _ in EXPORTED}


@pytest.mark.parametrize("read", READERS, ids=lambda read: read.__name__)
@pytest.mark.parametrize(("unit", "stream", "name"), EXPORTED)
def test_a_map_cuts_a_packed_record_into_its_fields(
    unit: str, stream: str, name: str, read: Callable[[Export, str], Map], exports: dict[str, Export],
) -> None:
    record, found = record_named(name, TINY, 0), read(exports[unit], stream)
    assert list(found) == [f.name for f in record.fields]
    for seed in range(20):
        row = known_row(record, seed)
        word = record.pack(row)
        for field, (high, low, form) in found.items():
            assert cut(word, high, low, form) == np.atleast_1d(row[field]).tolist(), (field, seed)


@pytest.mark.parametrize("config", [TINY, PAPER, TINY.with_(stereo=True)], ids=lambda config: f"{config.name} {config.stereo}")
@pytest.mark.parametrize("unit", [name for name in UNITS if name != TOP])
def test_maps_of_every_unit(unit: str, config: AcceleratorConfig) -> None:
    """A map leaves no bit out, no two fields overlap, and its formats are those of the record, in number and width."""
    for stream in stream_ports(UNITS[unit].make(config), config):
        assert stream.fields, f"{unit}.{stream.name}"
        assert [f.low for f in stream.fields] == [0, *np.cumsum([f.width for f in stream.fields])[:-1].tolist()]
        assert sum(f.width for f in stream.fields) == stream.bits
        if stream.record and not (unit == "warp_unit" and not config.stereo):
            record = record_named(stream.record, config, stream.bits)
            row = known_row(record, 1)
            for f, of in zip(stream.fields, record.fields, strict=True):
                assert cut(record.pack(row), f.low + f.width - 1, f.low, f.format) == np.atleast_1d(row[of.name]).tolist()
                assert ("SQ" in f.format) == (isinstance(of.format, Fixed) and of.format.signed)


@pytest.mark.parametrize("unit", ["tile_merge_unit", "axi_master", "collect"])
def test_streams_are_the_ports_of_the_verilog(unit: str) -> None:
    """Names, directions and widths are those of the emitted module."""
    component = UNITS[unit].make(TINY)
    text = to_rtlil(component, unit).partition(f"module \\{unit}\n")[2].partition("\nend\n")[0]
    ports = {name: (way, int(width)) for width, way, name in re.findall(r"wire width (\d+) (input|output) \d+ +\\(\S+)", text)}
    streams = stream_ports(component, TINY)
    assert {f"{one.name}__payload": (one.way, one.bits) for one in streams} == {
        name: port for name, port in ports.items() if name.endswith("__payload")}
    for one in streams:
        back = {"input": "output", "output": "input"}[one.way]
        assert ports[f"{one.name}__valid"] == (one.way, 1) and ports[f"{one.name}__ready"] == (back, 1)


def test_a_layout_without_a_record_has_integers() -> None:
    """Against Amaranth's own packing."""
    layout = data.StructLayout({"first": data.ArrayLayout(signed(5), 3),
                                "second": 7, "third": data.StructLayout({"a": 1, "b": 2})})
    fields = fields_of(layout, [])
    assert [(f.name, f.span, f.format) for f in fields] == [("first", "14:0", "3 × s5"), ("second", "21:15", "u7"),
                                                            ("third", "24:22", "u3")]
    word = layout.const({"first": [-16, 15, -1], "second": 100, "third": {"a": 1, "b": 2}}).as_bits()
    values = [cut(word, f.low + f.width - 1, f.low, f.format) for f in fields]
    assert values == [[-16, 15, -1], [100], [5]]
    assert integer_format(unsigned(3)) == "u3" and fields_of(unsigned(3), []) == ()


def test_a_unit_without_streams_has_no_page(tmp_path: Path) -> None:
    one = export(TINY, tmp_path, "float_sqrt")
    assert one.documents == () and not list(tmp_path.glob("*.md"))
    assert json.loads(one.description.read_text())["streams"] == []


def test_a_stream_that_is_a_keyword_keeps_the_name_of_its_port() -> None:
    component = UNITS["tile_merge_unit"].make(TINY)
    renamed = stream_ports(component, TINY, names={"hits__payload": "hits___payload"})
    assert renamed[0].name == "hits_" and isinstance(renamed[0], StreamPort)


def test_the_page_of_the_documents_is_not_stale() -> None:
    text = (ROOT / "docs" / "streams.md").read_text(encoding="utf-8")
    assert text == streams_document.page(), "run `python -m msv2.document`"


def test_every_link_of_the_page_has_its_heading() -> None:
    text = streams_document.page()
    links = set(re.findall(r"\]\(#([\w.-]+)\)", text))
    headings = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in re.findall(r"(?m)^### (.*)$", text)}
    assert links == headings and len(headings) > 15
