"""Compact records: decoding bit by bit against the text of spec, encoding to the nearest code, and models that are hard to
encode."""

import math
from dataclasses import replace
from fractions import Fraction
from itertools import product

import numpy as np
import pytest

from golden.host import compact
from golden.host.chunks import strongest
from golden.host.compact import CompactWords, decode, decode_shape, decoded_opacity, encode, opacity_codes
from golden.host.quantise import in_chunks, quantise_model
from golden.scenes.model import GaussianModel
from spec.chunks import chunk_header
from spec.compact import (
    BAND_BITS,
    BAND_EXPONENT_MOST,
    BANDS,
    OPACITY_LOG2,
    ROOT_BASE,
    ROOT_HALF,
    ROOT_SLOPE,
    SCALE_FRACTIONS,
    compact_colour,
    compact_geometry,
    compact_harmonics,
    dc_bits,
    levels_held,
    quaternion_bits,
    scale_bits,
)
from spec.config import V3_RECORDS
from spec.packing import unpack
from tests.helpers.golden_samples import random_model, splats

WIDE = V3_RECORDS.with_(records="wide")
F = V3_RECORDS.formats


def rs(x, n):
    return (x + (1 << n - 1)) >> n


class ByTheText:
    """Decodes one Gaussian with Python's integers, by the text of `spec.compact`."""

    def __init__(self, header, g, r, sh):
        self.header, self.g, self.r, self.sh = header, g, r, sh
        self.coarse = header["bound"] == 3

    def mean(self):
        out = []
        for low, step, code in zip(self.header["low"], self.header["step"], self.g["position"], strict=True):
            exact = Fraction(float(F.position.to_float(low))) + code * Fraction(2) ** (step - 40)
            rounded = self.rounded(exact)
            out.append(int(F.position.quantise(float(rounded))))
        return out

    @staticmethod
    def rounded(exact):
        """To 20 significant bits, ties to even."""
        if not exact:
            return exact
        exponent = math.frexp(float(exact))[1] - 20
        while abs(exact) >= Fraction(2) ** (exponent + 20):
            exponent += 1
        while abs(exact) < Fraction(2) ** (exponent + 19):
            exponent -= 1
        return round(exact / Fraction(2) ** exponent) * Fraction(2) ** exponent  # round() of a Fraction: ties to even

    def scale(self):
        out = []
        for code in self.g["scale"]:
            c = 8 * self.header["scale_top"] - code * (2 if self.coarse else 1)
            zero = code == (1023 if self.coarse else 2047) or c < 128
            out.append(0 if zero else (c >> 7) << 11 | SCALE_FRACTIONS[c & 127])
        return out

    def quat(self):
        b = 10 if self.coarse else 11
        q = [rs(code * ROOT_HALF, b - 1) for code in self.g["quaternion"]]
        x = max(2**26 - sum(v * v for v in q), 2**24)
        i, r = (x >> 20) - 16, x >> 12 & 255
        q.insert(self.g["largest"], min(rs(32 * ROOT_BASE[i] + ROOT_SLOPE[i] * r, 8), 8191))
        return q

    def log2_opacity(self):
        out = [OPACITY_LOG2[c] if c <= 255 else (c - 255) << 5 for c in self.r["opacity"][: 4 if self.coarse else 3]]
        return out if self.coarse else [*out, out[2]]

    def dc(self):
        r, s = self.r["dc_range"], 3 if self.coarse else 0
        out = [min((code << (r + s)) - (1024 << r), 8191) for code in self.r["dc"][: 12 if self.coarse else 9]]
        return out if self.coarse else [*out, *out[6:]]

    def rest(self, degree):
        out = []
        for band in range(degree):
            e = min(self.sh["exponent"][band], BAND_EXPONENT_MOST[band])
            out += [code << e for code in self.sh[f"degree_{band + 1}"]]
        return out


def row(rows, i):
    return {name: rows[name][i].tolist() for name in rows.dtype.names}


