"""What only machines have whose joint frames may have a warped eye, in Amaranth's simulator: the lists once more, the turns of
both eyes, and the tiles with holes."""

from __future__ import annotations

import random

import pytest

from rtl.culling.eyes import turn_layout
from rtl.supertiles.clip import clip_layout
from rtl.supertiles.list_replay import ListReplay
from rtl.supertiles.sweep_turns import SweepTurns
from rtl.supertiles.warp_strips import HoleTiles, StripWarp, WarpStrips
from spec.config import PAPER, TINY_EYES, TINY_EYES_WARP
from spec.constants import SUPER_TILES, SUPER_X, SUPER_Y, TILE
from spec.joint import grid_origins, joint_columns
from spec.records import frame_supertiles, list_group
from spec.supertiles import supertile
from tests.helpers.rtl_ports import play, words_of
from tests.helpers.rtl_streams import assert_rejected

LIST, SUPER = list_group(TINY_EYES_WARP), supertile(TINY_EYES_WARP)


def lists_of(rng: random.Random, supertiles: int) -> list[dict[str, int]]:
    """The lists of some super-tiles, each with one to three of them, merged at random."""
    rows, group = [], 0
    for _ in range(supertiles):
        count = rng.choice([1, 1, 2, 3])
        for n in range(count):
            last = rng.random() < 0.5
            rows.append({"tile": len(rows), "count": rng.choice([0, 3, 900]), "group": group, "last": last,
                         "ends": n == count - 1})
            group += last
    return rows


@pytest.mark.parametrize(("share", "seed"), [(0.0, 1), (0.6, 2), (0.3, 3)])
def test_lists_of_super_tiles_with_holes_come_once_more(share, seed):
    rng = random.Random(seed)
    rows = lists_of(rng, 12)
    holes = [rng.random() < 0.4 for _ in range(12)]
    dut, begun, answer, counts = ListReplay(TINY_EYES_WARP), [], [0], []

    def each(ctx, cycle):
        ctx.set(dut.list_count, len(rows))
        ctx.set(dut.holes, answer[0])  # that of the number in the cycle before
        answer[0] = holes[ctx.get(dut.number)] if ctx.get(dut.number) < 12 else 0
        again = cycle == 400
        ctx.set(dut.again, again)
        begun.append(ctx.get(dut.second))
        counts.append((ctx.get(dut.pairs_again), ctx.get(dut.groups_again)))

    moves = play(dut, {"listed": [LIST.pack(row) for row in rows]}, {"lists": share}, 900, seed=seed, each=each)
    owner, second, number = [], [], 0
    for row in rows:
        owner.append(number)
        number += row["ends"]
        count = row["count"] * holes[owner[-1]]
        second.append({**row, "count": count, "group": row["tile"], "last": 1})
    assert words_of(moves, "lists") == [LIST.pack(row) for row in (*rows, *second)]
    assert begun.index(1) == 401 and all(begun[401:])
    assert counts[-1] == (sum(row["count"] for row in second), sum(row["count"] > 0 for row in second))


def supers_of(rng: random.Random, count: int, joint: bool) -> list[dict[str, object]]:
    """The SuperTile items of some super-tiles."""
    rows = []
    for number in range(count):
        common = {"x": SUPER_X * number, "y": 0, "pairs": rng.choice([0, 1, 700]), "level": [0] * SUPER_TILES, "blend": 0,
                  "plane": [0] * 3 * SUPER_TILES}
        for eye in range(1 + joint):
            rows.append({**common, "inside": rng.choice([0, rng.getrandbits(SUPER_TILES)]), "eye": eye})
    return rows


@pytest.mark.parametrize(("joint", "stereo", "second", "shared"), [
    (0, 0, 0, 0), (1, 0, 0, 0), (1, 1, 0, 0), (1, 1, 0, 1), (1, 1, 1, 0), (1, 1, 1, 1)])
