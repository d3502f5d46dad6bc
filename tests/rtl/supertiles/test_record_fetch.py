"""Record fetch in Verilator: the suite's runs, and faults put there on purpose; latency and storage in Amaranth's simulator.

V3 is long.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from amaranth.hdl import Mux, Value
from amaranth.lib import memory
from amaranth.sim import Simulator

from golden.msv2_ref.fetch import find_misses
from rtl.emit import to_rtlil, to_verilog
from rtl.supertiles import record_fetch
from rtl.supertiles.record_fetch import LATENCY, RecordFetch
from rtl.units import emit
from spec.chunks import PLACE_BITS
from spec.config import TINY_V3, V3, V3_RECORDS
from spec.queues import HEADERS_MISSED, HEADERS_PENDING, RECORD_BEATS, RECORDS_PENDING
from spec.records import chunk_item
from spec.supertiles import HEADER_WAYS
from tb.common import exact
from tb.common.exact import problems
from tb.supertiles import record_fetch_suite as suite
from tb.supertiles.record_fetch_device import RecordFetchBench, playback
from tb.supertiles.record_fetch_stimuli import DIRECTED
from tests.helpers.rtl_streams import assert_rejected

LINES = TINY_V3.header_lines


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """TINY_V3' plan and outcome."""
    plan = suite.quick_plan(TINY_V3, 0)
    return plan, suite.run_plan(TINY_V3, plan, tmp_path_factory.mktemp("fetch"))


def test_every_point_and_beat_is_exact_and_comes_fast_enough(tiny):
    plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) and outcome.items > 300_000
    assert len(suite.figures(TINY_V3, plan, outcome)) == 6


@pytest.mark.long
def test_the_large_machine_is_exact(tmp_path):
    plan = suite.full_plan(V3, 1)
    assert suite.run_plan(V3, plan, tmp_path).failures == {}


def test_runs_show_something(tiny):
    """Hits and misses, coarse records and fine ones; the strongest opacity at every level, and beyond the bound, where it does
    not count."""
    wanted = {item.name: item.expected for item in tiny[0]}
    rows = np.concatenate([expected["points"] for name, expected in wanted.items() if name.startswith("random")])
    assert min(np.bincount(rows["bound"])) > 100 and len(np.unique(rows["log2_opacity"])) > 400
    assert not len(wanted["rate, hits"]["reads_chunks"]) and len(wanted["rate, misses"]["reads_chunks"]) == 3000
    kept = [len(wanted[f"back to back, kept {k}"]["reads_chunks"]) for k in range(4)]
    assert kept == [LINES // 2, 0, 0, 0]
    failed = [item for item in tiny[0] if item.observed.get("error")]
    assert {item.name for item in failed} == {"error of records", "error stays", "error of headers"}


def test_faults_are_found(tiny):
    plan, outcome = tiny
    item = next(item for item in plan if item.name.startswith("random, 30"))
    recording = outcome.recordings[item.name]
    assert problems(item, recording) == []
    for port, rows in item.expected.items():
        for name in rows.dtype.names:
            wrong = rows.copy()
            wrong[name][3] ^= 1
            assert problems(replace(item, expected=item.expected | {port: wrong}), recording)[0].startswith(f"{port} 3: ")
    for name in ("hits", "misses"):
        assert problems(replace(item, observed={name: item.observed[name] + 1}), recording)


@pytest.mark.parametrize(("name", "lines", "ways", "keep_used"), [
    ("every line", 2 * LINES, HEADER_WAYS, False), ("every line", LINES // 2, HEADER_WAYS, False),
    ("conflicts", LINES, 2, False), ("conflicts", LINES, 8, False), ("conflicts", LINES, HEADER_WAYS, True),
])
def test_another_cache_is_told_apart(tiny, name, lines, ways, keep_used):
    item = next(item for item in tiny[0] if item.name.startswith(f"{name}, 0 and"))
    items = item.run.inputs["sorted"]
    number = items["index"][items["empty"] == 0].astype(np.int64) >> PLACE_BITS
    reads = tiny[1].recordings[item.name].outputs["reads_chunks"]
    assert len(reads) != find_misses(number, np.zeros_like(number), lines, ways, keep_used, False).sum()


def _faulty(tmp_path, **options: object) -> dict[str, list[str]]:
    """Failures of the hand-made cases in a bench that is emitted anew."""
    bench = replace(playback(TINY_V3), name="record-fetch-faulty",
                    verilog=to_verilog(RecordFetchBench(TINY_V3), "record_fetch_bench"))
    plan, rng = suite.Plan(TINY_V3, 0), np.random.default_rng(0)
    for make in DIRECTED:
        plan.add(make(TINY_V3, rng), **options)
    return exact.run_plan(bench, plan.runs, tmp_path, watchdog=2000).failures


def test_a_tag_written_in_the_cycle_of_its_reading_must_be_seen(monkeypatch, tmp_path):
    """Without that a second miss is sent for a header that is on its way."""
    read_port = memory.Memory.read_port
    monkeypatch.setattr(
        memory.Memory, "read_port", lambda self, **options: read_port(self, **options | {"transparent_for": ()}))
    assert "the same chunk again" in _faulty(tmp_path)


def test_the_strongest_opacity_must_be_found(monkeypatch, tmp_path):
    monkeypatch.setattr(record_fetch, "_larger", lambda a, b: Mux(a > b, b, a))
    failures = _faulty(tmp_path)
    assert len(failures) == len(DIRECTED) and all(found[0].startswith("points") for found in failures.values())


def test_traced_frames_of_the_embedded_scene(monkeypatch, tmp_path):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path / "absent"))
    plan = suite.traced_plan(TINY_V3, "64x48")
    assert len(plan) == 2 and suite.run_plan(TINY_V3, plan, tmp_path / "run").failures == {}
    assert all(len(item.expected["points"]) > 300 for item in plan)


