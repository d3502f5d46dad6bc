"""The area of two eyes in one list: its units are those that the field `joint` changes, and the sums are right."""

from __future__ import annotations

import pytest

from golden.scenes.files import read_json
from msv2.studies.area import eyes
from msv2.studies.area.estimate import estimate_area
from rtl.units import UNITS
from spec.config import V3, V3_EYES, V3_EYES_STREAMS
from spec.paths import REPORTS
from synth.machine import CULLING, GROUPS
from synth.scaling import TO_16NM


def test_every_unit_can_be_made() -> None:
    assert {name for name, part in eyes.PARTS.items() if part.make is None} <= set(UNITS)
    assert {part.group for part in eyes.PARTS.values()} <= set(GROUPS) and not {*eyes.PARTS} & {*eyes.UNMEASURED}
    for name in ("eye_points", "eye_culls", "pair_union"):
        assert eyes.PARTS[name].make(V3_EYES) is not None


def test_what_units_add_is_in_the_machines_area() -> None:
    row = {"unit": "eye_culls", "group": CULLING, "added_um2": 1000.0}
    for config in (V3_EYES, V3_EYES_STREAMS):
        none, more = estimate_area(config, []), estimate_area(config, [row])
        added = more.groups[CULLING].logic_um2 - none.groups[CULLING].logic_um2
        assert added == pytest.approx(1000 * TO_16NM["asap7"].area)
        assert more.logic_mm2 - none.logic_mm2 == pytest.approx(1e-6 * added) and more.memory_mm2 == none.memory_mm2
    assert estimate_area(V3, [row]) == estimate_area(V3)


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
