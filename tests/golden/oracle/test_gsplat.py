"""Plain 3DGS semantics of the oracle against gsplat's PyTorch reference; skipped where PyTorch or gsplat is absent."""

import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from golden.scenes.camera import Camera
from tests.golden.oracle.test_brute_force import random_model

pytest.importorskip("torch", reason="PyTorch is not installed")
if importlib.util.find_spec("gsplat") is None:
    pytest.skip("gsplat is not installed (pip install --no-deps gsplat==1.5.3)", allow_module_level=True)


@pytest.mark.parametrize("sh_degree", [0, 3])
def test_agrees_but_for_the_splat_at_which_a_pixel_stops(sh_degree, monkeypatch):
    from tests.golden.oracle.compare_gsplat import compare

    model = random_model(np.random.default_rng(5), 800, sh=sh_degree)
    model = replace(model, opacity=model.opacity**0.25)  # opaque enough for pixels to stop
    turn = np.deg2rad(12)
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    # The principal point is in the centre: elsewhere gsplat's Jacobian clamp adds its margin differently.
    camera = Camera(rotation, np.array([0.3, -0.2, 1.0]), 60.0, 65.0, 40.0, 24.0, 80, 48)
    result = compare(model, camera)
    assert 0.05 < result.stopped_share < 0.95
    assert result.max_error_open < 1e-9
    assert result.max_error_same_stop < 1e-9
    assert 1e-6 < result.max_error_stopped < 0.4
