"""What an image loses without a Gaussian, against images that are rendered without it."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.removal import removal  # noqa: E402
from golden.diff.render import render  # noqa: E402
from golden.scenes.camera import Camera  # noqa: E402
from tests.helpers.training_samples import crowd, forward_camera, round_gaussians  # noqa: E402

BACKGROUND = (0.2, 0.5, 0.1)
CAMERA = Camera(np.eye(3), np.zeros(3), 40.0, 36.0, 12.0, 9.0, 25, 19)
"""25x19 pixels: two tiles each way, the last ones cut by the frame."""


@pytest.mark.parametrize("alpha_max", [0.99, 0.5])
def test_change_is_the_squared_difference_from_the_image_without_it(alpha_max):
    """Also where alpha is clipped, where the image stays as it is, and for what lies behind the camera."""
    gaussians = crowd()

    def image(of):
        return render(of, CAMERA, alpha_max=alpha_max, background=BACKGROUND).image.double()

    found = removal(gaussians, CAMERA, alpha_max=alpha_max, background=BACKGROUND)
    assert found.index.tolist() == list(range(len(gaussians) - 1))
    for row, change in zip(found.index.tolist(), found.change.tolist(), strict=True):
        others = torch.arange(len(gaussians)) != row
        expected = float((image(gaussians) - image(gaussians.select(others))).square().sum())
        assert expected > 1e-4 and change == pytest.approx(expected, rel=1e-4)


def test_what_nothing_shows_changes_nothing():
    """Behind an opaque wall that stops all pixels, and of the colour of what is behind it."""
    wall = round_gaussians([(32.0, 32.0, 2.0, 60.0, 0.99)] * 4 + [(32.0, 32.0, 3.0, 2.0, 0.9)])
    found = removal(wall, forward_camera())
    assert found.change[-1] == 0 and found.tiles[-1] == 0 and found.tiles[0] == 16
    wall.sh_dc[:] = -3.0  # black before black
    assert removal(wall, forward_camera()).change[:4].max() == 0


def test_tiles_are_those_of_the_renderer_and_threads_change_nothing():
    gaussians, threads = crowd(seed=5, count=40), torch.get_num_threads()
    one = removal(gaussians, CAMERA)
    rendering = render(gaussians, CAMERA, usage=True)
    assert torch.equal(one.index, rendering.index) and torch.equal(one.tiles, rendering.tiles)
    try:
        torch.set_num_threads(3)
        again = removal(gaussians, CAMERA)
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(one.change, again.change)
