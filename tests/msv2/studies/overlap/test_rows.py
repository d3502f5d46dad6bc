"""The study of frames in a row through the RTL: its rows, its report, and what it refuses."""

from __future__ import annotations

import pytest

from golden.msv2_ref.joint import JointFrame
from golden.scenes.files import read_json
from golden.scenes.load import EMBEDDED
from msv2.studies.overlap import rows, rtl
from spec.config import TINY_EYES_OVERLAP, TINY_OVERLAP
from spec.errors import InputError
from spec.paths import REPORTS


def test_rows_of_a_scene_have_the_bounds_of_the_frame_before_the_last() -> None:
    found = rows.rows_of(rows.golden_frames(TINY_OVERLAP, EMBEDDED, "32x32", joint=False, every=20), short=False)
    assert {name: len(cases) for name, cases in found.items()} == {"still": rows.STILL, "turning": len(rows.TURNS)}
    both = rows.golden_frames(TINY_EYES_OVERLAP, EMBEDDED, "32x32", joint=True, every=20)
    short = rows.rows_of(both, short=True)
    assert list(short) == ["in short"] and all(isinstance(case.frame, JointFrame) for case in short["in short"])
    first, second, third = short["in short"]
    assert first.frame.source.pixels is second.frame.source.pixels is not third.frame.source.pixels
    for cases in (*found.values(), *short.values()):
        lists = [rows.bounds_of(case).lists for case in cases]
        assert lists[0] == lists[1] == rows.bounds_of(cases[0]).supertiles


def test_new_rows_replace_those_of_the_same_frame_and_machine() -> None:
    def row(frame: str, machine: str, period: int) -> dict[str, object]:
        return {"frame": frame, "machine": machine, "period": period}

    found = rtl.with_rows([row("a", "m", 1), row("b", "m", 2), row("a", "n", 3)], [row("a", "m", 4)])
    assert found == [row("b", "m", 2), row("a", "n", 3), row("a", "m", 4)]


def test_the_report_is_exact_and_its_page_is_its_own() -> None:
    kept = read_json(REPORTS / "frames_overlap.json")
    assert (REPORTS / "frames_overlap.md").read_text() == f"{rtl.page(kept).rstrip()}\n"
    for row in kept["rows"]:
        assert row["problems"] == [] and abs(row["model"] / row["period"] - 1) < 0.02


def test_a_machine_whose_phases_take_turns_is_refused() -> None:
    with pytest.raises(InputError, match="'v3' is not accepted: machines whose phases overlap are"):
        rtl.main(["embedded", "--config", "v3"])
