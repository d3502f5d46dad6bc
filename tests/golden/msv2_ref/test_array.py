"""The array of the integer renderer against docs/array.md in plain Python, with ==."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref import array_kernel
from golden.msv2_ref.array import Pixels, render_tiles
from golden.msv2_ref.pipeline import render
from spec.config import DEFAULT, TINY, AcceleratorConfig, NumberFormats
from spec.constants import EXPONENT_SCALE, LOW_PASS
from spec.formats import SQ, UQ
from spec.records import array_splat, tile_header
from spec.tables import t_stop
from tests.helpers.array_by_the_text import ArrayByTheText
from tests.helpers.golden_samples import map_for, random_model, turned_view

N = DEFAULT.formats
WHITE = float(N.weight.to_float(N.weight.raw_max))
"""The brightest 1.0: all the weight that the first transmittance gives."""


def conic_bits(angle: np.ndarray, major: np.ndarray, minor: np.ndarray, config: AcceleratorConfig = DEFAULT) -> np.ndarray:
    """(n, 3) bit patterns of the Cholesky factors of ellipses of these deviations in pixels, the low-pass added."""
    c, s = np.cos(angle), np.sin(angle)
    xx, yy = (c * major) ** 2 + (s * minor) ** 2, (s * major) ** 2 + (c * minor) ** 2
    det = (major * minor) ** 2 + LOW_PASS * (xx + yy) + LOW_PASS**2
    xy, yy = c * s * (major**2 - minor**2), yy + LOW_PASS
    l1 = np.sqrt(yy / det)
    return config.formats.conic.quantise(EXPONENT_SCALE * np.stack([l1, -l1 * xy / yy, 1 / np.sqrt(yy)], 1))


def random_entries(rng: np.random.Generator, tiles: np.ndarray, config: AcceleratorConfig = DEFAULT) -> np.ndarray:
    """One ArraySplat per row of `tiles` (n, 2): splats in and around their tile, from dots and needles to giants.

    A quarter lie far off, where pairs are dropped. Factors come from covariances with the low-pass, as in the machine.
    """
    n, f = len(tiles), config.formats
    entries = np.zeros(n, array_splat(config).dtype)
    distance = np.where(rng.random((n, 1)) < 0.25, 200.0, 12.0)
    entries["mean2d"] = f.mean2d.quantise(tiles * 16 + 8 + distance * rng.normal(size=(n, 2)))
    entries["conic"] = conic_bits(rng.uniform(0, np.pi, n), *10 ** rng.uniform(-2, 3, (2, n)), config)
    entries["use"] = rng.integers(0, 2, (n, 2))
    frac = f.log2_opacity.frac_bits
    entries["log2_opacity"] = rng.integers(-9 << frac, (7 << frac) + 1, (n, 2))
    entries["colour"] = rng.integers(0, f.colour.raw_max, (n, 6), endpoint=True) * rng.choice((0.3, 1.0), (n, 1))
    entries["depth"] = rng.integers(0, f.depth.raw_max, n, endpoint=True)
    return entries


def random_headers(rng: np.random.Generator, counts: list[int], config: AcceleratorConfig = DEFAULT) -> np.ndarray:
    """Tiles with random positions, flags and planes that cross 0 and 1 inside the tile."""
    n, plane = len(counts), config.formats.plane
    headers = np.zeros(n, tile_header(config).dtype)
    headers["tile_x"], headers["tile_y"] = rng.integers(0, 60, (2, n))
    headers["outer"], headers["blend"] = rng.integers(0, 2, (2, n))
    slope = rng.uniform(-0.15, 0.15, (n, 2))
    start = rng.uniform(-0.5, 1.5, n) - slope.sum(1) * 8
    headers["plane"] = plane.quantise(np.column_stack([start, slope]))
    headers["count"] = counts
    return headers


def assert_by_the_text(config: AcceleratorConfig, headers, entries, background) -> Pixels:
    got = render_tiles(config, headers, entries, np.array(background))
    expected = ArrayByTheText(config).render(headers, entries, list(background))
    assert np.array_equal(got.transmittance, expected[..., 0])
    assert np.array_equal(got.colour, expected[..., 1:4])
    assert np.array_equal(got.depth, expected[..., 4])
    return got


@pytest.mark.parametrize("seed", range(3))
def test_random_tiles(seed):
    rng = np.random.default_rng(seed)
    headers = random_headers(rng, [0, 1, 2, 30, 18, 25])
    tiles = np.column_stack([headers["tile_x"], headers["tile_y"]]).repeat(headers["count"], axis=0)
    entries = random_entries(rng, tiles)
    text = ArrayByTheText(DEFAULT)
    kept = [text.polynomial(array_splat(DEFAULT).unpack(array_splat(DEFAULT).pack(e)), *t) is not None
            for e, t in zip(entries, tiles.tolist(), strict=True)]
    assert 0 < sum(kept) < len(kept)  # dropped pairs are among them
    got = assert_by_the_text(DEFAULT, headers, entries, rng.integers(0, 1024, 3).tolist())
    assert (got.transmittance[1:] < N.transmittance.raw_max).any()


@pytest.mark.parametrize("outer", [0, 1])
@pytest.mark.parametrize("blend", [0, 1])
def test_every_combination_of_use(blend, outer):
    rng = np.random.default_rng(7)
    headers = random_headers(rng, [16])
    headers["blend"], headers["outer"] = blend, outer
    headers["plane"] = N.plane.quantise([0.1, 0.05, 0.001])
    entries = random_entries(rng, np.column_stack([headers["tile_x"], headers["tile_y"]]).repeat(16, axis=0))
    entries["use"] = [(i & 1, i >> 1 & 1) for i in range(16)]
    got = assert_by_the_text(DEFAULT, headers, entries, [100, 200, 300])
    entries["use"][:, 1] = 0
    changed = not np.array_equal(render_tiles(DEFAULT, headers, entries, np.array([100, 200, 300])).colour, got.colour)
    assert changed == bool(blend)


def wide_entry(tile=(3, 2), log2_opacity=0.0, colour=(511, 0, 0), use=(1, 1), depth=5000) -> np.ndarray:
    """One splat centred on its tile and much wider than it."""
    entry = np.zeros(1, array_splat(DEFAULT).dtype)
    entry["mean2d"] = N.mean2d.quantise(np.array(tile) * 16 + 8.5)
    entry["conic"] = N.conic.quantise([1e-3, 0, 1e-3])
    entry["use"], entry["log2_opacity"], entry["depth"] = use, N.log2_opacity.quantise(log2_opacity), depth
    entry["colour"] = [*colour, *colour]
    return entry


def header(tile=(3, 2), count=1, **changes) -> np.ndarray:
    row = np.zeros(1, tile_header(DEFAULT).dtype)
    row["tile_x"], row["tile_y"], row["count"] = *tile, count
    for name, value in changes.items():
        row[name] = value
    return row


def test_amplification_of_128_saturates_to_one_or_to_the_first_levels_bound():
    entry = wide_entry(log2_opacity=7.0, colour=(512, 512, 512))
    inner = assert_by_the_text(DEFAULT, header(), entry, [0, 0, 0])
    outer = assert_by_the_text(DEFAULT, header(outer=1), entry, [0, 0, 0])
    assert (outer.transmittance == 0).all() and (N.accumulator.to_float(outer.colour) == WHITE).all()
    assert np.allclose(N.transmittance.to_float(inner.transmittance), 0.01, atol=2.0**-N.alpha.frac_bits)


def test_an_empty_tile_shows_the_background_and_keeps_its_light():
    got = assert_by_the_text(DEFAULT, header(count=0, blend=1), wide_entry()[:0], [512, 100, 1023])
    assert (got.transmittance == N.transmittance.raw_max).all() and (got.depth == 0).all()
    assert np.allclose(N.accumulator.to_float(got.colour), np.array([512, 100, 1023]) / 512, atol=2 * (1 - WHITE))


def test_pixels_stop_after_the_splat_that_stops_them():
    """0.99 leaves 1 %, another 0.01 %: the second and third still show, the fourth does not."""
    colours = [(0, 0, 0), (0, 0, 0), (0, 1023, 0), (0, 0, 1023)]
    entries = np.concatenate([wide_entry(log2_opacity=7.0, colour=c) for c in colours])
    got = assert_by_the_text(DEFAULT, header(count=4), entries, [0, 0, 0])
    assert (got.transmittance <= t_stop(N)).all() and (got.colour[..., 2] == 0).all()
    many = np.concatenate([entries, *[wide_entry(colour=(1023, 1023, 1023))] * 40])  # tiles stop as well
    assert np.array_equal(assert_by_the_text(DEFAULT, header(count=44), many, [0, 0, 0]).colour, got.colour)


def test_weights_and_last_transmittance_sum_to_the_first():
    """White splats on white: every pixel is the brightest white there is, however many splats cover it."""
    rng = np.random.default_rng(1)
    entries = random_entries(rng, np.tile([3, 2], (60, 1)))
    entries["colour"], entries["use"] = 512, 1
    got = assert_by_the_text(DEFAULT, header(count=60), entries, [512, 512, 512])
    assert (N.accumulator.to_float(got.colour) == WHITE).all()


def test_needles_across_a_tile():
    """The thinnest and longest splats at every angle: the largest factors, slopes and curvatures that occur."""
    angles = np.linspace(0, np.pi, 24, endpoint=False)
    entries = np.concatenate([wide_entry(log2_opacity=o, colour=(300, 20, 700)) for o in np.linspace(-6, 7, len(angles))])
    entries["conic"] = conic_bits(angles, 1e4, 0.0)
    entries["mean2d"] += np.random.default_rng(0).integers(-9000, 9000, (len(angles), 2)).astype(np.int32)
    assert_by_the_text(DEFAULT, header(count=len(angles)), entries, [1, 2, 3])


@pytest.mark.parametrize("conic", [0.0, N.conic.min, -N.conic.min])
def test_vanishing_factors(conic):
    entry = wide_entry()
    entry["conic"] = N.conic.quantise([max(conic, N.conic.min), conic, max(conic, N.conic.min)])
    got = assert_by_the_text(DEFAULT, header(), entry, [0, 0, 0])
    assert len(np.unique(got.transmittance)) == 1  # as good as flat


@pytest.mark.parametrize("raw", [0, 1, 2, 3, 700])
def test_the_rows_that_are_visited_hold_every_row_within_reach(raw):
    """A row is `v + k3 (row - 8)` from the splat's centre, in raw units of `offset`; nothing is visited far beyond reach."""
    k = array_kernel.array_constants(DEFAULT)
    unit, random = 2.0 ** (k.offset_frac - k.factor_frac), np.random.default_rng(raw)
    for _ in range(500):
        falloff = float(random.integers(0, 20 << k.cut_frac))
        reach = math.sqrt(falloff / 2**k.cut_frac) * 2**k.offset_frac
        v = float(round(random.choice([-1, 1]) * reach + random.uniform(-10, 10) * max(raw, 1) * unit))
        first, last = array_kernel._row_range(falloff, v, float(raw), k)
        within = [row for row in range(16) if abs(v + raw * unit * (row - 8)) <= reach]
        assert all(first <= row <= last for row in within)
        slack = 2 + math.sqrt(array_kernel._ROW_MARGIN) * 2**k.offset_frac / (max(raw, 1) * unit)
        if raw:
            assert last - first <= (within[-1] - within[0] if within else 0) + 2 * slack


