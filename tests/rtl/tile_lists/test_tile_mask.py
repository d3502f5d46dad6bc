"""The second eye's tiles: which are rendered is decided by the host's table and the mask of holes, in both readers of it."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest
from amaranth.hdl import Module
from amaranth.lib import memory, wiring

from rtl.tile_lists.header_maker import HeaderMaker
from rtl.tile_lists.table_loader import TableLoader
from spec.config import TINY
from spec.memory import tile_setting
from spec.records import tile_group, tile_header, tile_level, tile_use
from tests.helpers.rtl_ports import beats_of, play, words_of

STEREO = TINY.with_(row_width=176, stereo=True)  # 121 tiles
TILES, TILES_X = 103, 11


class Masked(wiring.Component):
    """A unit and a memory of its mask, one bit a tile."""

    def __init__(self, unit, mask):
        self._unit, self._mask = unit, mask
        super().__init__({})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = self._unit
        m.submodules.mask = mask = memory.Memory(shape=1, depth=1 << len(unit.mask_tile), init=self._mask)
        read = mask.read_port()
        m.d.comb += [read.addr.eq(unit.mask_tile), unit.mask.eq(read.data)]
        return m


def drawn(seed):
    """A table, its words, the mask, and which tiles of the target eye are rendered."""
    rng = random.Random(seed)
    table = [{"plane": [rng.randrange(-2**18, 2**18) for _ in range(3)], "level": rng.randrange(4), "blend": rng.randrange(2),
              "warp": rng.random() < 0.7} for _ in range(TILES)]
    mask = [int(rng.random() < 0.3) for _ in range(TILES)]
    rendered = [int(not row["warp"] or hole) for row, hole in zip(table, mask, strict=True)]
    return table, [tile_setting(STEREO).pack(row) for row in table], mask, rendered


@pytest.mark.parametrize("held", [0.0, 0.4])
@pytest.mark.parametrize("target", [0, 1])
def test_the_table_tells_which_tiles_are_rendered_and_how_many(target, held):
    table, words, mask, rendered = drawn(target)
    rendered = rendered if target else [1] * TILES
    dut, counts = TableLoader(STEREO), []

    def each(ctx, cycle):
        ctx.set(dut.start, cycle in (2, 500))
        counts.append(ctx.get(dut.rendered_tiles))

    moves = play(dut, {"data": [*beats_of(words, 4), *beats_of(words, 4)]}, {"reads": 0.0, "levels": held}, 1000, each=each,
                 setup={"tiles_base": 7, "tile_count": TILES, "target": target}, design=Masked(dut, mask))
    record = tile_level(STEREO)
    assert words_of(moves, "levels") == [
        record.pack({"tile": t, "level": row["level"], "blend": row["blend"], "rendered": rendered[t]})
        for t, row in enumerate(table)] * 2
    assert counts[499] == counts[-1] == sum(rendered) and counts[502] <= 1


@pytest.mark.parametrize("held", [0.0, 0.4])
@pytest.mark.parametrize("target", [0, 1])
def test_tiles_that_are_not_rendered_have_neither_header_nor_level(target, held):
    """Two frames behind each other, `clear` between them."""
    table, words, mask, rendered = drawn(2 + target)
    rng, dut, done = random.Random(9), HeaderMaker(STEREO), []
    counts = [rng.randrange(1 << 20) if not target or rendered[i % TILES] else 0 for i in range(2 * TILES)]
    group = tile_group(STEREO)
    tiles = [group.pack({"tile": i % TILES, "count": count, "group": 0, "last": 1}) for i, count in enumerate(counts)]

    def each(ctx, cycle):
        done.append(ctx.get(dut.done))
        ctx.set(dut.clear, done[-1] and len(done) < 900)

    moves = play(dut, {"tiles": tiles, "data": [*beats_of(words, 4), *beats_of(words, 4)]},
                 {"reads": 0.0, "headers": held, "levels": held}, 1300,
                 setup={"tiles_base": 7, "tiles_x": TILES_X, "tile_count": TILES, "target": target}, each=each,
                 design=Masked(dut, mask))
    header, use, headers, uses = tile_header(STEREO), tile_use(STEREO), [], []
    for i, count in enumerate(counts):
        row, tile = table[i % TILES], i % TILES
        if rendered[tile] or not target:
            headers.append(header.pack({**{name: row[name] for name in ("plane", "blend")}, "tile_y": tile // TILES_X,
                                        "tile_x": tile % TILES_X, "outer": int(row["level"] > 0), "count": count}))
            uses.append(use.pack({"level": row["level"], "blend": row["blend"], "count": count}))
    assert words_of(moves, "headers") == headers and words_of(moves, "levels") == uses
    assert sum(b and not a for a, b in pairwise(done)) == 2 and not done[0]
