"""The list of a pair: without buckets that of its super-tile."""

from __future__ import annotations

import random

from amaranth.hdl import Module, Signal

from rtl.supertiles.buckets import SingleLists
from spec.config import PAPER, TINY_SUPERTILES
from spec.records import intersection_item, list_group, tile_group
from spec.supertiles import supertile_pair
from tests.helpers.rtl_ports import play, words_of
from tests.helpers.rtl_streams import assert_rejected

PAIR, ENTRY = supertile_pair(TINY_SUPERTILES), intersection_item(TINY_SUPERTILES)
GROUP, LISTED = tile_group(TINY_SUPERTILES), list_group(TINY_SUPERTILES)


def test_without_buckets_a_list_is_a_supertile():
    rng = random.Random(0)
    pairs = [{"index": rng.randrange(1 << 24), "depth_key": rng.randrange(1 << 24), "supertile": rng.randrange(64), "end": 0}
             for _ in range(100)]
    pairs.append({"index": 0, "depth_key": 0, "supertile": 0, "end": 1})
    groups = [{"tile": s, "count": rng.randrange(1 << 24), "group": s // 3, "last": s % 3 == 2} for s in range(64)]
    dut, seen, clocked = SingleLists(TINY_SUPERTILES), [], Module()
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


def test_machines_without_supertiles_are_rejected():
    assert_rejected(lambda: SingleLists(PAPER), ValueError, "tile")
    assert_rejected(lambda: SingleLists("paper"), TypeError, "paper")
