"""Chunks and their headers: the rules by which they are cut, boxes that contain every mean, and hard models."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest

from golden.host import chunks
from golden.host.chunks import cut_chunks, largest_scale, opacity_code_above, sixteenths
from golden.host.quantise import quantise_model
from golden.scenes.model import GaussianModel
from spec.chunks import STEP_BITS, chunk_header
from spec.compact import OPACITY_LOG2, POSITION_BITS
from spec.config import V3_RECORDS
from spec.packing import pack, unpack
from spec.tables import log2_alpha_min
from tests.helpers.golden_samples import random_model, splats

WIDE = V3_RECORDS.with_(records="wide")
BOTH = pytest.mark.parametrize("config", [V3_RECORDS, WIDE], ids=["compact", "wide"])
F = V3_RECORDS.formats


def check(words):
    """What holds for the chunks of any model."""
    found, mean = words.chunks, words.decoded.mean
    ends = found["first"] + found["count"]
    assert (found["count"] >= 1).all() and (found["count"] <= 64).all()
    assert found["first"].tolist() == [0, *ends.tolist()][: len(found)] and ends[-1:].tolist() == [len(mean)] * (len(mean) > 0)
    assert np.array_equal(unpack(chunk_header(V3_RECORDS), pack(chunk_header(V3_RECORDS), found)), found)
    for chunk in found:
        rows = slice(int(chunk["first"]), int(chunk["first"] + chunk["count"]))
        low = F.position.to_float(chunk["low"])
        size = (chunk["extent"].astype(float) + 1) * 2.0 ** (chunk["step"].astype(float) + 8 - 40)
        assert (mean[rows] >= low).all()
        for axis in range(3):  # exactly: Python's integers
            most = Fraction(float(mean[rows, axis].max()))
            assert most <= Fraction(float(low[axis])) + Fraction(float(size[axis]))
        assert set(words.geometry["bound"][rows].tolist()) == {int(chunk["bound"])}
        top = 2.0 ** (chunk["scale_top"] / 16 - 40)
        largest = words.decoded.scale[rows].max()
        assert largest <= top * (1 + 2.0**-12) or largest == 0
        strongest = words.decoded.opacity[rows].max()
        assert (chunk["opacity"] == 0) == (strongest < log2_alpha_min(F))
        raw = OPACITY_LOG2[chunk["opacity"]] if chunk["opacity"] < 256 else (chunk["opacity"] - 255) * 32
        assert chunk["opacity"] == 0 or raw >= strongest or chunk["opacity"] == 511
    return found


@BOTH
@pytest.mark.parametrize("count", [0, 1, 2, 63, 64, 65, 128, 700])
def test_chunks_of_one_bound_are_full_but_the_last(config, count):
    model = splats(*np.random.default_rng(0).normal(size=(count, 3)), scale=0.1) if count else random_model(
        np.random.default_rng(0), 0)
    found = check(quantise_model(config, model))
    assert found["count"].tolist() == [64] * (count // 64) + [count % 64] * (count % 64 > 0)


@BOTH
def test_a_chunk_has_one_bound(config):
    words = quantise_model(config, random_model(np.random.default_rng(1), 3000, levels=4, sh=1))
    found = check(words)
    assert set(found["bound"].tolist()) == {0, 1, 2, 3}
    for a, b in pairwise(found):  # a short chunk ends because the bound changes
        assert a["count"] == 64 or a["bound"] != b["bound"]


@BOTH
def test_points_at_one_place_have_a_box_of_least_size(config):
    found = check(quantise_model(config, splats(*[(3.0, -7.0, 1e-3)] * 100, scale=0.1)))
    assert len(found) == 2 and (found["step"] == 0).all() and (found["extent"] == 0).all()


@BOTH
def test_small_splats_do_not_share_a_chunk_with_giants(config):
    """More than 8 octaves larger; with exactly 8 they do."""
    means = [(0.001 * i, 0, 0) for i in range(9)]
    model = splats(*means, scale=[[0.01] * 3] * 4 + [[2.7] * 3] + [[0.01] * 3] * 4)
    words = quantise_model(config, model)
    found = check(words)
    assert len(found) == 2 and words.saturated.get("scale_floor", 0) == 0
    assert np.allclose(words.decoded.scale[:8], 0.01, rtol=0.01) and np.allclose(words.decoded.scale[8], 2.7, rtol=0.01)
    even = splats(*means, scale=[[2.0**-7] * 3] * 4 + [[2.0] * 3] + [[2.0**-7] * 3] * 4)
    assert len(check(quantise_model(config, even))) == 1
    odd = splats(*means, scale=[[2.0**-7 * 0.95] * 3] * 4 + [[2.0] * 3] + [[2.0**-7] * 3] * 4)
    assert len(check(quantise_model(config, odd))) == 2
    order = quantise_model(WIDE, model).geometry[[0, 1, 8, 2, 3]]
    assert cut_chunks(config, order)["count"].tolist() == [2, 1, 2]


def rows_at(x, scale):
    """Wide geometry of splats along x, as it lies in memory; no origin is subtracted."""
    geometry = np.zeros(len(x), quantise_model(WIDE, splats((0, 0, 0))).geometry.dtype)
    geometry["mean"][:, 0], geometry["scale"] = F.position.quantise(np.array(x)), F.scale.quantise(np.array(scale))[:, None]
    return geometry


def test_a_splat_without_size_fits_where_positions_are_exact():
    """Beside splats of any size, but only where the grid is finer than the ulp of the positions."""
    x, scale = 10 + 0.01 * np.arange(6), [0.0, 1.0] * 3
    assert cut_chunks(V3_RECORDS, rows_at(x, scale))["count"].tolist() == [6]
    assert cut_chunks(V3_RECORDS, rows_at(x - 10, scale))["count"].tolist() == [1] * 6
    assert cut_chunks(V3_RECORDS, rows_at(np.full(6, 3.0), scale))["count"].tolist() == [6]
    assert cut_chunks(V3_RECORDS, rows_at([16.0, 15.0], [0.0, 0.0]))["count"].tolist() == [2]
    assert cut_chunks(V3_RECORDS, rows_at([16.0, 14.99], [0.0, 0.0]))["count"].tolist() == [1, 1]
    assert cut_chunks(V3_RECORDS, rows_at([-16.0, -15.0], [0.0, 0.0]))["count"].tolist() == [2]


@BOTH
def test_a_model_of_splats_without_size(config):
    words = quantise_model(config, splats((0, 0, 0), (0, 0, 0), scale=0.0))
    assert len(check(words)) == 1 and words.chunks["scale_top"].tolist() == [0] and not words.decoded.scale.any()


def test_a_far_splat_does_not_coarsen_the_grid_of_near_ones():
    """A grid has at least 16 steps in the smallest splat's standard deviation."""
    assert cut_chunks(V3_RECORDS, rows_at([0.0, 1.0, 4096.0], [1.0] * 3))["count"].tolist() == [3]
    assert cut_chunks(V3_RECORDS, rows_at([0.0, 1.0, 4100.0], [1.0] * 3))["count"].tolist() == [2, 1]
    assert cut_chunks(V3_RECORDS, rows_at([0.0, 4096.0, 4096.0], [1.0, 1.0, 0.99]))["count"].tolist() == [2, 1]
    assert cut_chunks(V3_RECORDS, rows_at([0.0, 4096.0, 4096.0], [0.99, 1.0, 1.0]))["count"].tolist() == [1, 2]
    model = splats((0, 0, 1), (0.01, 0, 1), (0, 0.01, 1), (1e6, 0, 1), scale=0.01)
    words = quantise_model(V3_RECORDS, model)
    mean = words.decoded.mean[np.argsort(words.model_index)] + words.origin
    assert np.abs(mean - model.means)[:3].max() < 0.01 / 32


