"""docs/formats.md: the formats, records, constants, tables and configurations as they are.

The page quotes the docstrings, so that each format, field or constant is explained once, where it is defined.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np

from msv2.document.text import attribute_docs, doc_of, listed_docs, number, one_line, table
from spec import (
    chunks,
    compact,
    constants,
    formats,
    guard_band,
    harmonics,
    joint,
    joint_warp,
    memory,
    packed,
    queues,
    records,
    stereo,
    supertiles,
    tables,
)
from spec.config import CONFIGS, DEFAULT, PAPER, V3, V3_RECORDS, AcceleratorConfig, NumberFormats
from spec.formats import Fixed, Format, SmallFloat
from spec.paths import DOCS


def format_range(f: Format) -> tuple[str, str]:
    """The range of a format, and the distance between neighbouring numbers."""
    if isinstance(f, SmallFloat):
        low = f"0, ±{f.min:.4g}..±{f.max:.4g}" if f.signed else f"0, {f.min:.4g}..{f.max:.4g}"
        return low, f"2^-{f.sig_bits - 1}, relative"
    low, high = (float(f.to_float(raw)) for raw in (f.raw_min, f.raw_max))
    return f"{number(low)}..{number(high)}", f"2^-{f.frac_bits}" if f.frac_bits else "1"


def formats_section() -> list[str]:
    """Every number format with its docstring."""
    docs, standard = attribute_docs(inspect.getsource(NumberFormats)), NumberFormats()
    rows, others = [], []
    for f in dataclasses.fields(NumberFormats):
        value = getattr(standard, f.name)
        if isinstance(value, Format):
            rows.append([f"`{f.name}`", str(value), value.width, *format_range(value), docs[f.name]])
        else:
            others.append([f"`{f.name}`", value, docs[f.name]])
    return [
        "## Number formats", "", doc_of(formats), "", doc_of(NumberFormats), "",
        *table(("name", "format", "bits", "range", "step", "what for"), rows),
        *table(("parameter", "value", "what for"), others)]


def field_format(f: records.Field) -> str:
    """The format of a field's numbers; plain unsigned integers as uN."""
    plain = isinstance(f.format, Fixed) and not f.format.signed and f.format.frac_bits == 0
    one = f"u{f.format.width}" if plain else str(f.format)
    return f"{f.count} × {one}" if f.count > 1 else one


def record_section(make: Callable[[AcceleratorConfig], records.Record], config: AcceleratorConfig = PAPER) -> list[str]:
    """One record field by field, lowest bits first."""
    record = make(config)
    rows, offset = [], 0
    for f in record.fields:
        rows.append([f"{offset + f.width - 1}:{offset}", f"`{f.name}`", field_format(f), one_line(f.doc)])
        offset += f.width
    return [
        f"### {record.name}: {record.width} bits", "", one_line(record.doc), "",
        *table(("bits", "field", "format", "holds"), rows)]


def guard_band_section() -> list[str]:
    """Where projected means may lie."""
    return ["## Guard band", "", doc_of(guard_band), ""]


def chunks_section() -> list[str]:
    """The records of chunks and of compact Gaussians."""
    lines = ["## Chunks", "", doc_of(chunks), "", "## Compact records", "", doc_of(compact), "",
             "## Records of machines with chunks", "", f"Layouts are those of `{V3_RECORDS.name}`.", ""]
    for make in (*chunks.CHUNK_RECORDS, *compact.COMPACT_RECORDS):
        lines += record_section(make, V3_RECORDS)
    return [*lines, *_added_fields(PAPER.with_(order="spatial", chunks=True))]


def packed_section() -> list[str]:
    """What packed frames are, and their records."""
    lines = ["## Packed frames", "", doc_of(packed), "", "Errors of a block:", "",
             *table(("number", "name", "meaning"), ([error.value, f"`{error.name}`", doc] for error, doc in zip(
                 packed.PackedError, attribute_docs(inspect.getsource(packed.PackedError)).values(), strict=True))),
             "## Records of packed frames", ""]
    for make in packed.PACKED_RECORDS:
        lines += record_section(make)
    return lines


