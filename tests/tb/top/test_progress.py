"""The progress bar of a frame: it moves in both phases, never back, and its estimates are near the RTL's cycles."""

import json

import pytest

from golden.msv2_ref import pipeline
from golden.scenes.request import parse_request, resolve
from spec.config import PAPER, TINY
from spec.paths import REPORTS
from tb.top.expected import expected_pass
from tb.top.memory import MemorySpeed
from tb.top.progress import Pass, Progress

ONE = Pass(geometry_beats=1000, geometry_cycles=8000, render_cycles=2000, pixels=400)
OTHER = Pass(geometry_beats=500, geometry_cycles=4000, render_cycles=1000, pixels=100)


def test_it_moves_in_both_phases():
    progress = Progress([ONE])
    assert progress.total == 10_000 and progress.done == 0
    seen = []
    for beats, pixels in ((0, 0), (500, 0), (1000, 0), (1100, 100), (1300, 400)):
        progress.see(beats, pixels)
        seen.append((progress.done, progress.phase))
    assert seen == [(0, "geometry"), (4000, "geometry"), (8000, "geometry"), (8500, "rendering"), (10_000, "rendering")]


def test_more_beats_than_expected_do_not_pass_the_phase():
    progress = Progress([ONE])
    progress.see(9999, 0)
    assert progress.done == 8000
    progress.see(9999, 1)
    assert progress.done == 8005


def test_it_never_moves_back():
    progress = Progress([ONE])
    progress.see(900, 0)
    progress.see(100, 0)
    assert progress.done == 7200


def test_the_second_pass_has_a_geometry_phase_of_its_own():
    progress = Progress([ONE, OTHER])
    seen = []
    for beats, pixels in ((1000, 0), (1500, 399), (1600, 400), (1850, 400), (2300, 450), (2400, 500)):
        progress.see(beats, pixels)
        seen.append((progress.done, progress.phase))
    assert seen == [(8000, "geometry"), (9995, "rendering"), (10_000, "geometry"), (12_000, "geometry"), (14_500, "rendering"),
                    (15_000, "rendering")]
    assert progress.total == 15_000


def test_nothing_to_do_is_done():
    progress = Progress([Pass(0, 0, 0, 0)])
    progress.see(0, 0)
    assert progress.total == progress.done == 0


def test_a_small_machine_is_limited_by_its_units():
    """The tiny machine's geometry phase took 258,139 cycles in the RTL for this frame."""
    request = resolve(parse_request("embedded", "--size", "64x48", "--gaze", "30,20", "--levels", "4"))
    frame = pipeline.render(request.model, request.camera, config=TINY, foveation=request.foveation)
    assert expected_pass(frame, MemorySpeed(), display=False).geometry_cycles == pytest.approx(258_139, rel=0.1)


ROWS = [row for row in json.loads((REPORTS / "frames.json").read_text())["rows"] if row["scene"] == "embedded"]


@pytest.mark.parametrize("gaze", [None, "64,64"])
def test_the_estimates_are_near_the_cycles_of_the_rtl(gaze):
    """Of the kept frames of the embedded scene, which the command of the report names."""
    row = next(row for row in ROWS if (row["gaze"] is None) == (gaze is None) and row["bytes_per_cycle"] is not None)
    options = ["--gaze", gaze, "--levels", str(row["levels"])] if gaze else []
    size = "x".join(map(str, row["size"]))
    request = resolve(parse_request("embedded", "--size", size, *options))
    frame = pipeline.render(request.model, request.camera, config=PAPER, foveation=request.foveation)
    assert len(frame.entries.splat) == row["entries"]
    found = expected_pass(frame, MemorySpeed(), display=False)
    assert found.geometry_cycles == pytest.approx(row["geometry_cycles"], rel=0.02)
    assert found.render_cycles == pytest.approx(row["render_cycles"], rel=0.2)
    beats = sum(row["dram_bytes"][way][client] for way, client in (
        ("reads", "geometry"), ("reads", "tiles"), ("reads", "colour"), ("writes", "entries"), ("writes", "views"))) / 32
    assert found.geometry_beats == pytest.approx(beats, rel=0.02)
