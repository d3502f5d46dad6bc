"""The AXI master with its read queues, and the test bench's memory (tb/top/memory.sv), a cycle a step.

A read that is granted in cycle c stands on AR in c + 1 and is in memory at the end of that cycle; its beat, answered at the end
of cycle p, crosses R, the master's register and the read queue, and is offered to its client in cycle p + 4. A write's answer
frees its place in p + 2. Reads and writes take turns in the order of their arrival, each turn costs credit, of which some comes
in every cycle: that is the bandwidth.
"""

from __future__ import annotations

import numpy as np

from perf.kernel import phase, step
from perf.layout import Layout
from spec.memory import BEAT_BYTES
from spec.queues import IN_FLIGHT, READ_DEPTHS
from spec.registers import READ_CLIENTS, STEREO_WRITE_CLIENTS, WRITE_CLIENTS

READERS, WRITERS = len(READ_CLIENTS), len(WRITE_CLIENTS + STEREO_WRITE_CLIENTS)

GEOMETRY, TILES, COLOUR, ENTRIES, SPILL, VIEWS = range(READERS)
W_ENTRIES, W_VIEWS, W_SPILL, W_FRAME, W_WARP = range(WRITERS)

QUEUE = 256
"""Requests that memory holds of each kind (QUEUE_LOG2 of memory.sv)."""

COMPUTED, LPDDR3, STEPPED = range(3)
"""Of memory: requests go by one by one in the order of their arrival, so that their answers' times are known at once; channels
of DRAM; the bench's at more than a beat a cycle, where reads and writes may overtake each other."""

RING = 512  # requests in memory and in the buffer before it
_MASK, _DATA, _WRITES = RING - 1, 512, 256
_TO_CLIENT = 4  # cycles from an answer to its offer
_READ_FREED, _WRITE_FREED = 3, 2  # cycles from an answer to its place's next use
NEVER = 1 << 60

layout = Layout()
layout.words("""
    gain cost latency kind credit turn_at last_read last_write
    read_push read_new read_client read_in read_turn read_out
    write_push write_new write_in write_turn write_out write_comes write_ready""")
for _name in ("credits", "beats_in", "beats_out", "reads", "writes", "written"):
    layout.ring(_name, 8)  # a place a client
layout.ring("lowest_bit", 64)  # place of the lowest bit set
for _name in ("id", "due", "address", "answers"):
    layout.ring(f"read_{_name}", RING)
    layout.ring(f"write_{_name}", RING)
layout.ring("client_answers", 8, _WRITES)
layout.ring("beat_times", 8, _DATA)


def prepare(s: np.record, *, latency: int, gain: int, cost: int, dram: bool) -> None:
    """An idle bus in a new state; in every cycle memory gives `gain` of a beat's `cost`, or with cost 0 a read and a write."""
    s.latency, s.gain, s.cost, s.credit = latency, gain, cost, 2 * cost
    s.kind = LPDDR3 if dram else STEPPED if gain > cost else COMPUTED
    s.turn_at = -1
    s.write_ready = 1
    s.read_answers[:] = s.write_answers[:] = s.client_answers[:] = -NEVER
    s.lowest_bit[:] = [(x & -x).bit_length() - 1 for x in range(64)]
    for place, name in enumerate(READ_CLIENTS):
        s.credits[place] = READ_DEPTHS[name]


@step
def _next(s, last, asking):
    """Of those who ask, the next one after the last who was served."""
    later = asking & (-2 << last)
    return s.lowest_bit[later if later else asking]


@step
def grant_read(s, t, asking):
    """Which of the clients that ask (a bit each, with a credit) is served in cycle t; -1: none. `read` must follow."""
    s.read_new = 0
    if asking == 0 or s.read_answers[s.read_push - IN_FLIGHT & _MASK] > t - _READ_FREED:
        return -1
    return _next(s, s.last_read, asking)