def layout(make: Callable[[AcceleratorConfig], records.Record], config: AcceleratorConfig) -> list[tuple[str, int]]:
    """Names and bits of a record's fields."""
    return [(f.name, f.width) for f in make(config).fields]


def supertiles_section() -> list[str]:
    """What lists by super-tile are, and the records that only machines with them have, or have otherwise."""
    lines = ["## Super-tiles", "", doc_of(supertiles), "", "## Records of machines with super-tiles", "",
             f"Layouts are those of `{V3.name}`. Records of other machines stand here if their fields differ.", ""]
    for make in (*supertiles.SUPERTILE_RECORDS, records.list_group):
        lines += record_section(make, V3)
    for make in (*records.RECORDS, *memory.MEMORY_RECORDS, *chunks.CHUNK_RECORDS):
        if layout(make, V3) != layout(make, V3_RECORDS):
            lines += record_section(make, V3)
    return lines


def joint_section() -> list[str]:
    """Frames of two eyes on machines with super-tiles; no record of theirs exists yet."""
    return ["## Joint frames", "", doc_of(joint), "", "### Joint frames with a warped target", "", doc_of(joint_warp), ""]


def stereo_section() -> list[str]:
    """The fields and records that only machines with stereo have."""
    return ["## Records of machines with stereo", "", f"Layouts are those of `{PAPER.name}` with `stereo`.", "",
            *_added_fields(PAPER.with_(stereo=True))]


def _added_fields(config: AcceleratorConfig) -> list[str]:
    """What the records of this machine have behind the fields of PAPER's."""
    lines = []
    for make in (*records.RECORDS, *memory.MEMORY_RECORDS):
        plain, record = make(PAPER), make(config)
        added = record.fields[len(plain.fields):]
        if record.fields[: len(plain.fields)] != plain.fields:
            raise ValueError(f"{record.name} must begin with the fields of {PAPER.name}, not {record.fields!r}")
        if added:
            offset, rows = plain.width, []
            for f in added:
                rows.append([f"{offset + f.width - 1}:{offset}", f"`{f.name}`", field_format(f), one_line(f.doc)])
                offset += f.width
            lines += [f"### {record.name}, besides: {record.width} bits in all", "",
                      *table(("bits", "field", "format", "holds"), rows)]
    return lines


def records_section() -> list[str]:
    """Every record, and a table of the widths that depend on a parameter."""
    lines = ["## Records", "", "Field 0 sits in the lowest bits; the numbers of one field follow each other upwards. "
             f"Layouts are those of `{PAPER.name}` and of SH degree 3.", ""]
    for make in (*records.RECORDS, *memory.MEMORY_RECORDS):
        lines += record_section(make)
    colour = [[degree, records.gaussian_colour(PAPER, degree).width] for degree in range(4)]
    widths = [[f"`{make(PAPER).name}`", *(make(c).width for c in CONFIGS.values())]
              for make in (*records.RECORDS, *memory.MEMORY_RECORDS)]
    return [*lines, "### Widths in bits", "", *table(("record", *CONFIGS), widths),
            *table(("SH degree", "bits of GaussianColour"), colour)]


def constants_section() -> list[str]:
    """Constants with their values and derivations, then the integers derived from them."""
    lines = ["## Constants", ""]
    for module in (constants, harmonics, tables, records, memory, chunks, compact, supertiles, joint, joint_warp, packed,
                   stereo, queues):
        rows = [[f"`{name}`", _values(getattr(module, name)), doc] for name, doc in _module_docs(module).items()]
        lines += [f"`{module.__name__}`", "", *table(("name", "value", "derivation"), rows)]
    n = DEFAULT.formats
    derived = (
        (tables.log2_alpha_min, tables.log2_alpha_min(n), n.cut),
        (tables.support_exponent, tables.support_exponent(DEFAULT), n.cut),
        (tables.alpha_max_l1, tables.alpha_max_l1(n), n.alpha),
        (tables.t_stop, tables.t_stop(n), n.transmittance),
        (stereo.background_transmittance, stereo.background_transmittance(n), n.transmittance),
        (stereo.solid_transmittance, stereo.solid_transmittance(n), n.transmittance))
    rows = [[f"`{f.__name__}`", raw, number(raw / (1 << q.frac_bits)), one_line(doc_of(f))] for f, raw, q in derived]
    return [*lines, "As integers of the array:", "", *table(("name", "raw", "value", "meaning"), rows)]


