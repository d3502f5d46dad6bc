"""The bench's LPDDR3 memory beside the cycle model's, request by request, and its bus beside an independent AXI master."""

from __future__ import annotations

import json
import random

import pytest

pytest.importorskip("cocotbext.axi")

from perf import bus, dram
from spec.lpddr3 import CHANNELS, Lpddr3
from spec.memory import BEAT_BYTES
from tb.common.runner import simulate
from tb.top.memory import MemorySpeed, plusargs
from tb.top.memory_check import memory_design

BEATS = 1 << 18
DRAIN_NS = 1500
"""Nothing is requested at the end for so long, so that all requests are answered."""
CLIENTS, READS, WRITES = 6, 200, 100


def addresses(rng: random.Random):
    """Beat addresses of a client: runs of beats, which stay in rows, and single ones anywhere."""
    while True:
        at, run = rng.randrange(BEATS), rng.choice((1, 1, 1, 4, 40, 300))
        stride = rng.choice((1, 1, 4))
        yield from ((at + stride * i) % BEATS for i in range(run))


def modelled(cycles: int, clock_ns: float, device: Lpddr3, rng: random.Random):
    """Random requests, and the model's answers as lists of (cycle, client). After 700 ns, before the first refresh,
    requests fill all channels."""
    s = dram.layout.new()
    bus.prepare(s, latency=1, gain=0, cost=0, dram=True)
    dram.prepare(s, device, clock_ns)
    reading, writing = ([addresses(rng) for _ in range(n)] for n in (CLIENTS, bus.WRITERS))
    requests, answers = {"reads": [], "writes": []}, {"reads": [], "writes": []}
    for t in range(cycles):
        ended = t * clock_ns > cycles * clock_ns - DRAIN_NS
        sparse, writes_now = t * clock_ns < 700, (t >> 9) % 3 != 0
        s.read_new = s.write_new = 0
        if t >= 3 and not ended and s.read_push - s.read_out < READS and rng.random() < (0.05 if sparse else 0.9):
            client = rng.randrange(CLIENTS)
            at = next(reading[client])
            bus.read(s, client, at)
            requests["reads"].append((t + 1, client, BEAT_BYTES * at))
        may_write = t >= 3 and not ended and writes_now and s.write_push - s.write_out < WRITES
        if may_write and rng.random() < (0.04 if sparse else 0.4):
            client = rng.randrange(bus.WRITERS)
            at = next(writing[client])
            bus.write(s, client, at)
            requests["writes"].append((t + 1, client, BEAT_BYTES * at))
        before, done = s.beats_in.copy(), s.written.copy()
        dram.end_cycle(s, t)
        answers["reads"] += [(t, c) for c in range(CLIENTS) for _ in range(int(s.beats_in[c] - before[c]))]
        answers["writes"] += [(t, c) for c in range(bus.WRITERS) for _ in range(int(s.written[c] - done[c]))]
    return requests, answers, (int(s.dram_activates_given), int(s.dram_refreshes))


def played(folder, requests, cycles, clock_ns, device):
    """The answers of the bench's memory to the same requests."""
    folder.mkdir(exist_ok=True)
    signals = MemorySpeed(kind="lpddr3", clock_ns=clock_ns).signals
    (folder / "requests.json").write_text(json.dumps({"signals": signals, "cycles": cycles, **requests}))
    simulate(memory_design(), "tb.top.lpddr3_check", folder, env={"CHECK_FOLDER": str(folder)},
             plusargs=plusargs(folder, BEATS, device))
    return json.loads((folder / "answers.json").read_text())


@pytest.mark.parametrize(("clock_ns", "cycles"), [(1.0, 12_000), (2.3, 6_000), (0.4, 24_000)])
def test_answers_and_commands_are_the_models(tmp_path, clock_ns, cycles):
    """Every read and every write has its answer in the model's cycle, among refreshes of busy and of idle channels. A client's
    writes are answered in order, a write in a cycle, so that many answers come long after their data are in the device."""
    device = Lpddr3()
    requests, wanted, commands = modelled(cycles, clock_ns, device, random.Random(7))
    got = played(tmp_path, requests, cycles, clock_ns, device)
    assert len(wanted["reads"]) == len(requests["reads"]) > 1000
    assert len(wanted["writes"]) == len(requests["writes"]) > 500
    for kind in ("reads", "writes"):
        assert [tuple(item) for item in got[kind]] == wanted[kind]
    assert (got["activates"], got["refreshes"]) == commands and commands[1] >= 2 * CHANNELS
