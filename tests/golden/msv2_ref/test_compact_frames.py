"""Frames of compact records: close to the oracle's, no darker and no brighter, and the same whatever the file's order."""

import numpy as np
import pytest

from golden.metrics.image import psnr_vs
from golden.msv2_ref.pipeline import render
from golden.oracle.render import render as oracle
from golden.scenes.embedded.splats import cached_embedded_model
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.levels import smfr_levels
from spec.config import PAPER, V3_RECORDS
from tests.helpers.golden_samples import map_for

WIDE = V3_RECORDS.with_(records="wide")

MEAN_SHIFT = 4e-4
"""A tenth of a step of 8-bit colour. Coarse base colours lie on a grid that the colour unit does not round, and so lack the
1/8 ulp of `colour` by which it brightens those of wide records."""


@pytest.fixture(scope="module")
def model():
    return smfr_levels(cached_embedded_model())


@pytest.fixture(scope="module", params=[(0, None), (3, None), (0, (0.5, 0.5)), (3, (0.2, 0.7))], ids=str)
def frames(request, model):
    """Images of the machines by name, and the oracle's."""
    view, gaze = request.param
    camera = embedded_cameras(240, 136)[view]
    foveation = map_for(camera, gaze, 4)
    images = {name: np.clip(render(model, camera, config=config, foveation=foveation).image, 0, 1)
              for name, config in (("paper", PAPER), ("wide", WIDE), ("compact", V3_RECORDS))}
    return images | {"oracle": np.clip(oracle(model, camera, foveation=foveation, weights="plane").image, 0, 1)}


def test_compact_records_are_as_exact_as_they_must_be(frames):
    assert psnr_vs(frames["compact"], frames["oracle"]) >= 58
    assert psnr_vs(frames["wide"], frames["oracle"]) >= 60
    assert psnr_vs(frames["compact"], frames["paper"]) >= 58


def test_order_and_chunks_alone_change_next_to_nothing(frames):
    """Only splats of equal depth keys change places."""
    assert (frames["wide"] != frames["paper"]).any(axis=2).mean() < 0.01


def test_no_mean_is_shifted(frames):
    assert abs(frames["compact"].mean() - frames["wide"].mean()) < MEAN_SHIFT
    assert abs(frames["compact"].mean() - frames["oracle"].mean()) < MEAN_SHIFT
    assert np.abs((frames["compact"] - frames["wide"]).mean(axis=(0, 1))).max() < MEAN_SHIFT


def test_the_files_order_does_not_change_a_pixel(model):
    camera = embedded_cameras(120, 68)[0]
    foveation = map_for(camera, (0.5, 0.5), 4)
    first = render(model, camera, config=V3_RECORDS, foveation=foveation)
    shuffled = model.select(np.random.default_rng(0).permutation(len(model)))
    second = render(shuffled, camera, config=V3_RECORDS, foveation=foveation)
    assert np.array_equal(first.image, second.image) and np.array_equal(first.entries.splat, second.entries.splat)
    assert first.chunks_skipped == second.chunks_skipped > 0
    dumped = first.stage("gaussians")
    assert np.array_equal(dumped["model_index"], first.words.model_index) and len(dumped["chunks"]) == len(first.words.chunks)
