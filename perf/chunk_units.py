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

from golden.msv2_ref.supertiles import chunk_order
from perf import bus, constants, datapath
from perf.bus import CHUNKS, GEOMETRY
from perf.datapath import CHUNK_TEST, accepts, enter, fetch, set_path
from perf.kernel import step
from perf.layout import Layout
from spec.chunks import TESTED_CHUNKS
from spec.config import AcceleratorConfig
from spec.queues import CHUNKS_AHEAD

layout = Layout(datapath.layout)
layout.counters("geometry")
layout.words("""
    chunked chunks headers_asked tested queue_in queue_out flight_in flight_out run_beat run_left chunk_place halves
    decode_pipe point_taken""")
_QUEUE, _FLIGHT = 1 << (TESTED_CHUNKS - 1).bit_length(), 1 << CHUNKS_AHEAD.bit_length()
layout.ring("queue_times", _QUEUE)
layout.ring("flight_times", _FLIGHT)
_QUEUE_LATENCY = 2  # cycles from an item's entry into a buffered queue until it is offered
_IN_USE = 1  # the header of the chunk whose Gaussians come is in registers behind its queue
_DECODED = constants.DECODE_STAGES - 1


def prepare(
    s: np.record, count: np.ndarray, read: np.ndarray, config: AcceleratorConfig, paths: constants.Culling, eyes: int = 1,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Initialises the units.

    Args:
        s: the state of the geometry phase.
        count: (chunks,) the numbers of Gaussians. read: (chunks,) bool, whether a chunk passes the test.
        config: the machine. paths: its datapaths.
        eyes: how often every chunk is tested: twice in joint frames of two eyes.

    Returns:
        `chunk_at`, `chunk_read`, `chunk_first` and `chunk_points` of `step_chunks`.
    """
    s.chunked, s.chunks, s.halves = config.chunks, len(read), 2 if config.compact else 1
    set_path(s, CHUNK_TEST, paths.chunk_test.length, paths.chunk_test.interval * eyes, paths.chunk_test.rows)
    order = chunk_order(len(read)) if config.supertiles else np.arange(len(read))
    turn, passes = np.append(order, len(read)), np.append(read[order], True)  # the end is the last item
    points = np.append(count, 0).astype(np.int64)
    first = np.cumsum(points) - points
    return order, passes.astype(np.uint8), first[turn][passes], points[turn][passes]


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
def _arrives(s, t, chunk_points):
    """Whether the chunk reader has an item: the next Gaussian of a beat that has come, or the frame's end."""
    at = s.flight_out
    if at == s.flight_in or s.flight_times[at & _FLIGHT - 1] > t:
        return False
    return chunk_points[at] == 0 or bus.offered(s, GEOMETRY, t)


@step
def decoded(s):
    """Whether the decode unit offers a Gaussian of a compact record."""
    return s.decode_pipe >> _DECODED & 1 != 0


@step
def offers_point(s, t, chunk_points):
    """Whether an item is offered to projection. `point_taken` must then say whether it is taken."""
    s.point_taken = 0
    if s.halves > 1:
        return decoded(s)
    return _arrives(s, t, chunk_points)


@step
def _give_points(s, t, chunk_first, chunk_points):
    """Steps the decode unit, whose stages all wait for the last one, and the chunk reader's items, which go there. Wide records
    go straight to projection."""
    waits = bus.offered(s, GEOMETRY, t)
    moves = s.point_taken
    if s.halves > 1:
        advance = moves or s.decode_pipe >> _DECODED & 1 == 0
        moves = advance and _arrives(s, t, chunk_points)
        if advance:
            s.decode_pipe = (s.decode_pipe << 1 | moves) & (2 << _DECODED) - 1
    if moves:
        at, place = s.flight_out, s.chunk_place
        last = place + 1 >= chunk_points[at]
        if chunk_points[at] and (last or s.halves == 1 or (chunk_first[at] + place) & 1):
            bus.take(s, GEOMETRY)
            s.busy_geometry += 1
            waits = False
        s.chunk_place = 0 if last else place + 1
        s.flight_out = at + last
    s.blocked_geometry += waits


@step
def _request_chunks(s, t, granted, base, chunk_first, chunk_points):
    """Steps the side of the chunk reader that requests beats."""
    if granted:
        bus.read(s, GEOMETRY, s.run_beat)
        s.run_beat += 1
        s.run_left -= 1
    at, room = s.queue_out, s.flight_in - s.flight_out < CHUNKS_AHEAD + _IN_USE
    if s.run_left == 0 and room and at != s.queue_in and s.queue_times[at & _QUEUE - 1] <= t:
        first, count = chunk_first[at], chunk_points[at]
        if s.halves == 1:
            s.run_beat, s.run_left = base + first, count
        elif count:
            s.run_beat = base + (first >> 1)
            s.run_left = (first + count - 1 >> 1) - (first >> 1) + 1
        s.queue_out = at + 1
        s.flight_times[s.flight_in & _FLIGHT - 1] = t + _QUEUE_LATENCY + _IN_USE
        s.flight_in += 1


@step
def _test_chunks(s, t, chunk_read):
    """Steps the chunk test. The item after the last header is the frame's end, which goes the same way."""
    if s.path_full[CHUNK_TEST]:
        at = s.tested
        if chunk_read[at] == 0:
            s.path_full[CHUNK_TEST], s.tested = 0, at + 1
        elif s.queue_in - s.queue_out < TESTED_CHUNKS:
            s.path_full[CHUNK_TEST], s.tested = 0, at + 1
            s.queue_times[s.queue_in & _QUEUE - 1] = t + _QUEUE_LATENCY
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
def step_chunks(s, t, reader, header_base, geometry_base, chunk_at, chunk_read, chunk_first, chunk_points):
    """Steps all units before projection, which has taken its input of this cycle. `reader` is the client whose read was
    granted.

    `chunk_at` are the chunks' numbers in the order in which their headers are read. Of the chunks that are read and the
    frame's end, `chunk_first` are the first indices, and `chunk_points` the numbers of
    Gaussians, 0 at the end. `chunk_read` says of each header, and of the end, whether it passes the test.
    """
    _give_points(s, t, chunk_first, chunk_points)
    _request_chunks(s, t, reader == GEOMETRY, geometry_base, chunk_first, chunk_points)
    _test_chunks(s, t, chunk_read)
    if reader == CHUNKS:
        bus.read(s, CHUNKS, header_base + chunk_at[s.headers_asked])
        s.headers_asked += 1
