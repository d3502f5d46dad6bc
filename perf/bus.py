"""The AXI master with its read queues, and the test bench's memory (tb/top/memory.sv), a cycle a step.

A read that is granted in cycle c stands on AR in c + 1 and is in memory at the end of that cycle; its beat, answered at the end
of cycle p, crosses R, the master's register and the read queue, and is offered to its client in cycle p + 4. A write's answer
frees its place in p + 2. Reads and writes take turns in the order of their arrival, each turn costs credit, of which some comes
in every cycle: that is the bandwidth.
"""

from __future__ import annotations

import numpy as np

from perf.kernel import step
from perf.layout import Layout
from spec.memory import BEAT_BYTES
from spec.queues import IN_FLIGHT, READ_DEPTHS
from spec.registers import READ_CLIENTS, STEREO_WRITE_CLIENTS, WRITE_CLIENTS

READERS, WRITERS = len(READ_CLIENTS), len(WRITE_CLIENTS + STEREO_WRITE_CLIENTS)

GEOMETRY, TILES, COLOUR, ENTRIES, SPILL, VIEWS = range(READERS)
W_ENTRIES, W_VIEWS, W_SPILL, W_FRAME, W_WARP = range(WRITERS)

QUEUE = 256
"""Requests that memory holds of each kind (QUEUE_LOG2 of memory.sv)."""

_RING = 512  # requests in memory and in the buffer before it
_TO_CLIENT = 4  # cycles from an answer to its offer
_RING_MASK, _DATA = _RING - 1, 512

layout = Layout()
(GAIN, COST, LATENCY, DRAM, COUNT, LAST_READ, LAST_WRITE, R_PUSH, R_NEW, R_IN, R_TURN, R_OUT, W_PUSH, W_NEW, W_IN, W_TURN,
 W_OUT, CREDIT, R_READY, W_READY, ANSWERED, B_1, B_2, BUSY) = layout.words(
    "gain cost latency dram count last_read last_write r_push r_new r_in r_turn r_out w_push w_new w_in w_turn w_out "
    "credit r_ready w_ready answered b_1 b_2 busy")
CREDITS, D_IN, D_OUT, READS = (layout.ring(8) for _ in range(4))
WAITING, WRITES = layout.ring(8), layout.ring(8)
LOWEST = layout.ring(64)  # place of the lowest bit set
R_ID, R_DUE, R_ADDRESS, W_ID, W_DUE, W_ADDRESS = (layout.ring(_RING) for _ in range(6))
DATA = layout.ring(8 * _DATA)


def prepare(s: np.ndarray, *, latency: int, gain: int, cost: int, dram: bool) -> None:
    """An idle bus; memory gives `gain` of the `cost` of a beat in every cycle, cost 0: a read and a write each."""
    s[: layout.size] = 0
    s[LATENCY], s[GAIN], s[COST], s[DRAM], s[CREDIT] = latency, gain, cost, dram, 2 * cost
    s[R_READY] = s[W_READY] = 1
    s[LAST_READ] = s[LAST_WRITE] = 0
    s[LOWEST : LOWEST + 64] = [(x & -x).bit_length() - 1 for x in range(64)]
    for place, name in enumerate(READ_CLIENTS):
        s[CREDITS + place] = READ_DEPTHS[name]


@step
def begin_cycle(s):
    """Answers that arrived a few cycles ago return their places."""
    s[COUNT] -= s[ANSWERED] >> 2 & 1
    s[ANSWERED] <<= 1
    client = s[B_2]
    if client:
        s[WAITING + client - 1] -= 1
    s[B_2] = s[B_1]
    s[B_1] = 0
    s[R_NEW] = s[W_NEW] = 0


@step
def _next(s, last, asking):
    """Of those who ask, the next one after the last who was served."""
    later = asking & (-2 << last)
    return s[LOWEST + (later if later else asking)]


@step
def grant_read(s, asking):
    """Which of the clients that ask (a bit each, with a credit) is served in this cycle; -1: none. `read` must follow."""
    if asking == 0 or s[COUNT] == IN_FLIGHT or s[R_PUSH] - s[R_IN] > 1:
        return -1
    return _next(s, s[LAST_READ], asking)


