"""The units that read a model in chunks, stepped cycle by cycle (rtl/chunks).

    headers ─► ChunkHeaderReader ─► ChunkTest ─► queue ─► ChunkReader ─► decode ─► projection
                                                             │   ▲
                                                             ▼   │
                                                            memory

A header enters the chunk test every TEST_INTERVAL cycles. Chunks that are read wait in a queue; the others leave. The reader
requests the beats of one chunk after the other. A beat of compact records holds two Gaussians, which are decoded one by one.
"""

from __future__ import annotations

import numpy as np

from perf import bus, constants, datapath
from perf.bus import CHUNKS, GEOMETRY
from perf.datapath import CHUNK_TEST, DECODE, accepts, enter, fetch, set_path
from perf.kernel import step
from perf.layout import Layout
from spec.chunks import TESTED_CHUNKS
from spec.config import AcceleratorConfig

layout = Layout(datapath.layout)
layout.counters("geometry")
layout.words("""
    chunked chunks headers_asked tested queue_room queue_in queue_out flight_room flight_in flight_out run_beat run_left
    chunk_place halves""")


def prepare(
    s: np.record, count: np.ndarray, read: np.ndarray, config: AcceleratorConfig, paths: constants.Culling,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Initialises the units.

    Args:
        s: the state of the geometry phase.
        count: (chunks,) the numbers of Gaussians. read: (chunks,) bool, whether a chunk passes the test.
        config: the machine. paths: its datapaths.

    Returns:
        `chunk_read`, `chunk_first` and `chunk_points` of `step_chunks`.
    """
    s.chunked, s.chunks, s.halves = config.chunks, len(read), 2 if config.compact else 1
    s.queue_room, s.flight_room = TESTED_CHUNKS, constants.CHUNKS_IN_FLIGHT
    for place, path in ((CHUNK_TEST, paths.chunk_test), (DECODE, paths.decode)):
        set_path(s, place, path.length, path.interval, path.rows)
    points, passes = np.append(count, 0).astype(np.int64), np.append(read, True)
    return passes.astype(np.uint8), (np.cumsum(points) - points)[passes], points[passes]


@step
def chunk_requests(s):
    """A bit for each of the clients that ask for a beat and have a credit."""
    asking = 0
    if s.run_left and s.credits[GEOMETRY]:
        asking = 1 << GEOMETRY
    if s.headers_asked < s.chunks and s.credits[CHUNKS]:
        asking |= 1 << CHUNKS
    return asking


@step
def _give_points(s, t, chunk_first, chunk_points):
    """Steps the side of the chunk reader that takes beats and gives one Gaussian a cycle to the decode unit."""
    at = s.flight_out
    if at == s.flight_in:
        return
    if chunk_points[at] == 0:
        if accepts(s, DECODE, t):
            enter(s, DECODE, t)
            s.flight_out = at + 1
    elif bus.offered(s, GEOMETRY, t):
        place = s.chunk_place
        last = place + 1 == chunk_points[at]
        if accepts(s, DECODE, t):
            enter(s, DECODE, t)
            if last or s.halves == 1 or (chunk_first[at] + place) & 1:
                bus.take(s, GEOMETRY)
                s.busy_geometry += 1
            else:
                s.blocked_geometry += 1
            s.chunk_place = 0 if last else place + 1
            s.flight_out = at + last
        else:
            s.blocked_geometry += 1


@step
def _request_chunks(s, granted, base, chunk_first, chunk_points):
    """Steps the side of the chunk reader that requests beats."""
    if granted:
        bus.read(s, GEOMETRY, s.run_beat)
        s.run_beat += 1
        s.run_left -= 1
    at = s.queue_out
    if s.run_left == 0 and at != s.queue_in and s.flight_in - s.flight_out < s.flight_room:
        first, count = chunk_first[at], chunk_points[at]
        if s.halves == 1:
            s.run_beat, s.run_left = base + first, count
        elif count:
            s.run_beat = base + (first >> 1)
            s.run_left = (first + count - 1 >> 1) - (first >> 1) + 1
        s.queue_out = at + 1
        s.flight_in += 1


@step
def _test_chunks(s, t, chunk_read):
    """Steps the chunk test. The item after the last header is the frame's end, which goes the same way."""
    if s.path_full[CHUNK_TEST]:
        at = s.tested
        if chunk_read[at] == 0:
            s.path_full[CHUNK_TEST], s.tested = 0, at + 1
        elif s.queue_in - s.queue_out < s.queue_room:
            s.path_full[CHUNK_TEST], s.tested = 0, at + 1
            s.queue_in += 1
    fetch(s, CHUNK_TEST, t)
    entered, chunks = s.path_in[CHUNK_TEST], s.chunks
    if entered <= chunks and accepts(s, CHUNK_TEST, t):
        if entered == chunks:
            enter(s, CHUNK_TEST, t)
        elif bus.offered(s, CHUNKS, t):
            bus.take(s, CHUNKS)
            enter(s, CHUNK_TEST, t)


@step
def step_chunks(s, t, reader, header_base, geometry_base, chunk_read, chunk_first, chunk_points):
    """Steps all units before projection, which has taken its input of this cycle. `reader` is the client whose read was
    granted.

    Of the chunks that are read and the frame's end, `chunk_first` are the first indices, and `chunk_points` the numbers of
    Gaussians, 0 at the end. `chunk_read` says of each header, and of the end, whether it passes the test.
    """
    fetch(s, DECODE, t)
    _give_points(s, t, chunk_first, chunk_points)
    _request_chunks(s, reader == GEOMETRY, geometry_base, chunk_first, chunk_points)
    _test_chunks(s, t, chunk_read)
    if reader == CHUNKS:
        bus.read(s, CHUNKS, header_base + s.headers_asked)
        s.headers_asked += 1