def test_latency_and_the_cycles_of_clearing():
    """A hit takes LATENCY cycles and the memory's; after `clear`, as after a reset, nothing is taken for a cycle a set."""
    dut, waits, latencies, missed = RecordFetch(TINY_V3), [], [], []

    async def send(ctx) -> None:
        """One pair, whose header and beats come in the cycle after their requests."""
        ctx.set(Value.cast(dut.sorted.payload), chunk_item(TINY_V3).pack(
            {"index": 5 << PLACE_BITS | 3, "depth_key": 0, "tile": 0, "last": 0, "empty": 0}))
        ctx.set(dut.sorted.valid, 1)
        wait = 0
        while not ctx.get(dut.sorted.ready):
            await ctx.tick()
            wait += 1
        waits.append(wait)
        before, cycles = ctx.get(dut.misses), 0
        while not ctx.get(dut.points.valid):
            for client in ("chunks", "colour"):
                asked = ctx.get(getattr(dut, f"reads_{client}").valid)
                if asked:
                    due[client] = cycles + 1
            await ctx.tick()
            ctx.set(dut.sorted.valid, 0)
            cycles += 1
            for client in ("chunks", "colour"):
                ctx.set(getattr(dut, f"data_{client}").valid, due.get(client) == cycles)
        missed.append(ctx.get(dut.misses) - before)
        latencies.append(cycles)
        assert ctx.get(dut.points.payload.index) == 5 << PLACE_BITS | 3
        due.clear()
        for _ in range(3):
            await ctx.tick()
        assert not ctx.get(dut.busy)

    due: dict[str, int] = {}

    async def bench(ctx):
        for port in (dut.reads_chunks, dut.reads_colour, dut.points, dut.beats):
            ctx.set(port.ready, 1)
        await send(ctx)
        await send(ctx)
        ctx.set(dut.clear, 1)
        await ctx.tick()
        ctx.set(dut.clear, 0)
        assert ctx.get(dut.busy) and not ctx.get(dut.misses)
        await send(ctx)

    simulator = Simulator(dut)
    simulator.add_clock(1e-9)
    simulator.add_testbench(bench)
    simulator.run()
    assert missed == [1, 0, 1] and waits == [LINES // HEADER_WAYS, 0, LINES // HEADER_WAYS]
    assert latencies == 3 * [LATENCY + 1]  # a header that comes at once costs nothing


def test_storage():
    """Tags, both kinds of lines, and the queues, each of which keeps one item in a register."""
    text = to_rtlil(RecordFetch(V3), "fetch")
    memories = sorted((int(width), int(depth)) for width, depth in re.findall(r"memory width (\d+) size (\d+)", text))
    lines = V3.header_lines
    assert memories == sorted([
        (54, lines // HEADER_WAYS), (26, lines), (112, lines), (33, HEADERS_PENDING - 1), (35, RECORDS_PENDING - 1),
        (112, HEADERS_MISSED - 1), (256, RECORD_BEATS - 1)])


def test_verilog():
    text = emit("record_fetch", TINY_V3)
    assert "module record_fetch(" in text and emit("record_fetch", TINY_V3) == text


def test_no_counters_where_there_are_none():
    constant = [f"connect \\{name} 32'{0:032b}" for name in ("hits", "misses")]
    texts = [to_rtlil(RecordFetch(TINY_V3.with_(counters=counters)), "f") for counters in (True, False)]
    assert [[line in text for line in constant] for text in texts] == [[False, False], [True, True]]


def test_other_machines_are_refused():
    assert_rejected(lambda: RecordFetch("v3"), TypeError, "v3")
    assert_rejected(lambda: RecordFetch(V3_RECORDS), ValueError, "tile")
