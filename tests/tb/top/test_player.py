"""Whole-frame testbench on a stand-in for the machine: frames come back, faults are found, memory is as fast as it says."""

from dataclasses import replace

import numpy as np
import pytest

from golden.host.memory_image import memory_image, read_frame
from golden.msv2_ref import pipeline
from spec.codes import ErrorCode
from spec.config import TINY
from spec.memory import page_beats
from tb.common import runner
from tb.top.memory import LEAST_BEATS, MemorySpeed, memory_beats
from tb.top.player import FrameRun, play_frames
from tests.helpers.golden_samples import random_model, view
from tests.helpers.stand_in_machine import MISALIGNS, OVERWRITES, STOPS, STRAYS, WITHDRAWS, WRONG_PIXEL, stand_in

WIDTH, HEIGHT = 36, 27
FAST = MemorySpeed(latency=1, bytes_per_cycle=None)


def image_of(seed: int, more_beats: int = 0, **options):
    frame = pipeline.render(random_model(np.random.default_rng(seed), 600), view(WIDTH, HEIGHT), config=TINY)
    entries = page_beats(np.diff(frame.entries.start)) + more_beats
    return memory_image(TINY, frame.words, frame.registers, entries_beats=entries, spill_beats=10, **options)


FIRST, SECOND, DISPLAY = image_of(1, beta=0), image_of(2, beta=0), image_of(3, beta=0, display=True)
RUNS = {
    "first": FrameRun("first", FIRST),
    "second": FrameRun("second", SECOND, FAST, reset=False, poison=False),
    "for displays": FrameRun("for displays", DISPLAY, reset=False),
    "slow": FrameRun("slow", FIRST, MemorySpeed(latency=7, bytes_per_cycle=3.2), reset=False),
    "far": FrameRun("far", SECOND, MemorySpeed(latency=90, bytes_per_cycle=None)),
    "pauses": FrameRun("pauses", FIRST, MemorySpeed(latency=3, pauses=120)),
    "read error": FrameRun("read error", FIRST, MemorySpeed(failing=(32 * 60, 32 * 61))),
    "aborted": FrameRun("aborted", FIRST, reset=False, abort=50),
    "cut": FrameRun("cut", FIRST, cut=60),
    "after the cut": FrameRun("after the cut", SECOND),
    "stops": FrameRun("stops", FIRST, changes={"beta": STOPS}),
    "withdraws": FrameRun("withdraws", FIRST, MemorySpeed(pauses=100), changes={"beta": WITHDRAWS}),
    "misaligns": FrameRun("misaligns", FIRST, changes={"beta": MISALIGNS}),
    "strays": FrameRun("strays", FIRST, changes={"beta": STRAYS}),
    "overwrites": FrameRun("overwrites", FIRST, changes={"beta": OVERWRITES}),
    "wrong pixel": FrameRun("wrong pixel", FIRST, changes={"beta": WRONG_PIXEL}),
}
BEATS = WIDTH * HEIGHT // 2


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    played = play_frames(stand_in(TINY), list(RUNS.values()), tmp_path_factory.mktemp("player"), watchdog=2000)
    return dict(zip(RUNS, played, strict=True))


def expected(run):
    display = bool(run.image.settings["display"])
    return read_frame(TINY, run.image.contents["geometry"][:BEATS].reshape(-1), WIDTH, HEIGHT, display=display)


def test_frames_of_every_size_share_a_build(results, tmp_path, monkeypatch):
    """A memory twice as large needs no other simulator, and gives the same frame."""
    large = image_of(1, more_beats=LEAST_BEATS, beta=0)
    assert memory_beats(large.beats) > memory_beats(FIRST.beats)
    monkeypatch.setattr(runner, "_build", lambda *_: pytest.fail("a simulator is built anew"))
    played, = play_frames(stand_in(TINY), [FrameRun("large", large)], tmp_path, watchdog=2000)
    assert played.done and not played.errors
    for found, wanted in zip(played.pixels, results["first"].pixels, strict=True):
        assert np.array_equal(found, wanted)


