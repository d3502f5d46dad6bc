"""Streams of the integer renderer: quarters of tiles that a stream renders alone from its own visits, and the test that says
which entries they need."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref import projection
from golden.msv2_ref.array import render_visits
from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.pipeline import Frame, render
from golden.msv2_ref.regions import region_of, stream_entries
from spec.config import TINY_V3
from spec.constants import TILE
from tests.helpers.golden_samples import map_for, random_model, turned_view

ONE = TINY_V3.with_(cores_x=8, cores_y=8, batch_places=16)
FOUR = ONE.with_(name="four", streams=4)


def frame_of(seed: int, config=FOUR, **options) -> Frame:
    """A frame with blend tiles whose last rows and columns of tiles are cut."""
    rng = np.random.default_rng(seed)
    camera = turned_view(*((300, 90), (140, 70), (64, 47))[seed % 3])
    model = random_model(rng, (1500, 60, 900)[seed % 3], levels=4, sh=seed % 2, wild=seed == 2)
    return render(model, camera, config=config, foveation=map_for(camera, (0.2, 0.6), 4), background=(0.1, 0.5, 0.9), **options)


@pytest.fixture(scope="module", params=range(3))
def frame(request) -> Frame:
    return frame_of(request.param)


def test_a_stream_gives_the_pixels_of_its_region(frame):
    """Entries without a bit of the stream change no pixel of its region in the frame, whatever the batches."""
    batches, pixels = FrameBatches(frame), frame.pixels
    for stream in range(FOUR.streams):
        visits = batches.stream_visits(stream)
        got = render_visits(
            FOUR, batches.visit_records_from(0, stream), batches.stream_entry_records(stream), frame.registers.background)
        part, tile = region_of(FOUR, stream), visits.tile[visits.final]
        y, x = np.divmod(tile, frame.registers.tiles_x)
        inside = (TILE * y[:, None] + np.arange(TILE) < frame.registers.height)[:, :, None]
        inside = (inside & (TILE * x[:, None] + np.arange(TILE) < frame.registers.width)[:, None])[:, *part]
        assert inside.any()
        for name, values in got._asdict().items():
            np.testing.assert_array_equal(values[:, *part][inside], getattr(pixels, name)[tile][:, *part][inside])
        assert len(visits.order) == (frame.regions >> stream & 1).sum()


def test_streams_change_nothing_else(frame):
    one = render(
        frame.words, turned_view(frame.registers.width, frame.registers.height), config=ONE,
        foveation=map_for(turned_view(frame.registers.width, frame.registers.height), (0.2, 0.6), 4),
        background=(0.1, 0.5, 0.9))
    assert one.regions is None
    for name in ("colour", "depth", "transmittance"):
        np.testing.assert_array_equal(getattr(one.pixels, name), getattr(frame.pixels, name))
    np.testing.assert_array_equal(one.entries.splat, frame.entries.splat)
    np.testing.assert_array_equal(one.pairs.mask, frame.pairs.mask)


def pixel_rows(frame: Frame, entry: int, tile: int) -> np.ndarray:
    """(16, 16) bool: the pixels of a tile within an intersection's ellipse by real arithmetic, without any margin."""
    splat, registers = frame.entries.splat[entry], frame.registers
    mean = FOUR.formats.mean2d.to_float(frame.projected.mean2d[splat])
    l1, l2, l3 = frame.projected.conic[splat]
    y, x = np.divmod(tile, registers.tiles_x)
    dy, dx = np.mgrid[:TILE, :TILE]
    dx, dy = dx + TILE * x + 0.5 - mean[0], dy + TILE * y + 0.5 - mean[1]
    k = projection.culling_constants(FOUR)
    limit = projection.falloff_limit(int(frame.words.decoded.opacity[splat]), k)
    inside = (TILE * y + np.arange(TILE)[:, None] < registers.height) & (TILE * x + np.arange(TILE) < registers.width)
    return ((l1 * dx + l2 * dy) ** 2 + (l3 * dy) ** 2 <= limit) & inside


def test_every_pixel_in_an_ellipse_has_its_bit(frame):
    """The bits are those of all quarters with such a pixel, and not of many others."""
    tile = np.repeat(np.arange(len(frame.registers.header)), np.diff(frame.entries.start))
    rng = np.random.default_rng(1)
    some = rng.choice(len(tile), min(len(tile), 400), replace=False)
    needed, given = 0, 0
    for entry in some.tolist():
        met = pixel_rows(frame, entry, tile[entry])
        for stream in range(FOUR.streams):
            has, wanted = frame.regions[entry] >> stream & 1, met[region_of(FOUR, stream)].any()
            assert has or not wanted, (entry, stream)
            needed, given = needed + int(wanted), given + int(has)
    assert needed <= given <= 1.35 * needed


def test_entries_of_a_stream_are_those_with_its_bit(frame):
    for stream in range(FOUR.streams):
        part = stream_entries(frame.entries, frame.regions, stream)
        for tile in range(len(part.start) - 1):
            here = slice(frame.entries.start[tile], frame.entries.start[tile + 1])
            bits = (frame.regions[here] >> stream & 1).astype(bool)
            mine = slice(part.start[tile], part.start[tile + 1])
            np.testing.assert_array_equal(part.splat[mine], frame.entries.splat[here][bits])
            np.testing.assert_array_equal(part.use[mine], frame.entries.use[here][bits])


def test_masks_of_places_are_those_of_the_entries(frame):
    batches = FrameBatches(frame)
    masks = batches.stream_masks
    tile = np.repeat(np.arange(len(frame.registers.header)), np.diff(frame.entries.start))
    for stream in range(FOUR.streams):
        wanted = np.zeros(len(masks), np.int64)
        for entry in np.flatnonzero(frame.regions >> stream & 1):
            wanted[frame.pairs.intersection[entry]] |= 1 << batches.grid.place[tile[entry]]
        np.testing.assert_array_equal(masks[:, stream], wanted)
    records = batches.place_records
    np.testing.assert_array_equal(records["mask"], masks[batches.places.pair])


def test_boxes_have_all_regions():
    assert (frame_of(1, obb=True).regions == 15).all()


def test_a_frame_of_one_stream_has_no_regions_to_replace():
    frame = frame_of(1, ONE)
    assert frame.regions is None and replace(frame).regions is None
    assert FrameBatches(frame).stream_masks.shape[1] == 1
