"""The area of two eyes in one list: its units are those that the field `joint` changes, and the sums are right."""

from __future__ import annotations

import pytest

from golden.scenes.files import read_json
from msv2.studies.area import eyes
from msv2.studies.area.estimate import estimate_area
from rtl.units import UNITS
from spec.config import V3, V3_EYES, V3_EYES_OVERLAP, V3_EYES_STREAMS, V3_OVERLAP, AcceleratorConfig
from spec.paths import REPORTS
from synth.machine import CULLING, GROUPS
from synth.scaling import TO_16NM


def test_every_unit_can_be_made() -> None:
    for name, part in eyes.PARTS.items():
        assert part.group in GROUPS and getattr(part.machine, part.field)
        for unit in (name.split()[0], *(part.instead or ())):
            assert (unit in UNITS) != (unit in eyes.MAKERS)
    for field, names in eyes.UNMEASURED.items():
        assert not {name for name, part in eyes.PARTS.items() if part.field == field} & {*names}
    for make in eyes.MAKERS.values():
        assert make(V3_EYES_OVERLAP) is not None


def added(config: AcceleratorConfig, *fields: str) -> float:
    """What rows of 1,000 um^2 with these fields add to the logic of a machine, in um^2 at 16 nm."""
    rows = [{"unit": "x", "group": CULLING, "field": field, "added_um2": 1000.0} for field in fields]
    none, more = estimate_area(config, []), estimate_area(config, rows)
    found = more.groups[CULLING].logic_um2 - none.groups[CULLING].logic_um2
    assert more.logic_mm2 - none.logic_mm2 == pytest.approx(1e-6 * found) and more.memory_mm2 == none.memory_mm2
    return found / (1000 * TO_16NM["asap7"].area)


def test_what_units_add_is_in_the_machines_area() -> None:
    for config in (V3_EYES, V3_EYES_STREAMS):
        assert added(config, "joint") == pytest.approx(1) and added(config, "overlap") == 0
    assert added(V3_OVERLAP, "overlap") == pytest.approx(1) and added(V3_OVERLAP, "joint") == 0
    assert added(V3_EYES_OVERLAP, "overlap", "joint", "joint") == pytest.approx(3) and added(V3, "overlap", "joint") == 0


def test_the_report_says_whether_units_meet_the_clock() -> None:
    kept = read_json(REPORTS / "area_eyes.json")
    assert [row["unit"] for row in kept["rows"]] == list(eyes.PARTS)
    assert (REPORTS / "area_eyes.md").read_text() == f"{eyes.page(kept).rstrip()}\n"
    for row in kept["rows"]:
        if "alone_um2" in row:
            assert row["added_um2"] == pytest.approx(row["count"] * row["area_um2"] - row["alone_um2"], abs=0.01)
    for found, wanted in zip(eyes.machines(kept["rows"]), kept["machines"], strict=True):
        assert found == {name: pytest.approx(value, abs=0.004) if name.endswith("mm2") else value  # without the macros' library
                         for name, value in wanted.items()}
    late = kept | {"rows": [kept["rows"][0] | {"slack_ps": -1.0}]}
    assert "| NO |" in eyes.page(late)
