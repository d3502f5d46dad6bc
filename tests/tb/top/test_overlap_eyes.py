"""Joint frames of two eyes, among frames of one, in a row on machines whose phases overlap, against the golden renderer."""

from __future__ import annotations

from dataclasses import replace

import pytest

from golden.msv2_ref.joint import JointFrame
from spec.codes import ErrorCode
from spec.config import TINY_EYES_OVERLAP
from tb.top.overlap_player import RowFrame, RowResult
from tb.top.plan_overlap import EYES, broken_rows, good_rows, row_problems, run_rows
from tb.top.suite import VARIANTS

IN_SHORT = (
    "turning", "abort 300 cycles", "reset 1500", "target_tiles of the second", "target_frame of the first", "a bad shift")
"""Of the rows, some of each kind."""


@pytest.fixture(scope="module")
def rows():
    return [*good_rows(TINY_EYES_OVERLAP, 0), *broken_rows(TINY_EYES_OVERLAP, 0)]


def test_rows_in_short(rows, tmp_path):
    short = [row for row in rows if row.name == "turning" or any(words in row.name for words in IN_SHORT[1:])]
    assert {frame.error for row in short for frame in row.frames} == {
        ErrorCode.NONE, ErrorCode.ABORTED, ErrorCode.READ_ERROR, ErrorCode.WRITE_ERROR, ErrorCode.BAD_SETTING}
    found = run_rows(TINY_EYES_OVERLAP, short, tmp_path)
    assert found.failures == {} and found.runs == len(short) == 11
    turning: RowResult = found.recordings["turning"]
    assert [frame.target is not None for frame in turning.frames] == [eyes is not None for eyes in EYES[:4]]
    last = turning.frames[-1].registers
    both = last["cycles_table_low"] + last["cycles_geometry_low"] + last["cycles_render_low"]
    assert both > 1.15 * last["cycles_total_low"]
    _wrong_targets_are_found(short[0], turning)


def _wrong_targets_are_found(row, result):
    """One wrong bit of the target eye shows, and so does a wrong event."""
    frame: RowFrame = result.frames[1]
    colour = frame.target.colour.copy()
    colour[5, 7, 1] ^= 1
    for wrong in (replace(frame, target=frame.target._replace(colour=colour)),
                  replace(frame, events=frame.events | {"pairs": frame.events["pairs"] + 1})):
        frames = (result.frames[0], wrong, *result.frames[2:])
        assert len(row_problems(row, replace(result, frames=frames))) == 1


@pytest.mark.long
@pytest.mark.parametrize("variant", ["tiny_eyes_overlap", "tiny_eyes_overlap_full"])
def test_all_rows(variant, tmp_path):
    config = VARIANTS[variant]
    rows = [*good_rows(config, 1), *broken_rows(config, 1)]
    found = run_rows(config, rows, tmp_path)
    assert found.failures == {} and found.runs == len(rows)


def test_the_plans_frames_need_what_they_show(rows):
    """Frames of one eye have bounds of joint frames and the other way round, and several lists by them."""
    mixed = next(row for row in rows if row.name == "one eye, then two").frames
    lists = [len(item.frame.bounds.key) for item in mixed]
    assert lists[:2] == [0, 0] and min(lists[2:]) > 0
    assert [isinstance(item.joint, JointFrame) for item in mixed] == [False, False, True, True, False, False, True]
    every = next(row for row in rows if row.name == "every kind of eyes").frames
    assert {item.joint.registers.shift for item in every if item.joint is not None} >= {-3, 8}
