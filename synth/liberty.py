"""Cell libraries: the liberty files of a technology merged into one, cut down to the cells and groups the flow uses."""

from __future__ import annotations

import gzip
import os
import re
from dataclasses import dataclass
from pathlib import Path

from spec.errors import InputError

PDK_VARIABLE = "MSV2_PDK"
UNUSED = ("internal_power", "leakage_power", "normalized_driver_waveform")


@dataclass(frozen=True)
class Technology:
    """A standard-cell library and what the flow must know of it.

    Attributes:
        node: process node as reported.
        files: liberty files below the folder MSV2_PDK, plain or gzipped.
        cell_list: name of the cell list, for areas compare under one list only.
        excluded: cells never used (regular expression on the whole name).
        flop, clock_gate, full_adder, tie_high, tie_low, inverter: cells named by the flow.
        gates: cell and input pins of the gates of incremented blocks; all drive Y.
        broadcast_buffer: buffer (pins A, Y) of nets that feed many cores.
        driver: cell that is assumed to drive the unit's inputs.
        load_ff: load of the unit's outputs, in the liberty's capacitive unit.
    """

    node: str
    files: tuple[str, ...]
    cell_list: str
    excluded: str
    flop: str
    clock_gate: str
    full_adder: str
    tie_high: str
    tie_low: str
    inverter: str
    gates: dict[str, tuple[str, tuple[str, ...]]]
    broadcast_buffer: str
    driver: str
    load_ff: float


ASAP7 = Technology(
    node="ASAP7 7.5-track RVT, TT 0.70 V 25 C",
    files=tuple(f"asap7/asap7sc7p5t_{group}_RVT_TT_nldm.lib" for group in ("SIMPLE", "INVBUF", "AO", "OA", "SEQ")),
    cell_list="strict: without *xp*, HB*, CKINV*; flops DFFHQNx1",
    # All but the one flop and the clock gate of the sequential cells: the flow names these two itself.
    excluded=r".*xp.*|HB.*|CKINV.*|(?!DFFHQNx1_)S?DFF?[HL].*|D[HL]Lx.*|DFFAS.*|(?!ICGx1_)ICG.*",
    flop="DFFHQNx1_ASAP7_75t_R",
    clock_gate="ICGx1_ASAP7_75t_R",
    full_adder="FAx1_ASAP7_75t_R",
    tie_high="TIEHIx1_ASAP7_75t_R",
    tie_low="TIELOx1_ASAP7_75t_R",
    inverter="INVx1_ASAP7_75t_R",
    gates={
        **{f"AND{n}": (f"AND{n}x{2 if n == 2 else 1}_ASAP7_75t_R", tuple("ABCDE"[:n])) for n in (2, 3, 4, 5)},
        "XOR2": ("XOR2x2_ASAP7_75t_R", ("A", "B")),
        "AO21": ("AO21x1_ASAP7_75t_R", ("A1", "A2", "B")),
    },
    broadcast_buffer="BUFx5_ASAP7_75t_R",
    driver="DFFHQNx1_ASAP7_75t_R",
    load_ff=2.0,
)


def find_files(technology: Technology) -> list[Path]:
    """The technology's liberty files; InputError where the folder or one of them is absent."""
    folder = os.environ.get(PDK_VARIABLE)
    if not folder:
        raise InputError(f"{PDK_VARIABLE} must name the folder of the liberty files (asap7/...); it is not set. "
                         "Without one, TECH=generic reports NAND2 equivalents")
    paths = []
    for name in technology.files:
        path = next((p for p in (Path(folder, name), Path(folder, name + ".gz")) if p.is_file()), None)
        if path is None:
            raise InputError(f"{PDK_VARIABLE} must hold {name} or {name}.gz, not so in {folder!r}")
        paths.append(path)
    return paths


def merge(technology: Technology, output: Path) -> Path:
    """Write the cells in use of all the technology's files, without power groups, as one liberty file."""
    if output.exists():
        return output
    parts = [_kept_lines(path, re.compile(technology.excluded), first=i == 0) for i, path in enumerate(find_files(technology))]
    output.parent.mkdir(parents=True, exist_ok=True)
    scratch = output.with_suffix(f".{os.getpid()}.tmp")
    scratch.write_text("".join(line for part in parts for line in part) + "}\n")
    scratch.replace(output)
    return output


def _kept_lines(path: Path, excluded: re.Pattern, first: bool) -> list[str]:
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
