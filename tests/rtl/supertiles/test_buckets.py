"""The list of a pair: without buckets that of its super-tile, with them by the bounds that the frame before has made."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from amaranth.hdl import Module, Signal

from rtl.emit import to_rtlil
from rtl.supertiles.buckets import SingleLists, depth_buckets
from rtl.supertiles.depth_buckets import DepthBuckets
from spec.config import PAPER, TINY_V3, V3
from spec.records import intersection_item, list_group, tile_group
from spec.supertiles import BUCKETS, supertile_pair
from tb.common.exact import problems
from tb.supertiles import buckets_suite as suite
from tb.supertiles import order_suite
from tests.helpers.rtl_ports import cycles_of, play, words_of
from tests.helpers.rtl_streams import assert_rejected

PAIR, ENTRY = supertile_pair(TINY_V3), intersection_item(TINY_V3)
GROUP, LISTED = tile_group(TINY_V3), list_group(TINY_V3)


def test_without_buckets_a_list_is_a_supertile():
    rng = random.Random(0)
    pairs = [{"index": rng.randrange(1 << 24), "depth_key": rng.randrange(1 << 24), "supertile": rng.randrange(64), "end": 0}
             for _ in range(100)]
    pairs.append({"index": 0, "depth_key": 0, "supertile": 0, "end": 1})
    groups = [{"tile": s, "count": rng.randrange(1 << 24), "group": s // 3, "last": s % 3 == 2} for s in range(64)]
    dut, seen, clocked = SingleLists(TINY_V3), [], Module()
    clocked.submodules.dut = dut
    clocked.d.sync += Signal().eq(1)  # the unit itself has no register, and so no clock
    moves = play(
        dut, {"pairs": [PAIR.pack(p) for p in pairs], "groups": [GROUP.pack(g) for g in groups]},
        {"entries": 0.3, "listed": 0.3}, 400, setup={"supertile_count": 64}, pauses=0.2,
        design=clocked,
        each=lambda ctx, cycle: seen.append((ctx.get(dut.list_count), ctx.get(dut.busy))))
    assert words_of(moves, "entries") == [
        ENTRY.pack({**{k: p[k] for k in ("index", "depth_key", "end")}, "tile": p["supertile"]}) for p in pairs]
    assert words_of(moves, "listed") == [LISTED.pack(g | {"ends": 1}) for g in groups]
    assert set(seen[1:]) == {(64, 0)}


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    plan = suite.full_plan(TINY_V3, 0)
    return plan, suite.run_plan(TINY_V3, plan, tmp_path_factory.mktemp("tiny"))


def test_tiny_is_exact_and_fast_enough(tiny):
    plan, outcome = tiny
    assert outcome.failures == {}
    assert outcome.runs == sum(item.run.abort is None for item in plan) > 35 and outcome.items > 15_000
    lists = {item.name: item.expected["counts"]["lists"].tolist() for item in plan}
    assert len(set(lists["turned a little"][1:])) == 1  # bounds, good or bad, are as many
    assert max(lists["most lists of a frame"]) == TINY_V3.list_heads
    assert max(lists["most bounds of a super-tile"]) == 4 + 3 * (BUCKETS - 1) - 1  # and the last one has no bound


def test_faults_are_found(tiny):
    plan, outcome = tiny
    item = next(item for item in plan if item.name == "bad bounds")
    for port, rows in item.expected.items():
        for name in rows.dtype.names:
            wrong = rows.copy()
            wrong[name][3] ^= 1
            found = problems(replace(item, expected={port: wrong}), outcome.recordings[item.name])
            assert len(found) == 1 and found[0].startswith(f"{port} 3: ")


def test_a_pair_takes_sixteen_cycles():
    dut, pairs = DepthBuckets(TINY_V3), [PAIR.pack({"index": i, "depth_key": 5, "supertile": i, "end": 0})
                                                 for i in range(50)]
    moves = play(dut, {"pairs": pairs}, {"entries": 0.0}, 80, setup={"supertile_count": 64})
    assert [b - a for a, b in zip(cycles_of(moves, "pairs"), cycles_of(moves, "entries"), strict=True)] == [16] * 50


def test_the_machine_has_the_unit_that_its_parameter_names():
    machine = {buckets: depth_buckets(TINY_V3.with_(buckets=buckets)) for buckets in (False, True)}
    for buckets, unit in machine.items():
        assert isinstance(unit, DepthBuckets if buckets else SingleLists)
        to_rtlil(unit, "depth_buckets")


@pytest.mark.long
def test_pairs_leave_the_sorter_in_the_same_order_whatever_the_bounds_are(tmp_path):
    plan = order_suite.full_plan(TINY_V3, 0)
    outcome = order_suite.run_plan(TINY_V3, plan, tmp_path)
    assert outcome.failures == {} and outcome.runs == 30
    lists = {item.name: item.expected["sorted"]["tile"].max(initial=0) for item in plan}
    assert lists["turned a little"] == 14 and lists["bad bounds"] > 14  # 7 super-tiles


@pytest.mark.long
def test_the_machines_buckets_are_exact(tmp_path):
    assert suite.run_plan(V3, suite.full_plan(V3, 1), tmp_path).failures == {}


def test_machines_without_supertiles_are_rejected():
    assert_rejected(lambda: SingleLists(PAPER), ValueError, "tile")
    assert_rejected(lambda: SingleLists("paper"), TypeError, "paper")
    assert_rejected(lambda: DepthBuckets(TINY_V3, every=1), ValueError, 1)
    assert_rejected(lambda: DepthBuckets(TINY_V3, every=2.0), TypeError, 2.0)
