"""The AXI master with its read queues, and the test bench's memory (tb/top/memory.sv), stepped cycle by cycle.

A read that is granted in cycle c is on AR in cycle c + 1 and is in memory at the end of that cycle. A write passes a register
more: it is in memory a cycle later. If a read is answered at the end of cycle p, its beat passes R, the master's register and
the read queue, and is offered to its client in cycle p + 4. A write's answer frees its place in cycle p + 2. Memory serves
reads and writes in the order of their arrival. Serving one costs credit, of which every cycle brings some: this limits the
bandwidth.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from perf.kernel import phase, step
from perf.layout import Layout
from spec.memory import BEAT_BYTES
from spec.queues import IN_FLIGHT, READ_DEPTHS
from spec.registers import CHUNK_READ_CLIENTS, READ_CLIENTS, STEREO_WRITE_CLIENTS, WRITE_CLIENTS

READER_NAMES = READ_CLIENTS + CHUNK_READ_CLIENTS
"""All read clients. Those that a machine lacks never ask, so that they change no turn."""

READERS, WRITERS = len(READER_NAMES), len(WRITE_CLIENTS + STEREO_WRITE_CLIENTS)

GEOMETRY, TILES, COLOUR, ENTRIES, SPILL, VIEWS, CHUNKS = range(READERS)
W_ENTRIES, W_VIEWS, W_SPILL, W_FRAME, W_WARP = range(WRITERS)

QUEUE = 256
"""Requests of each kind that memory can hold (QUEUE_LOG2 of memory.sv)."""

COMPUTED, LPDDR3, STEPPED = range(3)
"""The kinds of memory. COMPUTED: requests are served one by one in the order of their arrival, so that the times of their
answers are known at once. LPDDR3: channels of DRAM. STEPPED: the bench's memory at more than a beat per cycle, where reads and
writes may overtake each other."""

RING = 512  # covers the requests in memory and those in the buffer before it
BEATS, ANSWERS = 512, 256  # beats and answers of a client that are kept
_MASK = RING - 1
_TO_CLIENT = 4  # cycles from an answer until its beat is offered
_READ_FREED, _WRITE_FREED = 3, 2  # cycles from an answer until its place can be used again
NEVER = 1 << 60

layout = Layout()
layout.words("""
    gain cost latency kind credit turn_at last_read last_write
    read_push read_new read_client read_in read_turn read_out
    write_push write_new write_late write_in write_turn write_out write_comes write_ready""")
for _name in ("credits", "beats_in", "beats_out", "reads", "writes", "written"):
    layout.ring(_name, 8)  # one place for each client
layout.ring("lowest_bit", 128)  # a table of the position of a number's lowest set bit
for _name in ("id", "due", "address", "answers"):
    layout.ring(f"read_{_name}", RING)
    layout.ring(f"write_{_name}", RING)
layout.ring("client_answers", 8, ANSWERS)
layout.ring("beat_times", 8, BEATS)


def prepare(
    s: np.record, *, latency: int, gain: int, cost: int, dram: bool, depths: Mapping[str, int] = READ_DEPTHS,
) -> None:
    """Initialises the bus in a new state. A beat costs `cost` credits and every cycle brings `gain`; with cost 0, memory serves
    a read and a write in every cycle. `depths`: the most beats of each read client that are outstanding or wait."""
    s.latency, s.gain, s.cost, s.credit = latency, gain, cost, 2 * cost
    s.kind = LPDDR3 if dram else STEPPED if gain > cost else COMPUTED
    s.turn_at = -1
    s.write_ready = 1
    s.read_answers[:] = s.write_answers[:] = s.client_answers[:] = -NEVER
    s.lowest_bit[:] = [(x & -x).bit_length() - 1 for x in range(128)]
    for place, name in enumerate(READER_NAMES):
        s.credits[place] = depths[name]


@step
def _next(s, last, asking):
    """The next client in turn after `last` among those that ask."""
    later = asking & (-2 << last)
    return s.lowest_bit[later if later else asking]


@step
def grant_read(s, t, asking):
    """The client whose read is granted in cycle t, or -1. `asking` has a bit for each client that asks and has a credit. If a
    client is granted, `read` must follow."""
    s.read_new = 0
    if asking == 0 or s.read_answers[s.read_push - IN_FLIGHT & _MASK] > t - _READ_FREED:
        return -1
    return _next(s, s.last_read, asking)


@step
def grant_write(s, t, asking):
    """The same as `grant_read`, for writes."""
    s.write_late, s.write_new = s.write_new, 0
    if asking == 0 or s.write_push - s.write_in + s.write_comes > 2:
        return -1
    client = _next(s, s.last_write, asking)
    while s.client_answers[client, s.writes[client] & ANSWERS - 1] > t - _WRITE_FREED:
        asking &= ~(1 << client)
        if asking == 0:
            return -1
        client = _next(s, s.last_write, asking)
    return client


@step
def read(s, client, address):
    """Sends the read of a client that was granted."""
    s.last_read = client
    s.credits[client] -= 1
    at = s.read_push & _MASK
    s.read_client, s.read_new = client, 1
    s.read_id[at], s.read_address[at], s.read_answers[at] = client, address, NEVER
    s.read_push += 1


@step
def write(s, client, address):
    """Sends the write of a client that was granted."""
    s.last_write = client
    at, count = s.write_push & _MASK, s.writes[client]
    s.write_id[at], s.write_address[at] = client, address
    s.client_answers[client, count & ANSWERS - 1] = NEVER
    s.writes[client] = count + 1
    s.write_push += 1
    s.write_new = 1


@step
def writes_idle(s, t, client):
    """Whether all writes of a client are in memory."""
    return s.client_answers[client, s.writes[client] - 1 & ANSWERS - 1] <= t - _WRITE_FREED


@step
def offered(s, client, t):
    """Whether a beat is offered to the client."""
    at = s.beats_out[client]
    return at != s.beats_in[client] and s.beat_times[client, at & BEATS - 1] <= t


@step
def take(s, client):
    """The client takes the offered beat."""
    s.beats_out[client] += 1
    s.credits[client] += 1


@step
def _deliver(s, client, t):
    """Schedules the beat of a read that is answered at the end of cycle t."""
    at = s.beats_in[client]
    s.beat_times[client, at & BEATS - 1] = t + _TO_CLIENT
    s.beats_in[client] = at + 1
    s.reads[client] += 1


@step
def deliver(s, client, t):
    """Answers the oldest read at the end of cycle t."""
    _deliver(s, client, t)
    s.read_answers[s.read_out & _MASK] = t
    s.read_out += 1


@step
def written(s, client, t):
    """Answers a client's oldest write at the end of cycle t."""
    count = s.written[client]
    s.client_answers[client, count & ANSWERS - 1] = t
    s.written[client] = count + 1


