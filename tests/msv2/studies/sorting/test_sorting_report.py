"""The report of how fast scenes' frames are sorted: its numbers are those of today's frames."""

from __future__ import annotations

import json

import numpy as np
import pytest

from msv2.studies.sorting.study import REPORT, SIZES, group_lengths, row_of
from spec.config import PAPER
from tb.common.exact import Outcome, Planned
from tb.common.player import Recording
from tb.common.scenes import traced_frame
from tb.sort_tmu.chunk_stimuli import items_of, random_chunk, whole_groups
from tb.sort_tmu.hierarchical_suite import LATENCY, plan_of


def rows() -> dict[str, dict]:
    return {row["frame"]: row for row in json.loads(REPORT.read_text())["rows"]}


def test_groups_lengths_count_no_empty_item() -> None:
    lengths = [3, 0, 1, 0, 0, 7, 2]
    items = items_of(PAPER, [np.zeros((length, 3), int) for length in lengths])
    assert group_lengths(items).tolist() == lengths


def given(item: Planned, taken: int, stalled: int) -> dict[str, object]:
    """The row of a run that was not simulated."""
    recording = Recording(
        outputs={}, items={"groups": taken}, stalls={"groups": stalled}, observed=dict(item.observed), cycles=9, seconds=0.0,
        errors=())
    return row_of(PAPER, item, Outcome(recordings={item.name: recording}))


def test_large_groups_are_those_that_the_buffer_does_not_hold() -> None:
    top, rng = PAPER.sort_chunk, np.random.default_rng(0)
    groups = [random_chunk(PAPER, rng, length, "random") for length in (top, top + 1, 5, 2 * top)]
    row = given(plan_of(PAPER, "traced large", groups), 3, 1)
    assert row == {
        "frame": "large", "entries": 4 * top + 6, "groups": 4, "large_groups": 2, "entries_in_large_groups": 3 * top + 1,
        "entries_written": 3 * top + 1, "taken_per_cycle": 0.75, "cycles": 9}


@pytest.mark.parametrize(("gaze", "levels"), [("none", None), ("50,40", PAPER.levels)])
def test_the_report_is_of_the_frames_of_today(gaze: str, levels: int | None) -> None:
    """All but cycles, which the simulation gave; entries written are the plan's, which it was compared with."""
    name, frame = traced_frame(PAPER, "embedded", SIZES[0], gaze, levels)
    entries = len(frame.entries.splat)
    row, there = given(plan_of(PAPER, f"traced {name}", whole_groups(frame)), entries, entries), rows()[name]
    assert row.pop("taken_per_cycle") == 0.5 and row.pop("cycles") == 9
    assert row == {key: there[key] for key in row} and row["entries"] == entries


def test_rows_agree_with_themselves() -> None:
    report = json.loads(REPORT.read_text())
    assert (report["config"], report["buffer_entries"], report["latency"]) == (PAPER.name, PAPER.sort_chunk, LATENCY)
    assert len(report["rows"]) == 6 * len(SIZES)
    for row in report["rows"]:
        large = row["entries_in_large_groups"]
        assert row["large_groups"] * report["buffer_entries"] < large if large else row["large_groups"] == 0
        assert large <= row["entries_written"] <= 2 * large and row["cycles"] >= row["entries"] / row["taken_per_cycle"] - 1
        assert large or row["taken_per_cycle"] == 1
