"""Tiles in pieces: however a tile's list is split, its pixels are those of the whole list, with ==."""

from __future__ import annotations

import numpy as np
import pytest

from golden.msv2_ref.array import Pixels, render_tiles, render_visits
from spec.config import DEFAULT, PAPER, AcceleratorConfig
from spec.constants import SUPER_TILES
from spec.supertiles import tile_visit, visit_entry
from spec.tables import t_stop
from tests.golden.msv2_ref.test_array import header, random_entries, random_headers, wide_entry

BACKGROUND = np.array([100, 300, 500])


def in_pieces(
    headers: np.ndarray, entries: np.ndarray, cuts: list[list[int]], order: np.ndarray, config: AcceleratorConfig = DEFAULT,
) -> tuple[Pixels, np.ndarray]:
    """The pixels of tiles whose lists are cut before these entries, and the tile of each; `order` has every tile as many times
    as it has pieces, and says when each comes. Tiles keep their states at different places."""
    start = np.concatenate(([0], np.cumsum(headers["count"].astype(np.int64))))
    record, kind = tile_visit(config), visit_entry(config)
    visits, streams, done, taken = np.zeros(len(order), record.dtype), [], [], [0] * len(headers)
    for row, tile in zip(visits, order.tolist(), strict=True):
        edges = [0, *cuts[tile], int(headers["count"][tile])]
        piece, taken[tile] = taken[tile], taken[tile] + 1
        for name in set(record.dtype.names) & set(headers.dtype.names):
            row[name] = headers[name][tile]
        row["place"], row["fresh"], row["final"] = tile % SUPER_TILES, piece == 0, piece == len(edges) - 2
        done += [tile] if row["final"] else []
        part = entries[start[tile] + edges[piece] : start[tile] + edges[piece + 1]]
        stream = np.zeros(len(part) + 1, kind.dtype)
        for name in part.dtype.names:
            stream[name][:-1] = part[name]
        stream["end"][-1] = 1
        streams.append(stream)
    return render_visits(config, visits, np.concatenate(streams), BACKGROUND), np.array(done)


def assert_the_same(headers, entries, cuts, order, config: AcceleratorConfig = DEFAULT) -> None:
    whole = render_tiles(config, headers, entries, BACKGROUND)
    pieces, tile = in_pieces(headers, entries, cuts, order, config)
    assert sorted(tile.tolist()) == list(range(len(headers)))
    for name, got in pieces._asdict().items():
        assert np.array_equal(got, getattr(whole, name)[tile]), name


@pytest.mark.parametrize("config", [DEFAULT, PAPER.with_(depth=False), PAPER.with_(fine_depth=True)],
                         ids=["default", "no depth", "fine depth"])
@pytest.mark.parametrize("seed", range(4))
def test_random_splits(seed, config):
    """Sixteen tiles, some of them blend tiles, whose pieces come in turn; pieces may be empty."""
    rng = np.random.default_rng(seed)
    headers = random_headers(rng, rng.integers(0, 200, SUPER_TILES).tolist(), config)
    tiles = np.column_stack([headers["tile_x"], headers["tile_y"]]).repeat(headers["count"], axis=0)
    entries = random_entries(rng, tiles, config)
    cuts = [sorted(rng.integers(0, count, rng.integers(0, 9), endpoint=True).tolist()) for count in headers["count"].tolist()]
    order = rng.permutation(np.repeat(np.arange(len(headers)), [len(c) + 1 for c in cuts]))
    assert headers["blend"].any() and not headers["blend"].all()
    assert_the_same(headers, entries, cuts, order, config)


def test_an_entry_at_a_time():
    rng = np.random.default_rng(9)
    headers = random_headers(rng, [70, 33])
    headers["blend"] = 1
    entries = random_entries(rng, np.column_stack([headers["tile_x"], headers["tile_y"]]).repeat(headers["count"], axis=0))
    order = rng.permutation(np.repeat([0, 1], [70, 33]))
    assert_the_same(headers, entries, [list(range(1, 70)), list(range(1, 33))], order)


def test_a_bank_that_gets_nothing_in_a_piece():
    """The first piece is for the tile's level alone, the second for the next level, the third for none of them."""
    rng = np.random.default_rng(5)
    headers = random_headers(rng, [30])
    headers["blend"], headers["plane"] = 1, DEFAULT.formats.plane.quantise([0.3, 0.02, 0.01])
    entries = random_entries(rng, np.column_stack([headers["tile_x"], headers["tile_y"]]).repeat(30, axis=0))
    entries["use"] = np.repeat([(1, 0), (0, 1), (0, 0)], 10, axis=0)
    assert_the_same(headers, entries, [[10, 20]], np.zeros(3, np.int64))


def test_a_tile_that_stops_in_its_first_piece_of_40():
    opaque = np.concatenate([wide_entry(log2_opacity=7.0, use=(1, 1), colour=(511, 100, 50))] * 3)
    behind = np.concatenate([wide_entry(log2_opacity=0.0, colour=(0, 511, 511))] * 39)
    entries = np.concatenate([opaque, behind])
    for blend in (0, 1):
        tile = header(count=len(entries), outer=1, blend=blend, plane=DEFAULT.formats.plane.quantise([0.4, 0.01, 0.0]))
        stopped = render_tiles(DEFAULT, header(count=3, outer=1), opaque, BACKGROUND)
        assert (stopped.transmittance < t_stop(DEFAULT.formats)).all()
        assert_the_same(tile, entries, [list(range(3, len(entries)))], np.zeros(40, np.int64))


def test_a_blend_tile_of_which_one_bank_stops():
    """Only the next level stops in the first piece, because level 1 has no use of the opaque splats."""
    opaque = np.concatenate([wide_entry(log2_opacity=7.0, use=(0, 1), colour=(511, 100, 50))] * 3)
    behind = np.concatenate([wide_entry(log2_opacity=-1.0, colour=(0, 511, 511))] * 6)
    entries = np.concatenate([opaque, behind])
    tile = header(count=len(entries), blend=1, plane=DEFAULT.formats.plane.quantise([0.4, 0.01, 0.0]))
    inner = render_tiles(DEFAULT, header(count=9), entries, BACKGROUND)
    opaque["use"] = opaque["use"][:, ::-1]  # the next level's use, in a tile of that level
    outer = render_tiles(DEFAULT, header(count=3, outer=1), opaque, BACKGROUND)
    assert (inner.transmittance >= t_stop(DEFAULT.formats)).all() and (outer.transmittance < t_stop(DEFAULT.formats)).all()
    assert_the_same(tile, entries, [[3, 5]], np.zeros(3, np.int64))


def test_empty_tiles_and_no_visits():
    headers = random_headers(np.random.default_rng(1), [0, 0])
    entries = random_entries(np.random.default_rng(1), np.zeros((0, 2), np.int64))
    assert_the_same(headers, entries, [[0, 0], []], np.array([0, 1, 0, 0]))
    none = render_visits(DEFAULT, np.zeros(0, tile_visit(DEFAULT).dtype), np.zeros(0, visit_entry(DEFAULT).dtype), BACKGROUND)
    assert len(none.colour) == 0


def test_every_visit_has_its_end():
    with pytest.raises(ValueError, match=r"^entries must have 1 items with `end`, one behind every visit, not 0$"):
        render_visits(DEFAULT, np.zeros(1, tile_visit(DEFAULT).dtype), np.zeros(3, visit_entry(DEFAULT).dtype), BACKGROUND)
