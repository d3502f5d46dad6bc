"""Hard cases of super-tiles on the machine with four streams: empty super-tiles, tiles that stop early, blend tiles of which
one bank stops, and super-tiles that the frame's edges cut."""

from __future__ import annotations

import numpy as np
import pytest

from golden.host.quantise import quantise_model
from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.pipeline import render
from msv2.cases.supertiles import BACKGROUND, CASES
from spec.config import TINY_STREAMS, TINY_V3
from tb.top.planned import planned
from tb.top.stimuli import Case
from tb.top.suite import run_plan


def frames_of(case):
    """The case's frames with four streams. Their pixels are those with one."""
    found = {}
    for label, shot in case.supertiles().items():
        one, four = (render(quantise_model(config, shot.model), shot.camera, config=config, foveation=shot.foveation,
                            background=BACKGROUND) for config in (TINY_V3, TINY_STREAMS))
        assert all(np.array_equal(a, b) for a, b in zip(one.pixels, four.pixels, strict=True))
        found[f"{case.name}: {label}"] = four
    return found


@pytest.mark.long
def test_hard_cases_of_super_tiles_are_bit_exact(tmp_path):
    frames = {name: frame for case in CASES for name, frame in frames_of(case).items()}
    assert max(len(FrameBatches(frame).batches.supertile) for frame in frames.values()) > 8
    plan = [planned(Case(name, frame, None, False), reset=False, poison=False) for name, frame in frames.items()]
    outcome = run_plan(TINY_STREAMS, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == len(frames) == 10
    visits = sum(result.registers["visits"] for result in outcome.recordings.values())
    every = sum(len(FrameBatches(frame).stream_visits(q).tile) for frame in frames.values() for q in range(4))
    assert 0 < visits < every  # regions that have stopped are left out
