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
from perf.bus import QUEUE, READERS
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


layout = Layout(bus.layout)
_PARAMETERS = tuple(f.name for f in fields(Lpddr3) if f.name not in ("window", "high", "low"))
layout.words(" ".join(f"dram_{name}" for name in _PARAMETERS))
layout.words("dram_window dram_high dram_low dram_turn dram_activates_given dram_refreshes")
for _name in ("wake", "drains", "read_ok", "write_ok", "next_refresh", "activated"):
    layout.ring(f"dram_{_name}", CHANNELS)
layout.ring("dram_activates", CHANNELS, 4)
for _name in ("open", "cas_ok", "precharge_ok", "activate_ok"):
    layout.ring(f"dram_{_name}", CHANNELS * BANKS)
_HELD = 512  # requests of a channel and kind, as many as memory can hold
layout.ring("dram_waiting", 2 * CHANNELS)
layout.ring("dram_requests", 2 * CHANNELS, _HELD)  # row, bank, client and number in one word, the oldest first
layout.ring("dram_numbers", 8)
layout.ring("dram_answer", 8, 512)
layout.ring("dram_written", 512)  # by cycle, the number of writes of each client that reach memory then, in any order

_NEVER = 1 << 60


def prepare(s: np.record, device: Lpddr3) -> None:
    """Initialises idle channels with all rows closed in a new state."""
    for name in _PARAMETERS:
        s[f"dram_{name}"] = round(_UNIT * getattr(device, name))
    s.dram_window, s.dram_high, s.dram_low = device.window, device.high, device.low
    s.dram_open[:] = -1
    s.dram_wake[:] = s.dram_answer[:] = _NEVER
    s.dram_activates[:] = -_NEVER
    for channel in range(CHANNELS):
        s.dram_next_refresh[channel] = s.dram_refi * (channel + 1) // CHANNELS  # the channels refresh one after the other


@step
def _arrive(s, now, kind, address, client, number):
    """Puts a request into the queue of its channel."""
    channel = (address ^ address >> 2 ^ address >> 4 ^ address >> 6 ^ address >> 8 ^ address >> 10) & CHANNELS - 1
    row = address >> 12
    bank = (address >> 9 ^ row) & BANKS - 1
    queue = 2 * channel + kind
    s.dram_requests[queue, s.dram_waiting[queue]] = row << 16 | bank << 13 | client << 9 | (number & 511)
    s.dram_waiting[queue] += 1
    s.dram_wake[channel] = min(s.dram_wake[channel], now)


@step
def _remove(s, queue, place):
    """Removes a request from its queue; those behind it move up."""
    count = s.dram_waiting[queue] - 1
    for i in range(place, count):
        s.dram_requests[queue, i] = s.dram_requests[queue, i + 1]
    s.dram_waiting[queue] = count