def test_coordinates_at_the_ends_of_their_format():
    entries = np.concatenate([wide_entry()] * 4)
    entries["mean2d"] = [[N.mean2d.raw_min, N.mean2d.raw_max], [N.mean2d.raw_max, 0], [0, N.mean2d.raw_min], [0, 0]]
    entries["conic"][2:] = N.conic.quantise([1e-6, 0, 1e-6])
    for tile in ((0, 0), (511, 511), (1023, 1023)):
        assert_by_the_text(DEFAULT, header(tile, count=4), entries, [9, 9, 9])


@pytest.mark.parametrize("config", [
    TINY, DEFAULT.with_(depth=False), DEFAULT.with_(fine_depth=True),
    DEFAULT.with_(support_sigma=None), DEFAULT.with_(support_sigma=1.5),
    DEFAULT.with_(formats=NumberFormats(transmittance=UQ(0, 16), weight=UQ(0, 14), accumulator=UQ(1, 12))),
    DEFAULT.with_(formats=NumberFormats(exp2_segments=8, alpha=UQ(1, 10))),
    DEFAULT.with_(formats=replace(N, plane=SQ(6, 10), blend_weight=UQ(1, 8))),
], ids=["tiny", "no-depth", "fine-depth", "no-support", "small-support", "finer", "8-segments", "plane"])
def test_other_configurations(config):
    rng = np.random.default_rng(11)
    headers = random_headers(rng, [20, 0, 20], config)
    tiles = np.column_stack([headers["tile_x"], headers["tile_y"]]).repeat(headers["count"], axis=0)
    got = assert_by_the_text(config, headers, random_entries(rng, tiles, config), [50, 60, 70])
    assert config.depth or (got.depth == 0).all()