@step
def grant_write(s, t, asking):
    """The same for writes."""
    s.write_new = 0
    if asking == 0 or s.write_push - s.write_in + s.write_comes > 1:
        return -1
    client = _next(s, s.last_write, asking)
    while s.client_answers[client, s.writes[client] & _WRITES - 1] > t - _WRITE_FREED:
        asking &= ~(1 << client)
        if asking == 0:
            return -1
        client = _next(s, s.last_write, asking)
    return client


@step
def read(s, client, address):
    """The client that was granted a read sends it."""
    s.last_read = client
    s.credits[client] -= 1
    at = s.read_push & _MASK
    s.read_client, s.read_new = client, 1
    s.read_id[at], s.read_address[at], s.read_answers[at] = client, address, NEVER
    s.read_push += 1


@step
def write(s, client, address):
    """The client that was granted a write sends it."""
    s.last_write = client
    at, count = s.write_push & _MASK, s.writes[client]
    s.write_id[at], s.write_address[at] = client, address
    s.client_answers[client, count & _WRITES - 1] = NEVER
    s.writes[client] = count + 1
    s.write_push += 1
    s.write_new = 1


@step
def writes_idle(s, t, client):
    """All writes of a client are in memory."""
    return s.client_answers[client, s.writes[client] - 1 & _WRITES - 1] <= t - _WRITE_FREED


@step
def offered(s, client, t):
    """A beat is offered to the client."""
    at = s.beats_out[client]
    return at != s.beats_in[client] and s.beat_times[client, at & _DATA - 1] <= t


@step
def take(s, client):
    """The client takes the beat on offer."""
    s.beats_out[client] += 1
    s.credits[client] += 1


@step
def _deliver(s, client, t):
    """A read is, or will be, answered at the end of cycle t."""
    at = s.beats_in[client]
    s.beat_times[client, at & _DATA - 1] = t + _TO_CLIENT
    s.beats_in[client] = at + 1
    s.reads[client] += 1


@step
def deliver(s, client, t):
    """A read is answered at the end of cycle t."""
    _deliver(s, client, t)
    s.read_answers[s.read_out & _MASK] = t
    s.read_out += 1


@step
def written(s, client, t):
    """A write is answered at the end of cycle t."""
    count = s.written[client]
    s.client_answers[client, count & _WRITES - 1] = t
    s.written[client] = count + 1


@step
def _turn(s, at):
    """When a request that is in memory at the end of cycle `at` has its turn: once all before it have, and credit is there."""
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
    """What was granted in cycle t stands before memory in the next, a write perhaps longer: when they are answered."""
    if s.read_new:
        at = s.read_push - 1
        answer = max(_turn(s, t + 1), t + s.latency, s.read_answers[at - 1 & _MASK] + 1)
        s.read_answers[at & _MASK] = answer
        _deliver(s, s.read_client, answer)
    at = s.write_in
    comes = at != s.write_push and s.write_answers[at - QUEUE & _MASK] <= t
    s.write_comes = comes
    if comes:
        answer = max(_turn(s, t + 1), t + s.latency, s.write_answers[at - 1 & _MASK] + 1)
        s.write_answers[at & _MASK] = answer
        written(s, s.write_id[at & _MASK], answer)
        s.write_in = at + 1


@phase
def step_memory(s, t):
    """The clock edge at the end of cycle t in the bench's memory."""
    at = s.read_in
    if at != s.read_push - s.read_new:
        s.read_due[at & _MASK] = t + s.latency - 1
        s.read_in = at + 1
    at = s.write_in
    if at != s.write_push - s.write_new and s.write_ready:
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
    """`gain` and `cost` of a bandwidth, as tb.top.memory has them; None: a beat read and a beat written in every cycle."""
    from fractions import Fraction

    if bytes_per_cycle is None:
        return 0, 0
    fraction = Fraction(str(bytes_per_cycle)).limit_denominator(1000)
    return fraction.numerator, BEAT_BYTES * fraction.denominator