def test_turns_say_for_which_eyes_pairs_are_projected(joint, stereo, second, shared):
    rng = random.Random(5)
    rows = supers_of(rng, 20, bool(joint))
    dut = SweepTurns(TINY_EYES_WARP)

    def each(ctx, cycle):
        for name, value in (("joint", joint), ("stereo", stereo), ("second", second), ("shared", shared)):
            ctx.set(getattr(dut, name), value)

    moves = play(dut, {"supertiles": [SUPER.pack(row) for row in rows]}, {"turns": 0.4, "clipped": 0.7}, 600, seed=3, each=each)
    turns, clipped = [], []
    for source, target in zip(rows[:: 1 + joint], rows[joint :: 1 + joint], strict=True):
        both = joint and (shared if second else not stereo or target["inside"] != 0)
        turns.append({"pairs": source["pairs"], "both": int(both), "target": int(second and not both)})
        clipped.append({"x": source["x"], "y": 0, "pairs": source["pairs"], "both": int(both),
                        "wanted": [source["inside"], target["inside"]]})
    assert [turn_layout().from_bits(word).as_bits() for word in words_of(moves, "turns")] == [
        turn_layout().const(turn).as_bits() for turn in turns]
    assert words_of(moves, "clipped") == [clip_layout(TINY_EYES_WARP).const(item).as_bits() for item in clipped]


@pytest.mark.parametrize(("tiles_x", "tiles_y", "shift"), [(20, 5, 0), (9, 2, -8), (8, 1, 3), (17, 4, -3), (3, 3, 8)])
def test_hole_tiles_lie_in_joint_super_tiles(tiles_x, tiles_y, shift):
    rng = random.Random(tiles_x)
    holes = [[rng.random() < 0.4 for _ in range(tiles_x)] for _ in range(tiles_y)]
    dut, answers = HoleTiles(TINY_EYES_WARP), {}
    strips = [[(y, x) for y in range(odd, tiles_y, 2) for x in range(tiles_x)] for odd in range(SUPER_Y)]
    depth = frame_supertiles(TINY_EYES_WARP)
    columns = joint_columns(tiles_x, shift)
    supertiles = columns * -(-tiles_y // SUPER_Y)

    def stimulus(ctx, cycle):
        for name, value in (("joint", 1), ("shift", shift), ("width", TILE * tiles_x - 5)):
            ctx.set(getattr(dut, name), value)
        ctx.set(dut.begin, cycle == depth + 10)
        ends, marks, lasts = 0, 0, 0
        for odd, todo in enumerate(strips):
            if cycle > depth + 12 and todo and rng.random() < 0.5:
                y, x = todo.pop(0)
                ends, marks, lasts = ends | 1 << odd, marks | holes[y][x] << odd, lasts | (x == tiles_x - 1) << odd
        for name, value in (("tile_ends", ends), ("holes", marks), ("strip_ends", lasts)):
            ctx.set(getattr(dut, name), value)
        asked = cycle - 2 * depth - 200
        if 0 <= asked <= supertiles:
            if asked:
                answers[asked - 1] = ctx.get(dut.tiles[0])
            ctx.set(dut.number[0], min(asked, supertiles - 1))

    play(dut, {}, {}, 2 * depth + 210 + supertiles, each=stimulus)
    wanted = dict.fromkeys(range(supertiles), 0)
    origin = grid_origins(shift)[1]
    for y, row in enumerate(holes):
        for x, hole in enumerate(row):
            place = y % SUPER_Y * SUPER_X + (x + origin) % SUPER_X
            wanted[y // SUPER_Y * columns + (x + origin) // SUPER_X] |= hole << place
    assert answers == wanted


def test_only_machines_with_a_warp_unit_and_joint_frames_have_them():
    for make in (ListReplay, SweepTurns, WarpStrips):
        assert_rejected(lambda make=make: make(3), TypeError, 3)
        for config in (TINY_EYES, PAPER.with_(stereo=True)):
            assert_rejected(lambda make=make, config=config: make(config), ValueError, config.name)
    assert_rejected(lambda: StripWarp(TINY_EYES, False), ValueError, TINY_EYES)
