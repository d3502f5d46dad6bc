"""Four channels of LPDDR3-1600 behind the bus, with banks, rows, turnarounds and refresh.

Beats are spread over the channels one by one, so that a run of beats keeps all four busy. Higher bits of the address are mixed
in; otherwise the splat records of one level, which are every fourth beat, would all lie in one channel. A beat is a burst of 8
on 32 data pins.

The controller of a channel looks at a window of the oldest reads and one of the oldest writes. It serves reads until many
writes wait or no read does, then writes until few are left. Within a window, requests to an open row go first, then the oldest.
A row is closed for another one only if no request in the window needs it. A client's reads are answered in order over one R
channel.

The unit of time is a picosecond, because the device's timing is in nanoseconds and the machine's clock may have any period. A
controller decides at the edges of the machine's clock. Where that clock is slower than the device's, it decides several times
in a cycle, at equal distances of at most a clock period of the device, so that it can give every command that the device could
take. Over AR and R pass one request and one answer in a cycle of the machine, whatever its period is.
"""

from __future__ import annotations

import numpy as np

from perf import bus
from perf.bus import QUEUE, READERS, WRITERS
from perf.kernel import phase, step
from perf.layout import Layout
from spec.lpddr3 import BANKS, CHANNELS, PARAMETERS, Lpddr3, picoseconds

layout = Layout(bus.layout)
layout.words(" ".join(f"dram_{name}" for name in PARAMETERS))
layout.words("""
    dram_cycle dram_looks dram_window dram_high dram_low dram_turn dram_write_turn dram_unanswered dram_activates_given
    dram_refreshes""")
for _name in ("wake", "drains", "read_ok", "write_ok", "next_refresh", "activated"):
    layout.ring(f"dram_{_name}", CHANNELS)
layout.ring("dram_activates", CHANNELS, 4)
for _name in ("open", "cas_ok", "precharge_ok", "activate_ok"):
    layout.ring(f"dram_{_name}", CHANNELS * BANKS)
_HELD = 512  # requests of a channel and kind, as many as memory can hold
layout.ring("dram_waiting", 2 * CHANNELS)
layout.ring("dram_requests", 2 * CHANNELS, _HELD)  # row, bank, client and number in one word, the oldest first
layout.ring("dram_numbers", 2, 8)  # by kind and client, like the times of answers
layout.ring("dram_answer", 8, 512)
layout.ring("dram_write_answer", 8, 512)
_AHEAD = 4096  # cycles from a write command until its data are in memory, at most
layout.ring("dram_written", _AHEAD)  # by cycle, the number of writes that reach memory then

_NEVER = 1 << 60


def prepare(s: np.record, device: Lpddr3, clock_ns: float = 1.0) -> None:
    """Initialises idle channels with all rows closed in a new state.

    Args:
        s: the state.
        device: the timing of the channels.
        clock_ns: the period of the machine's clock in nanoseconds.

    Raises:
        ValueError: a write takes too many cycles of such a clock.
    """
    for name in PARAMETERS:
        s[f"dram_{name}"] = picoseconds(getattr(device, name))
    s.dram_cycle = picoseconds(clock_ns)
    s.dram_looks = device.looks(clock_ns)
    longest = s.dram_write_latency + s.dram_clock + s.dram_burst + s.dram_controller
    if longest >= s.dram_cycle * (_AHEAD - 1):
        raise ValueError(f"clock_ns must be above {longest / 1000 / (_AHEAD - 1):g} with this device, not {clock_ns!r}")
    s.dram_window, s.dram_high, s.dram_low = device.window, device.high, device.low
    s.dram_open[:] = -1
    s.dram_answer[:] = s.dram_write_answer[:] = _NEVER
    s.dram_activates[:] = -_NEVER
    for channel in range(CHANNELS):
        s.dram_next_refresh[channel] = s.dram_refi * (channel + 1) // CHANNELS  # the channels refresh one after the other
    s.dram_wake[:] = s.dram_next_refresh


