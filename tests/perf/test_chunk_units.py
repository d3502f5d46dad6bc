"""Machines that read models in chunks, in the cycle model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.scenes.load import EMBEDDED
from golden.scenes.request import parse_request
from perf import geometry
from perf.model import MemoryModel, simulate
from perf.trace import EyeTrace, FrameTrace, load_trace, save_trace, trace_request
from spec.chunks import CHUNK, TEST_INTERVAL
from spec.config import PAPER, V3_RECORDS
from spec.memory import BEAT_BYTES

WIDE = PAPER.with_(name="wide", order="spatial", chunks=True)
FAST = MemoryModel(bytes_per_cycle=None)


@pytest.fixture(scope="module")
def v3() -> FrameTrace:
    args = parse_request(EMBEDDED, "--size", "128x96", "--gaze", "64,48", "--levels", "4", "--levels-from", "random")
    return trace_request(args, V3_RECORDS)


def cut(trace: FrameTrace, counts: np.ndarray, read: np.ndarray) -> FrameTrace:
    """A frame of chunks of so many Gaussians, all of them behind the camera."""
    eye, points = trace.eyes[0], int(counts.sum())
    tiles = len(eye.counts)
    classes = np.full(points + 1, geometry.NEAR_CULLED, np.uint8)
    classes[:-1][~np.repeat(read, counts)] = geometry.UNREAD
    classes[-1] = geometry.VISIBLE
    nothing = {name: getattr(eye, name)[:0] for name in ("survivor", "views", "tile", "splat", "use", "rank")}
    empty = replace(eye, **nothing, point_class=classes, splat_steps=np.ones(1, np.int32), step_runs=np.ones(1, np.uint8),
                    run_entries=np.zeros(1, np.uint8), run_closes=np.full(1, geometry.ENDS, np.uint8),
                    counts=np.zeros(tiles, np.int32), stop=np.full((tiles, 2), -1, np.int32),
                    chunk_count=counts.astype(np.uint8), chunk_read=read)
    assert isinstance(empty, EyeTrace)
    return replace(trace, points=points, eyes=(empty,))


def beats(counts: np.ndarray, read: np.ndarray) -> int:
    """Beats of compact records: two Gaussians lie in a beat, so that chunks with an odd index at an end share one."""
    last = np.cumsum(counts) - 1
    return int((last[read] // 2 - (last - counts + 1)[read] // 2 + 1).sum())


@pytest.mark.parametrize("config", (WIDE, V3_RECORDS))
@pytest.mark.parametrize("memory", (MemoryModel(), MemoryModel("lpddr3")))
def test_the_beats_are_those_of_the_headers_and_of_the_chunks_that_are_read(v3, config, memory):
    random = np.random.default_rng(3)
    counts, read = random.integers(1, CHUNK + 1, 300), random.random(300) < 0.4
    frame = simulate(cut(v3, counts, read), config, memory=memory)
    assert frame.reads["chunks"] == BEAT_BYTES * len(counts)
    assert frame.reads["geometry"] == BEAT_BYTES * (beats(counts, read) if config.compact else counts[read].sum())
    assert frame.stages["geometry"].busy * BEAT_BYTES == frame.reads["geometry"]
    assert frame.stages["projection"].busy == counts[read].sum() + 1


def test_a_chunk_is_tested_in_every_interval_and_a_point_enters_in_every_cycle(v3):
    counts = np.full(400, CHUNK)
    none = simulate(cut(v3, counts, np.zeros(400, bool)), V3_RECORDS, memory=FAST).phases["geometry"]
    assert TEST_INTERVAL * 400 <= none <= TEST_INTERVAL * 400 + 400
    every = simulate(cut(v3, counts, np.ones(400, bool)), V3_RECORDS, memory=FAST).phases["geometry"]
    assert 400 * CHUNK <= every <= 1.01 * 400 * CHUNK + 400
    eighth = simulate(cut(v3, counts, np.arange(400) % 8 == 0), V3_RECORDS, memory=FAST).phases["geometry"]
    assert max(400 * TEST_INTERVAL, 400 * CHUNK / 8) <= eighth <= 1.1 * 400 * TEST_INTERVAL + 400


def test_chunks_that_wait_hide_a_run_of_skipped_ones(v3):
    """Eight tested chunks take as long to read as 64 to test, so memory has no pause where survivors cluster."""
    read = np.tile(np.arange(72) < 8, 40)
    cycles = simulate(cut(v3, np.full(len(read), CHUNK), read), V3_RECORDS, memory=FAST).phases["geometry"]
    assert cycles <= 1.15 * max(len(read) * TEST_INTERVAL, read.sum() * CHUNK) + 400


def test_a_model_of_nothing_and_one_whose_chunks_are_all_skipped_end(v3):
    for counts in (np.zeros(0, np.int64), np.full(1, 1)):
        frame = simulate(cut(v3, counts, np.zeros(len(counts), bool)), V3_RECORDS)
        assert frame.reads["geometry"] == 0
        assert frame.phases["geometry"] < 1000


def test_real_frames_read_the_chunks_that_the_golden_renderer_reads(v3, tmp_path):
    eye = v3.eyes[0]
    counts = eye.chunk_count.astype(np.int64)
    assert counts.sum() == v3.points
    unread = eye.point_class[:-1] == geometry.UNREAD
    np.testing.assert_array_equal(np.repeat(eye.chunk_read, counts), ~unread)
    assert not unread[eye.survivor].any()
    assert v3.points_read == (~unread).sum()
    frame = simulate(v3, V3_RECORDS)
    assert frame.reads["geometry"] == BEAT_BYTES * beats(counts, eye.chunk_read)
    assert frame.reads["colour"] == BEAT_BYTES * 2 * len(eye.survivor)
    save_trace(v3, tmp_path / "trace.npz")
    again = load_trace(tmp_path / "trace.npz")
    assert again is not None and again.chunked
    assert simulate(again, V3_RECORDS).total == frame.total


def test_a_trace_and_a_machine_must_agree_on_chunks(v3):
    with pytest.raises(ValueError, match="config must be a machine with chunks, like the trace, not 'paper'"):
        simulate(v3, PAPER)
    plain = replace(v3, chunked=False)
    with pytest.raises(ValueError, match="config must be a machine without chunks, like the trace, not 'v3_records'"):
        simulate(plain, V3_RECORDS)
