"""Frames in a row on machines whose phases overlap, against the golden renderer: every pixel and every event of each frame."""

from __future__ import annotations

from dataclasses import replace

import pytest

from spec.codes import ErrorCode
from spec.config import TINY_OVERLAP
from tb.top.overlap_player import RowFrame, RowResult, outcome
from tb.top.plan_overlap import broken_rows, good_rows, in_a_row, row_problems, run_rows
from tb.top.stimuli import Case
from tb.top.suite import VARIANTS

IN_SHORT = ("turning", "abort 300 cycles", "reset 1500", "entries of the second", "frame of the first", "a bad near")
"""Of the rows, some of each kind."""


@pytest.fixture(scope="module")
def rows():
    return [*good_rows(TINY_OVERLAP, 0), *broken_rows(TINY_OVERLAP, 0)]


@pytest.mark.long  # test_overlap_eyes.py plays rows in short on a machine that has these units, too
def test_rows_in_short(rows, tmp_path):
    short = [row for row in rows if row.name == "turning" or any(words in row.name for words in IN_SHORT[1:])]
    assert {frame.error for row in short for frame in row.frames} >= {
        ErrorCode.NONE, ErrorCode.ABORTED, ErrorCode.WRITE_ERROR, ErrorCode.BAD_SETTING}
    found = run_rows(TINY_OVERLAP, short, tmp_path)
    assert found.failures == {} and found.runs == len(short) == 11
    turning: RowResult = found.recordings["turning"]
    first = turning.frames[0].registers
    assert turning.frames[1].begun - turning.frames[0].begun < first["cycles_total_low"] / 2  # while frame 0 was rendered
    last = turning.frames[-1].registers
    both = last["cycles_table_low"] + last["cycles_geometry_low"] + last["cycles_render_low"]
    assert both > 1.15 * last["cycles_total_low"]
    _wrong_rows_are_found(short[0], turning)


def _wrong_rows_are_found(row, result):
    """One wrong bit, one wrong event, another end and a missing beat show."""
    frame: RowFrame = result.frames[2]
    colour = frame.pixels.colour.copy()
    colour[5, 7, 1] ^= 1
    for wrong in (replace(frame, pixels=frame.pixels._replace(colour=colour)),
                  replace(frame, events=frame.events | {"groups": frame.events["groups"] + 1}),
                  replace(frame, error=ErrorCode.ABORTED)):
        frames = (*result.frames[:2], wrong, *result.frames[3:])
        assert len(row_problems(row, replace(result, frames=frames))) == 1
    assert row_problems(row, result) == [] and len(row_problems(row, replace(result, reads=result.reads - 1))) == 1


@pytest.mark.long
@pytest.mark.parametrize("variant", ["tiny_overlap", "tiny_overlap_streams"])
def test_all_rows(variant, tmp_path):
    config = VARIANTS[variant]
    rows = [*good_rows(config, 1), *broken_rows(config, 1)]
    found = run_rows(config, rows, tmp_path)
    assert found.failures == {} and found.runs == len(rows)


def test_the_plans_frames_need_what_they_show(rows):
    """Bounds are those of the frame before the last, and differ from those of the frame before."""
    bounds = next(row for row in rows if row.name == "bounds")
    lists = [len(item.frame.bounds.key) for item in bounds.frames]
    assert lists[:2] == [0, 0] and max(lists) > 0
    cases = [Case(item.name, item.frame, 0, False) for item in bounds.frames]
    again = in_a_row(cases)
    assert [len(case.frame.bounds.key) for case in again] == lists
    wide = [item.frame.registers.width for item in bounds.frames]
    assert len(set(wide)) == 2


def test_how_frames_ended_is_told_from_the_register():
    none, spill, full, bad, aborted = (ErrorCode[name] for name in (
        "NONE", "SPILL_FULL", "ENTRIES_FULL", "BAD_SETTING", "ABORTED"))
    for codes, together, wanted in (
            ((none, none), 1, [none]), ((none, none), 2, [none, none]), ((spill, none), 1, [spill]), ((none, full), 1, [full]),
            ((spill, aborted), 2, [spill, aborted]), ((aborted, full), 2, [aborted, full]), ((spill, none), 2, [none, spill]),
            ((none, full), 2, [none, full]), ((none, bad), 1, [none]), ((spill, bad), 1, [spill])):
        assert [outcome(*codes, place, together) for place in range(together)] == wanted
    assert outcome(none, bad, 0, 0) is bad