_TIMES = ("wake", "read_ok", "write_ok", "next_refresh", "activates", "cas_ok", "precharge_ok", "activate_ok")
_KEPT = ("dram_open", "dram_drains", "dram_activated", "dram_turn", "dram_write_turn", "last_read", "last_write")


def go_on(s: np.record, before: np.record, cycles: int) -> None:
    """Takes over channels, and whose turn it is, as they are `cycles` cycles after the beginning of an earlier state, in which
    everything has been answered by then."""
    for name in _TIMES:
        s[f"dram_{name}"] = before[f"dram_{name}"] - before.dram_cycle * cycles
    for name in _KEPT:
        s[name] = before[name]


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
        done = (ends + s.dram_controller) // s.dram_cycle
        s.dram_written[done & _AHEAD - 1] += 1
        s.dram_write_answer[request >> 9 & 15, request & 511] = done
    else:
        ends = now + s.dram_read_latency + s.dram_dqsck + s.dram_burst
        s.dram_read_ok[channel] = now + s.dram_burst
        s.dram_write_ok[channel] = max(s.dram_write_ok[channel], ends + s.dram_clock - s.dram_write_latency)
        s.dram_precharge_ok[bank] = max(s.dram_precharge_ok[bank], now + s.dram_rtp)
        s.dram_answer[request >> 9 & 15, request & 511] = (ends + s.dram_controller) // s.dram_cycle
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
        return s.dram_next_refresh[channel]
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
def _next_ready(answers, oldest, turn, clients, t):
    """The client after `turn` whose oldest request has its answer by now, which is taken; -1 if there is none."""
    client = turn
    for _ in range(clients):
        client = 0 if client + 1 == clients else client + 1
        place = oldest[client] & 511
        if answers[client, place] <= t:
            answers[client, place] = _NEVER
            return client
    return -1


@step
def _answers(s, t):
    """Answers one read on R if the oldest read of some client is ready, and all writes that are in memory by now."""
    client = _next_ready(s.dram_answer, s.reads, s.dram_turn, READERS, t)
    if client >= 0:
        bus.deliver(s, client, t)
        s.dram_turn = client
    done = s.dram_written[t & _AHEAD - 1]
    if done:
        s.dram_written[t & _AHEAD - 1] = 0
        s.dram_unanswered += done
        s.write_out += done
    if s.dram_unanswered:
        client = _next_ready(s.dram_write_answer, s.written, s.dram_write_turn, WRITERS, t)
        if client >= 0:
            s.dram_unanswered -= 1
            bus.written(s, client, t)
            s.dram_write_turn = client


@step
def _look(s, now):
    """Lets every channel give a command that may be given now."""
    for channel in range(CHANNELS):
        if s.dram_wake[channel] <= now:
            s.dram_wake[channel] = _command(s, now, channel)


@phase
def end_cycle(s, t):
    """Steps the channels over the clock edge at the end of cycle t."""
    begin = s.dram_cycle * t
    for number in range(1, s.dram_looks):
        _look(s, begin + s.dram_cycle * number // s.dram_looks)
    now = begin + s.dram_cycle
    at, came = s.read_in, s.read_push - s.read_new
    if at != came:
        client = s.read_id[at & 511]
        _arrive(s, now, 0, s.read_address[at & 511], client, s.dram_numbers[0, client])
        s.dram_numbers[0, client] += 1
        s.read_in = at + 1
    at, came = s.write_in, s.write_push - s.write_new - s.write_late
    if at != came and s.write_ready:
        client = s.write_id[at & 511]
        _arrive(s, now, 1, s.write_address[at & 511], client, s.dram_numbers[1, client])
        s.dram_numbers[1, client] += 1
        s.write_in = at + 1
    _look(s, now)
    _answers(s, t)
    s.write_ready = s.write_in - s.write_out < QUEUE
