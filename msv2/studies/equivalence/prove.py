"""Proves the sequential equivalence of two emissions of a unit, by induction in Yosys, with memories cut out of both.

Flip-flops are matched by name. The pins of a memory become ports, so that the proof shows that both versions access the memory
in the same way. Equal writes in every cycle then imply that both memories have the same content.
"""

from __future__ import annotations

import json
from pathlib import Path

from synth.flow import run
from synth.memories import take_out

DEPTH = 4
"""Number of cycles of the induction. No unit whose flip-flops all match by name needs more."""


def _flat(source: Path, top: str, name: str, folder: Path, log: Path) -> tuple[Path, list[dict[str, str]]]:
    """The unit as module `name` without memories, as a JSON netlist of Yosys, and its memories' shapes and initial values."""
    path = folder / f"{name}.json"
    run(f"read_rtlil {source}", f"hierarchy -top {top}", "proc", "flatten", "opt_clean", "memory_collect",
        f"rename {top} {name}", f"write_json {path}", log=log)
    design = json.loads(path.read_text())
    design["modules"] = {name: design["modules"][name]}
    memories = [cell["parameters"] for cell in design["modules"][name]["cells"].values() if cell["type"] == "$mem_v2"]
    take_out(design["modules"][name], limit=0)
    path.write_text(json.dumps(design))
    return path, memories


def equivalent(before: Path, after: Path, top: str, folder: Path) -> bool:
    """Whether two RTLIL texts of a unit describe the same machine. Yosys' log is in `folder/prove.log`.

    Args:
        before, after: the RTLIL of module `top` and of the modules that it uses.
        top: the module's name, the same in both.
        folder: for intermediate files.
    """
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "prove.log"
    log.write_bytes(b"")
    gold, stored_before = _flat(before, top, "gold", folder, log)
    gate, stored_after = _flat(after, top, "gate", folder, log)
    if stored_before != stored_after:
        return False
    verdict = folder / "verdict.txt"
    verdict.unlink(missing_ok=True)
    run(f"read_json {gold}", f"read_json {gate}", "memory_map", "opt_clean", "equiv_make gold gate both", "hierarchy -top both",
        "opt_clean", "equiv_simple", f"equiv_induct -seq {DEPTH}", f"tee -q -o {verdict} equiv_status", log=log)
    return "Equivalence successfully proven" in verdict.read_text()
