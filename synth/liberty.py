"""Cell libraries: merges the liberty files of a technology into one and keeps only the cells and groups that the flow uses."""

from __future__ import annotations

import gzip
import importlib
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from spec.errors import InputError

PDK_VARIABLE = "MSV2_PDK"
UNUSED = ("internal_power", "leakage_power", "normalized_driver_waveform")


@dataclass(frozen=True)
class Technology:
    """A standard-cell library and what the flow must know of it.

    Attributes:
        name: the name that a user gives; a path for a library that is not in TECHNOLOGIES.
        node: the process node as it appears in reports.
        files: liberty files below the folder MSV2_PDK, plain or gzipped.
        cell_list: name of the list of permitted cells; areas can be compared only under the same list.
        excluded: cells that are never used (a regular expression that matches the whole name).
        flop: the flip-flop; the smallest if there are several.
        clock_gate: cell, and its pins for enable, clock, gated clock and test (None if it has no test pin). If the whole is
            None, enables become multiplexers.
        full_adder: cell, and its pins for A, B, carry in, carry out and sum. None leaves the sums to Yosys.
        adder_inverts: the adder's carry and sum are complemented.
        tie_high, tie_low: cells that drive constants, and their pin; None leaves constants in the netlist.
        inverter: cell that is assumed to drive the inputs of the logic between adders.
        gates: cell and input pins for the gates of incremented blocks; every cell drives Y. ABC builds the gates that are
            absent.
        broadcast_buffer: buffer, and its input and output pin, for nets that feed many cores.
        driver: cell and output pin that are assumed to drive the unit's inputs.
        load: load of the unit's outputs, in the liberty's unit of capacitance.
        gate_load_ff: load in fF that ABC assumes at its outputs: one pin of a full adder.
        time_unit_ps: time unit of the liberty file in ps.
        drive_ff: the most that a cell of size 1 should drive in fF; larger sizes drive as much more (`synth.sizing`). None
            leaves sizes as ABC chooses them.
        delay: delay of its gates relative to ASAP7, for estimates of the time at which a sum is ready (`synth.heap`).
        elsewhere: further folders to search for the files if MSV2_PDK does not have them.
        package: module and class by which the Python package lambdapdk knows the library.
    """

    name: str
    node: str
    files: tuple[str, ...]
    cell_list: str
    excluded: str
    flop: str
    clock_gate: tuple[str, str, str, str, str | None] | None
    full_adder: tuple[str, tuple[str, str, str, str, str]] | None
    adder_inverts: bool
    tie_high: tuple[str, str] | None
    tie_low: tuple[str, str] | None
    inverter: str
    gates: dict[str, tuple[str, tuple[str, ...]]]
    broadcast_buffer: tuple[str, str, str]
    driver: tuple[str, str]
    load: float
    gate_load_ff: float
    time_unit_ps: float
    drive_ff: float | None = None
    delay: float = 1.0
    elsewhere: tuple[str, ...] = ()
    package: tuple[str, str] | None = None


ASAP7 = Technology(
    name="asap7",
    node="ASAP7 7.5-track RVT, TT 0.70 V 25 C",
    files=tuple(f"asap7/asap7sc7p5t_{group}_RVT_TT_nldm.lib" for group in ("SIMPLE", "INVBUF", "AO", "OA", "SEQ")),
    cell_list="strict: without *xp*, HB*, CKINV*; flops DFFHQNx1",
    # Of the sequential cells only one flip-flop and one clock gate remain; the flow uses these two by name.
    excluded=r".*xp.*|HB.*|CKINV.*|(?!DFFHQNx1_)S?DFF?[HL].*|D[HL]Lx.*|DFFAS.*|(?!ICGx1_)ICG.*",
    flop="DFFHQNx1_ASAP7_75t_R",
    clock_gate=("ICGx1_ASAP7_75t_R", "ENA", "CLK", "GCLK", "SE"),
    full_adder=("FAx1_ASAP7_75t_R", ("A", "B", "CI", "CON", "SN")),
    adder_inverts=True,
    tie_high=("TIEHIx1_ASAP7_75t_R", "H"),
    tie_low=("TIELOx1_ASAP7_75t_R", "L"),
    inverter="INVx1_ASAP7_75t_R",
    gates={
        **{f"AND{n}": (f"AND{n}x{2 if n == 2 else 1}_ASAP7_75t_R", tuple("ABCDE"[:n])) for n in (2, 3, 4, 5)},
        "XOR2": ("XOR2x2_ASAP7_75t_R", ("A", "B")),
        "AO21": ("AO21x1_ASAP7_75t_R", ("A1", "A2", "B")),
    },
    broadcast_buffer=("BUFx5_ASAP7_75t_R", "A", "Y"),
    driver=("DFFHQNx1_ASAP7_75t_R", "QN"),
    load=2.0,
    gate_load_ff=1.6,
    time_unit_ps=1.0,
    drive_ff=8.0,
    package=("lambdapdk.asap7.libs.asap7sc7p5t", "ASAP7SC7p5RVT"),
)