@pytest.mark.parametrize("name", ["first", "second", "for displays", "slow", "far", "pauses", "after the cut"])
def test_a_frame_comes_back_with_its_counters(results, name):
    result = results[name]
    assert result.errors == () and result.done and result.error is ErrorCode.NONE
    for got, wanted in zip(result.pixels, expected(RUNS[name]), strict=True):
        assert got.shape[:2] == (HEIGHT, WIDTH) and (got == wanted).all()
    assert result.reads == result.writes == (-(-BEATS // 4) if name == "for displays" else BEATS)
    assert result.registers["cycles_total"] >> 32 == 7
    assert abs(result.cycles - (result.registers["cycles_total"] & 0xFFFFFFFF)) < 5


def test_memory_is_as_fast_as_it_says(results):
    beats = 2 * BEATS
    assert abs(results["slow"].cycles - 10 * beats) < 60  # 3.2 of 32 bytes a cycle
    assert 0 <= results["first"].cycles - 2 * BEATS - 200 < 60  # a read every other cycle, latency out and back
    assert results["second"].cycles < 2 * BEATS + 10 < results["far"].cycles < 2 * BEATS + 200
    assert 10 * (beats - 3) < results["slow"].busy <= results["slow"].cycles
    assert results["pauses"].cycles > 2.5 * BEATS


def test_early_ends_are_told(results):
    assert not results["read error"].done and results["read error"].error is ErrorCode.READ_ERROR
    assert results["aborted"].error is ErrorCode.ABORTED and results["aborted"].writes < BEATS
    assert results["cut"].registers == {} and results["cut"].writes < BEATS


@pytest.mark.parametrize(("name", "says"), [
    ("stops", "nothing moved on the bus for the length of the watchdog"),
    ("withdraws", "an address or data changed, or was withdrawn, while valid and not ready"),
    ("misaligns", "a transaction is not one aligned beat"),
    ("strays", "an address lies outside memory"),
    ("overwrites", "a write lies in what the host filled"),
])
def test_broken_rules_are_found(results, name, says):
    assert results[name].errors == (says,)


def test_one_wrong_bit_shows(results):
    wrong = results["wrong pixel"].pixels.colour != expected(RUNS["wrong pixel"]).colour
    assert np.argwhere(wrong).tolist() == [[0, 6, 0]] and results["wrong pixel"].errors == ()


def test_small_frames_with_independent_models_of_axi(tmp_path):
    pytest.importorskip("cocotbext.axi")
    from tb.top.axi_small import play_small

    runs = [RUNS[name] for name in ("first", "second", "pauses", "aborted", "cut", "after the cut", "wrong pixel", "stops")]
    played = play_small(stand_in(TINY), runs, tmp_path, watchdog=500)
    for run, result in zip(runs, played, strict=True):
        same = all((got == wanted).all() for got, wanted in zip(result.pixels, expected(run), strict=True))
        good = run.name in ("first", "second", "pauses", "after the cut")
        assert same == good and result.done == (good or run.name == "wrong pixel"), run.name
        assert bool(result.errors) == (run.name == "stops")
    assert played[3].error is ErrorCode.ABORTED
    with pytest.raises(ValueError, match="failing addresses"):
        play_small(stand_in(TINY), [RUNS["read error"]], tmp_path)


def test_bad_orders_are_refused(tmp_path):
    machine = stand_in(TINY)
    with pytest.raises(ValueError, match="'bta'"):
        play_frames(machine, [FrameRun("x", FIRST, changes={"bta": 1})], tmp_path)
    with pytest.raises(ValueError, match="one configuration"):
        play_frames(machine, [FrameRun("x", FIRST), FrameRun("y", replace(FIRST, config=TINY.with_(name="b")))], tmp_path)
    with pytest.raises(ValueError, match=r"latency must be in 1..1048576, not 0"):
        MemorySpeed(latency=0)
    with pytest.raises(TypeError, match=r"pauses must be an integer, not 1.5"):
        MemorySpeed(pauses=1.5)
    with pytest.raises(ValueError, match=r"bytes_per_cycle must be None or in 0.01..64, which the bus moves at most, not 0"):
        MemorySpeed(bytes_per_cycle=0)
