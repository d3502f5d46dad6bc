"""The integer warp unit against the oracle and against its definition; hard cases 45 to 50.

Hard cases: 45 no coverage, depth invalid · 46 depth normalised · 47 zero disparity at infinity · 48 depth near 0, disparity
beyond the row · 49 many pixels onto one target · 50 hole patterns around the median's limits.
"""

from __future__ import annotations

import numpy as np
import pytest

from golden.metrics.image import psnr_vs
from golden.msv2_ref import warp
from golden.oracle import warp as oracle
from spec.config import TINY
from spec.memory import frame_pixel
from spec.stereo import background_transmittance, reach, solid_transmittance

CONFIG = TINY.with_(name="stereo", stereo=True)
INTERIOR, VEILS = CONFIG.with_(warp_fill="interior"), CONFIG.with_(warp_veiled=True)
N = CONFIG.formats
SOLID, VEILED, EMPTY = 0, 20000, N.transmittance.raw_max
"""Raw transmittances of a pixel with a depth, of one without, of background."""

SCALE = 1 << 10
"""Disparity scale of 1/16 pixel at full depth: the smallest disparity that `pixels` can make."""


def pixels(disparity: np.ndarray, transmittance: np.ndarray | int = SOLID, seed: int = 0) -> np.ndarray:
    """FramePixel records of random colours whose disparity at SCALE is nearest to the one given, in pixels."""
    disparity = np.atleast_2d(np.asarray(disparity, float))
    out = np.zeros(disparity.shape, frame_pixel(CONFIG).dtype)
    out["colour"] = np.random.default_rng(seed).integers(0, 1 << N.accumulator.frac_bits, (*disparity.shape, 3))
    out["transmittance"] = transmittance
    weight = (N.transmittance.raw_max - out["transmittance"]) / 8
    with np.errstate(divide="ignore"):
        out["depth"] = np.minimum(np.round(SCALE * weight / (disparity * 256)), N.depth_accumulator.raw_max)
    return out


def warped(frame: np.ndarray, scale: int = SCALE, *, right: bool = False, config=CONFIG) -> warp.WarpedFrame:
    return warp.warp(config, frame, scale, right)


