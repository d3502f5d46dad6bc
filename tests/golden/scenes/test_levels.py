"""Levels without training: nested, of the paper's sizes, seeded or spread."""

from dataclasses import replace

import numpy as np
import pytest

from golden.scenes.levels import smfr_levels, spread_levels
from tests.helpers.scenes_samples import float32_model


def test_levels_are_nested_random_subsets_of_the_right_sizes():
    model = float32_model(n=1000, levels=1)
    levels = smfr_levels(model)
    bound = levels.quality_bound.astype(int)
    assert [int((bound > level).sum()) for level in range(4)] == [1000, 400, 220, 170]
    assert bound.min() == 1 and levels.levels == 4
    for level in range(4):
        np.testing.assert_array_equal(levels.opacity[:, level], model.opacity[:, 0])
        np.testing.assert_array_equal(levels.sh_dc[:, level], model.sh_dc[:, 0])
    np.testing.assert_array_equal(levels.means, model.means)
    kept = np.flatnonzero(bound > 1)  # drawn from everywhere, not from one end
    assert abs(kept.mean() - 500) < 50


def test_sizes_can_be_given():
    model = float32_model(n=300, levels=1)
    bound = smfr_levels(model, 3, seed=2, counts=(300, 77, 76)).quality_bound
    assert [int((bound > level).sum()) for level in range(3)] == [300, 77, 76]
    drawn = smfr_levels(model, 3, seed=2).quality_bound  # one permutation ranks the points, whatever the sizes
    assert (drawn[bound == 3] >= 2).all()
    for counts in ((299, 77, 76), (300, 76, 77), (300, 77, 0), (300, 77)):
        with pytest.raises(ValueError, match="300 down to"):
            smfr_levels(model, 3, counts=counts)


def test_seed_decides():
    model = float32_model(n=300, levels=1)
    first = smfr_levels(model, seed=3).quality_bound
    np.testing.assert_array_equal(smfr_levels(model, seed=3).quality_bound, first)
    assert (smfr_levels(model, seed=4).quality_bound != first).any()


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_fewer_levels_are_the_first_of_more(levels):
    model = float32_model(n=300, levels=1)
    bound = smfr_levels(model, levels).quality_bound
    np.testing.assert_array_equal(bound, np.minimum(smfr_levels(model).quality_bound, levels))


def test_one_point_is_in_every_level():
    assert smfr_levels(float32_model(n=3, levels=1).select(np.array([1]))).quality_bound[0] == 4


@pytest.mark.parametrize("levels", [0, 5])
def test_number_of_levels(levels):
    with pytest.raises(ValueError, match=f"not {levels}"):
        smfr_levels(float32_model(levels=1), levels)


def test_spread_levels_are_nested_spread_and_amplified():
    model = replace(float32_model(n=3000, levels=1), means=np.random.default_rng(3).uniform(-1, 1, (3000, 3)))
    enhanced = spread_levels(model)
    counts = [(enhanced.quality_bound > level).mean() for level in range(4)]
    assert counts == pytest.approx([1.0, 0.40, 0.22, 0.17], abs=1e-3)
    assert np.allclose(enhanced.opacity[:, 3], np.minimum(model.opacity[:, 0] * 32, 128))
    octant = (model.means > 0) @ [1, 2, 4]
    kept = np.bincount(octant[enhanced.quality_bound == 4], minlength=8) / np.bincount(octant, minlength=8)
    assert kept.min() > 0.5 * kept.max()
    with pytest.raises(ValueError, match="not 5"):
        spread_levels(model, 5)