@dataclass(frozen=True)
class Library:
    """A library with a known file; its cells are found by `synth.discover`. The attributes are those of `Technology`."""

    node: str
    file: str
    delay: float = 1.0
    excluded: str = r"(?!)"
    elsewhere: tuple[str, ...] = ()
    package: tuple[str, str] | None = None


LIBRARIES = {
    "nangate45": Library(
        "Nangate45 open cell library, typical 1.10 V 25 C", "nangate45/nangate45_typ.lib", 1.86 / 0.48,
        package=("lambdapdk.freepdk45.libs.nangate45", "Nangate45")),
    "osu018": Library(
        "OSU 0.18 um standard cells, typical 1.8 V 25 C", "osu018/osu018_stdcells.lib", 11.8 / 0.48,
        r"CLKBUF.*|TBUF.*|DFFNEG.*",
        elsewhere=("/usr/share/qflow/tech",)),
}


def find_files(technology: Technology | Library) -> list[Path]:
    """The liberty files, searched below MSV2_PDK, in the folders of a system package, and in the Python package lambdapdk.

    Raises:
        InputError: one of the files is in none of these places.
    """
    names = (technology.file,) if isinstance(technology, Library) else technology.files
    variable = os.environ.get(PDK_VARIABLE)
    missing = ""
    for folder in [*([variable] if variable else []), *technology.elsewhere]:
        found = [next((p for p in (Path(folder, name), Path(folder, name + ".gz")) if p.is_file()), None) for name in names]
        if None not in found:
            return found
        missing = missing or f"{names[found.index(None)]} or {names[found.index(None)]}.gz, not so in {folder!r}"
    if variable:
        raise InputError(f"{PDK_VARIABLE} must hold {missing}")
    return _from_package(technology, names)


def _from_package(technology: Technology | Library, names: Sequence[str]) -> list[Path]:
    """The files that lambdapdk has or downloads."""
    lacks = (f"{PDK_VARIABLE} must name the folder of the liberty files ({names[0].split('/')[0]}/...); it is not set. "
             "Without one, TECH=generic reports NAND2 equivalents")
    if technology.package is None:
        raise InputError(lacks)
    module, kind = technology.package
    try:
        library = getattr(importlib.import_module(module), kind)()
    except ImportError:
        raise InputError(f"{lacks}; the Python package lambdapdk, which downloads them, is not installed") from None
    try:
        offered = [Path(path) for fileset in library.getkeys("fileset") if fileset.startswith("models.timing")
                   for path in library.get_file(fileset=fileset)]
    except Exception as error:  # depends on what the download uses
        raise InputError(f"{lacks}; lambdapdk cannot download them: {error}") from None
    found = []
    for name in names:
        stem = Path(name).stem
        path = next((p for p in offered if p.name.split(".")[0] in (stem, _PACKAGED.get(stem))), None)
        if path is None or not path.is_file():
            raise InputError(f"{lacks}; lambdapdk has no {name}")
        found.append(path)
    return found


_PACKAGED = {"nangate45_typ": "NangateOpenCellLibrary_typical"}
"""Names in lambdapdk of files that have another name here."""


def merge(technology: Technology, output: Path) -> Path:
    """Write one liberty file with the permitted cells of all files of the technology, without power groups."""
    if output.exists():
        return output
    parts = [kept_lines(path, re.compile(technology.excluded), first=i == 0) for i, path in enumerate(find_files(technology))]
    return write_lines(output, parts)


def write_lines(output: Path, parts: Sequence[Sequence[str]]) -> Path:
    """Write the lines of some libraries as one liberty file; `output` appears only when it is complete."""
    output.parent.mkdir(parents=True, exist_ok=True)
    scratch = output.with_suffix(f".{os.getpid()}.tmp")
    scratch.write_text("".join(line for part in parts for line in part) + "}\n")
    scratch.replace(output)
    return output


def kept_lines(path: Path, excluded: re.Pattern, first: bool) -> list[str]:
    """The lines to keep of a library, without its last brace: templates, permitted cells, and the header if it is the first."""
    opened = gzip.open(path, "rt") if path.suffix == ".gz" else open(path)
    lines, depth, skip_from = [], 0, None
    with opened as text:
        for line in text:
            if skip_from is None:
                group = re.match(r"\s*(\w+)\s*\((.*?)\)\s*\{", line)
                kind, name = (group[1], group[2].strip('" ')) if group else (None, "")
                wanted = depth > 1 or first or line.strip() == "}" or kind in ("cell", "lu_table_template")
                if kind in UNUSED or (kind == "cell" and excluded.fullmatch(name)) or (kind and depth == 1 and not wanted):
                    skip_from = depth
            depth_after = depth + line.count("{") - line.count("}")
            if skip_from is None and wanted and depth_after > 0:
                lines.append(line)
            if depth_after == skip_from:
                skip_from = None
            depth = depth_after
    return lines
