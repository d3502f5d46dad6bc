"""Binocular HVSQ: each eye at its own gaze, and their mean."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.metrics.binocular import BinocularReference  # noqa: E402
from golden.metrics.hvsq import foveated  # noqa: E402
from golden.scenes.gaze import Display  # noqa: E402
from spec.errors import InputError  # noqa: E402


def test_it_is_the_mean_of_both_eyes_at_their_own_gazes():
    torch.set_num_threads(1)
    rng = np.random.default_rng(0)
    left, right = rng.random((2, 64, 96, 3)).astype(np.float32)
    gazes = (20.0, 30.0), (70.5, 12.0)
    reference = BinocularReference((left, right), gazes)
    same = reference((left, right))
    assert same.eyes == (0.0, 0.0) and same.mean == 0
    worse = np.clip(right + rng.normal(0, 0.1, right.shape), 0, 1).astype(np.float32)
    found = reference((left, worse))
    alone = foveated(torch.from_numpy(right), Display(96, 64).eccentricity(gazes[1]))
    assert found.eyes[0] == 0 and found.eyes[1] == pytest.approx(float(alone(torch.from_numpy(worse))), rel=1e-6)
    assert found.mean == pytest.approx(found.eyes[1] / 2) and found.mean > 0
    elsewhere = BinocularReference((left, right), (gazes[0], (10.0, 60.0)))((left, worse))
    assert elsewhere.eyes[1] != found.eyes[1]


def test_bytes_are_fractions_of_255():
    rng = np.random.default_rng(1)
    frames = rng.integers(0, 256, (3, 32, 32, 3), dtype=np.uint8)
    gazes = ((16.0, 16.0), (16.0, 16.0))
    by_bytes = BinocularReference((frames[0], frames[1]), gazes)((frames[2], frames[1]))
    floats = frames / np.float32(255)
    assert by_bytes == BinocularReference((floats[0], floats[1]), gazes)((floats[2], floats[1]))


def test_a_gaze_off_its_frame_is_refused():
    frame = np.zeros((32, 32, 3), np.float32)
    with pytest.raises(InputError, match="off the display"):
        BinocularReference((frame, frame), ((5.0, 5.0), (33.0, 5.0)))
