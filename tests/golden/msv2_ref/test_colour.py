"""Colour arithmetic: ranges that the formats must hold, the table's accuracy, and the unit's view of a frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref.colour import survivor_records
from golden.msv2_ref.frame_memory import splat_records
from golden.msv2_ref.pipeline import render
from golden.msv2_ref.projection import projected_splats
from golden.msv2_ref.tile_test import tile_test
from spec import harmonics
from spec.config import PAPER, V3_RECORDS
from spec.formats import SQ
from spec.harmonics import DIRECTION_SCALE, SEED_FRAC_BITS, SEED_INDEX_BITS, basis_beyond_dc
from spec.records import gaussian_colour, surviving_splat
from tests.helpers.golden_samples import map_for, random_model, turned_view

N = PAPER.formats
ONE = 1 << N.sh_basis.frac_bits


def directions(count: int, seed: int = 0) -> np.ndarray:
    """(count + 26, 3) unit vectors: random, axes and diagonals."""
    corners = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float)
    vectors = np.concatenate([np.random.default_rng(seed).normal(size=(count, 3)), corners])
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def colours(offset: np.ndarray, rest: np.ndarray, dc: int = 0, config=PAPER) -> np.ndarray:
    """(N, 3) raw colours at level 1 of survivors at these offsets; rest (45,) raw, for all."""
    survivors = np.zeros(len(offset), surviving_splat(config).dtype)
    survivors["offset"], survivors["levels"] = config.formats.view.quantise(offset), 1
    records = np.zeros(len(offset), gaussian_colour(config).dtype)
    records["rest"], records["dc"] = rest, dc
    return survivor_records(config, survivors, records, 3, 0)[0]["colour"][:, :3]


@pytest.mark.parametrize("term", range(15))
def test_every_function_alone(term):
    """Its largest coefficient, on a grey that keeps clear of 0 and saturation."""
    unit, rest = directions(4000), np.zeros(45, np.int64)
    rest[3 * term : 3 * term + 3] = 1 << N.sh_rest.frac_bits
    got = N.colour.to_float(colours(unit * 5.0, rest, 1 << N.sh_dc.frac_bits))
    error = (got - 1)[:, 0] - basis_beyond_dc(unit, 15)[:, term]
    half = 2.0 ** -(N.colour.frac_bits + 1)
    assert np.abs(error).max() < half + 6 / ONE and np.sqrt(np.mean(error**2)) < half / np.sqrt(3) * 1.06
    assert (got[:, 0] == got[:, 1]).all() and (got[:, 0] == got[:, 2]).all()


def test_more_bits_gain_nothing():
    """The format's justification: the rms error is that of rounding colours, within 2 %."""
    rng, unit = np.random.default_rng(3), directions(20_000, 1)
    rest = np.rint(rng.normal(0, 0.15, 45) * 2.0**N.sh_rest.frac_bits).astype(np.int64)
    exact = 1 + basis_beyond_dc(unit, 15) @ N.sh_rest.to_float(rest).reshape(15, 3)
    assert 0 < exact.min() and exact.max() < 1.99
    errors = {}
    for bits in (12, 13, 18):
        config = PAPER.with_(formats=replace(N, sh_basis=SQ(0, bits)))
        got = N.colour.to_float(colours(unit * 3.7, rest, 1 << N.sh_dc.frac_bits, config))
        errors[bits] = np.sqrt(np.mean((got - exact) ** 2))
    assert N.sh_basis.frac_bits == 13
    assert errors[18] < errors[13] < errors[12] and errors[13] < 1.02 * errors[18]


def test_distance_does_not_matter_and_nowhere_is_grey():
    unit, rest = np.asarray(N.view.round(directions(500))), np.random.default_rng(4).integers(-600, 600, 45)
    near = colours(unit, rest, 3000)
    for scale in (2.0**-90, 2.0**-3, 2.0**90):
        assert np.array_equal(colours(unit * scale, rest, 3000), near)
    assert len(np.unique(near)) > 100
    assert (colours(np.zeros((70, 3)), rest, 1024) == 256).all()


