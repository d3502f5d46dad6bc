"""LPIPS's wrapper: what it hands to the package, and what it says where package or weights are absent."""

import sys
from types import SimpleNamespace
from urllib.error import URLError

import pytest

torch = pytest.importorskip("torch")

from golden.metrics.lpips import NETWORKS, Lpips  # noqa: E402
from spec.errors import InputError  # noqa: E402


class Network:
    """Stands in for the package's network: the mean difference of its inputs as the network sees them."""

    def __init__(self, net, verbose):
        assert net in NETWORKS and not verbose

    def __call__(self, image, reference, normalize):
        assert image.shape == reference.shape == (1, 3, 8, 6) and image.dtype == torch.float32
        assert normalize, "images of 0..1 must be rescaled"
        return (2 * image[:, 0] - 2 * reference[:, 0]).mean().view(1, 1, 1, 1)


def test_images_reach_the_network_as_it_expects_them(monkeypatch):
    monkeypatch.setitem(sys.modules, "lpips", SimpleNamespace(LPIPS=Network))
    image = torch.zeros(8, 6, 3, dtype=torch.float64, requires_grad=True)
    red = image.detach().clone()
    red[..., 0] = 0.25
    assert Lpips()(red, image) == 0.5 and Lpips("alex")(image, red) == -0.5
    with pytest.raises(ValueError, match="7, 6"):
        Lpips()(image, torch.zeros(7, 6, 3))


def test_an_absent_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "lpips", None)
    with pytest.raises(InputError, match="extra 'judge'"):
        Lpips()


@pytest.mark.parametrize("failure", [URLError("no route"), RuntimeError("invalid hash value"), FileNotFoundError("no file")])
def test_absent_weights_are_named(monkeypatch, failure):
    def fails(**_):
        raise failure

    monkeypatch.setitem(sys.modules, "lpips", SimpleNamespace(LPIPS=fails))
    with pytest.raises(InputError, match=r"vgg cannot be loaded .*checkpoints"):
        Lpips()


def test_another_network_is_refused():
    with pytest.raises(InputError, match="'resnet' is not accepted: vgg or alex"):
        Lpips("resnet")


def test_the_real_network_tells_worse_from_better():
    pytest.importorskip("lpips")
    try:
        distance = Lpips()
    except InputError as error:
        pytest.skip(str(error))
    image = torch.rand(64, 64, 3, generator=torch.Generator().manual_seed(0)) * 0.2 + 0.4
    noise = torch.randn(64, 64, 3, generator=torch.Generator().manual_seed(1))
    scores = [distance((image + s * noise).clamp(0, 1), image) for s in (0, 0.05, 0.3)]
    assert scores[0] == pytest.approx(0, abs=1e-6) and scores == sorted(scores) and scores[2] > 2 * scores[1]
