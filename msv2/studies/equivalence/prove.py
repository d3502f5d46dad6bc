"""Proves the sequential equivalence of two emissions of a unit, module by module, by induction in Yosys.

A module whose text is the same in both needs no proof. In one that differs, memories and instances of other modules are cut
out: their pins become ports, so that the proof shows that both versions use them in the same way. Equal inputs in every cycle
then imply equal outputs of the same memory, and of a module that is the same or proven itself. Flip-flops are matched by name.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

from msv2.studies.equivalence.emit import canonical
from synth.flow import run
from synth.memories import take_out

DEPTH = 4
"""Number of cycles of the induction. No unit whose flip-flops all match by name needs more."""


def modules_of(text: str) -> dict[str, str]:
    """The text of every module of an RTLIL text, by name."""
    parts = re.split(r"(?m)^(?=(?:attribute [^\n]*\n)*module \\)", text)
    return {head[1]: part for part in parts if (head := re.search(r"(?m)^module \\(\S+)$", part))}


def alone(modules: dict[str, str], name: str) -> str:
    """RTLIL of one module, with the ports alone of the modules that it uses."""
    used = sorted({kind for kind in re.findall(r"(?m)^\s*cell \\(\S+) ", modules[name]) if kind in modules})
    port = re.compile(r"(?m)^\s*wire .*(?:input|output|inout) \d+.*$")
    stubs = ["\n".join([f"module \\{kind}", *port.findall(modules[kind]), "end"]) for kind in used]
    return "\n".join([*stubs, modules[name]])


def name_ports(module: dict) -> None:
    """Renames ports that Amaranth has numbered, `port$17$0`, in place: they count in the order in which they are declared."""
    numbered = [port for port in module["ports"] if re.fullmatch(r"port\$\d+\$\d+", port)]
    for place, port in enumerate(numbered):
        module["ports"][f"port_{place}"] = module["ports"].pop(port)


def cut_instances(module: dict) -> list[tuple[str, str]]:
    """Removes the instances of other modules from a module of Yosys' JSON, in place; their pins become ports of the module.

    Returns the instances: the name and the module of each.
    """
    cut = []
    for name, cell in sorted(module["cells"].items()):
        if cell["type"].startswith("$") and not cell["type"].startswith("$paramod"):
            continue
        cut.append((name, cell["type"]))
        for pin, bits in cell["connections"].items():
            inside = cell["port_directions"][pin] == "output"
            module["ports"][f"{name}__{pin}"] = {"direction": "input" if inside else "output", "bits": bits}
        del module["cells"][name]
    return cut


def _single(text: str, module: str, name: str, folder: Path, log: Path) -> tuple[Path, list[object]]:
    """One module as `name` without memories and instances, as JSON; and what was cut, which both versions must share."""
    source, path = folder / f"{name}.il", folder / f"{name}.json"
    source.write_text(text)
    run(f"read_rtlil {source}", "proc", "opt_clean", "memory_collect", f"write_json {path}", log=log)
    found = json.loads(path.read_text())["modules"][module]
    name_ports(found)
    memories = [cell["parameters"] for cell in found["cells"].values() if cell["type"] == "$mem_v2"]
    take_out(found, limit=0)
    instances = cut_instances(found)
    found["attributes"] = {}
    path.write_text(json.dumps({"modules": {name: found}}))
    return path, [memories, instances]


def proven(before: str, after: str, module: str, folder: Path) -> bool:
    """Whether one module is the same machine in two RTLIL texts, its memories and instances being the same.

    Args:
        before, after: RTLIL of the module, as `alone` gives it.
        module: the module's name, the same in both.
        folder: for intermediate files; Yosys' log is `prove.log` in it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    log, verdict = folder / "prove.log", folder / "verdict.txt"
    log.write_bytes(b"")
    verdict.unlink(missing_ok=True)
    gold, cut_before = _single(before, module, "gold", folder, log)
    gate, cut_after = _single(after, module, "gate", folder, log)
    if cut_before != cut_after:
        return False
    run(f"read_json {gold}", f"read_json {gate}", "memory_map", "opt_clean", "equiv_make gold gate both", "hierarchy -top both",
        "opt_clean", "equiv_simple", f"equiv_induct -seq {DEPTH}", f"tee -q -o {verdict} equiv_status", log=log)
    return "Equivalence successfully proven" in verdict.read_text()


def differences(before: Path, after: Path, folder: Path) -> list[str]:
    """Modules of a unit that are not proven to be the same; a module that only one of the texts has is one of them.

    Args:
        before, after: the RTLIL of the unit and of the modules that it uses.
        folder: for intermediate files.
    """
    old, new = modules_of(before.read_text()), modules_of(after.read_text())
    changed = sorted(name for name in old.keys() & new.keys() if canonical(old[name]) != canonical(new[name]))
    wrong = [name for name in changed if not proven(alone(old, name), alone(new, name), name, folder / name)]
    return sorted({*(old.keys() ^ new.keys()), *wrong})
