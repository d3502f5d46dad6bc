"""The study of warped eyes on top of joint frames: what it measures of a small frame, and what its summary makes of rows."""

from __future__ import annotations

import json

import pytest

from msv2.studies.two_eyes import warp
from msv2.studies.two_eyes.warp_page import ALL_HOLES, JOINT, KINDS, NO_SWEEP, WARPED, page, summary


def row(frame: str, kind: str, cycles: int) -> dict[str, object]:
    return {"frame": frame, "kind": kind, "cycles": cycles, "machine": "m", "memory": "ideal"}


def test_the_summary_divides_the_joint_frames_cycles_by_those_of_each_kind():
    rows = [row("a", JOINT, 100), row("a", WARPED, 200), row("a", NO_SWEEP, 50), row("a", ALL_HOLES, 100),
            row("b", JOINT, 90), row("b", WARPED, 45), row("b", NO_SWEEP, 90), row("b", ALL_HOLES, 360)]
    assert summary(rows) == {"m, ideal": {WARPED: pytest.approx(1.0), NO_SWEEP: pytest.approx(2**0.5),
                                          ALL_HOLES: pytest.approx(0.5)}}


def test_a_small_frame(tmp_path):
    assert warp.main(["embedded", "--size", "160x96", "--out", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "two_eyes_warp.json").read_text())
    assert (tmp_path / "two_eyes_warp.md").read_text() == page(content).rstrip() + "\n"
    rows = content["frames"]
    assert len(rows) == len(warp.MACHINES) * 2 * (1 + len(KINDS))
    by_kind = {r["kind"]: r for r in rows if (r["machine"], r["memory"]) == ("v3_eyes_warp", "ideal")}
    assert by_kind[JOINT]["pairs"] == by_kind[WARPED]["pairs"] and by_kind[JOINT]["pairs_again"] == 0
    assert by_kind[WARPED]["pairs_again"] > 0 == by_kind[NO_SWEEP]["sweep_cycles"] < by_kind[WARPED]["sweep_cycles"]
    assert by_kind[NO_SWEEP]["cycles"] < by_kind[JOINT]["cycles"] and by_kind[NO_SWEEP]["bytes"]["write"]["warp"] > 0
    quality = content["quality"][0]
    assert quality[f"{NO_SWEEP}_db"] < quality[f"{WARPED}_db"] <= quality[f"{JOINT}_db"]