def random_records(record, count, rng):
    """Random bit patterns, so that every code occurs; the first have all bits clear, all bits set."""
    patterns = rng.integers(0, 256, (count, -(-record.width // 8)), np.uint8)
    patterns[0], patterns[1] = 0, 255
    return unpack(record, patterns)


@pytest.fixture(scope="module", params=range(4))
def anything(request):
    """(chunks, words): arbitrary codes of chunks of one bound, with the same geometry in G and R."""
    bound, rng = request.param, np.random.default_rng(request.param)
    coarse, count = bound == 3, 64 * 40
    header = chunk_header(V3_RECORDS)
    chunks = np.zeros(40, header.dtype)
    low = np.exp2(rng.uniform(-20, 30, (40, 3))) * rng.choice([-1, 1], (40, 3))
    chunks["low"], chunks["step"] = F.position.quantise(low), rng.integers(0, 64, (40, 3))
    chunks["low"][0], chunks["step"][0] = 0, 0
    chunks["scale_top"] = rng.integers(16, 1024, 40)
    chunks["scale_top"][:4] = 16, 17, 144, 1023
    chunks["bound"], chunks["count"], chunks["first"] = bound, 64, 64 * np.arange(40)
    short = random_records(compact_colour(V3_RECORDS, coarse), count, rng)
    colour = np.zeros(count, compact_colour(V3_RECORDS, coarse=True).dtype)
    for name in short.dtype.names:
        held = colour[name] if short[name].ndim == 1 else colour[name][:, : short[name].shape[1]]
        held[:] = short[name]
    geometry = np.zeros(count, compact_geometry(V3_RECORDS, coarse=True).dtype)
    for name in ("position", "scale", "largest", "quaternion"):
        geometry[name] = colour[name]
    geometry["opacity"] = colour["opacity"][:, 0]
    harmonics = random_records(compact_harmonics(V3_RECORDS), count, rng)
    return chunks, CompactWords(V3_RECORDS, np.full(count, coarse), geometry, colour, harmonics)


@pytest.mark.parametrize("degree", range(4))
def test_decoding_follows_the_text(anything, degree):
    chunks, words = anything
    geometry, colour = decode(V3_RECORDS, chunks, words, degree)
    assert (geometry["bound"] == chunks["bound"][0]).all()
    for i in range(0, len(geometry), 1 if degree == 3 else 37):
        text = ByTheText(row(chunks, i // 64), row(words.geometry, i), row(words.colour, i), row(words.harmonics, i))
        for name in ("mean", "scale", "quat", "log2_opacity"):
            assert geometry[name][i].tolist() == getattr(text, name)(), (i, name)
        assert colour["dc"][i].tolist() == text.dc()
        if degree:
            assert colour["rest"][i].tolist() == text.rest(degree)


def test_both_records_decode_to_the_same_geometry(anything):
    chunks, words = anything
    first, second = decode_shape(V3_RECORDS, chunks, words.geometry), decode_shape(V3_RECORDS, chunks, words.colour)
    assert all(np.array_equal(first[name], second[name]) for name in ("mean", "scale", "quat"))


def test_decoded_words_fit_their_formats(anything):
    chunks, words = anything
    geometry, colour = decode(V3_RECORDS, chunks, words, 3)
    for rows, names in ((geometry, {"mean": F.position, "scale": F.scale}), (geometry, {"quat": F.quaternion}),
                        (geometry, {"log2_opacity": F.log2_opacity}), (colour, {"dc": F.sh_dc, "rest": F.sh_rest})):
        for name, form in names.items():
            low, high = (form.raw_min, form.raw_max) if hasattr(form, "raw_min") else (0, (1 << form.width) - 1)
            assert rows[name].min() >= low and rows[name].max() <= high, name
    length = np.sqrt((geometry["quat"].astype(float) ** 2).sum(axis=1)) / 2**13
    possible = (words.geometry["quaternion"].astype(float) ** 2).sum(axis=1) <= 1.5 * (512 if words.coarse[0] else 1024) ** 2
    assert possible.any() and np.abs(length[possible] - 1).max() < 4e-4


@pytest.fixture(scope="module", params=range(4))
def coded(request):
    """(wide words in order, compact words) of a random model whose Gaussians all have one bound."""
    rng = np.random.default_rng(request.param + 10)
    model = random_model(rng, 2000, levels=4, sh=3)
    model.quality_bound[:] = request.param + 1
    model.opacity[:] = np.exp2(rng.uniform(-9, 7, model.opacity.shape))
    model.sh_dc[:] = rng.normal(0, 1.5, model.sh_dc.shape)
    words = quantise_model(WIDE, model)
    return words, in_chunks(type(words)(V3_RECORDS, *(getattr(words, n) for n in (
        "geometry", "colour", "origin", "levels", "sh_degree", "saturated", "model_index"))))


def test_positions_are_within_half_a_step(coded):
    wide, words = coded
    step = np.repeat(np.exp2(words.chunks["step"] - 40.0), words.chunks["count"], axis=0)
    error = words.decoded.mean - wide.decoded.mean
    ulp = np.exp2(np.floor(np.log2(np.abs(wide.decoded.mean))) - 19)
    assert (np.abs(error) <= step / 2 + ulp / 2 * 1.01).all()
    assert np.abs((error / step).mean(axis=0)).max() < 5 * 0.29 / math.sqrt(2000)  # five standard deviations: no shift


def test_scales_are_within_half_a_code(coded):
    wide, words = coded
    unit = 1 / 64 if words.compact.coarse[0] else 1 / 128
    ratio = np.log2(words.decoded.scale / wide.decoded.scale)
    assert np.abs(ratio).max() <= unit / 2 + math.log2(1 + 2.0**-12) and words.saturated["scale_floor"] == 0
    assert abs(ratio.mean()) < 4 * unit * 0.29 / math.sqrt(6000)


def test_quaternions_are_within_half_a_code(coded):
    wide, words = coded
    half = ROOT_HALF / 2 ** (quaternion_bits(bool(words.compact.coarse[0])) - 1) / 2
    a, b = wide.geometry["quat"].astype(float), words.geometry["quat"].astype(float)
    b *= np.sign((a * b).sum(axis=1))[:, None]
    rows, largest = np.arange(len(a)), words.compact.geometry["largest"]
    assert (np.abs(a)[rows, largest] == np.abs(a).max(axis=1)).all() and (words.geometry["quat"][rows, largest] > 0).all()
    others = np.ones(a.shape, bool)
    others[rows, largest] = False
    near = np.abs(a[others]) < ROOT_HALF - 2 * half  # beyond, a code may be clipped
    assert np.abs(b - a)[others][near].max() <= half + 1 and np.abs(b - a)[others].max() <= 2 * half + 1
    assert words.saturated["quaternion"] < 10
    assert abs((b - a)[others].mean()) < 4 * half / math.sqrt(3 * 2000)


def test_base_colours_are_within_half_a_code(coded):
    wide, words = coded
    bound, coarse = int(words.chunks["bound"][0]), bool(words.compact.coarse[0])
    step = 1 << words.compact.colour["dc_range"].astype(int)[:, None] + (3 if coarse else 0)
    error = (words.colour["dc"].astype(int) - wide.colour["dc"])[:, : 3 * (bound + 1)]
    assert (2 * np.abs(error) <= step).all() and len(np.unique(words.compact.colour["dc_range"])) >= 3
    assert abs((error / step).mean()) < 4 * 0.3 / math.sqrt(error.size)
    for r in range(1, 4):  # no smaller range would do
        rows = words.compact.colour["dc_range"] == r
        dc, most = wide.colour["dc"][rows, : 3 * (bound + 1)].astype(int), ((1 << dc_bits(coarse)) - 1) * (8 if coarse else 1)
        unit = 4 << r - 1 if coarse else 0
        assert ((dc.min(axis=1) < -1024 << r - 1) | (dc.max(axis=1) + unit > (most - 1024) << r - 1)).all()


def test_opacities_are_nearest(coded):
    wide, words = coded
    held = int(words.chunks["bound"][0]) + 1
    a, b = (np.exp2(rows.geometry["log2_opacity"][:, :held] / 1024.0) for rows in (wide, words))
    seen = a >= 1 / 255
    assert np.abs(b - a)[seen & (a <= 1)].max() <= 0.5 / 255 + 1e-3
    assert np.abs(np.log2(b[a > 1] / a[a > 1])).max() <= 1 / 64 + 1e-9
    assert (words.geometry["log2_opacity"][:, :held][~seen] == F.log2_opacity.raw_min).all() and (~seen).any()


def test_harmonics_are_within_half_a_code(coded):
    wide, words = coded
    for band, terms in enumerate(BANDS):
        columns = slice(3 * terms.start, 3 * terms.stop)
        step = 1 << words.compact.harmonics["exponent"][:, band].astype(int)[:, None]
        error = words.colour["rest"][:, columns].astype(int) - wide.colour["rest"][:, columns]
        assert (2 * np.abs(error) <= step).all() and abs((error / step).mean()) < 0.02
        codes = np.abs(words.compact.harmonics[f"degree_{band + 1}"]).max(axis=1)
        assert (codes[step[:, 0] > 1] >= 1 << BAND_BITS[band] - 2).all()  # the exponent is the smallest that fits


def test_levels_in_use_are_held(coded):
    """Levels above the bound repeat the highest in use, or the third where a fine record ends."""
    _, words = coded
    bound = int(words.chunks["bound"][0])
    opacity, dc = words.geometry["log2_opacity"], words.colour["dc"].reshape(-1, 4, 3)
    for level in range(bound + 1, 4):
        assert np.array_equal(opacity[:, level], opacity[:, bound]) and np.array_equal(dc[:, level], dc[:, bound])
    assert levels_held(bound == 3) > bound
    strong = strongest(V3_RECORDS, words.geometry)
    assert np.array_equal(strong, decoded_opacity(words.compact.geometry["opacity"]))


def test_what_was_decoded_is_encoded_again_without_loss(coded):
    _, words = coded
    again, lost = encode(V3_RECORDS, words.chunks, words.geometry, words.colour, 3)
    for first, second in zip(decode(V3_RECORDS, words.chunks, again, 3), (words.geometry, words.colour), strict=True):
        for name in first.dtype.names:
            same = first[name] == second[name]
            assert same.all() or (name == "quat" and same.mean() > 0.99), name
    assert lost["scale_floor"] == lost["harmonics"] == 0


def test_opacity_codes():
    raw = np.arange(F.log2_opacity.raw_min, 7169)
    code = opacity_codes(V3_RECORDS, raw)
    assert (np.diff(code) >= 0).all() and code[-1] == 479 and code[raw == 0] == 255
    assert code[raw == -8187] == 0 and code[raw == -8186] == 1
    back = decoded_opacity(np.arange(512))
    assert np.array_equal(opacity_codes(V3_RECORDS, np.minimum(back, F.log2_opacity.raw_max))[1:480], np.arange(1, 480))
    above = raw[(raw > 0) & (raw % 32 == 16)]
    assert ((opacity_codes(V3_RECORDS, above) - 255) % 2 == 0).all()  # ties to even, counted from opacity 1


def single(**fields):
    """The words of one splat, with fields of the model replaced."""
    values = {"scale": 1.0, "opacity": 0.5, **fields}
    return quantise_model(V3_RECORDS, splats((0.0, 0.0, 0.0), **values))


@pytest.mark.parametrize("levels", [1, 4])
def test_a_quaternion_of_zero_turns_nothing(levels):
    model = splats((0, 0, 0), (1, 0, 0), scale=[[1.0, 2.0, 3.0]] * 2, levels=levels)
    model.quats[0] = 0
    model.quats[1] = 1, 0, 0, 0
    words = quantise_model(V3_RECORDS, model)
    assert words.geometry["quat"].tolist() == [[8191, 0, 0, 0]] * 2


@pytest.mark.parametrize("levels", [1, 4])
@pytest.mark.parametrize("quat", [q for q in product((-1, 0, 1), repeat=4) if any(q)])
def test_quaternions_with_equal_components(quat, levels):
    """Their codes are the largest there are, and a turn by a half has two components of the root of 1/2."""
    model = splats((0, 0, 0), scale=1.0, levels=levels)
    model.quats[0] = quat
    got = quantise_model(V3_RECORDS, model).geometry["quat"][0] / 2.0**13
    want = np.array(quat) / np.linalg.norm(quat)
    assert 1 - abs(got @ want) / np.linalg.norm(got) < 2e-6 and abs(np.linalg.norm(got) - 1) < 1e-3


@pytest.mark.parametrize("levels", [1, 4])
def test_flat_splats_keep_their_plane(levels):
    """An axis of 0 stays 0. One that is far thinner than 16 octaves below the largest becomes 0, and is counted; one just above
    keeps its scale."""
    thin = (0.0, 2.0**-15.9, 2.0**-16.5, 2.0**-30)
    model = splats(*[(0, 0, 0)] * 4, scale=[[1, 1, axis] for axis in thin], levels=levels)
    words = quantise_model(V3_RECORDS, model)
    scale = words.decoded.scale[np.argsort(words.model_index)]
    assert scale[:, :2].tolist() == [[1, 1]] * 4
    assert scale[[0, 3], 2].tolist() == [0, 0]
    assert scale[1:3, 2] == pytest.approx([2.0**-15.9, 2.0**-15.97], rel=0.02)
    assert words.saturated["scale_floor"] == 2


def test_the_smallest_scales_of_the_format():
    """A chunk whose largest scale is the smallest normal number of the format."""
    words = single(scale=[[2.0**-39, 2.0**-38.99, 0.0]])
    assert words.decoded.scale[0, 2] == 0 and words.decoded.scale[0, :2] == pytest.approx([2.0**-39] * 2, rel=0.01)
    assert words.saturated["scale_floor"] == 0
    flushed = single(scale=[[2.0**-38, 2.0**-39.0, 2.0**-37]]).decoded.scale[0]
    assert flushed == pytest.approx([2.0**-38, 2.0**-39, 2.0**-37], rel=0.01)


@pytest.mark.parametrize("levels", [1, 4])
def test_opacity_of_zero_cannot_be_seen(levels):
    words = quantise_model(V3_RECORDS, splats((0, 0, 0), scale=1.0, opacity=0.0, levels=levels))
    assert words.chunks["opacity"].tolist() == [0] and words.decoded.opacity.tolist() == [F.log2_opacity.raw_min]


def test_amplified_opacity_and_bright_colours_are_held():
    words = single(opacity=128.0)
    assert words.decoded.opacity.tolist() == [7168] and words.chunks["opacity"].tolist() == [479]
    for colour, raw, clipped in ((3.9, 3.9 * 2048, 0), (-4.5, -8192, 3), (5.0, 8191, 3), (1.5, 3072, 0), (-0.6, -1228.8, 0)):
        model = splats((0, 0, 0), scale=1.0, colour=colour)
        found = quantise_model(V3_RECORDS, replace(model, sh_rest=np.zeros((1, 3, 3))))
        assert found.colour["dc"][0, 0] == pytest.approx(raw, abs=4) and found.saturated["dc"] == clipped


@pytest.mark.parametrize("levels", [1, 4])
def test_without_harmonics_base_colours_beyond_black_and_white_cost_no_range(levels):
    """A colour of 0.5 beside channels that are clamped anyway keeps its precision. What is clamped stays beyond the limits."""
    model = splats((0, 0, 0), scale=1.0, colour=(0.5, -3.0, 0.25), levels=levels)
    words = quantise_model(V3_RECORDS, model)
    assert words.compact.colour["dc_range"].tolist() == [0] and words.colour["dc"][0, :3].tolist() == [1024, 0, 512]
    bright = quantise_model(V3_RECORDS, splats((0, 0, 0), scale=1.0, colour=(0.5, 3.5, 1.0), levels=levels))
    assert bright.colour["dc"][0, 0] == 1024 and bright.colour["dc"][0, 1] >= 4092
    assert F.colour.raw_max == (4092 + 2) // 4


def test_the_largest_harmonics_are_clipped_and_counted():
    model = splats((0, 0, 0), scale=1.0)
    model = GaussianModel(**{name: getattr(model, name) for name in (
        "means", "log_scales", "quats", "opacity", "sh_dc", "quality_bound")}, sh_rest=np.zeros((1, 15, 3)))
    model.sh_rest[0, 0, 0], model.sh_rest[0, 1, 1], model.sh_rest[0, 4, 2] = 1.999, -2.0, 1.9
    words = quantise_model(V3_RECORDS, model)
    assert words.colour["rest"][0, 0] == 63 << 5 and words.colour["rest"][0, 4] == -2048
    assert words.colour["rest"][0, 14] == 15 << 7
    assert words.saturated["harmonics"] == 1  # 1.9 is 15.2 steps, 1.999 is 63.97: only this rounds beyond the codes


@pytest.mark.parametrize("degree", range(4))
def test_bands_beyond_the_model_are_zero(degree):
    words = quantise_model(V3_RECORDS, random_model(np.random.default_rng(2), 100, levels=4, sh=degree)).compact
    assert (words.harmonics is None) == (degree == 0)
    for band in range(degree, 3) if degree else ():
        assert not words.harmonics[f"degree_{band + 1}"].any() and not words.harmonics["exponent"][:, band].any()


def test_scale_codes_reach_sixteen_octaves():
    assert (1 << scale_bits(False)) / 128 == (1 << scale_bits(True)) / 64 == 16


def test_encoding_is_the_same_whatever_the_levels_above_the_bound_hold():
    model = random_model(np.random.default_rng(3), 200, levels=4, sh=0)
    base = quantise_model(V3_RECORDS, model)
    unused = np.arange(4) >= model.quality_bound[:, None]
    model.opacity[unused], model.sh_dc[unused] = 100.0, 50.0
    other = quantise_model(V3_RECORDS, model)
    rows = np.argsort(base.model_index), np.argsort(other.model_index)
    assert np.array_equal(base.compact.geometry_bytes(), other.compact.geometry_bytes()) or len(rows) == 2
    for name in ("opacity", "dc", "dc_range"):
        assert np.array_equal(base.compact.colour[name][rows[0]], other.compact.colour[name][rows[1]])


def test_effects_change_compact_words_as_wide_ones():
    """Dropped and added harmonics, and levels like the first: bytes and words stay those of one another."""
    words = quantise_model(V3_RECORDS, random_model(np.random.default_rng(4), 300, levels=4, sh=2))
    for degree, present in ((0, False), (1, True), (2, True), (0, True)):
        packed = compact.with_sh_degree(words.compact, degree, present)
        assert (packed.harmonics is not None) == present
        _, colour = decode(V3_RECORDS, words.chunks, packed, degree)
        kept = 3 * (0, 3, 8)[degree]
        assert np.array_equal(colour["dc"], words.colour["dc"])
        if degree:
            assert np.array_equal(colour["rest"][:, :kept], words.colour["rest"][:, :kept])
    first = compact.with_first_level(words.compact)
    geometry, colour = decode(V3_RECORDS, words.chunks, first, 2)
    assert (geometry["log2_opacity"] == words.geometry["log2_opacity"][:, :1]).all()
    assert (colour["dc"].reshape(-1, 4, 3) == words.colour["dc"].reshape(-1, 4, 3)[:, :1]).all()
    assert np.array_equal(decoded_opacity(first.geometry["opacity"]), geometry["log2_opacity"][:, 0])