@step
def _turn(s, at):
    """The cycle in which memory serves a request that arrives at the end of cycle `at`: after all earlier ones, and when there
    is enough credit."""
    turn, credit, cost = s.turn_at, s.credit, s.cost
    if at > turn:
        credit = min(credit + s.gain * (at - turn), 2 * cost)
        turn = at
    if credit < cost:
        wait = (cost - credit + s.gain - 1) // s.gain
        turn += wait
        credit += s.gain * wait
    s.turn_at, s.credit = turn, credit - cost
    return turn


@step
def compute_answers(s, t):
    """Computes when the requests are answered that reach memory in the cycle after t. A read that is granted in cycle t always
    does; a write was granted in the cycle before or earlier."""
    if s.read_new:
        at = s.read_push - 1
        answer = max(_turn(s, t + 1), t + s.latency, s.read_answers[at - 1 & _MASK] + 1)
        s.read_answers[at & _MASK] = answer
        _deliver(s, s.read_client, answer)
    at = s.write_in
    comes = at != s.write_push - s.write_new and s.write_answers[at - QUEUE & _MASK] <= t
    s.write_comes = comes
    if comes:
        answer = max(_turn(s, t + 1), t + s.latency, s.write_answers[at - 1 & _MASK] + 1)
        s.write_answers[at & _MASK] = answer
        written(s, s.write_id[at & _MASK], answer)
        s.write_in = at + 1


@phase
def step_memory(s, t):
    """Steps the bench's memory over the clock edge at the end of cycle t."""
    at = s.read_in
    if at != s.read_push - s.read_new:
        s.read_due[at & _MASK] = t + s.latency - 1
        s.read_in = at + 1
    at = s.write_in
    if at != s.write_push - s.write_new - s.write_late and s.write_ready:
        s.write_due[at & _MASK] = t + s.latency - 1
        s.write_in = at + 1
    cost = s.cost
    credit = min(s.credit + s.gain, 2 * cost)
    r, w = s.read_turn, s.write_turn
    wants_read, wants_write = r != s.read_in, w != s.write_in
    if wants_read and wants_write and credit >= cost and s.write_due[w & _MASK] < s.read_due[r & _MASK]:
        s.write_turn = w + 1
        credit -= cost
        wants_write = False
    if wants_read and credit >= cost:
        s.read_turn = r + 1
        credit -= cost
    if wants_write and credit >= cost:
        s.write_turn = w + 1
        credit -= cost
    s.credit = credit
    at = s.read_out
    if at != s.read_turn and s.read_due[at & _MASK] <= t:
        deliver(s, s.read_id[at & _MASK], t)
    at = s.write_out
    if at != s.write_turn and s.write_due[at & _MASK] <= t:
        written(s, s.write_id[at & _MASK], t)
        s.write_out = at + 1
    s.write_ready = s.write_in - s.write_out < QUEUE


def rate(bytes_per_cycle: float | None) -> tuple[int, int]:
    """`gain` and `cost` of a bandwidth, as in tb.top.memory; None for a beat read and a beat written in every cycle."""
    from fractions import Fraction

    if bytes_per_cycle is None:
        return 0, 0
    fraction = Fraction(str(bytes_per_cycle)).limit_denominator(1000)
    return fraction.numerator, BEAT_BYTES * fraction.denominator
