"""The whole machine as units that are synthesised separately, cut out of the hierarchy with which it is emitted.

Every module of the emitted machine belongs to the unit of UNIT_GROUPS that is the module itself or its nearest ancestor.
Modules that several units share (`rtl.emit.add_shared`) are synthesised once and counted wherever they are used. So nothing is
left out, and nothing is counted twice. A module directly below one of FRAMES that is not a unit raises an error: it was added
to the machine but not to this list.
"""

from __future__ import annotations

import importlib.metadata
import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

from rtl.top.machine import Machine
from spec.config import AcceleratorConfig
from spec.progress import phase
from spec.sources import fingerprint, sources_of
from synth.design import Design, elaborate
from synth.report import write_json

TOP = "msv2_top"

ARRAY, SORTING, CULLING, COLOUR, LISTS, BLENDING, WARP, CONTROL = (
    "array", "sorting and tile merging", "culling and conversion", "colour", "lists and memory ports", "blending", "warp",
    "control and bus")
GROUPS = (ARRAY, BLENDING, CULLING, COLOUR, LISTS, SORTING, WARP, CONTROL)
"""Groups of units, in the order of the reports."""

UNIT_GROUPS = {
    "": CONTROL, "registers": CONTROL, "controller": CONTROL, "master": CONTROL, "counters": CONTROL,
    **{f"queue_{client}": LISTS for client in ("geometry", "tiles", "colour", "entries", "spill", "views", "chunks")},
    "geometry": CONTROL, "geometry.reader": LISTS, "geometry.loader": LISTS, "geometry.projection": CULLING,
    "geometry.headers": LISTS, "geometry.bounds": CULLING, "geometry.chunk_test": CULLING,
    "geometry.tile_test": CULLING, "geometry.colour": COLOUR, "geometry.writer": LISTS, "geometry.saturations": CONTROL,
    "geometry.path": CULLING, "geometry.path.projection": CULLING, "geometry.path.clip": CULLING,
    "geometry.path.tile_test": CULLING, "geometry.path.saturations": CONTROL, "geometry.buckets": LISTS,
    "render": CONTROL, "render.tile_merge": SORTING, "render.fork": LISTS, "render.reader": LISTS, "render.headers": LISTS,
    "render.sorter": SORTING, "render.sorter.sorter": SORTING, "render.sorter.writer": SORTING,
    "render.sorter.reader": SORTING, "render.sorter.tree": SORTING, "render.handover": SORTING,
    "render.fetch": LISTS, "render.array": ARRAY, "render.array.setup": ARRAY, "render.array.sequencer": ARRAY,
    "render.array.expand": ARRAY, "render.array.collect": BLENDING, "render.writer": LISTS,
    "render.finished": LISTS, "render.broadcast": WARP, "render.warp_rows": WARP, "render.warp": WARP,
    "render.supertiles": LISTS, "render.supertile_fork": LISTS, "render.queue": LISTS, "render.lists": LISTS,
    "render.colour": COLOUR, "render.saturations": CONTROL, "render.batches": BLENDING, "render.array.state": BLENDING,
    "geometry.target_bounds": CULLING, "geometry.path.turns": CULLING, "render.replay": LISTS,
}
"""The group of each unit, by the unit's path below the machine. A frame around other units is the logic left between them."""

CHUNK_UNITS = ("queue_chunks", "geometry.headers", "geometry.bounds", "geometry.chunk_test")
"""Units that only machines with chunks have."""

SUPERTILE_UNITS = (
    "geometry.path", "geometry.path.projection", "geometry.path.clip", "geometry.path.tile_test", "geometry.path.saturations",
    "geometry.buckets", "render.supertiles", "render.supertile_fork", "render.queue", "render.lists", "render.colour",
    "render.saturations", "render.batches", "render.array.state")
"""Units that only machines with lists by super-tile have."""

JOINT_UNITS = ("geometry.target_bounds", "geometry.path.turns", "render.replay")
"""Units that only machines with joint frames of two eyes have: `turns` and `replay` only where the target may be warped."""

FRAMES = ("", "geometry", "geometry.path", "render")
"""Units of which every direct submodule must be a unit, too."""

UNTIMED = ("", "geometry", "geometry.path", "render", "render.array")
"""Units that are little more than wiring around large units; timing them would mean timing most of the machine at once."""


def label(path: str) -> str:
    """Name of the module that a unit is synthesised as."""
    return f"{TOP}__{path.replace('.', '__')}" if path else TOP