@step
def grant_write(s, asking):
    """The same for writes."""
    if asking == 0 or s[W_PUSH] - s[W_IN] > 1:
        return -1
    client = _next(s, s[LAST_WRITE], asking)
    while s[WAITING + client] == IN_FLIGHT:
        asking &= ~(1 << client)
        if asking == 0:
            return -1
        client = _next(s, s[LAST_WRITE], asking)
    return client


@step
def read(s, client, address):
    """The client that was granted a read sends it."""
    s[LAST_READ] = client
    s[COUNT] += 1
    s[CREDITS + client] -= 1
    s[R_ID + (s[R_PUSH] & _RING_MASK)], s[R_ADDRESS + (s[R_PUSH] & _RING_MASK)] = client, address
    s[R_PUSH] += 1
    s[R_NEW] = 1


@step
def write(s, client, address):
    """The client that was granted a write sends it."""
    s[LAST_WRITE] = client
    s[WAITING + client] += 1
    s[WRITES + client] += 1
    s[W_ID + (s[W_PUSH] & _RING_MASK)], s[W_ADDRESS + (s[W_PUSH] & _RING_MASK)] = client, address
    s[W_PUSH] += 1
    s[W_NEW] = 1


@step
def offered(s, client, t):
    """A beat is offered to the client."""
    at = s[D_OUT + client]
    return at != s[D_IN + client] and s[DATA + client * _DATA + (at & _DATA - 1)] <= t


@step
def take(s, client):
    """The client takes the beat on offer."""
    s[D_OUT + client] += 1
    s[CREDITS + client] += 1


@step
def deliver(s, client, t):
    """A read is answered at the end of cycle t."""
    at = s[D_IN + client]
    s[DATA + client * _DATA + (at & _DATA - 1)] = t + _TO_CLIENT
    s[D_IN + client] = at + 1
    s[READS + client] += 1
    s[ANSWERED] |= 1


@step
def end_cycle(s, t):
    """The clock edge at the end of cycle t in the bench's memory."""
    at, came = s[R_IN], s[R_PUSH] - s[R_NEW]
    if at != came and s[R_READY]:
        s[R_DUE + (at & _RING_MASK)] = t + s[LATENCY] - 1
        s[R_IN] = at + 1
    at, came = s[W_IN], s[W_PUSH] - s[W_NEW]
    if at != came and s[W_READY]:
        s[W_DUE + (at & _RING_MASK)] = t + s[LATENCY] - 1
        s[W_IN] = at + 1
    cost = s[COST]
    credit = min(s[CREDIT] + s[GAIN], 2 * cost)
    r, w = s[R_TURN], s[W_TURN]
    wants_read, wants_write = r != s[R_IN], w != s[W_IN]
    if wants_read or wants_write:
        s[BUSY] += 1
        if wants_read and wants_write and credit >= cost and s[W_DUE + (w & _RING_MASK)] < s[R_DUE + (r & _RING_MASK)]:
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
    if at != s[R_TURN] and s[R_DUE + (at & _RING_MASK)] <= t:
        deliver(s, s[R_ID + (at & _RING_MASK)], t)
        s[R_OUT] = at + 1
    at = s[W_OUT]
    if at != s[W_TURN] and s[W_DUE + (at & _RING_MASK)] <= t:
        s[B_1] = s[W_ID + (at & _RING_MASK)] + 1
        s[W_OUT] = at + 1
    s[R_READY] = s[R_IN] - s[R_OUT] < QUEUE
    s[W_READY] = s[W_IN] - s[W_OUT] < QUEUE


def rate(bytes_per_cycle: float | None) -> tuple[int, int]:
    """`gain` and `cost` of a bandwidth, as tb.top.memory has them; None: a beat read and a beat written in every cycle."""
    from fractions import Fraction

    if bytes_per_cycle is None:
        return 0, 0
    fraction = Fraction(str(bytes_per_cycle)).limit_denominator(1000)
    return fraction.numerator, BEAT_BYTES * fraction.denominator