@BOTH
def test_coordinates_that_no_grid_holds_split_a_chunk(config):
    rng = np.random.default_rng(5)
    far = rng.normal(size=(40, 3)) + np.array([1e20, 0, -3e25])
    means = [*rng.normal(size=(40, 3)), *far, (1e37, -1e37, 1e37), (-1e37, 0, 5.0)]
    words = quantise_model(config, splats(*means, scale=0.1))
    found = check(words)
    assert len(found) >= 4
    want = np.array(means)[words.model_index] - words.origin
    step = np.repeat(2.0 ** (found["step"].astype(float) - 40), found["count"], axis=0)
    assert (np.abs(words.decoded.mean - want) <= np.abs(want) * 2.0**-19 + step).all()


@BOTH
def test_planetary_coordinates_lose_nothing_but_their_grid(config):
    """A small object at 6,371 km: the origin lies in it, and one outlier at the planet's centre does not coarsen its grid."""
    rng = np.random.default_rng(6)
    means = [*(6.371e6 + rng.normal(size=(300, 3))), (0.0, 0, 0)]
    words = quantise_model(config, splats(*means, scale=0.1))
    check(words)
    near = words.model_index != 300
    want = np.array(means)[words.model_index] - words.origin
    chunk = np.repeat(np.arange(len(words.chunks)), words.chunks["count"])
    alone = near & (chunk != chunk[~near][0])
    assert alone.sum() >= 200 and np.abs(words.decoded.mean - want)[alone].max() < 2e-4


@BOTH
@pytest.mark.parametrize("seed", range(8))
def test_boxes_contain_every_mean_of_wild_models(config, seed):
    """Coordinates whose magnitudes spread over tens of octaves, with ulps far above and far below a grid's step."""
    rng = np.random.default_rng(seed)
    count = 400
    base = np.exp2(rng.uniform(-30, 40, 3)) * rng.choice([-1, 1], 3)
    means = base + np.exp2(rng.uniform(-35, 38, (count, 3))) * rng.choice([-1, 1], (count, 3)) * rng.integers(0, 2, (count, 3))
    model = GaussianModel(
        means=means, log_scales=rng.uniform(-20, 12, (count, 3)), quats=rng.normal(size=(count, 4)),
        opacity=np.exp2(rng.uniform(-12, 7, (count, 4))), sh_dc=rng.normal(0, 3, (count, 4, 3)),
        sh_rest=np.zeros((count, 0, 3)), quality_bound=rng.integers(1, 5, count).astype(np.uint8))
    check(quantise_model(config, model))


