"""The study of joint frames: what it measures of a small frame, and what its summary makes of rows."""

from __future__ import annotations

import json
import math

import pytest

from msv2.studies.two_eyes import headset, measure
from msv2.studies.two_eyes.page import page, summary
from msv2.studies.two_eyes.study import main
from msv2.studies.v3.frames import Subject
from spec.errors import InputError

SMALL = Subject("embedded", "160x96")


def row(frame: str, kind: str, cycles: int, machine: str = "v3_eyes", memory: str = "ideal") -> dict[str, object]:
    return {"frame": frame, "kind": kind, "cycles": cycles, "machine": machine, "memory": memory}


def test_the_summary_has_shares_and_gains_by_machine_and_memory():
    rows = [row("a", measure.ONE, 100), row("a", measure.TWO, 150), row("a", measure.SHARED, 140),
            row("b", measure.ONE, 100), row("b", measure.TWO, 180), row("b", measure.ONE, 50, memory="lpddr3")]
    paper = [{"frame": "a", "memory": "ideal", "cycles": 300}, {"frame": "b", "memory": "ideal", "cycles": 360},
             {"frame": "a", "memory": "lpddr3", "cycles": 1}]
    found = summary(rows, paper)["v3_eyes, ideal"]
    assert found["shares"] == {"a": pytest.approx(0.5), "b": pytest.approx(0.8)}
    assert found["second_eye_share"] == pytest.approx(math.sqrt(0.5 * 0.8))
    assert found["two_eyes_gain"] == pytest.approx(math.sqrt(4 * 4))
    assert found["shares_shared"] == {"a": pytest.approx(0.4), "b": pytest.approx(0.8)}  # b has no harmonics
    assert summary(rows, paper)["v3_eyes, lpddr3"]["second_eye_share"] is None
    assert summary(rows, [])["v3_eyes, ideal"]["two_eyes_gain"] is None


@pytest.fixture(scope="module")
def content(tmp_path_factory) -> dict[str, object]:
    out = tmp_path_factory.mktemp("report")
    assert main(["embedded", "--size", SMALL.size, "--out", str(out)]) == 0
    found = json.loads((out / "two_eyes.json").read_text())
    assert (out / "two_eyes.md").read_text() == page(found).rstrip() + "\n"
    return found


def test_a_small_frame(content):
    rows = content["frames"]
    assert len(rows) == len(measure.MACHINES) * 2 * 3
    for machine in measure.MACHINES:
        one, two, shared = (next(r for r in rows if (r["machine"], r["memory"], r["kind"]) == (machine, "ideal", kind))
                            for kind in (measure.ONE, measure.TWO, measure.SHARED))
        assert one["cycles"] < two["cycles"] < 2 * one["cycles"] and shared["cycles"] < two["cycles"]
        assert one["pairs"] <= two["pairs"] < 1.5 * one["pairs"] and two["busy"]["fetch"] == two["pairs"]
        written = two["bytes"]["write"]["frame"] / one["bytes"]["write"]["frame"]
        assert written == (pytest.approx(2, rel=0.1) if measure.MACHINES[machine].packed else 2)
    assert content["shifts"][0]["best"] <= content["shifts"][0]["median"]


def test_the_pixels_of_a_small_frame(content):
    for found, camera in zip(content["quality"], measure.CAMERAS, strict=True):
        assert found["camera"] == camera and found["source_equal"] and found["keys_differ"] > 0.1
        assert found["joint_vs_oracle_db"] > 58 and abs(found["joint_vs_oracle_db"] - found["alone_vs_oracle_db"]) < 1
        assert found["joint_vs_alone_db"] is None or found["joint_vs_alone_db"] > 60
        assert found["shared_vs_own_db"] > 50


def test_the_page_says_what_is_missing(content):
    text = page(content)
    assert "`v3_eyes_large`, has twice the places" in text and "DIFFERS" not in text and "inf" not in text.split("## Pixels")[1]


def test_a_missing_scene_is_named(tmp_path):
    with pytest.raises(InputError, match="'nothing' is not accepted"):
        main(["nothing", "--out", str(tmp_path)])


def test_frames_of_a_headset(monkeypatch):
    monkeypatch.setattr(headset, "SIZE", "96x64")
    monkeypatch.setattr(headset, "SCENES", ("embedded", "no_such_scene"))
    monkeypatch.setattr(headset, "scene_file", lambda name: name == "embedded" or None)
    rows = headset.rows()
    assert headset.missing() == ["no_such_scene"]
    assert len(rows) == len(headset.MACHINES) * len(headset.clocks_mhz()) * 3
    for row in rows:
        assert row["fps"] == pytest.approx(1e6 * row["clock_mhz"] / row["cycles"])
    fast, *slow = (next(row for row in rows if row["clock_mhz"] == clock) for clock in headset.clocks_mhz())
    assert len(slow) == 2 and slow[1]["clock_mhz"] < 500, "the machine does not reach 500 MHz at 16 nm"
    for row in slow:
        assert fast["cycles"] > row["cycles"] and fast["fps"] > row["fps"], "a faster machine waits more cycles for memory"
    text = headset.section({"headset": rows, "headset_missing": ["no_such_scene"]})
    assert "no_such_scene (`make train" in text and f"{fast['fps']:.0f}" in text
    assert "|" not in headset.section({"headset": [], "headset_missing": []})