def _module_docs(module: ModuleType) -> dict[str, str]:
    """The docstrings of a module's numbers, by name."""
    docs = attribute_docs(inspect.getsource(module))
    return {name: doc for name, doc in docs.items() if _is_numbers(getattr(module, name, None))}


def _is_numbers(value: object) -> bool:
    """Whether it is a number, or a tuple of numbers."""
    values = value if isinstance(value, tuple) else (value,)
    return all(isinstance(x, int | float) and not isinstance(x, bool) for x in values)


_MOST_VALUES = 64
"""Numbers of a constant that the page shows; of longer tables it shows the first and the last ones."""


def _values(value: float | tuple[float, ...]) -> str:
    if not isinstance(value, tuple):
        return number(value)
    if len(value) > _MOST_VALUES:
        return f"{_values(value[:4])}, ..., {_values(value[-4:])} ({len(value)} numbers)"
    return ", ".join(map(number, value))


def tables_section() -> list[str]:
    """The contents of the ROMs."""
    n = DEFAULT.formats
    base, slope = tables.exp2_segments(n)
    one = 1 << n.cut.frac_bits
    segment, rest = np.divmod(np.arange(one), one // len(base))
    mantissa = base[segment] + (slope[segment] * rest >> tables.EXP2_SLOPE_FRAC + n.cut.frac_bits - n.alpha.frac_bits)
    exact = np.exp2(np.arange(one) / one)
    worst = max(np.abs(n.alpha.to_float(-(-mantissa >> i)) - exact / 2**i).max() for i in range(1, 9))
    smooth = tables.smoothstep_table(n).reshape(-1, 16)
    return [
        "## Tables", "", "### exp2_segments", "", one_line(doc_of(tables.exp2_segments)), "",
        f"Largest error of an alpha below 1, its shift included: {worst * 255:.2g}/255.", "",
        *table(("segment", "base", "slope"), ([s, *pair] for s, pair in enumerate(zip(base, slope, strict=True)))),
        "### smoothstep_table", "", one_line(doc_of(tables.smoothstep_table)), "",
        *table(("index", *range(16)), ([f"{16 * i}..", *row] for i, row in enumerate(smooth)))]


def configurations_section() -> list[str]:
    """The configurations side by side."""
    docs = listed_docs(doc_of(AcceleratorConfig))
    properties = [name for name, value in vars(AcceleratorConfig).items() if isinstance(value, property)]
    docs |= {name: one_line(doc_of(getattr(AcceleratorConfig, name))) for name in properties}
    names = [f.name for f in dataclasses.fields(AcceleratorConfig) if f.name not in ("name", "formats")]
    rows = [[f"`{name}`", *(getattr(c, name) for c in CONFIGS.values()), docs[name]] for name in [*names, *properties]]
    standard = NumberFormats()
    changed = [[f"`{f.name}` {getattr(c.formats, f.name)}" for f in dataclasses.fields(NumberFormats)
                if getattr(c.formats, f.name) != getattr(standard, f.name)] for c in CONFIGS.values()]
    rows.append(["`formats`", *(f"but {'; '.join(names)}" if names else "as above" for names in changed), docs["formats"]])
    return ["## Configurations", "", *table(("parameter", *CONFIGS, "what for"), rows)]


def page() -> str:
    """The whole page."""
    lines = ["# Formats", "", "Generated by `python -m msv2.document` from `spec/`; a test fails when it is stale.", ""]
    for section in (formats_section, guard_band_section, records_section, chunks_section, supertiles_section, joint_section,
                    packed_section, stereo_section, constants_section, tables_section, configurations_section):
        lines += section()
    return "\n".join(lines).rstrip() + "\n"


PAGES: dict[Path, Callable[[], str]] = {DOCS / "formats.md": page}
"""What is generated, by path."""
