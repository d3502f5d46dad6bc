"""The AXI master with its read queues, and the test bench's memory (tb/top/memory.sv), stepped cycle by cycle.

A read that is granted in cycle c is on AR in cycle c + 1 and is in memory at the end of that cycle. If it is answered at the
end of cycle p, its beat passes R, the master's register and the read queue, and is offered to its client in cycle p + 4. A
write's answer frees its place in cycle p + 2. Memory serves reads and writes in the order of their arrival. Serving one costs
credit, of which every cycle brings some: this limits the bandwidth.
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
"""Requests of each kind that memory can hold (QUEUE_LOG2 of memory.sv)."""

COMPUTED, LPDDR3, STEPPED = range(3)
"""The kinds of memory. COMPUTED: requests are served one by one in the order of their arrival, so that the times of their
answers are known at once. LPDDR3: channels of DRAM. STEPPED: the bench's memory at more than a beat per cycle, where reads and
writes may overtake each other."""

RING = 512  # covers the requests in memory and those in the buffer before it
_MASK, _DATA, _WRITES = RING - 1, 512, 256
_TO_CLIENT = 4  # cycles from an answer until its beat is offered
_READ_FREED, _WRITE_FREED = 3, 2  # cycles from an answer until its place can be used again
NEVER = 1 << 60

layout = Layout()
(GAIN, COST, LATENCY, KIND, LAST_READ, LAST_WRITE, R_PUSH, R_NEW, R_CLIENT, R_IN, R_TURN, R_OUT, W_PUSH, W_NEW, W_IN, W_TURN,
 W_OUT, W_COMES, CREDIT, TURN_AT, W_READY) = layout.words(
    "gain cost latency kind last_read last_write r_push r_new r_client r_in r_turn r_out w_push w_new w_in w_turn "
    "w_out w_comes credit turn_at w_ready")
CREDITS, D_IN, D_OUT, READS = (layout.ring(8) for _ in range(4))
WRITES, WRITTEN = layout.ring(8), layout.ring(8)
LOWEST = layout.ring(64)  # a table of the position of a number's lowest set bit
R_ID, R_DUE, R_ADDRESS, R_ANSWERS, W_ID, W_DUE, W_ADDRESS, W_ANSWERS = (layout.ring(RING) for _ in range(8))
CLIENT_ANSWERS = layout.ring(8 * _WRITES)
DATA = layout.ring(8 * _DATA)


def prepare(s: np.ndarray, *, latency: int, gain: int, cost: int, dram: bool) -> None:
    """Makes an idle bus. A beat costs `cost` credits and every cycle brings `gain`; cost 0 serves a read and a write per
    cycle."""
    s[: layout.size] = 0
    s[LATENCY], s[GAIN], s[COST], s[CREDIT] = latency, gain, cost, 2 * cost
    s[KIND] = LPDDR3 if dram else STEPPED if gain > cost else COMPUTED
    s[TURN_AT] = -1
    s[W_READY] = 1
    for ring, size in ((R_ANSWERS, RING), (W_ANSWERS, RING), (CLIENT_ANSWERS, 8 * _WRITES)):
        s[ring : ring + size] = -NEVER
    s[LOWEST : LOWEST + 64] = [(x & -x).bit_length() - 1 for x in range(64)]
    for place, name in enumerate(READ_CLIENTS):
        s[CREDITS + place] = READ_DEPTHS[name]


@step
def _next(s, last, asking):
    """The next client in turn after `last` among those that ask."""
    later = asking & (-2 << last)
    return s[LOWEST + (later if later else asking)]


@step
def grant_read(s, t, asking):
    """The client whose read is granted in cycle t, or -1. `asking` has a bit for each client that asks and has a credit. If a
    client is granted, `read` must follow."""
    s[R_NEW] = 0
    if asking == 0 or s[R_ANSWERS + (s[R_PUSH] - IN_FLIGHT & _MASK)] > t - _READ_FREED:
        return -1
    return _next(s, s[LAST_READ], asking)


@step
def grant_write(s, t, asking):
    """The same as `grant_read`, for writes."""
    s[W_NEW] = 0
    if asking == 0 or s[W_PUSH] - s[W_IN] + s[W_COMES] > 1:
        return -1
    client = _next(s, s[LAST_WRITE], asking)
    while s[CLIENT_ANSWERS + client * _WRITES + (s[WRITES + client] & _WRITES - 1)] > t - _WRITE_FREED:
        asking &= ~(1 << client)
        if asking == 0:
            return -1
        client = _next(s, s[LAST_WRITE], asking)
    return client


@step
def read(s, client, address):
    """Sends the read of a client that was granted."""
    s[LAST_READ] = client
    s[CREDITS + client] -= 1
    at = s[R_PUSH] & _MASK
    s[R_CLIENT], s[R_NEW] = client, 1
    s[R_ID + at], s[R_ADDRESS + at], s[R_ANSWERS + at] = client, address, NEVER
    s[R_PUSH] += 1


@step
def write(s, client, address):
    """Sends the write of a client that was granted."""
    s[LAST_WRITE] = client
    at, count = s[W_PUSH] & _MASK, s[WRITES + client]
    s[W_ID + at], s[W_ADDRESS + at] = client, address
    s[CLIENT_ANSWERS + client * _WRITES + (count & _WRITES - 1)] = NEVER
    s[WRITES + client] = count + 1
    s[W_PUSH] += 1
    s[W_NEW] = 1


@step
def writes_idle(s, t, client):
    """Whether all writes of a client are in memory."""
    return s[CLIENT_ANSWERS + client * _WRITES + (s[WRITES + client] - 1 & _WRITES - 1)] <= t - _WRITE_FREED


@step
def offered(s, client, t):
    """Whether a beat is offered to the client."""
    at = s[D_OUT + client]
    return at != s[D_IN + client] and s[DATA + client * _DATA + (at & _DATA - 1)] <= t


@step
def take(s, client):
    """The client takes the offered beat."""
    s[D_OUT + client] += 1
    s[CREDITS + client] += 1


@step
def _deliver(s, client, t):
    """Schedules the beat of a read that is answered at the end of cycle t."""
    at = s[D_IN + client]
    s[DATA + client * _DATA + (at & _DATA - 1)] = t + _TO_CLIENT
    s[D_IN + client] = at + 1
    s[READS + client] += 1


@step
def deliver(s, client, t):
    """Answers the oldest read at the end of cycle t."""
    _deliver(s, client, t)
    s[R_ANSWERS + (s[R_OUT] & _MASK)] = t
    s[R_OUT] += 1


@step
def written(s, client, t):
    """Answers a client's oldest write at the end of cycle t."""
    count = s[WRITTEN + client]
    s[CLIENT_ANSWERS + client * _WRITES + (count & _WRITES - 1)] = t
    s[WRITTEN + client] = count + 1