@pytest.mark.parametrize("gaze", [None, (0.3, 0.6)])
def test_records_of_a_frame_give_its_pixels(gaze):
    """Through the dumped records, every tile; through the text, some of them."""
    camera = turned_view(90, 60)
    frame = render(random_model(np.random.default_rng(8), 300, levels=4, sh=1), camera, foveation=map_for(camera, gaze, 4),
                   background=(0.2, 0.9, 0.4))
    headers, entries = frame.headers, frame.array_entries
    assert gaze is None or headers["blend"].any()
    got = render_tiles(frame.config, headers, entries, frame.registers.background)
    assert all(np.array_equal(a, b) for a, b in zip(got, frame.pixels, strict=True))
    text, background, start = ArrayByTheText(frame.config), frame.registers.background.tolist(), frame.entries.start
    for tile in range(0, len(headers), 7):
        mine = text.render(headers[tile : tile + 1], entries[start[tile] : start[tile + 1]], background)[0]
        assert np.array_equal(mine[..., 1:4], frame.pixels.colour[tile])
        assert np.array_equal(mine[..., 4], frame.pixels.depth[tile])


def test_counts_that_do_not_sum_are_refused():
    with pytest.raises(ValueError, match=r"number of entries, 1, not 2$"):
        render_tiles(DEFAULT, header(count=2), wide_entry(), np.zeros(3, int))
