"""Whole frames on the bench's LPDDR3: every bit and every counter, and the cycle model's cycles."""

import json

import pytest

from msv2.studies.model import study
from tb.frame import __main__ as command

pytestmark = pytest.mark.long


@pytest.mark.parametrize("line", study.LPDDR3_FRAMES[:2])
def test_tiny_frames_are_bit_exact_and_take_the_models_cycles(tmp_path, line):
    """The machine, its memory and the model have no chance in them: the same frame always takes the same cycles."""
    scene, *options = line.split()
    assert command.main([scene, "--machine", "full", *options, "--camera", "orbit", "--out", str(tmp_path)]) == 0
    row = json.loads((tmp_path / "frame.json").read_text())
    assert row["bit_exact"] and row["counter_errors"] == row["stream_errors"] == [] and row["memory"] == "lpddr3"
    _, frame = study.model_row(row, scene)
    got = study.compared(row, frame)
    assert abs(got["total"]["error"]) <= study.TOTAL_GOAL
    assert got["beats_equal"] and got["misses_equal"]
    assert got["commands"]["activates"]["model"] == pytest.approx(row["activates"], rel=0.05)
    assert got["commands"]["refreshes"]["model"] == pytest.approx(row["refreshes"], abs=16)