@step
def _turn(s, at):
    """The cycle in which memory serves a request that arrives at the end of cycle `at`: after all earlier ones, and when there
    is enough credit."""
    turn, credit, cost = s[TURN_AT], s[CREDIT], s[COST]
    if at > turn:
        credit = min(credit + s[GAIN] * (at - turn), 2 * cost)
        turn = at
    if credit < cost:
        wait = (cost - credit + s[GAIN] - 1) // s[GAIN]
        turn += wait
        credit += s[GAIN] * wait
    s[TURN_AT], s[CREDIT] = turn, credit - cost
    return turn


@step
def compute_answers(s, t):
    """Computes when the requests are answered that reach memory in the cycle after t. A granted read always does; a write may
    have to wait longer."""
    if s[R_NEW]:
        at = s[R_PUSH] - 1
        answer = max(_turn(s, t + 1), t + s[LATENCY], s[R_ANSWERS + (at - 1 & _MASK)] + 1)
        s[R_ANSWERS + (at & _MASK)] = answer
        _deliver(s, s[R_CLIENT], answer)
    at = s[W_IN]
    comes = at != s[W_PUSH] and s[W_ANSWERS + (at - QUEUE & _MASK)] <= t
    s[W_COMES] = comes
    if comes:
        answer = max(_turn(s, t + 1), t + s[LATENCY], s[W_ANSWERS + (at - 1 & _MASK)] + 1)
        s[W_ANSWERS + (at & _MASK)] = answer
        written(s, s[W_ID + (at & _MASK)], answer)
        s[W_IN] = at + 1


@phase
def step_memory(s, t):
    """Steps the bench's memory over the clock edge at the end of cycle t."""
    at = s[R_IN]
    if at != s[R_PUSH] - s[R_NEW]:
        s[R_DUE + (at & _MASK)] = t + s[LATENCY] - 1
        s[R_IN] = at + 1
    at = s[W_IN]
    if at != s[W_PUSH] - s[W_NEW] and s[W_READY]:
        s[W_DUE + (at & _MASK)] = t + s[LATENCY] - 1
        s[W_IN] = at + 1
    cost = s[COST]
    credit = min(s[CREDIT] + s[GAIN], 2 * cost)
    r, w = s[R_TURN], s[W_TURN]
    wants_read, wants_write = r != s[R_IN], w != s[W_IN]
    if wants_read and wants_write and credit >= cost and s[W_DUE + (w & _MASK)] < s[R_DUE + (r & _MASK)]:
        s[W_TURN] = w + 1
        credit -= cost
        wants_write = False
    if wants_read and credit >= cost:
        s[R_TURN] = r + 1
        credit -= cost
    if wants_write and credit >= cost:
        s[W_TURN] = w + 1
        credit -= cost
    s[CREDIT] = credit
    at = s[R_OUT]
    if at != s[R_TURN] and s[R_DUE + (at & _MASK)] <= t:
        deliver(s, s[R_ID + (at & _MASK)], t)
    at = s[W_OUT]
    if at != s[W_TURN] and s[W_DUE + (at & _MASK)] <= t:
        written(s, s[W_ID + (at & _MASK)], t)
        s[W_OUT] = at + 1
    s[W_READY] = s[W_IN] - s[W_OUT] < QUEUE


def rate(bytes_per_cycle: float | None) -> tuple[int, int]:
    """`gain` and `cost` of a bandwidth, as in tb.top.memory; None for a beat read and a beat written in every cycle."""
    from fractions import Fraction

    if bytes_per_cycle is None:
        return 0, 0
    fraction = Fraction(str(bytes_per_cycle)).limit_denominator(1000)
    return fraction.numerator, BEAT_BYTES * fraction.denominator