def test_a_box_is_no_larger_than_it_must_be():
    """The grid is the finest whose codes hold the chunk, and the extent ends within a cell of the largest mean."""
    words = quantise_model(WIDE, splats((0, 0, 0), (1.0, 0.7, 2.0**-20), scale=0.1))
    chunk = words.chunks[0]
    assert chunk["step"].tolist() == [25, 24, 5]  # 1.0 does not fit 65,535 steps of 2^-16
    assert chunk["extent"].tolist() == [127, 179, 127]
    assert F.position.to_float(chunk["low"]).tolist() == F.position.round(-words.origin).tolist()


def test_differences_are_rounded_up_exactly():
    """The float64 that is not below the exact difference, and the least of them."""
    rng = np.random.default_rng(4)
    pair = np.sort(rng.uniform(-1, 1, (400, 2)) * np.exp2(rng.integers(-40, 60, (400, 2)).astype(float)), axis=1)
    low, high = pair.T
    above = chunks._above(high, low)
    for larger in (np.abs(high) > np.abs(low), np.abs(high) < np.abs(low)):
        assert (above != high - low)[larger].sum() > 30
    for a, h, b in zip(above.tolist(), high.tolist(), low.tolist(), strict=True):
        exact = Fraction(h) - Fraction(b)
        assert Fraction(a) >= exact > Fraction(float(np.nextafter(a, -np.inf)))


def test_a_grid_is_used_to_its_last_code():
    """65,535 steps of 2^-40 fit a grid of the smallest step, and one step more does not."""
    size = np.array([65535.0, 65536.0]) * 2.0**-40
    step, extent = chunks._grids(WIDE, np.zeros(2), size)
    assert step.tolist() == [0, 1] and extent.tolist() == [255, 127]


def test_the_widest_chunk_takes_half_of_the_largest_grid():
    largest = np.array([(1 << STEP_BITS) - 1])
    assert chunks.place(WIDE, np.zeros(1), largest, np.array([1 << POSITION_BITS])) == 2 * chunks.WIDEST


def test_a_chunk_wider_than_every_grid_is_an_error():
    geometry = quantise_model(WIDE, splats((0, 0, 0), scale=0.1)).geometry.repeat(2)
    geometry["mean"][1] = F.position.quantise(1e15)
    with pytest.raises(ValueError, match="must not be wider than"):
        chunks._grids(WIDE, np.zeros(1), np.array([1e15]))
    assert len(cut_chunks(WIDE, geometry)) == 2


def test_scales_are_rounded_up_to_sixteenths_of_an_octave():
    words = np.arange(1 << 11, 1 << 17)  # every word but the zeros
    got, value = sixteenths(V3_RECORDS, words), F.scale.to_float(words)
    inside = got <= 1023
    assert (value[inside] <= np.exp2(got[inside] / 16 - 40) * (1 + 1e-12)).all()
    assert (value > np.exp2((got - 1) / 16 - 40) * (1 - 1e-12)).all()
    assert sixteenths(V3_RECORDS, np.arange(1 << 11)).tolist() == [-1] * (1 << 11)


def test_scales_beyond_the_largest_header_are_clipped_and_counted():
    words = quantise_model(V3_RECORDS, splats((0, 0, 1), (0, 0, 2), scale=[[1e7, 1.0, 1.0], [1e9, 1.0, 1.0]]))
    assert words.saturated["scale"] == 1 and words.chunks["scale_top"].max() == 1023
    assert words.decoded.scale.max() <= largest_scale(V3_RECORDS) * (1 + 2.0**-12)
    unlimited = quantise_model(V3_RECORDS.with_(chunks=False, records="wide"), splats((0, 0, 1), scale=1e9))
    assert unlimited.decoded.scale.max() == F.scale.max


def test_opacity_codes_of_headers_are_not_below():
    raw = np.arange(F.log2_opacity.raw_min, 7169)
    code = opacity_code_above(V3_RECORDS, raw)
    seen = raw >= log2_alpha_min(F)
    assert not code[~seen].any() and (code[seen] >= 1).all() and code.max() == 479
    alpha = np.exp2(raw / 1024)
    linear, above = seen & (raw <= 0), raw > 0
    assert (code[linear] / 255 >= alpha[linear] - 1e-12).all() and ((code[linear] - 1) / 255 < alpha[linear]).all()
    assert ((code[above] - 255) * 32 >= raw[above]).all() and ((code[above] - 256) * 32 < raw[above]).all()
    assert code[raw == 0] == 255