def test_sums_clamp_once():
    up = np.full(45, N.sh_rest.raw_max)
    base = N.sh_dc.raw_min, 0, N.sh_dc.raw_max
    both = np.concatenate([colours(directions(300), rest, dc) for rest in (up, -up) for dc in base])
    assert both.min() == 0 and both.max() == N.colour.raw_max
    assert (colours(directions(300), 0 * up, -1) == 0).all() and (colours(directions(300), 0 * up, 8191) == 1023).all()


def test_reciprocal_roots_are_one_step_from_exact():
    roots, inverses = harmonics.root_seeds(N)
    m = np.arange(ONE, 4 * ONE) / ONE
    upper = m >= 2
    cell = np.floor((m / np.where(upper, 2, 1) - 1) * (1 << SEED_INDEX_BITS)).astype(int)
    index = cell + (upper << SEED_INDEX_BITS)
    seed, inverse = roots[index] * 2.0**-SEED_FRAC_BITS, inverses[index] / ONE
    residual = 1 - m * inverse
    error = seed * (1 + residual / 2) * np.sqrt(m) / DIRECTION_SCALE - 1
    assert np.abs(residual).max() < 2.0**-6 and np.abs(error).max() < 2.0**-13


def test_formats_hold_every_direction():
    """Polynomials of a direction a bit too long: nothing wraps where the unit drops bits above."""
    x, y, z = (directions(100_000) * DIRECTION_SCALE * (1 + 2.0**-10)).T
    xx, yy, zz = x * x, y * y, z * z
    f = harmonics.Factors(*(raw / ONE for raw in harmonics.factors(N)))
    sums = (2 * zz - xx - yy, 3 * xx - yy, xx - 3 * yy, 4 * zz - xx - yy, 2 * zz - 3 * xx - 3 * yy, 2 * z)
    products = (xx, x * y, sums[1] * y, sums[3] * f.ring, sums[4] * f.polar, sums[5] * f.mixed)
    basis = basis_beyond_dc(directions(100_000), 15)
    slack = 8 / ONE
    for values, number in ((sums, harmonics.polynomial_format(N)), (products, harmonics.product_format(N)),
                           ((x, *f), harmonics.direction_format(N)), ((basis,), N.sh_basis)):
        largest = max(np.abs(v).max() for v in values)
        assert largest + slack < 2.0**number.int_bits
    assert 3 * 2.0**2 < 2.0 ** harmonics.length_format(N).int_bits
    together = np.abs(basis).sum(axis=1).max()
    assert together < 4.3 and 2 * (together + 15 * slack) + 4 < 2.0 ** harmonics.sum_format(N).int_bits


@pytest.mark.parametrize("config", [PAPER, V3_RECORDS], ids=lambda config: config.name)
@pytest.mark.parametrize(("sh", "levels"), [(0, 1), (1, 4), (2, 3), (3, 4)])
def test_the_units_views_are_the_arrays(sh, levels, config):
    camera = turned_view(160, 120)
    model = random_model(np.random.default_rng(40 + sh), 600, levels=levels, sh=sh)
    frame = render(model, camera, config=config, foveation=map_for(camera, (0.4, 0.6), levels) if levels > 1 else None)
    r, words = frame.registers, frame.words
    splats = projected_splats(config, words, r)[:-1]
    found = tile_test(config, splats, r.header[:, :2], r.width, r.height)
    rows = found.survivors[:-1]["index"]
    opacity = words.geometry["log2_opacity"][rows] if config.compact else None
    views, place = survivor_records(config, found.survivors[:-1], words.colour[rows], sh, 2, opacity)
    expected = splat_records(frame, 4)
    assert len(found.entries) - 1 == len(frame.entries.splat)
    assert len(views) >= len(rows) > 50 and (np.diff(place) > 0).all()
    assert np.array_equal(views, expected[place >> 2, place & 3])
