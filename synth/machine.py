"""The whole machine as units that are synthesised apart: a cut through the hierarchy that it is emitted with.

Every module of the emitted machine belongs to the unit of UNIT_GROUPS that is its nearest ancestor, or itself; modules shared
by several (`rtl.emit.add_shared`) are synthesised once and counted where they are used. So nothing can be left out, and nothing
counted twice. A module directly below a frame (FRAMES) that is no unit is an error: it was added to the machine and not here.
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
from spec.sources import fingerprint, sources_of
from synth.design import Design, elaborate
from synth.report import write_json

TOP = "msv2_top"

ARRAY, SORTING, CULLING, COLOUR, LISTS, BLENDING, WARP, CONTROL = (
    "array", "sorting and tile merging", "culling and conversion", "colour", "lists and memory ports", "blending", "warp",
    "control and bus")
GROUPS = (ARRAY, BLENDING, CULLING, COLOUR, LISTS, SORTING, WARP, CONTROL)
"""Groups of units, as reports have them."""

UNIT_GROUPS = {
    "": CONTROL, "registers": CONTROL, "controller": CONTROL, "master": CONTROL, "counters": CONTROL,
    **{f"queue_{client}": LISTS for client in ("geometry", "tiles", "colour", "entries", "spill", "views")},
    "geometry": CONTROL, "geometry.reader": LISTS, "geometry.loader": LISTS, "geometry.projection": CULLING,
    "geometry.tile_test": CULLING, "geometry.colour": COLOUR, "geometry.writer": LISTS, "geometry.saturations": CONTROL,
    "render": CONTROL, "render.tile_merge": SORTING, "render.fork": LISTS, "render.reader": LISTS, "render.headers": LISTS,
    "render.sorter": SORTING, "render.sorter.sorter": SORTING, "render.sorter.writer": SORTING,
    "render.sorter.reader": SORTING, "render.sorter.tree": SORTING, "render.handover": SORTING,
    "render.fetch": LISTS, "render.array": ARRAY, "render.array.setup": ARRAY, "render.array.sequencer": ARRAY,
    "render.array.expand": ARRAY, "render.array.collect": BLENDING, "render.writer": LISTS,
    "render.broadcast": WARP, "render.warp": WARP,
}
"""The units, by their path below the machine; the frames around them are what is left between."""

FRAMES = ("", "geometry", "render")
"""Units whose every submodule must be a unit."""

UNTIMED = ("", "geometry", "render", "render.array")
"""Units that are wires and little else around large ones: their slack is that of the whole machine."""


def label(path: str) -> str:
    """Name of a unit's module."""
    return f"{TOP}__{path.replace('.', '__')}" if path else TOP


def machine_design(config: AcceleratorConfig, folder: Path) -> Design:
    """The machine as one module a unit, lower ones first, and the shared modules; kept in `folder` by the hash of all sources.

    Raises:
        ValueError: a submodule of a frame belongs to no unit, or two modules have one name.
    """
    version = importlib.metadata.version("amaranth")
    key = fingerprint(sources_of("synth.machine"), config, version)
    kept = folder / "cache" / f"{TOP}-{config.name}-{key}.json"
    if not kept.exists():
        design = cut(elaborate(Machine(config), TOP))
        write_json(kept, {"texts": design.texts, "below": {name: dict(count) for name, count in design.below.items()}})
    found = json.loads(kept.read_text())
    return Design(TOP, found["texts"], {name: Counter(below) for name, below in found["below"].items()})


def modules_of(text: str) -> dict[str, str]:
    """The modules of an RTLIL text by their path below the machine (without Amaranth's `$N`), names as there."""
    modules: dict[str, str] = {}
    for found in re.finditer(r"(?ms)^module \\(\S+)\n.*?^end$", text):
        path = _path(found[1])
        if path in modules:
            raise ValueError(f"the machine must have one module {path!r}, not two")
        modules[path] = found[0]
    return modules


def steady(modules: Mapping[str, str]) -> dict[str, str]:
    """Modules whose ports without a name are numbered by the module alone.

    Amaranth numbers them by the nets of the whole machine, so that every text would change with any other module, and nothing
    that was synthesised before would do again.
    """
    names = {_module_name(text): _steady_ports(text) for text in modules.values()}
    return {path: "\n".join(_with_ports(text, names)) for path, text in modules.items()}


def _module_name(text: str) -> str:
    return re.match(r"module \\(\S+)", text)[1]


def _steady_ports(text: str) -> dict[str, str]:
    """New names of a module's ports `port$NET$BIT`: the net's place among them instead of its number."""
    places: dict[str, int] = {}
    return {f"\\port${net}${bit}": f"\\port${places.setdefault(net, len(places))}${bit}"
            for net, bit in re.findall(r"(?m)^\s*wire .*\\port\$(\d+)\$(\d+)$", text)}


def _with_ports(text: str, names: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """Lines of a module with its ports, and those of the modules in it, called by their new names."""
    own = names[_module_name(text)]
    of = own
    for line in text.split("\n"):
        cell = re.match(r"\s*cell \\(\S+) ", line)
        if cell or line.strip() == "end":
            of = names.get(cell[1], {}) if cell else own
        begin, port, value = re.match(r"(\s*connect )?((?<=connect )\S+)?(.*)", line).groups("")
        yield begin + of.get(port, port) + re.sub(r"\\port\$\d+\$\d+", lambda found: own[found[0]], value)


def unit_of(path: str) -> str:
    """The unit that a module belongs to."""
    parent = path
    while parent not in UNIT_GROUPS:
        parent = parent.rpartition(".")[0]
        if parent in FRAMES:
            raise ValueError(f"{path!r} of the machine must be one of the units in synth/machine.py")
    return parent


def cut(design: Design) -> Design:
    """The machine's own module cut into one a unit."""
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
    """A module, and what it instantiates, under a unit's name; clock and reset called as in a module of its own."""
    text = re.sub(rf"(?m)^(module |\s*cell )\\({TOP}\S*)", lambda found: f"{found[1]}\\{label(_path(found[2]))}", text)
    text = re.sub(r"(?m)^(\s*connect )\\units_(clk|rst) ", r"\1\\\2 ", text)
    return text if path == "" else re.sub(r"\\units_(clk|rst)\b", r"\\\1", text)
