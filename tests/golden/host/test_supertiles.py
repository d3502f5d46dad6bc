"""The host's side of super-tile machines: the table of super-tiles, regions and settings, what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from golden.host import quantise
from golden.host.memory_image import REGIONS, memory_image, supertile_bytes
from golden.msv2_ref.frame_memory import list_lengths
from golden.msv2_ref.pipeline import render
from golden.render import main
from golden.scenes.gaze import Display, FoveationMap, no_foveation
from spec.config import TINY_V3, V3, V3_RECORDS
from spec.constants import SUPER_X, SUPER_Y
from spec.effects import with_two_eyes
from spec.errors import InputError
from spec.memory import DIRECTORY_BEATS, TILE_SETTING_BYTES, frame_settings, page_beats, tile_setting
from tests.helpers.golden_samples import map_for, random_model, view


def frame_of(size=(300, 90), config=TINY_V3, foveation: FoveationMap | None = None, points=300):
    camera = view(*size)
    model = random_model(np.random.default_rng(7), points, 4)
    return render(model, camera, config=config, foveation=foveation or map_for(camera, (0.2, 0.3), 4))


def image_of(frame, config=None, **options):
    return memory_image(config or frame.config, frame.words, frame.registers, entries_beats=40, spill_beats=9, **options)


def every_tile_its_own(width: int, height: int) -> FoveationMap:
    """Tiles with random levels and planes, so that no tile's setting can stand for another's."""
    flat, rng = no_foveation(Display(width, height)), np.random.default_rng(0)
    return replace(flat, levels=4, tile_level=rng.integers(0, 4, flat.tile_level.shape).astype(flat.tile_level.dtype),
                   plane=rng.uniform(-1, 1, flat.plane.shape))


@pytest.mark.parametrize("size", [(300, 90), (128, 32), (16, 16), (129, 33), (127, 31), (400, 20)])
def test_the_table_of_super_tiles(size):
    """Every place by the text of `spec.memory`, and no place twice."""
    frame = frame_of(size, foveation=every_tile_its_own(*size))
    r, record = frame.registers, tile_setting(TINY_V3)
    table = supertile_bytes(TINY_V3, r).reshape(-1, TILE_SETTING_BYTES)
    columns, rows = -(-r.tiles_x // SUPER_X), -(-r.tiles_y // SUPER_Y)
    assert len(table) == 16 * columns * rows
    for n, entry in enumerate(table):
        number, place = divmod(n, 16)
        y, x = number // columns * SUPER_Y + place // SUPER_X, number % columns * SUPER_X + place % SUPER_X
        got = int.from_bytes(entry.tobytes(), "little")
        if y >= r.tiles_y or x >= r.tiles_x:
            assert got == 0
            continue
        tile = y * r.tiles_x + x
        assert got == record.pack({"plane": r.plane[tile], "level": r.header[tile, 0], "blend": r.header[tile, 1]})


def test_regions_and_settings():
    frame = frame_of()
    image = image_of(frame)
    assert list(image.regions) == [n for n in REGIONS if n not in ("views", "target_tiles", "target_frame")]
    assert all(a.end < b.base for a, b in pairwise(image.regions.values()))
    assert image.regions["directory"].beats == TINY_V3.list_heads * DIRECTORY_BEATS
    assert image.regions["supertiles"].beats == len(image.contents["supertiles"]) == 4 * len(frame.bounds.first[1:])
    fields = {f.name for f in frame_settings(TINY_V3).fields}
    assert fields == image.settings.keys() and not fields & {"views_base", "view_shift"}
    assert image.settings["supertiles_base"] == image.regions["supertiles"].base


def test_what_lies_in_memory_is_that_of_lists_by_tile_but_for_the_table():
    frame, other = (frame_of((60, 40), config) for config in (V3, V3_RECORDS))
    mine, theirs = image_of(frame), image_of(other)
    assert mine.contents.keys() - theirs.contents.keys() == {"supertiles"}
    assert all(np.array_equal(mine.contents[name], rows) for name, rows in theirs.contents.items())


def test_room_for_lists_is_that_of_the_pairs():
    frame = frame_of(points=900)
    lengths = list_lengths(frame)
    assert np.array_equal(lengths, np.diff(frame.pairs.start)) and page_beats(lengths) > 8 * len(lengths)
    tiles = frame_of(points=900, config=V3_RECORDS)
    assert np.array_equal(list_lengths(tiles), np.diff(tiles.entries.start))


def test_two_eyes_are_refused_by_the_name_of_a_machine_that_has_them():
    message = r"^two eyes are not accepted: config 'v3' has lists by super-tile .*; config 'paper' does, "
    with pytest.raises(InputError, match=message):
        with_two_eyes(V3)
    assert with_two_eyes(V3_RECORDS).stereo


def test_a_frame_of_super_tiles_through_the_command_line(tmp_path):
    for name, config in (("a", "v3_records"), ("b", "v3")):
        main(["embedded", "--config", config, "--size", "96x54", "--out", str(tmp_path / name)])
    pictures = [(tmp_path / name / "frame.png").read_bytes() for name in "ab"]
    assert pictures[0] == pictures[1]
    tiles, supertiles = (json.loads((tmp_path / name / "stats.json").read_text()) for name in "ab")
    new = {"pairs", "supertiles", "places", "visits", "lists", "batches", "header_hits", "header_misses"}
    assert supertiles.keys() - tiles.keys() == new
    assert (supertiles["supertiles"], supertiles["lists"], supertiles["tiles"]) == (2, 2, 24)
    assert supertiles["pairs"] == supertiles["header_hits"] + supertiles["header_misses"] < supertiles["entries"]
    assert all(tiles[name] == supertiles[name] for name in ("visible", "culled", "entries", "entries_filtered", "coverage"))


def test_more_chunks_than_their_number_can_hold_are_refused(monkeypatch):
    monkeypatch.setattr(quantise, "CHUNK_BITS", 2)
    model = random_model(np.random.default_rng(0), 600)
    assert len(quantise.quantise_model(V3_RECORDS, model).chunks) > 4
    with pytest.raises(InputError, match=r"chunks of Gaussians are not accepted: 2 bits of a chunk's number take 4"):
        quantise.quantise_model(V3, model)