def machine_design(config: AcceleratorConfig, folder: Path) -> Design:
    """The machine as one module per unit and the shared modules, lower ones first.

    The result is cached in `folder` under a hash of all sources.

    Raises:
        ValueError: a submodule of a frame belongs to no unit, or two modules have the same name.
    """
    version = importlib.metadata.version("amaranth")
    key = fingerprint(sources_of("synth.machine"), config, version)
    kept = folder / "cache" / f"{TOP}-{config.name}-{key}.json"
    if not kept.exists():
        with phase(f"elaborating the machine {config.name}"):
            design = cut(elaborate(Machine(config), TOP))
        write_json(kept, {"texts": design.texts, "below": {name: dict(count) for name, count in design.below.items()}})
    found = json.loads(kept.read_text())
    return Design(TOP, found["texts"], {name: Counter(below) for name, below in found["below"].items()})


def modules_of(text: str) -> dict[str, str]:
    """The modules of an RTLIL text by their path below the machine, without the `$N` that Amaranth appends to names."""
    modules: dict[str, str] = {}
    for found in re.finditer(r"(?ms)^module \\(\S+)\n.*?^end$", text):
        path = _path(found[1])
        if path in modules:
            raise ValueError(f"the machine must have one module {path!r}, not two")
        modules[path] = found[0]
    return modules


def steady(modules: Mapping[str, str]) -> dict[str, str]:
    """The modules with port numbers that depend on the module alone.

    Amaranth numbers ports without a name by the nets of the whole machine. A change of any module would then change the text of
    all others, and no cached synthesis result could be reused.
    """
    names = {_module_name(text): _steady_ports(text) for text in modules.values()}
    return {path: "\n".join(_with_ports(text, names)) for path, text in modules.items()}


def _module_name(text: str) -> str:
    return re.match(r"module \\(\S+)", text)[1]


def _steady_ports(text: str) -> dict[str, str]:
    """New names of the ports `port$NET$BIT` of a module, with the net's rank in this module instead of its number."""
    places: dict[str, int] = {}
    return {f"\\port${net}${bit}": f"\\port${places.setdefault(net, len(places))}${bit}"
            for net, bit in re.findall(r"(?m)^\s*wire .*\\port\$(\d+)\$(\d+)$", text)}


def _with_ports(text: str, names: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """The lines of a module, with its own ports and those of its submodules under their new names."""
    own = names[_module_name(text)]
    of = own
    for line in text.split("\n"):
        cell = re.match(r"\s*cell \\(\S+) ", line)
        if cell or line.strip() == "end":
            of = names.get(cell[1], {}) if cell else own
        begin, port, value = re.match(r"(\s*connect )?((?<=connect )\S+)?(.*)", line).groups("")
        yield begin + of.get(port, port) + re.sub(r"\\port\$\d+\$\d+", lambda found: own[found[0]], value)


def unit_of(path: str) -> str:
    """The unit that a module belongs to; ValueError if it is a submodule of a frame without being a unit."""
    parent = path
    while parent not in UNIT_GROUPS:
        parent = parent.rpartition(".")[0]
        if parent in FRAMES:
            raise ValueError(f"{path!r} of the machine must be one of the units in synth/machine.py")
    return parent


def cut(design: Design) -> Design:
    """The design with the machine's own module cut into one module per unit."""
    modules = steady(modules_of(design.texts[design.top]))
    shared = {name: text for name, text in design.texts.items() if name != design.top}
    parts: dict[str, list[str]] = {}
    for path, text in modules.items():
        parts.setdefault(unit_of(path), []).append(_renamed(path, text))
    texts, below = dict(shared), {name: Counter(design.below[name]) for name in shared}
    for unit in sorted(parts, key=lambda unit: (-unit.count(".") - bool(unit), unit)):  # inner ones first
        name = label(unit)
        texts[name] = "\n\n".join(parts[unit]) + "\n"
        below[name] = Counter(
            kind for kind in re.findall(r"(?m)^\s*cell \\(\S+) ", texts[name]) if kind in texts and kind != name)
    return Design(design.top, texts, below)


def _path(module: str) -> str:
    return ".".join(part.partition("$")[0] for part in module.removeprefix(TOP).lstrip(".").split("."))


def _renamed(path: str, text: str) -> str:
    """The text of a module under its unit's name, with its submodules, and with clock and reset named `clk` and `rst`."""
    text = re.sub(rf"(?m)^(module |\s*cell )\\({TOP}\S*)", lambda found: f"{found[1]}\\{label(_path(found[2]))}", text)
    text = re.sub(r"(?m)^(\s*connect )\\units_(clk|rst) ", r"\1\\\2 ", text)
    return text if path == "" else re.sub(r"\\units_(clk|rst)\b", r"\\\1", text)
