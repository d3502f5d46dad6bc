"""The study of joint frames through the RTL: which frames it wants, and what its report holds."""

from __future__ import annotations

import pytest

from golden.scenes.files import read_json
from msv2.studies.results import joint_frames
from msv2.studies.results.joint_frames import WANTED
from msv2.studies.results.report_tables import joint_frames_table
from spec.config import V3_EYES, V3_EYES_STREAMS
from spec.paths import REPORTS


def test_the_rows_of_a_frame_are_found_again() -> None:
    assert len({joint_frames._asked(frame) for frame in WANTED}) == len(WANTED)
    kept = read_json(REPORTS / "frames_eyes.json")
    assert {joint_frames._key(row) for row in kept["rows"]} == {joint_frames._asked(frame) for frame in WANTED}


def test_the_report_has_both_machines_and_memories_and_the_models_error() -> None:
    kept = read_json(REPORTS / "frames_eyes.json")
    rows = kept["rows"]
    assert {row["config"] for row in rows} == {V3_EYES.name, V3_EYES_STREAMS.name}
    assert {(row["pixels"], row.get("memory", "ideal")) for row in rows} == {
        ("display", "ideal"), ("packed", "ideal"), ("packed", "lpddr3")}
    assert "embedded_trained" in {row["scene"] for row in rows} and all(row["bit_exact"] for row in rows)
    for row in rows:
        cycles = sum(row[f"{phase}_cycles"] for phase in joint_frames.PHASES)
        model = sum(row["model"][f"{phase}_cycles"] for phase in joint_frames.PHASES)
        assert row["model"]["error"] == pytest.approx(model / cycles - 1, abs=1e-6) and abs(row["model"]["error"]) < 0.02
    assert kept["summary"]["model_error_total"] == max(abs(row["model"]["error"]) for row in rows)
    assert "NO" not in str(joint_frames_table({"frames_eyes": kept})) and joint_frames_table({}) is None
