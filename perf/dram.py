"""Four channels of LPDDR3-1600 behind the bus, with banks, rows, turnarounds and refresh.

Beats are spread over the channels one by one, so that a run of beats keeps all four busy. Higher bits of the address are mixed
in; otherwise the splat records of one level, which are every fourth beat, would all lie in one channel. A beat is a burst of 8
on 32 data pins.

The controller of a channel looks at a window of the oldest reads and one of the oldest writes. It serves reads until many
writes wait or no read does, then writes until few are left. Within a window, requests to an open row go first, then the oldest.
A row is closed for another one only if no request in the window needs it. A client's reads are answered in order over one R
channel.

The unit of time is a quarter of a nanosecond: the DRAM's clock period is 1.25 ns and the machine's is 1 ns.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from perf import bus
from perf.bus import QUEUE, R_ADDRESS, R_ID, R_IN, R_NEW, R_PUSH, READERS, W_ADDRESS, W_ID, W_IN, W_NEW, W_OUT, W_PUSH
from perf.kernel import phase, step
from perf.layout import Layout

CHANNELS, BANKS, ROW_BEATS = 4, 8, 128
"""Number of channels, of banks in a device, and of beats in a row: 1,024 columns of 32 bits."""

_UNIT = 4  # units of time in a nanosecond


@dataclass(frozen=True)
class Lpddr3:
    """Timing of an 8 Gb x32 device at 800 MHz, in nanoseconds.

    The values are those of JEDEC JESD209-3 for LPDDR3-1600 (latency set A), rounded up to clock periods. DRAMsim3's
    configs/LPDDR3_8Gb_x32_1600.ini agrees except in tRCD and tRP (18.75 ns) and in the write latency (set B, 9 clocks).

    Attributes:
        clock: tCK. burst: BL / 2 clock periods. read_latency, write_latency: RL, WL. dqsck: the largest tDQSCK.
        rcd, rp, rp_all, ras, rrd, faw, wr, wtr, rtp, refi, rfc: the device's parameters of these names; rp is per bank.
        controller: the delay of a request through controller and PHY together with that of its answer; an assumption.
        window: the number of reads, and of writes, among which a channel chooses.
        high, low: the numbers of waiting writes at which a channel begins and stops to serve writes.
    """

    clock: float = 1.25
    burst: float = 5.0
    read_latency: float = 15.0
    write_latency: float = 7.5
    dqsck: float = 5.0
    rcd: float = 18.75
    rp: float = 18.75
    rp_all: float = 21.25
    ras: float = 42.5
    rrd: float = 10.0
    faw: float = 50.0
    wr: float = 15.0
    wtr: float = 7.5
    rtp: float = 7.5
    refi: float = 3900.0
    rfc: float = 210.0
    controller: float = 20.0
    window: int = 16
    high: int = 16
    low: int = 4


layout = Layout(bus.layout.size)
_PARAMETERS = tuple(f.name for f in fields(Lpddr3) if f.name not in ("window", "high", "low"))
(CLOCK, BURST, RL, WL, DQSCK, RCD, RP, RP_ALL, RAS, RRD, FAW, WR, WTR, RTP, REFI, RFC, CONTROLLER) = layout.words(
    " ".join(_PARAMETERS))
WINDOW, HIGH, LOW, TURN = layout.words("window high low turn")
WAKE, DRAINS, READ_OK, WRITE_OK, COMMAND_OK, NEXT_REFRESH, ACTIVATED = (layout.ring(CHANNELS) for _ in range(7))
ACTIVATES = layout.ring(4 * CHANNELS)
OPEN, CAS_OK, PRECHARGE_OK, ACTIVATE_OK = (layout.ring(CHANNELS * BANKS) for _ in range(4))
_HELD = 512  # requests of a channel and kind, as many as memory can hold
WAITING = layout.ring(2 * CHANNELS)
REQUESTS = layout.ring(2 * CHANNELS * _HELD)  # row, bank, client and number in one word, the oldest first
NUMBERS = layout.ring(8)
ANSWER = layout.ring(8 * 512)
WRITTEN = layout.ring(512)  # by cycle, the number of writes of each client that reach memory then, in any order
ROW_HITS, ACTS, REFRESHES = layout.words("row_hits activates refreshes")

_NEVER = 1 << 60


def prepare(s: np.ndarray, device: Lpddr3) -> None:
    """Makes idle channels with all rows closed."""
    s[bus.layout.size : layout.size] = 0
    for place, name in enumerate(_PARAMETERS):
        s[CLOCK + place] = round(_UNIT * getattr(device, name))
    s[WINDOW], s[HIGH], s[LOW] = device.window, device.high, device.low
    s[OPEN : OPEN + CHANNELS * BANKS] = -1
    s[WAKE : WAKE + CHANNELS] = _NEVER
    s[ACTIVATES : ACTIVATES + 4 * CHANNELS] = -_NEVER
    for channel in range(CHANNELS):
        s[NEXT_REFRESH + channel] = s[REFI] * (channel + 1) // CHANNELS  # the channels refresh one after the other
    s[ANSWER : ANSWER + 8 * 512] = _NEVER


@step
def _arrive(s, now, kind, address, client, number):
    """Puts a request into the queue of its channel."""
    channel = (address ^ address >> 2 ^ address >> 4 ^ address >> 6 ^ address >> 8 ^ address >> 10) & CHANNELS - 1
    row = address >> 12
    bank = (address >> 9 ^ row) & BANKS - 1
    queue = 2 * channel + kind
    s[REQUESTS + queue * _HELD + s[WAITING + queue]] = row << 16 | bank << 13 | client << 9 | (number & 511)
    s[WAITING + queue] += 1
    s[WAKE + channel] = min(s[WAKE + channel], now)


@step
def _remove(s, queue, place):
    """Removes a request from its queue; those behind it move up."""
    count = s[WAITING + queue] - 1
    for i in range(place, count):
        s[REQUESTS + queue * _HELD + i] = s[REQUESTS + queue * _HELD + i + 1]
    s[WAITING + queue] = count


@step
def _transfer(s, now, channel, queue, place, kind):
    """Gives a READ or WRITE command: schedules its burst and delays the commands that must wait for it."""
    request = s[REQUESTS + queue * _HELD + place]
    bank = channel * BANKS + (request >> 13 & 7)
    if kind:
        ends = now + s[WL] + s[CLOCK] + s[BURST]
        s[WRITE_OK + channel] = now + s[BURST]
        s[READ_OK + channel] = max(s[READ_OK + channel], ends + s[WTR])
        s[PRECHARGE_OK + bank] = max(s[PRECHARGE_OK + bank], ends + s[WR])
        s[WRITTEN + ((ends + s[CONTROLLER]) // _UNIT & 511)] += 1 << 6 * (request >> 9 & 15)
    else:
        ends = now + s[RL] + s[DQSCK] + s[BURST]
        s[READ_OK + channel] = now + s[BURST]
        s[WRITE_OK + channel] = max(s[WRITE_OK + channel], ends + s[CLOCK] - s[WL])
        s[PRECHARGE_OK + bank] = max(s[PRECHARGE_OK + bank], now + s[RTP])
        s[ANSWER + (request >> 9 & 15) * 512 + (request & 511)] = (ends + s[CONTROLLER]) // _UNIT
    _remove(s, queue, place)


@step
def _activate_at(s, channel, bank):
    """The earliest time at which a closed bank can be activated."""
    last, oldest = s[ACTIVATED + channel], s[ACTIVATED + channel] + 1
    at = max(s[ACTIVATE_OK + bank], s[ACTIVATES + 4 * channel + (last & 3)] + s[RRD])
    return max(at, s[ACTIVATES + 4 * channel + (oldest & 3)] + s[FAW])


@step
def _refresh(s, now, channel):
    """Closes and refreshes all banks as soon as the timing permits. Returns when they are ready."""
    ready = now
    for bank in range(channel * BANKS, channel * BANKS + BANKS):
        if s[OPEN + bank] >= 0:
            ready = max(ready, s[PRECHARGE_OK + bank])
        s[OPEN + bank] = -1
    done = ready + s[RP_ALL] + s[RFC]
    for bank in range(channel * BANKS, channel * BANKS + BANKS):
        s[ACTIVATE_OK + bank] = max(s[ACTIVATE_OK + bank], done)
    s[NEXT_REFRESH + channel] += s[REFI]
    s[REFRESHES] += 1
    return done


@step
def _choose(s, now, channel, queue, kind):
    """The next command of a window: the place of the request that needs it, and the earliest time for it."""
    count = min(s[WAITING + queue], s[WINDOW])
    best, at, wanted = -1, _NEVER, 0
    for place in range(count):  # requests to open rows
        request = s[REQUESTS + queue * _HELD + place]
        bank = request >> 13 & 7
        if s[OPEN + channel * BANKS + bank] == request >> 16:
            wanted |= 1 << bank
            ready = max(s[CAS_OK + channel * BANKS + bank], s[WRITE_OK + channel] if kind else s[READ_OK + channel])
            if ready < at:
                best, at = place, ready
                if ready <= now:
                    return best, at
    for place in range(count):
        request = s[REQUESTS + queue * _HELD + place]
        bank = request >> 13 & 7
        if wanted >> bank & 1:
            continue
        wanted |= 1 << bank
        place_of = channel * BANKS + bank
        ready = _activate_at(s, channel, place_of) if s[OPEN + place_of] < 0 else s[PRECHARGE_OK + place_of]
        if ready < at:
            best, at = place, ready
            if ready <= now:
                return best, at
    return best, at


@step
def _command(s, now, channel):
    """Gives the channel's next command if it may be given now. Returns the time at which to look again."""
    if now >= s[NEXT_REFRESH + channel]:
        return _refresh(s, now, channel)
    reads, writes = s[WAITING + 2 * channel], s[WAITING + 2 * channel + 1]
    if s[DRAINS + channel]:
        s[DRAINS + channel] = writes > s[LOW] or (reads == 0 and writes != 0)
    else:
        s[DRAINS + channel] = writes >= s[HIGH] or (reads == 0 and writes != 0)
    kind = s[DRAINS + channel]
    queue = 2 * channel + kind
    if s[WAITING + queue] == 0:
        return _NEVER
    place, at = _choose(s, now, channel, queue, kind)
    if at > now:
        return min(at, s[NEXT_REFRESH + channel])
    request = s[REQUESTS + queue * _HELD + place]
    bank = channel * BANKS + (request >> 13 & 7)
    if s[OPEN + bank] == request >> 16:
        s[ROW_HITS] += 1
        _transfer(s, now, channel, queue, place, kind)
    elif s[OPEN + bank] < 0:
        s[OPEN + bank] = request >> 16
        s[CAS_OK + bank], s[PRECHARGE_OK + bank] = now + s[RCD], now + s[RAS]
        s[ACTIVATED + channel] += 1
        s[ACTIVATES + 4 * channel + (s[ACTIVATED + channel] & 3)] = now
        s[ACTS] += 1
    else:
        s[OPEN + bank] = -1
        s[ACTIVATE_OK + bank] = now + s[RP]
    return now + s[CLOCK]


