"""Each convention against something that only the right one satisfies."""

import numpy as np
import pytest

from golden.scenes import conventions

ROOT = np.sqrt(0.5)


def test_sigmoid_and_logit_are_inverse_and_never_overflow():
    x = np.array([-np.inf, -800, -5, 0, 5, 800, np.inf])
    with np.errstate(all="raise", under="ignore"):
        np.testing.assert_array_equal(conventions.sigmoid(x)[[0, 1, 3, 5, 6]], [0, 0, 0.5, 1, 1])
    assert np.isnan(conventions.sigmoid(np.array([np.nan])))[0]
    np.testing.assert_allclose(conventions.logit(conventions.sigmoid(x[2:5])), [-5, 0, 5])
    extremes = conventions.logit(np.array([0.0, 1.0, 128.0]))
    np.testing.assert_array_equal(extremes, [-30, 30, 30])
    assert list(1 / (1 + np.exp(-extremes[1:].astype(np.float32)))) == [1, 1]  # exactly, for readers in float32


def test_colour_to_dc():
    np.testing.assert_allclose(conventions.colour_to_sh_dc(np.array([0.5, 1.0])) * 0.28209479177387814 + 0.5, [0.5, 1.0])


def test_sh_rest_order():
    flat = np.array([[f"{channel}{k}" for channel in "rgb" for k in range(8)]])
    rest = conventions.sh_rest_from_ply(flat)
    assert rest.shape == (1, 8, 3) and list(rest[0, 2]) == ["r2", "g2", "b2"]
    np.testing.assert_array_equal(conventions.sh_rest_to_ply(rest), flat)


def test_opengl_camera_sees_what_lies_along_minus_z():
    """A Blender camera at (0, -5, 0), turned 90 degrees about x, looks along +y with +z up."""
    pose = np.array([[1, 0, 0, 0], [0, 0, -1, -5], [0, 1, 0, 0], [0, 0, 0, 1.0]])
    rotation, translation = conventions.camera_from_opengl(pose)
    np.testing.assert_allclose(rotation @ [0, 0, 0] + translation, [0, 0, 5])
    np.testing.assert_allclose(rotation @ [1, 0, 0] + translation, [1, 0, 5])  # right stays right
    np.testing.assert_allclose(rotation @ [0, 0, 1] + translation, [0, -1, 5])  # up is -y
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_llff_columns_are_down_right_backward():
    down, right, backward, position = [0, -1, 0], [ROOT, 0, ROOT], [-ROOT, 0, ROOT], [3, 4, 5]
    rotation, translation = conventions.camera_from_llff(np.array([down, right, backward, position], float).T)
    assert np.linalg.det(rotation) == pytest.approx(1)
    ahead = np.array(position) - 2 * np.array(backward)
    np.testing.assert_allclose(rotation @ ahead + translation, [0, 0, 2], atol=1e-12)
    np.testing.assert_allclose(rotation @ (ahead + np.array(down)) + translation, [0, 1, 2], atol=1e-12)
    np.testing.assert_allclose(rotation @ (ahead + np.array(right)) + translation, [1, 0, 2], atol=1e-12)


def test_opencv_pose_is_inverted():
    pose = np.array([[0, 0, 1, 1], [1, 0, 0, 2], [0, 1, 0, 3.0]])
    rotation, translation = conventions.camera_from_opencv(pose)
    np.testing.assert_allclose(rotation @ [1, 2, 3] + translation, 0)
    np.testing.assert_allclose(rotation @ [4, 2, 3] + translation, [0, 0, 3])


def test_up_of_cameras_is_against_their_y():
    tilted = np.array([[1, 0, 0], [0, ROOT, -ROOT], [0, ROOT, ROOT]])
    np.testing.assert_allclose(conventions.up_of_cameras(np.stack([np.eye(3), tilted, tilted.T])), [0, -1, 0])
