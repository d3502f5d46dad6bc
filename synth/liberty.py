"""Cell libraries: the liberty files of a technology merged into one, cut down to the cells and groups the flow uses."""

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
        name: as a user gives it; a path for a library that is not one of TECHNOLOGIES.
        node: process node as reported.
        files: liberty files below the folder MSV2_PDK, plain or gzipped.
        cell_list: name of the cell list, for areas compare under one list only.
        excluded: cells never used (regular expression on the whole name).
        flop: the flip-flop, or the smallest of several.
        clock_gate: cell and its pins for enable, clock, gated clock and test (None: has none); None: enables stay multiplexers.
        full_adder: cell and its pins A, B, CI, carry, sum; None: Yosys makes the sums.
        adder_inverts: carry and sum are complemented.
        tie_high, tie_low: cells of constants and their pin; None: constants stay.
        inverter: cell assumed to drive the inputs of logic between adders.
        gates: cell and input pins of the gates of incremented blocks; all drive Y. Those that are absent are left to ABC.
        broadcast_buffer: buffer and its pins of nets that feed many cores.
        driver: cell and output that are assumed to drive the unit's inputs.
        load: load of the unit's outputs, in the liberty's capacitive unit.
        gate_load_ff: load that ABC assumes at its outputs: a full adder's pin.
        time_unit_ps: the liberty's time unit.
        delay: how much slower than ASAP7 its gates are, for estimates of when a sum is there (`synth.heap`).
        elsewhere: folders of the same files where MSV2_PDK has none.
        package: how the Python package lambdapdk names the library: module and class.
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
    delay: float = 1.0
    elsewhere: tuple[str, ...] = ()
    package: tuple[str, str] | None = None


ASAP7 = Technology(
    name="asap7",
    node="ASAP7 7.5-track RVT, TT 0.70 V 25 C",
    files=tuple(f"asap7/asap7sc7p5t_{group}_RVT_TT_nldm.lib" for group in ("SIMPLE", "INVBUF", "AO", "OA", "SEQ")),
    cell_list="strict: without *xp*, HB*, CKINV*; flops DFFHQNx1",
    # All but the one flop and the clock gate of the sequential cells: the flow names these two itself.
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
    package=("lambdapdk.asap7.libs.asap7sc7p5t", "ASAP7SC7p5RVT"),
)

@dataclass(frozen=True)
class Library:
    """A known library whose cells are found in its liberty file (`synth.discover`)."""

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
    """The liberty files: below MSV2_PDK, where a package of the system puts them, or from the Python package lambdapdk.

    Raises:
        InputError: one of them is in none of these.
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
    """The files as lambdapdk has them or downloads them."""
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
    except Exception as error:  # of whatever the download makes use
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
"""Names of the same files in lambdapdk, where others."""


def merge(technology: Technology, output: Path) -> Path:
    """Write the cells in use of all the technology's files, without power groups, as one liberty file."""
    if output.exists():
        return output
    parts = [kept_lines(path, re.compile(technology.excluded), first=i == 0) for i, path in enumerate(find_files(technology))]
    return write_lines(output, parts)


def write_lines(output: Path, parts: Sequence[Sequence[str]]) -> Path:
    """One liberty file of the libraries' lines, whole or not at all."""
    output.parent.mkdir(parents=True, exist_ok=True)
    scratch = output.with_suffix(f".{os.getpid()}.tmp")
    scratch.write_text("".join(line for part in parts for line in part) + "}\n")
    scratch.replace(output)
    return output


def kept_lines(path: Path, excluded: re.Pattern, first: bool) -> list[str]:
    """Lines of one library: its header if it is the first, its templates and cells, without the library's last brace."""
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
