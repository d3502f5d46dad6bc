"""Frames in a row: what the command accepts, the bounds that follow each other, and what is told of them."""

import json
from itertools import pairwise

import numpy as np
import pytest

from golden.host.run_options import MEMORIES
from golden.msv2_ref.buckets import next_bounds
from golden.msv2_ref.plan import work_for
from golden.scenes.request import resolve
from msv2.studies.model import study
from spec.config import PAPER, TINY, TINY_V3, V3
from spec.errors import InputError
from tb.frame import __main__ as command
from tb.frame.row import TURN, check_row, golden_row, row_numbers

SCENE = ("embedded", "--size", "64x32", "--camera", "orbit")


def arguments(*more):
    return command._arguments([*SCENE, *more])


@pytest.mark.parametrize(("more", "message"), [
    (("--frames", "0"), "frames 0 is not accepted: 1..100 is"), (("--frames", "101"), "frames 101 is not accepted"),
    (("--turn", "3"), "turn 3 is not accepted with one frame"),
    (("--frames", "2", "--turn", "nan"), "turn nan is not accepted: -180..180 degrees are"),
    (("--frames", "2", "--turn", "-181"), "turn -181 is not accepted"),
    (("--frames", "2", "--stereo"), "frames 2 is not accepted with two eyes"),
    (("--frames", "2", "--part", "array"), "frames 2 is not accepted with two eyes or with part 'array'"),
])
def test_what_makes_no_row_is_refused(more, message):
    with pytest.raises(InputError, match=message):
        check_row(arguments(*more))


def test_one_frame_and_the_turn_of_a_head_are_the_defaults():
    args = arguments("--frames", "3")
    check_row(args)
    assert (arguments().frames, args.turn) == (1, TURN)


def test_each_frame_has_the_bounds_of_the_one_before_and_a_turned_camera():
    args = arguments("--frames", "3")
    for config in (TINY_V3, PAPER):
        work = work_for(args, resolve(args), config)
        frames = golden_row(work, 3, 4.0, beta=None)
        colours = [frame.pixels.colour for frame in frames]
        assert not np.array_equal(colours[0], colours[1]) and not np.array_equal(colours[1], colours[2])
        if not config.supertiles:
            assert all(frame.pairs is None for frame in frames)
            continue
        assert len(frames[0].bounds.key) == 0
        for before, frame in pairwise(frames):
            wanted = next_bounds(config, before.pairs.start, before.pairs.depth_key)
            assert len(wanted.key) > 1 and np.array_equal(frame.bounds.key, wanted.key)
        assert not np.array_equal(frames[1].bounds.key, frames[2].bounds.key)


def test_an_error_in_any_frame_is_told():
    right = {"bit_exact": True, "pixels_checked": 5, "mismatches": 0, "first_mismatches": [], "stream_errors": (),
             "counter_errors": [], "cycles": 10}
    wrong = right | {"bit_exact": False, "mismatches": 2, "first_mismatches": [{"x": 1}], "counter_errors": ["counter ops"],
                     "cycles": 11}
    assert row_numbers([right], TURN) == right
    told = row_numbers([wrong, right], 3.0)
    assert not told["bit_exact"] and (told["mismatches"], told["pixels_checked"], told["cycles"]) == (2, 10, 10)
    assert told["first_mismatches"] == [{"x": 1, "frame": 0}] and told["counter_errors"] == ["frame 0: counter ops"]
    assert [(each["cycles"], each["turned"]) for each in told["frames"]] == [(11, 0.0), (10, 3.0)]
    assert row_numbers([right, right], 3.0)["bit_exact"]


def test_the_model_study_renders_the_frames_of_one_configuration():
    lines = study.lines_of(MEMORIES, V3.name)
    assert all(f"--config {V3.name} --frames" in line for line in lines)
    assert {"--memory lpddr3" in line for line in lines} == {True, False}
    assert set(lines) < set(study.lines_of(MEMORIES, None)) and lines == [
        line for kind in MEMORIES for line in study.lines_of([kind], V3.name)]
    assert study.lines_of(MEMORIES, "tiny") and study.lines_of(MEMORIES, TINY_V3.name) == []


@pytest.mark.long
@pytest.mark.parametrize(("config", "memory"), [(TINY_V3, "ideal"), (TINY_V3, "lpddr3"), (TINY, "ideal")],
                         ids=lambda value: getattr(value, "name", value))
def test_rows_are_bit_exact_and_take_the_models_cycles(config, memory, tmp_path):
    row = ("--frames", "2", "--turn", "5")
    options = (*row, "--config", config.name, "--machine", "full", "--memory", memory, "--out", str(tmp_path))
    assert command.main([*SCENE, *options]) == 0
    report = json.loads((tmp_path / "frame.json").read_text())
    assert report["bit_exact"] and report["counter_errors"] == [] and report["pixels_checked"] == 2 * 64 * 32
    assert {path.name for path in tmp_path.iterdir()} == {"frame.json", "frame_0.png", "frame_1.png", "sim"}
    first, second = report["frames"]
    assert first["frame_cycles"] != second["frame_cycles"]
    if config.supertiles:
        assert first["lists"] == 1 < second["lists"]
        rows = [report | numbers | {"number": number} for number, numbers in enumerate(report["frames"])]
        for row, _, cycles in study.model_rows(rows, lambda name: SCENE[0]):
            got = study.compared(row, cycles)
            assert abs(got["total"]["error"]) <= study.TOTAL_GOAL and got["misses_equal"]
            assert all(stage["busy_equal"] for stage in got["stages"].values())
            assert got["beats_equal"]
