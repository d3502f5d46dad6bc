"""What models are judged by."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.gaussians import to_model  # noqa: E402
from golden.metrics import image as metrics  # noqa: E402
from golden.metrics.hvsq import Hvsq  # noqa: E402
from golden.oracle.render import render as oracle_render  # noqa: E402
from golden.training.evaluate import MARGIN, MOST_GAIN, Gate, Quality, evaluate  # noqa: E402
from tests.helpers.training_samples import GuardedScene, guarded, small_dense, small_scene  # noqa: E402


@pytest.fixture(scope="module")
def scene() -> GuardedScene:
    return guarded(small_scene())


def test_quality_is_the_mean_over_views_as_the_oracle_renders_them(scene):
    """PSNR, SSIM, HVSQ and entries of two views, from the float64 renderer's frames."""
    dense, views = small_dense(400), scene.validation[:2]
    seen = []
    quality = evaluate(dense, scene, views, hvsq=[lambda p: Hvsq(p, 1.0), lambda p: Hvsq(p, 3.0)], progress=seen.append)
    model = to_model(dense, up=scene.up, name="dense")
    expected = []
    for view in views:
        frame = oracle_render(model, scene.cameras[view])
        shown, photograph = np.clip(frame.image, 0, 1).astype(np.float32), scene.photograph(view)
        errors = [metric(shown, photograph.numpy()) for metric in (metrics.psnr, metrics.ssim)]
        hvsq = [float(Hvsq(photograph, size)(torch.from_numpy(shown))) for size in (1.0, 3.0)]
        expected.append([*errors, frame.entries, *hvsq])
    psnr, ssim, entries, *hvsq = np.mean(expected, axis=0)
    assert quality.psnr == pytest.approx(psnr, abs=1e-3)
    assert quality.ssim == pytest.approx(ssim, abs=1e-4)
    assert quality.entries == pytest.approx(entries, rel=1e-3)
    assert quality.entries_per_tile == pytest.approx(quality.entries / 16)
    assert quality.hvsq == pytest.approx(hvsq, rel=1e-3)
    assert quality.points == len(dense)
    assert seen == [1, 2]
    without = evaluate(dense, scene, views, ssim=False)
    assert without.ssim is None and without.psnr == quality.psnr and without.views == tuple(view[:1] for view in quality.views)


def test_gate_is_a_share_of_psnr_alone():
    """The paper's H, M and L; SSIM is neither needed nor read."""
    dense = Quality(30.0, 0.9, 100.0, 1.0, 10, views=((29.0, 0.9), (31.0, 0.9)))
    gate = Gate.of(dense, 0.02)
    assert gate.psnr == pytest.approx(29.4) and not gate.reads_ssim
    for ssim in (None, 0.1, 0.9):
        assert gate.passes(Quality(29.5, ssim, 1.0, 1.0, 1)) and not gate.passes(Quality(29.3, ssim, 1.0, 1.0, 1))
    assert gate.slack(Quality(29.6, None, 1.0, 1.0, 1, views=((28.8,), (30.4,)))) == pytest.approx(29.5 / 29.4 - 1)


def test_gate_of_both_is_a_share_of_psnr_and_of_ssim():
    dense = Quality(30.0, 0.9, 100.0, 1.0, 10)
    gate = Gate.of(dense, 0.02, "both")
    assert (gate.psnr, gate.ssim) == pytest.approx((29.4, 0.882))
    assert gate.passes(dense)
    assert not gate.passes(Quality(29.3, 0.9, 1.0, 1.0, 1)) and not gate.passes(Quality(30.0, 0.88, 1.0, 1.0, 1))


def test_gate_asks_for_half_the_standard_error_of_few_views():
    """Of two views that lose 0 and 0.4 dB the mean loss is 0.2 and its standard error 0.2: 0.3 in all, of 1 % of 30."""
    dense = Quality(30.0, 0.9, 1.0, 1.0, 1, views=((25.0, 0.9), (35.0, 0.9)))
    gate = Gate.of(dense, 0.01)
    uneven = Quality(29.79, 0.9, 1.0, 1.0, 1, views=((25.0, 0.9), (34.58, 0.9)))
    even = Quality(29.8, 0.9, 1.0, 1.0, 1, views=((24.8, 0.9), (34.8, 0.9)))
    assert gate.slack(uneven) == pytest.approx((29.79 - 0.105) / 29.7 - 1) and not gate.passes(uneven)
    assert gate.slack(even) == pytest.approx(29.8 / 29.7 - 1) and gate.passes(even)


def test_a_gain_in_one_view_does_not_pay_for_losses_in_the_others():
    """A gain of 8 dB counts as MOST_GAIN; a loss counts in full."""
    dense = Quality(25.0, None, 1.0, 1.0, 1, views=((10.0,), (30.0,), (35.0,)))
    gate = Gate.of(dense, 0.01)
    lucky = Quality(27.0, None, 1.0, 1.0, 1, views=((18.0,), (29.0,), (34.0,)))
    gains = np.array([MOST_GAIN, -1, -1])
    counted = 25 + gains.mean() - MARGIN * gains.std(ddof=1) / np.sqrt(3)
    assert gate.slack(lucky) == pytest.approx(counted / 24.75 - 1) and not gate.passes(lucky)
    assert replace(gate, dense=()).slack(lucky) == pytest.approx(27 / 24.75 - 1)
    both = Gate.of(replace(dense, ssim=0.5, views=tuple((*view, 0.5) for view in dense.views)), 0.01, "both")
    assert both.slack(replace(lucky, ssim=0.9, views=((18.0, 1.0), (29.0, 0.9), (34.0, 0.8)))) == pytest.approx(
        counted / 24.75 - 1)


def test_refusals(scene):
    with pytest.raises(ValueError, match="at least one view"):
        evaluate(small_dense(400), scene, [])
    with pytest.raises(ValueError, match=r"1\.5"):
        Gate.of(Quality(30.0, 0.9, 1.0, 1.0, 1), 1.5)
    with pytest.raises(ValueError, match="'ssim'"):
        Gate.of(Quality(30.0, 0.9, 1.0, 1.0, 1), 0.01, "ssim")
