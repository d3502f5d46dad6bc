"""A unit of a machine as files for other projects: modules, memories, file lists, lint waivers, documents of the registers."""

from __future__ import annotations

import json
import re
import textwrap
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from msv2.document.files import write_whole
from msv2.document.registers import MAKERS
from msv2.verilog.lint import control_file
from msv2.verilog.modules import Exported, exported
from msv2.verilog.streams import as_json, streams_page
from rtl.units import TOP, UNITS, stage_of
from spec.config import AcceleratorConfig
from spec.errors import InputError
from spec.overrides import config_record

MEMORIES = "memories"
"""Folder of the memories' models, below that of the export."""

_LINE, _WIDTH = "// ", 117


@dataclass(frozen=True)
class Export:
    """What was written.

    Attributes:
        folder: where all paths start.
        top: name of the unit's module.
        files: file list of everything that a simulator compiles; with `logic` and `memories` in its place, either alone.
        logic, memories: file lists of the logic and of the memories' models.
        waivers: Verilator's control file.
        description: JSON with configuration, ports, streams, modules and memories.
        documents: pages and other documents: the streams of a unit that has some, the registers of the whole machine.
    """

    folder: Path
    top: str
    files: Path
    logic: Path
    memories: Path
    waivers: Path
    description: Path
    documents: tuple[Path, ...]


def default_prefix(config: AcceleratorConfig) -> str:
    """What modules of a configuration begin with: its name, and whether it is a machine for two eyes."""
    return f"{config.name}_{'stereo_' if config.stereo else ''}"


def export(config: AcceleratorConfig, out_dir: Path | str, unit: str = TOP, prefix: str | None = None) -> Export:
    """Writes a unit as Verilog into a folder, one file a module; the same input gives the same bytes.

    Args:
        config: the machine.
        out_dir: the folder; made where it does not exist. Exports with different prefixes may share one.
        unit: a name of `rtl.units`.
        prefix: what every module's name begins with; without it, `default_prefix`.

    Raises:
        InputError: an unknown unit, a prefix that begins no identifier, or a folder that is a file.
    """
    folder, prefix = Path(out_dir), default_prefix(config) if prefix is None else prefix
    if not re.fullmatch(r"([A-Za-z_]\w*)?", prefix, re.ASCII):
        raise InputError(f"prefix {prefix!r} is not accepted: letters, digits and _ are, and no digit first")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"out {str(folder)!r} is a file: a folder is wanted")
    found = exported(unit, config, prefix)
    origin = f"Unit {unit} of configuration {config.name}{' for two eyes' if config.stereo else ''}."
    logic = {f"{name}.v": _headed(text, origin, found.notes if name == found.top else ()) for name, text in found.logic.items()}
    models = {f"{MEMORIES}/{name}.v": _headed(text, origin, ()) for name, text in found.models.items()}
    texts = {**models, **logic}
    names = {"files": f"{found.top}.f", "logic": f"{found.top}_logic.f", "memories": f"{found.top}_memories.f",
             "waivers": f"{found.top}.vlt", "description": f"{found.top}.json"}
    texts |= {names["files"]: _listed([*models, *logic]), names["logic"]: _listed(logic), names["memories"]: _listed(models),
              names["waivers"]: control_file(list(found.logic)),
              names["description"]: json.dumps(_description(config, unit, prefix, found), indent=1) + "\n"}
    documents = {f"{prefix}{name}": make(config) for name, make in MAKERS.items()} if unit == TOP else {}
    if found.streams:
        documents[f"{found.top}_streams.md"] = streams_page(found.top, origin, found.streams)
    for name, text in (texts | documents).items():
        write_whole(folder / name, text)
    return Export(folder, found.top, documents=tuple(folder / name for name in documents),
                  **{key: folder / name for key, name in names.items()})


def _headed(text: str, origin: str, notes: tuple[str, ...]) -> str:
    head = [f"{origin} Written by `msv2 verilog`: do not edit.", "SPDX-License-Identifier: Apache-2.0"]
    head += ["", "Ports:", "", *notes] if notes else []
    lines = [part for line in head for part in _wrapped(line)]
    return "\n".join([f"{_LINE}{line}".rstrip() for line in lines]) + "\n\n" + text


def _wrapped(line: str) -> list[str]:
    indent = " " * (len(line) - len(line.lstrip()) + 4)
    return textwrap.wrap(line, _WIDTH, subsequent_indent=indent, break_long_words=False) or [""]


def _listed(names: object) -> str:
    return "".join(f"{name}\n" for name in names)


def _description(config: AcceleratorConfig, unit: str, prefix: str, found: Exported) -> dict[str, object]:
    count = Counter(memory.shape for memory in found.placed)
    return {
        "unit": unit, "doc": UNITS[unit].doc, "stage": stage_of(unit), "top": found.top, "prefix": prefix,
        "configuration": config_record(config),
        "ports": [{"name": name, "direction": way, "bits": bits} for name, way, bits in found.ports],
        "streams": as_json(found.streams),
        "modules": list(found.logic),
        "memories": [
            {"module": prefix + shape.module, "words": shape.words, "width": shape.width, "lanes": shape.lanes,
             "write_through": shape.through, "bits": shape.bits, "count": count[shape],
             "instances": [f"{memory.parent}.{memory.instance}" for memory in found.placed if memory.shape == shape]}
            for shape in sorted(count)]}
