"""The study of combinations: its machines and frames are all of them, and so are the rows of its report."""

from __future__ import annotations

from itertools import product

import pytest

from golden.scenes.files import read_json
from msv2.studies.overlap import combinations
from msv2.studies.results.report_tables import combinations_table
from spec.paths import REPORTS

EVERY = set(product((1, 4), (False, True), (1, 2), (False, True)))
"""Streams, overlapped phases, eyes, and packed frames."""


def test_machines_and_frames_are_every_combination() -> None:
    found = {(config.streams, config.overlap, eyes, packed)
             for config, (eyes, packed) in product(combinations.machines(), combinations.FRAMES)}
    assert found == EVERY and all(config.packed and config.joint for config in combinations.machines())
    assert len({config.name for config in combinations.machines()}) == len(combinations.machines())


def test_the_report_has_a_row_of_each_which_is_exact_and_within_two_percent_of_the_model() -> None:
    kept = read_json(REPORTS / "combinations.json")
    rows = kept["rows"]
    assert {(row["streams"], row["overlap"], row["eyes"], row["packed"]) for row in rows} == EVERY and len(rows) == len(EVERY)
    for row in rows:
        assert row["problems"] == [] and row["frames"] == len(combinations.IN_SHORT)
        assert row["model_over_rtl"] == pytest.approx(row["model"] / row["cycles"]) and abs(row["model_over_rtl"] - 1) < 0.02
    assert kept["summary"] == {
        "combinations": len(EVERY), "frames": sum(row["frames"] for row in rows), "differences": 0,
        "model_error": max(abs(row["model_over_rtl"] - 1) for row in rows)}
    text = combinations_table({"combinations": kept})
    assert text is not None and "NO" not in text and combinations_table({}) is None
    assert "| NO |" in combinations_table({"combinations": kept | {"rows": [rows[0] | {"problems": ["a pixel"]}]}})


def test_overlap_and_packing_and_the_second_eye_do_what_they_are_for() -> None:
    """Frames follow each other faster with overlapped phases, and slower with two eyes."""
    cycles = {(row["streams"], row["overlap"], row["eyes"], row["packed"]): row["cycles"]
              for row in read_json(REPORTS / "combinations.json")["rows"]}
    for streams, packed in product((1, 4), (False, True)):
        for eyes in (1, 2):
            assert cycles[streams, True, eyes, packed] < cycles[streams, False, eyes, packed]
        for overlap in (False, True):
            assert cycles[streams, overlap, 1, packed] < cycles[streams, overlap, 2, packed]