def by_hand(frame: np.ndarray, scale: int, right: bool, veiled: bool) -> tuple[np.ndarray, np.ndarray]:
    """Column and key of every pixel in Python's integers, -1 where it is not warped; the text of docs/stereo.md."""
    columns, keys = np.full(frame.shape, -1), np.zeros(frame.shape, int)
    furthest = CONFIG.warp_columns * 3 // 4
    most = (1 << furthest.bit_length() + 8) - 1
    for (y, x), pixel in np.ndenumerate(frame):
        t, d = int(pixel["transmittance"]), int(pixel["depth"])
        if 255 * (32768 - t) < 32768:
            columns[y, x] = x
        elif veiled or 2 * (32768 - t) >= 32768:
            raw = most if d == 0 else min(most, scale * (32767 - t) // 8 // d)
            to = x + ((raw if right else -raw) + 128) // 256
            if 0 <= to < frame.shape[1] and abs(to - x) <= furthest:
                columns[y, x], keys[y, x] = to, raw + 1
    return columns, keys


@pytest.mark.parametrize("right", [False, True])
@pytest.mark.parametrize("config", [CONFIG, VEILS], ids=["solid", "veiled"])
@pytest.mark.parametrize("size", [(1, 1), (5, 37), (18, 61), (16, 512)])
def test_columns_and_keys_are_those_of_the_text(size, config, right):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        frame = np.zeros(size, frame_pixel(CONFIG).dtype)
        frame["transmittance"] = rng.choice([0, 4000, 16383, 16384, 16385, 20000, 32639, 32640, 32767], size)
        frame["depth"] = np.where(rng.random(size) < 0.1, rng.integers(0, 3, size), (1 << 18) * rng.random(size) ** 3)
        for scale in (0, 1, 700, 1 << 16, (1 << 24) - 1):
            moved = warp.warp_pixels(config, frame, scale, right)
            columns, keys = by_hand(frame, scale, right, config.warp_veiled)
            assert np.array_equal(np.where(moved["keep"] == 1, moved["x"], -1), columns)
            assert np.array_equal(moved["key"], keys)
            assert np.array_equal(moved["row"], np.indices(size)[0] % 16)


@pytest.mark.parametrize("right", [False, True])
@pytest.mark.parametrize("config", [CONFIG, INTERIOR, VEILS], ids=["majority", "interior", "veiled"])
def test_scatter_and_fill_are_the_oracles(config, right):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        disparity = rng.choice([0.25, 1.5, 2.0, 3.75, 8.0], (35, 13)).repeat(4, 1)[:, :49]
        t = rng.choice([SOLID, 9000, VEILED, EMPTY], disparity.shape, p=[0.6, 0.3, 0.05, 0.05])
        frame = pixels(disparity, t, seed)
        raw = warp.raw_disparity(CONFIG, frame["transmittance"], frame["depth"], SCALE)
        shown = display_colours(frame)
        found = warped(frame, right=right, config=config)
        depth, coverage = 256.0 / np.maximum(raw, 1), 1 - frame["transmittance"] / 32768
        wanted = oracle.warp(shown / 255.0, depth, coverage, 1.0, 1 if right else -1, veiled=config.warp_veiled,
                             majority=config.warp_fill == "majority")
        assert np.array_equal(found.origin, wanted.origin)
        assert np.array_equal(found.pixels["colour"], np.round(wanted.image * 255))
        assert np.array_equal(found.invalid, wanted.tiles.reshape(-1))
        solid = np.isin(found.origin, (warp.WARPED, warp.FILLED))
        assert np.array_equal(found.pixels["coverage"], np.where(solid, 255, 0))


def display_colours(frame: np.ndarray) -> np.ndarray:
    return np.minimum((510 * frame["colour"].astype(int) + (1 << 14)) // (2 << 14), 255)


@pytest.mark.parametrize("right", [False, True])
def test_pixels_move_as_far_as_the_window_reaches(right):
    """By three quarters of its columns, not a pixel further; where it holds whole rows, to the frame's other side."""
    for config, most in ((CONFIG, 96), (CONFIG.with_(warp_columns=64), 48), (CONFIG.with_(warp_columns=512), 511)):
        scale, at, disparity = 12_500 * most, 0 if right else 511, np.full((4, 512), 1e-3)
        disparity[:, at] = most, most + 0.25, most + 0.75, most + 1
        frame = pixels(disparity, np.where(disparity > 1, SOLID, EMPTY))
        frame["depth"][:, at] = np.round(scale * 32767 / 8 / 256 / disparity[:, at])
        moved = warp.warp_pixels(config, frame, scale, right)[:, at]
        assert moved["keep"].tolist() == [1, 1, 0, 0]
        assert (moved["x"][:2] == (most if right else 511 - most)).all()
        found, depth = warp.warp(config, frame, scale, right), 1 / disparity
        wanted = oracle.warp(display_colours(frame) / 255.0, depth, 1 - frame["transmittance"] / 32768, 1.0, 1 if right else -1,
                             reach=reach(config))
        assert np.array_equal(found.origin, wanted.origin)


def test_equal_keys_never_meet():
    """Why the order in which a row's pixels come does not matter: equal disparities move equally far."""
    rng = np.random.default_rng(0)
    frame = pixels(rng.choice([0.5, 1.0, 1.25, 6.0], (64, 64)))
    moved = warp.warp_pixels(CONFIG, frame, SCALE, False)
    places = np.stack([np.indices(moved.shape)[0], moved["x"], moved["key"]], -1)[moved["keep"] == 1]
    assert len(np.unique(places, axis=0)) == len(places) and len(np.unique(places[:, :2], axis=0)) < len(places)
    order = rng.permutation(64)
    strips = warp.scatter(moved)
    assert np.array_equal(warp.scatter(moved[:, order]), strips)


def test_45_no_coverage_and_no_depth():
    found = warped(pixels(np.full((20, 20), 4.0), EMPTY))
    assert (found.origin == warp.BACKGROUND).all() and not found.invalid.any() and not found.pixels["coverage"].any()
    assert np.array_equal(found.pixels["colour"], display_colours(pixels(np.full((20, 20), 4.0), EMPTY)))
    for t, origin in (
        (background_transmittance(N) - 1, warp.HOLE), (solid_transmittance(N) + 1, warp.HOLE),
        (solid_transmittance(N), warp.WARPED), (background_transmittance(N), warp.BACKGROUND),
    ):
        assert warped(pixels(0.25, t)).origin.tolist() == [[origin]]


def test_46_depth_is_normalised():
    """Half the coverage and half the sum are the same depth."""
    for t in (SOLID, 8192, 16384):
        raw = warp.raw_disparity(CONFIG, *(pixels(5.0, t)[name] for name in ("transmittance", "depth")), SCALE)
        assert abs(int(raw[0, 0]) - 5 * 256) <= 1


def test_47_what_is_at_infinity_stays():
    frame = pixels(np.full((3, 9), 1e-9))
    for right in (False, True):
        found = warped(frame, 40, right=right)
        assert np.array_equal(found.moved["x"][0], np.arange(9)) and (found.origin == warp.WARPED).all()


def test_48_beyond_the_row_and_depth_zero():
    frame = pixels(np.full((1, 40), 39.0))
    frame["depth"][0, 5:] = 0
    for right in (False, True):
        found = warped(frame, right=right)
        assert found.strips["valid"].sum() == right and found.invalid.all()


def test_49_the_nearest_of_many_wins_whatever_the_order():
    disparity = np.array([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]])
    frame = pixels(disparity)
    found = warped(frame)  # all to column -1 + ...: x - (x + 1)
    assert found.strips["valid"].sum() == 0
    many = warped(pixels(disparity - 1))  # all to column 0, the last is the nearest
    assert many.strips["valid"].tolist() == [[1] + [0] * 7]
    assert many.strips["colour"][0, 0].tolist() == display_colours(pixels(disparity - 1))[0, 7].tolist()
    hidden = pixels([[2.0, 0.25, 0.25]], [[EMPTY, SOLID, SOLID]])
    assert warped(hidden, 4 * SCALE).strips["key"][0, 0] > 0  # anything hides the background


@pytest.mark.parametrize(("holes", "filled"), [
    ([(1, 1)], [(1, 1)]), ([(1, 1), (0, 0), (0, 1), (0, 2)], [(1, 1)]), ([(1, 1), (0, 0), (0, 1), (0, 2), (1, 0)], []),
    ([(1, 0)], [(1, 0)]), ([(1, 0), (2, 0)], []), ([(0, 1)], [(0, 1)]), ([(0, 0)], []), ([(15, 4)], [(15, 4)]),
    ([(16, 4)], [(16, 4)]), ([(15, 4), (16, 4)], [(15, 4), (16, 4)]), ([(15, 4), (15, 5)], []),
])
def test_50_five_neighbours_of_the_strip_fill_a_hole(holes, filled):
    holes_and_fills(INTERIOR, (32, 9), holes, filled)


@pytest.mark.parametrize(("size", "holes", "filled"), [
    ((32, 9), [(1, 1), (0, 0), (0, 2), (1, 0)], [(0, 2), (1, 0), (1, 1)]),
    ((32, 9), [(1, 1), (0, 0), (0, 1), (0, 2), (1, 0)], [(0, 2)]), ((32, 9), [(1, 0), (2, 0)], [(1, 0), (2, 0)]),
    ((32, 9), [(1, 0), (2, 0), (1, 1), (2, 1)], [(1, 1), (2, 1)]),
    ((32, 9), [(15, 4), (15, 5)], [(15, 4), (15, 5)]),
    ((32, 9), [(16, 4), (16, 5), (16, 3)], [(16, 3), (16, 4), (16, 5)]),
    ((32, 9), [(15, 4), (14, 4), (14, 5)], [(14, 4), (14, 5), (15, 4)]),
    ((32, 9), [(0, 4), (1, 3), (1, 4), (1, 5)], [(1, 3), (1, 4), (1, 5)]),
    ((32, 9), [(0, 0)], [(0, 0)]), ((32, 9), [(31, 8), (31, 7)], [(31, 7), (31, 8)]),
    ((32, 9), [(16, 0), (16, 1), (17, 0)], [(16, 1), (17, 0)]),
    ((17, 9), [(16, 0)], [(16, 0)]), ((17, 9), [(16, 4)], [(16, 4)]), ((17, 9), [(16, 4), (16, 5)], []),
    ((32, 1), [(7, 0), (15, 0), (16, 0)], [(7, 0), (15, 0), (16, 0)]), ((32, 1), [(7, 0), (8, 0)], []),
    ((17, 1), [(16, 0)], []), ((1, 2), [(0, 1)], [(0, 1)]), ((32, 2), [(3, 0), (3, 1)], [(3, 0), (3, 1)]),
], ids=str)
def test_50_more_than_half_of_the_neighbours_that_exist_fill_a_hole(size, holes, filled):
    holes_and_fills(CONFIG, size, holes, filled)


def holes_and_fills(config, size, holes, filled):
    t = np.full(size, SOLID)
    t[tuple(np.transpose(holes))] = VEILED
    found = warped(pixels(np.full(size, 0.25), t), config=config)
    assert sorted(map(tuple, np.argwhere(found.origin == warp.FILLED).tolist())) == sorted(filled)
    tiles = -(-size[0] // 16)
    assert found.invalid.tolist() == [any(y // 16 == tile for y, _ in set(holes) - set(filled)) for tile in range(tiles)]


def test_45_veiled_pixels_are_warped_where_the_machine_does():
    veil = pixels(np.full((20, 20), 4.0), VEILED)
    assert warped(veil).invalid.all()
    found = warped(veil, config=VEILS)
    assert (found.origin[:, :16] == warp.WARPED).all() and (found.origin[:, 16:] == warp.HOLE).sum() > 40
    assert np.array_equal(found.pixels["colour"][:, :16], display_colours(veil)[:, 4:])


def test_50_the_median_of_an_even_number_is_the_lower_middle():
    frame = pixels(np.full((3, 3), 0.25))
    frame["transmittance"][1, 1] = frame["transmittance"][0, 0] = frame["transmittance"][0, 2] = VEILED
    found = warped(frame).pixels["colour"][1, 1]
    around = display_colours(frame)[[0, 1, 1, 2, 2, 2], [1, 0, 2, 0, 1, 2]]
    assert found.tolist() == np.sort(around, axis=0)[2].tolist()


def read_pgm(path) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(path))


def test_middlebury_cones_warped_by_their_true_disparity(data_dir, record_property):
    """The left photograph, warped, against the right one: sees the signs, the rounding and the order of depths."""
    folder = data_dir / "stereo" / "cones"
    if not folder.is_dir():
        pytest.skip(f"no Middlebury cones at {folder}")
    left, right, known = (read_pgm(folder / name) for name in ("im2.png", "im6.png", "disp2.pgm"))
    disparity = known / 4.0
    scale = 80000
    frame = np.zeros(known.shape, frame_pixel(CONFIG).dtype)
    frame["colour"] = np.round(left[..., :3] / 255.0 * (1 << N.accumulator.frac_bits))
    frame["transmittance"] = np.where(known > 0, SOLID, VEILED)
    frame["depth"] = np.where(known > 0, np.round(scale * 32767 / 8 / np.maximum(known * 64.0, 1)), 0)
    found = warped(frame, scale)
    valid = found.origin == warp.WARPED
    raw = warp.raw_disparity(CONFIG, frame["transmittance"], frame["depth"], scale)
    assert np.abs(raw / 256 - disparity)[known > 0].max() <= 1 / 128
    assert np.array_equal(display_colours(frame), left[..., :3])
    with_warp, without = (psnr_vs(image[valid] / 255.0, right[..., :3][valid] / 255.0)
                          for image in (found.pixels["colour"], left[..., :3]))
    record_property("psnr_warped_db", with_warp)
    record_property("psnr_unwarped_db", without)
    print(f"cones: {with_warp:.2f} dB warped, {without:.2f} dB not, over {valid.mean():.1%} of the pixels")
    assert valid.mean() > 0.7 and with_warp > without + 8