@step
def _answers(s, t):
    """Answers one read on R if the oldest read of some client is ready, and all writes that are in memory by now."""
    client = s[TURN]
    for _ in range(READERS):
        client = 0 if client + 1 == READERS else client + 1
        place = ANSWER + client * 512 + (s[bus.READS + client] & 511)
        if s[place] <= t:
            s[place] = _NEVER
            bus.deliver(s, client, t)
            s[TURN] = client
            break
    done = s[WRITTEN + (t & 511)]
    if done:
        s[WRITTEN + (t & 511)] = 0
        client = 0
        while done:
            count = done & 63
            for _ in range(count):
                bus.written(s, client, t - 1)
            s[W_OUT] += count
            done >>= 6
            client += 1


@phase
def end_cycle(s, t):
    """Steps the channels over the clock edge at the end of cycle t."""
    now = _UNIT * t + _UNIT
    at, came = s[R_IN], s[R_PUSH] - s[R_NEW]
    if at != came:
        client = s[R_ID + (at & 511)]
        _arrive(s, now, 0, s[R_ADDRESS + (at & 511)], client, s[NUMBERS + client])
        s[NUMBERS + client] += 1
        s[R_IN] = at + 1
    at, came = s[W_IN], s[W_PUSH] - s[W_NEW]
    if at != came and s[bus.W_READY]:
        _arrive(s, now, 1, s[W_ADDRESS + (at & 511)], s[W_ID + (at & 511)], 0)
        s[W_IN] = at + 1
    for channel in range(CHANNELS):
        if s[WAKE + channel] <= now:
            s[WAKE + channel] = _command(s, now, channel)
    _answers(s, t)
    s[bus.W_READY] = s[W_IN] - s[W_OUT] < QUEUE
