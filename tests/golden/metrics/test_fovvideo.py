"""FovVideoVDP's wrapper: what it says where the package is absent, and that the package is asked what is meant."""

import sys

import pytest

torch = pytest.importorskip("torch")

from golden.metrics.fovvideo import BEST_JOD, FovVideoVdp  # noqa: E402
from spec.errors import InputError  # noqa: E402

SIZE = (96, 64)


def test_an_absent_package_is_named_with_its_licence(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyfvvdp", None)
    with pytest.raises(InputError, match=r"CC BY-NC.*extra 'judge'"):
        FovVideoVdp(SIZE)


def test_the_real_metric_knows_noise_and_gaze():
    pytest.importorskip("pyfvvdp")
    judge = FovVideoVdp(SIZE)
    image = torch.rand(64, 96, 3, generator=torch.Generator().manual_seed(0)) * 0.2 + 0.4
    noise = torch.randn(64, 96, 3, generator=torch.Generator().manual_seed(1))
    scores = [judge((image + s * noise).clamp(0, 1), image, (48.0, 32.0)) for s in (0.0, 0.05, 0.3)]
    assert scores[0] == BEST_JOD and scores == sorted(scores, reverse=True) and scores[2] < scores[1] - 0.5
    noisy = image.clone()
    noisy[:, 64:] = (image + 0.2 * noise).clamp(0, 1)[:, 64:]  # on the right alone
    assert judge(noisy, image, (80.0, 32.0)) < judge(noisy, image, (0.0, 32.0)) < judge(noisy, image, (-400.0, 32.0))
    with pytest.raises(ValueError, match="96"):
        judge(image[:10], image, (48.0, 32.0))