@step
def _transfer(s, now, channel, queue, place, kind):
    """Gives a READ or WRITE command: schedules its burst and delays the commands that must wait for it."""
    request = s.dram_requests[queue, place]
    bank = channel * BANKS + (request >> 13 & 7)
    if kind:
        ends = now + s.dram_write_latency + s.dram_clock + s.dram_burst
        s.dram_write_ok[channel] = now + s.dram_burst
        s.dram_read_ok[channel] = max(s.dram_read_ok[channel], ends + s.dram_wtr)
        s.dram_precharge_ok[bank] = max(s.dram_precharge_ok[bank], ends + s.dram_wr)
        s.dram_written[(ends + s.dram_controller) // _UNIT & 511] += 1 << 6 * (request >> 9 & 15)
    else:
        ends = now + s.dram_read_latency + s.dram_dqsck + s.dram_burst
        s.dram_read_ok[channel] = now + s.dram_burst
        s.dram_write_ok[channel] = max(s.dram_write_ok[channel], ends + s.dram_clock - s.dram_write_latency)
        s.dram_precharge_ok[bank] = max(s.dram_precharge_ok[bank], now + s.dram_rtp)
        s.dram_answer[request >> 9 & 15, request & 511] = (ends + s.dram_controller) // _UNIT
    _remove(s, queue, place)


@step
def _activate_at(s, channel, bank):
    """The earliest time at which a closed bank can be activated."""
    last, oldest = s.dram_activated[channel], s.dram_activated[channel] + 1
    at = max(s.dram_activate_ok[bank], s.dram_activates[channel, last & 3] + s.dram_rrd)
    return max(at, s.dram_activates[channel, oldest & 3] + s.dram_faw)


@step
def _refresh(s, now, channel):
    """Closes and refreshes all banks as soon as the timing permits. Returns when they are ready."""
    ready = now
    for bank in range(channel * BANKS, channel * BANKS + BANKS):
        if s.dram_open[bank] >= 0:
            ready = max(ready, s.dram_precharge_ok[bank])
        s.dram_open[bank] = -1
    done = ready + s.dram_rp_all + s.dram_rfc
    for bank in range(channel * BANKS, channel * BANKS + BANKS):
        s.dram_activate_ok[bank] = max(s.dram_activate_ok[bank], done)
    s.dram_next_refresh[channel] += s.dram_refi
    s.dram_refreshes += 1
    return done


@step
def _choose(s, now, channel, queue, kind):
    """The next command of a window: the place of the request that needs it, and the earliest time for it."""
    count = min(s.dram_waiting[queue], s.dram_window)
    best, at, wanted = -1, _NEVER, 0
    for place in range(count):  # requests to open rows
        request = s.dram_requests[queue, place]
        bank = request >> 13 & 7
        if s.dram_open[channel * BANKS + bank] == request >> 16:
            wanted |= 1 << bank
            ready = max(s.dram_cas_ok[channel * BANKS + bank], s.dram_write_ok[channel] if kind else s.dram_read_ok[channel])
            if ready < at:
                best, at = place, ready
                if ready <= now:
                    return best, at
    for place in range(count):
        request = s.dram_requests[queue, place]
        bank = request >> 13 & 7
        if wanted >> bank & 1:
            continue
        wanted |= 1 << bank
        place_of = channel * BANKS + bank
        ready = _activate_at(s, channel, place_of) if s.dram_open[place_of] < 0 else s.dram_precharge_ok[place_of]
        if ready < at:
            best, at = place, ready
            if ready <= now:
                return best, at
    return best, at


@step
def _command(s, now, channel):
    """Gives the channel's next command if it may be given now. Returns the time at which to look again."""
    if now >= s.dram_next_refresh[channel]:
        return _refresh(s, now, channel)
    reads, writes = s.dram_waiting[2 * channel], s.dram_waiting[2 * channel + 1]
    if s.dram_drains[channel]:
        s.dram_drains[channel] = writes > s.dram_low or (reads == 0 and writes != 0)
    else:
        s.dram_drains[channel] = writes >= s.dram_high or (reads == 0 and writes != 0)
    kind = s.dram_drains[channel]
    queue = 2 * channel + kind
    if s.dram_waiting[queue] == 0:
        return _NEVER
    place, at = _choose(s, now, channel, queue, kind)
    if at > now:
        return min(at, s.dram_next_refresh[channel])
    request = s.dram_requests[queue, place]
    bank = channel * BANKS + (request >> 13 & 7)
    if s.dram_open[bank] == request >> 16:
        _transfer(s, now, channel, queue, place, kind)
    elif s.dram_open[bank] < 0:
        s.dram_open[bank] = request >> 16
        s.dram_cas_ok[bank], s.dram_precharge_ok[bank] = now + s.dram_rcd, now + s.dram_ras
        s.dram_activated[channel] += 1
        s.dram_activates[channel, s.dram_activated[channel] & 3] = now
        s.dram_activates_given += 1
    else:
        s.dram_open[bank] = -1
        s.dram_activate_ok[bank] = now + s.dram_rp
    return now + s.dram_clock


@step
def _answers(s, t):
    """Answers one read on R if the oldest read of some client is ready, and all writes that are in memory by now."""
    client = s.dram_turn
    for _ in range(READERS):
        client = 0 if client + 1 == READERS else client + 1
        place = s.reads[client] & 511
        if s.dram_answer[client, place] <= t:
            s.dram_answer[client, place] = _NEVER
            bus.deliver(s, client, t)
            s.dram_turn = client
            break
    done = s.dram_written[t & 511]
    if done:
        s.dram_written[t & 511] = 0
        client = 0
        while done:
            count = done & 63
            for _ in range(count):
                bus.written(s, client, t - 1)
            s.write_out += count
            done >>= 6
            client += 1


@phase
def end_cycle(s, t):
    """Steps the channels over the clock edge at the end of cycle t."""
    now = _UNIT * t + _UNIT
    at, came = s.read_in, s.read_push - s.read_new
    if at != came:
        client = s.read_id[at & 511]
        _arrive(s, now, 0, s.read_address[at & 511], client, s.dram_numbers[client])
        s.dram_numbers[client] += 1
        s.read_in = at + 1
    at, came = s.write_in, s.write_push - s.write_new
    if at != came and s.write_ready:
        _arrive(s, now, 1, s.write_address[at & 511], s.write_id[at & 511], 0)
        s.write_in = at + 1
    for channel in range(CHANNELS):
        if s.dram_wake[channel] <= now:
            s.dram_wake[channel] = _command(s, now, channel)
    _answers(s, t)
    s.write_ready = s.write_in - s.write_out < QUEUE
