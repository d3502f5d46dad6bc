"""The report of the linked machines: what is repeated at its top, the page, stored interfaces of several machines."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from msv2.studies.machine_timing import study
from msv2.studies.machine_timing.page import page
from msv2.studies.machine_timing.study import machine_row, main, merged, worst
from spec.errors import InputError
from spec.paths import REPORTS
from synth.corners import CORNERS
from synth.interfaces import Interface
from synth.linked import LinkedTiming, Pair
from synth.loads import Overload
from synth.machine import TOP
from synth.whole import WholeTiming, stored
from synth.whole_report import lines

KEPT = REPORTS / "machine_timing.json"


def _linked(corner: str, slack: float) -> LinkedTiming:
    pairs = (Pair("geometry.writer", "counters", ("geometry.writer", "geometry", "counters"), 12, slack, "a/b/Q", "c/d/D"),)
    return LinkedTiming(corner, 1000.0, 0.05, slack, 12, pairs, 5 * slack, -1.0, 3, 2, 1, -7.0, 4, "path")


def _whole(name: str, slack: float) -> WholeTiming:
    interfaces = {TOP: Interface(f"of {name}", 990, {}, {"done": 940}, {"go": 20})}
    linked = {"typical": _linked("typical", slack), "slow": _linked("slow", 2 * slack)}
    return WholeTiming(name, linked, interfaces, "s", 3, 9, 70, (Overload("msv2_top", "net", 50.0, 46.08),))


def test_the_page_and_the_lines_say_what_was_found() -> None:
    rows = {"paper": machine_row(_whole("paper", -95.0), "abc1234", 6), "v3": machine_row(_whole("v3", -190.0), "abc1234", 6)}
    top = worst(rows)
    assert top["typical"] == {"slack_ps": -190.0, "late_endpoints": 12, "ghz": 0.8333}
    assert rows["paper"]["typical"]["ghz"] == pytest.approx(1 / 1.1, abs=1e-4) and "path" not in rows["paper"]["typical"]
    assert [(pair["start"], pair["end"], pair["excess_ps"]) for pair in rows["paper"]["budget"]] == [
        (TOP, TOP, 40), (TOP, "ports", 40)]  # 990 ps inside, and 940 with 50 outside, of 950
    corners = {name: {"node": name, "memory_factor": one.memory_factor, "memory_source": one.source}
               for name, one in CORNERS.items()}
    text = page({**top, "clock_ps": 1000.0, "uncertainty": 0.05, "corners": corners, "machines": rows})
    assert "| `paper` | typical | -95.0 | 12 | 1 | 0.91 | -1.0 | 3 | 1 |" in text
    assert "| -380.0 | 12 | `geometry.writer` > `geometry` > `counters` |" in text
    assert "| 40 | `msv2_top` | `msv2_top` |" in text and "| `msv2_top` | `net` | 50.0 | 46.1 |" in text
    assert "of the linked run" not in text
    rows["v3"] = study.with_ports(rows["v3"], _whole("v3", -190.0), "def5678", 2)
    later = page({**top, "clock_ps": 1000.0, "uncertainty": 0.05, "corners": corners, "machines": rows})
    assert "At commit def5678 the RTL of all its modules is still that of the linked run.\n" in later
    for count, commit in ((2, "abc4567"), (1, "abc5678"), (0, "abc6789")):
        rows["v3"] = study.with_ports(rows["v3"], replace(_whole("v3", -190.0), measured=count), commit, 3 - count)
    last = page({**top, "clock_ps": 1000.0, "uncertainty": 0.05, "corners": corners, "machines": rows})
    assert ("Since the linked run, 3 modules were mapped again, with at most 2 runs, and measured. At commit abc6789 the RTL "
            "of all others is still that of the linked run.") in last
    printed = "\n".join(lines(_whole("paper", -95.0)))
    assert "paper, slow: slack -190.0 ps at 1000 ps with 5% uncertainty" in printed and "50 of 46 fF" in printed


def test_stored_interfaces_of_other_machines_stay() -> None:
    old = stored([_whole("paper", -1.0), _whole("v3", -1.0)], 1000.0, 0.05)
    changed = _whole("v3", -1.0)
    new = stored([replace(changed, interfaces={TOP: replace(changed.interfaces[TOP], source="new")})], 1000.0, 0.05)
    found = merged(new, old)
    assert list(found["machines"]) == ["paper", "v3"]
    assert set(found["interfaces"]) == {f"{TOP} of paper", f"{TOP} new"}
    assert found["machines"]["paper"] == old["machines"]["paper"]


def test_an_unknown_machine_is_refused() -> None:
    with pytest.raises(InputError, match="configs tiny are not known: paper, paper_eyes, v3, v3_eyes_warp are"):
        main(["--configs", "tiny"])


def test_ports_need_a_linked_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "time_ports", lambda *arguments: _whole("paper", -1.0))
    with pytest.raises(InputError, match=r"ports need a report with a linked run: paper is not in machine_timing\.json"):
        main(["--ports", "--configs", "paper", "--out", str(tmp_path)])
    monkeypatch.setattr(study, "budgets", dict)
    with pytest.raises(InputError, match="ports are measured again only where they were once: paper is not in machine_budget"):
        main(["--ports", "--configs", "paper", "--out", str(tmp_path)])


def test_the_kept_report_holds_together() -> None:
    """Its top repeats the worst of its machines; endpoints of pairs add up; the page is made of it."""
    report = json.loads(KEPT.read_text())
    assert "paper" in report["machines"] and set(report["machines"]) <= set(study.TIMED)
    assert {corner: report[corner] for corner in CORNERS} == worst(report["machines"])
    for machine in report["machines"].values():
        for corner in CORNERS:
            found = machine[corner]
            assert found["late_endpoints"] == sum(pair["endpoints"] for pair in found["pairs"])
            assert found["slack_ps"] == min([pair["slack_ps"] for pair in found["pairs"]], default=found["slack_ps"])
        assert machine["slow"]["ghz"] < machine["typical"]["ghz"]
    assert KEPT.with_suffix(".md").read_text() == page(report)


def test_every_machine_of_the_report_meets_its_clock() -> None:
    """At the typical corner, with the uncertainty; what is quoted as 1 GHz elsewhere rests on this."""
    machines = json.loads(KEPT.read_text())["machines"]
    assert {name: (row["typical"]["slack_ps"], row["typical"]["late_endpoints"]) for name, row in machines.items()
            if row["typical"]["slack_ps"] < 0 or row["typical"]["late_endpoints"]} == {}
