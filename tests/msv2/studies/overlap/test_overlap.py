"""The study of overlapped phases: what it measures of a small frame, and what its summary makes of rows."""

from __future__ import annotations

import json
import math

import pytest

from msv2.studies.overlap import measure
from msv2.studies.overlap.page import page, steps, summary
from msv2.studies.overlap.study import main
from msv2.studies.two_eyes.measure import ONE, TWO
from spec.errors import InputError


def row(frame: str, kind: str, in_turn: int, overlapped: int, machine: str = "v3", memory: str = "ideal") -> dict[str, object]:
    return {"frame": frame, "kind": kind, "in_turn": in_turn, "overlapped": overlapped, "machine": machine, "memory": memory}


def test_the_summary_has_gains_and_shares_by_machine_and_memory():
    rows = [row("a", ONE, 200, 100), row("a", TWO, 300, 150), row("b", ONE, 100, 100), row("b", TWO, 200, 180),
            row("a", ONE, 50, 40, memory="lpddr3")]
    paper = [{"frame": "a", "memory": "ideal", "cycles": 400}, {"frame": "b", "memory": "ideal", "cycles": 900},
             {"frame": "a", "memory": "lpddr3", "cycles": 80}]
    found = summary(rows, paper)
    assert found["v3, ideal"] == {
        "over_turns": pytest.approx(math.sqrt(2)), "over_turns_two": pytest.approx(math.sqrt(2 * 200 / 180)),
        "gain": pytest.approx(math.sqrt(4 * 9)), "two_eyes_gain": pytest.approx(math.sqrt(800 / 150 * 1800 / 180)),
        "second_eye_share": pytest.approx(math.sqrt(0.5 * 0.8))}
    assert found["v3, lpddr3"]["gain"] == pytest.approx(2) and found["v3, lpddr3"]["second_eye_share"] is None
    of_v3 = steps(found, "v3", "v3")
    assert of_v3["ideal_gain"] == pytest.approx(6) and of_v3["lpddr3_gain"] == pytest.approx(2)
    assert of_v3["second_eye_share_ideal"] == pytest.approx(math.sqrt(0.4)) and of_v3["two_eyes_gain"] is None


def test_a_small_frame(tmp_path):
    assert main(["embedded", "--size", "96x64", "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "overlap.json").read_text())
    text = (tmp_path / "overlap.md").read_text()
    assert text == page(found).rstrip() + "\n" and "**These are numbers of the cycle model**" in text
    assert len(found["frames"]) == 2 * sum(len(kinds) for _, kinds in measure.MACHINES.values())
    for frame in found["frames"]:
        assert frame["in_turn"] / 2 < frame["overlapped"] < frame["in_turn"]
        assert frame["overlapped"] == max(frame["first"], frame["second"])


def test_a_missing_scene_is_named(tmp_path):
    with pytest.raises(InputError, match="'nothing' is not accepted"):
        main(["nothing", "--out", str(tmp_path)])
