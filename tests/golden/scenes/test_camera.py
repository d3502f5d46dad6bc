"""Cameras made from cameras."""

import numpy as np
import pytest

from golden.scenes.camera import Camera


def test_a_camera_turns_to_its_right_in_its_place():
    rotation = np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]])
    camera = Camera(rotation, np.array([1.0, 2, 3]), 50, 60, 20, 10, 40, 20)
    turned = camera.turned(90)
    np.testing.assert_allclose(turned.position, camera.position, atol=1e-12)
    right = camera.position + rotation[0]  # one unit to the right of the camera
    np.testing.assert_allclose(turned.rotation @ right + turned.translation, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(turned.rotation[1], rotation[1])
    assert np.linalg.det(turned.rotation) == pytest.approx(1)
    again = camera.turned(30).turned(-30)
    np.testing.assert_allclose(again.rotation, rotation, atol=1e-12)
    assert (turned.fx, turned.width, turned.near) == (camera.fx, camera.width, camera.near)
