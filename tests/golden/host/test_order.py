"""The order in memory: total, independent of the file's, and what each candidate sorts by."""

import numpy as np
import pytest

from golden.host.memory_image import gaussian_bytes
from golden.host.order import CANDIDATES, LARGE_SHARE, SPATIAL, Candidate, contracted, memory_order, morton
from golden.host.quantise import quantise_model
from spec.config import PAPER, V3_RECORDS
from spec.records import gaussian_colour, gaussian_geometry
from tests.helpers.golden_samples import random_model

SORTED = [name for name in CANDIDATES if name != "file"]


def model_of(count=1500, sh=1, seed=3):
    return random_model(np.random.default_rng(seed), count, levels=4, sh=sh)


def wide(model):
    words = quantise_model(PAPER, model)
    return words.geometry, words.colour, words.sh_degree


def keys_of(geometry):
    """Morton code, bound and largest scale of every row, computed one by one."""
    mean = PAPER.formats.position.to_float(geometry["mean"])
    return morton(contracted(mean)), geometry["bound"].astype(int), PAPER.formats.scale.to_float(geometry["scale"]).max(axis=1)


def by_the_text(candidate, geometry):
    """The order of rows without equal places, sorted in Python by the text of the module."""
    place, bound, size = keys_of(geometry)
    assert len(set(place.tolist())) == len(place)
    large = size > np.quantile(size, 1 - LARGE_SHARE)
    key = {"bound": lambda i: -bound[i], "large": lambda i: large[i]}
    rows = sorted(range(len(place)), key=lambda i: (*(key[name](i) for name in candidate.apart), place[i]))
    out, part = [], []
    for i in [*rows, None]:
        new = i is not None and part and any(key[name](i) != key[name](part[-1]) for name in candidate.apart)
        if i is None or new or len(part) == candidate.block:
            out += sorted(part, key=lambda j: tuple(key[name](j) for name in candidate.inside))
            part = []
        part.append(i)
    return out


@pytest.mark.parametrize("name", SORTED)
def test_each_candidate_sorts_by_what_it_says(name):
    geometry, colour, sh = wide(model_of())
    order = memory_order(PAPER, geometry, colour, sh, CANDIDATES[name])
    assert order.tolist() == by_the_text(CANDIDATES[name], geometry)
    assert sorted(order.tolist()) == list(range(1500))


@pytest.mark.parametrize("candidate", [Candidate(("large",), 100, ("bound",)), Candidate((), 1, ("bound",)),
                                       Candidate(("bound",), 64, ("large",)), Candidate((), 10**9, ("bound", "large"))])
def test_blocks_begin_anew_where_something_lies_apart(candidate):
    geometry, colour, sh = wide(model_of(777))
    assert memory_order(PAPER, geometry, colour, sh, candidate).tolist() == by_the_text(candidate, geometry)


def test_the_files_order_is_kept_where_nothing_sorts():
    geometry, colour, sh = wide(model_of(50))
    assert memory_order(PAPER, geometry, colour, sh, None).tolist() == list(range(50))
    assert quantise_model(PAPER, model_of(50)).model_index is None


@pytest.mark.parametrize(
    "config", [V3_RECORDS, V3_RECORDS.with_(records="wide"), PAPER.with_(order="spatial")], ids=["compact", "wide", "plain"])
def test_no_permutation_of_the_model_changes_a_byte(config):
    """Although a third of the points coincide with others in place, in geometry, or in everything but one bit of colour."""
    model, rng = model_of(900), np.random.default_rng(0)
    twin = rng.integers(0, 900, 300)
    for name in ("means", "log_scales", "quats", "opacity"):
        getattr(model, name)[:200] = getattr(model, name)[twin[:200]]
    model.means[200:300] = model.means[twin[200:]]
    model.quality_bound[:200] = model.quality_bound[twin[:200]]
    for name in ("sh_dc", "sh_rest"):
        getattr(model, name)[:100] = getattr(model, name)[twin[:100]]
    base = gaussian_bytes(config, quantise_model(config, model))
    for seed in range(3):
        rows = np.random.default_rng(seed).permutation(900)
        shuffled = gaussian_bytes(config, quantise_model(config, model.select(rows)))
        assert all(np.array_equal(base[name], shuffled[name]) for name in base)


def test_coincident_points_are_ordered_by_their_bits():
    """Geometry before colour, the highest bit first."""
    model = model_of(1, sh=0)
    model = model.select(np.zeros(40, int))
    model.opacity[:] = np.random.default_rng(1).uniform(0.1, 1, model.opacity.shape)[:, :1]
    model.opacity[20:] = model.opacity[:20]
    model.sh_dc[:] = np.random.default_rng(2).normal(size=model.sh_dc.shape)
    geometry, colour, sh = wide(model)
    order = memory_order(PAPER, geometry, colour, sh, Candidate())
    bits = [(gaussian_geometry(PAPER).pack(geometry[i]), gaussian_colour(PAPER, 0).pack(colour[i])) for i in order]
    assert bits == sorted(bits) and len(set(bits)) == 40 and len({first for first, _ in bits}) == 20


def test_indices_lead_back_to_the_model():
    model = model_of(300)
    words, plain = quantise_model(V3_RECORDS.with_(records="wide"), model), quantise_model(PAPER, model)
    assert np.array_equal(words.geometry, plain.geometry[words.model_index])
    assert np.array_equal(words.colour, plain.colour[words.model_index])
    assert words.in_model(7) == words.model_index[7] and words.in_model([[1], [2]]).shape == (2, 1)
    assert plain.in_model(7) == 7


def test_the_machines_order_is_the_studys_winner():
    assert CANDIDATES["big+blocks"] is SPATIAL
    geometry, colour, sh = wide(model_of(400))
    found = quantise_model(V3_RECORDS, model_of(400)).model_index
    assert np.array_equal(found, memory_order(PAPER, geometry, colour, sh, SPATIAL))


@pytest.mark.parametrize(("place", "code"), [
    ((-2, -2, -2), 0), ((2, 2, 2), (1 << 63) - 1), ((2, -2, -2), 0x1249249249249249), ((-2, 2, -2), 0x2492492492492492),
    ((-2, -2, 2), 0x4924924924924924), ((-2 + 4 / 2**21, -2, -2), 1), ((-2, -2, -2 + 8 / 2**21), 32)])
def test_morton_codes_interleave_bits(place, code):
    assert morton(np.array([place], float)).tolist() == [code]


def test_contracted_coordinates_stay_in_their_cube():
    mean = np.concatenate([np.random.default_rng(0).normal(size=(101, 3)), [[1e30, 0, 0], [0, -1e9, 0]]])
    places = contracted(mean)
    radius = np.linalg.norm(places, axis=1)
    assert (radius <= 2).all() and np.median(radius) == pytest.approx(1) and radius[-2:] == pytest.approx([2, 2])
    assert contracted(np.full((5, 3), 7.0)).tolist() == [[0, 0, 0]] * 5


@pytest.mark.parametrize("count", [0, 1, 2])
def test_small_models_have_an_order(count):
    words = quantise_model(V3_RECORDS, model_of(count, sh=3))
    assert len(words.model_index) == len(words.geometry) == len(words.colour) == count
