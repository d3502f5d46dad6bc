"""Areas of our machines with fewer units, from the area report, and the published area of GSCore."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from spec.config import PAPER, V3, AcceleratorConfig
from spec.paths import REPORTS

REPORT = REPORTS / "area.json"

GSCORE_MM2_16NM = 1.45
"""Area of the published GSCore, scaled to 16 nm by the paper (section 7, "Hardware Implementation")."""

WITH_CORES, WITH_CULLING, WARP = ("array", "blending"), ("culling and conversion", "colour"), "warp"
"""Groups of units whose logic scales with the number of cores, those whose logic scales with the culling units, and the group
that a machine for one eye does not have."""


def load_area(path: Path = REPORT) -> dict[str, object] | None:
    """The area report of `make report-area`; None where it is missing."""
    return json.loads(path.read_text()) if path.is_file() else None


def build_of(report: Mapping[str, object]) -> tuple[str, Mapping[str, object]]:
    """The build with which frames of one eye are compared: the one without the warp unit, if it was made."""
    name = "mono" if "mono" in report["builds"] else "1ghz"
    return name, report["builds"][name]


def machine_mm2(report: Mapping[str, object], config: AcceleratorConfig) -> float:
    """Area in mm^2 at 16 nm of one of our machines for one eye, with memories: the report's groups, scaled by their units."""
    cores = config.cores_x * config.cores_y / (PAPER.cores_x * PAPER.cores_y)
    culling, total = config.culling_units / PAPER.culling_units, 0.0
    for name, sums in build_of(report)[1]["groups"].items():
        factor = cores if name in WITH_CORES else culling if name in WITH_CULLING else 1.0
        if name != WARP:
            total += factor * sums["logic_um2_16nm"] + sums["memory_um2_16nm"]
    return total / 1e6


def known_mm2(report: Mapping[str, object] | None) -> dict[str, float]:
    """Areas in mm^2 at 16 nm, with memories, of those of our whole machines for one eye that the report has, by their names."""
    if report is None:
        return {}
    found = {PAPER.name: machine_mm2(report, PAPER)}
    if V3.name in report["builds"]:
        found[V3.name] = report["builds"][V3.name]["mm2_16nm"]
    return found
