"""Random points in place of those of structure from motion."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")

from golden.scenes.orbit import look_at
from golden.train import main
from golden.training.random_points import depths_from, in_frame, random_points
from golden.training.scene import load_training_scene

UP = np.array([0.0, 0.0, 1.0])


def ring(count=12, radius=4.0):
    angles = np.arange(count) * 2 * np.pi / count
    return [look_at(np.array([radius * np.cos(a), radius * np.sin(a), 1.0]), np.zeros(3), UP, 60, 40, 50.0, name=str(i))
            for i, a in enumerate(angles)]


def wall(count=9):
    """Cameras side by side with parallel axes along +y."""
    return [look_at(np.array([0.1 * i, 0.0, 0.0]), np.array([0.1 * i, 1.0, 0.0]), UP, 60, 40, 50.0, name=str(i))
            for i in range(count)]


def photographs(cameras, colour=(10, 20, 30)):
    return np.full((len(cameras), 40, 60, 3), colour, np.uint8)


@pytest.mark.parametrize(("cameras", "depths"), [(ring(), None), (wall(), None), (wall(), (2.0, 9.0))])
def test_points_lie_in_the_common_volume(cameras, depths):
    points, colours = random_points(cameras, photographs(cameras), depths, count=2000)
    assert points.shape == colours.shape == (2000, 3) and np.allclose(colours * 255, (10, 20, 30))
    seen = sum(in_frame(points, camera).astype(int) for camera in cameras)
    assert seen.min() >= len(cameras) / 2
    if depths is not None:
        assert 2.0 <= points[:, 1].min() < 2.1 and 8.0 < points[:, 1].max() <= 9.0
    again = random_points(cameras, photographs(cameras), depths, count=2000)[0]
    assert np.array_equal(points, again)
    assert not np.array_equal(points, random_points(cameras, photographs(cameras), depths, count=2000, seed=1)[0])


def test_depths_from_cameras():
    near, far = depths_from(ring(radius=4.0))
    assert near == pytest.approx(np.sqrt(17) / 2) and far == pytest.approx(2 * np.sqrt(17))
    assert depths_from(wall()) == pytest.approx((0.4, 16.0))
    outwards = [replace(camera, rotation=np.diag([-1.0, 1.0, -1.0]) @ camera.rotation,
                        translation=np.diag([-1.0, 1.0, -1.0]) @ camera.translation) for camera in ring()]
    assert depths_from(outwards)[0] == pytest.approx(4.0)  # they look at no common point: the extent of their positions


def test_cameras_that_share_nothing_get_points_all_the_same():
    first, second = ring(2)
    away = replace(second, rotation=first.rotation, translation=first.translation + 1000.0)
    points, _ = random_points([first, away], photographs([first, away]), (1.0, 5.0), count=500)
    assert len(points) == 500 and all(in_frame(points, camera).any() for camera in (first, away))


@pytest.mark.data
def test_fern_without_its_points(data_dir, tmp_path, capsys):
    """An LLFF folder without points trains, and its model is found together with its cameras."""
    from golden.scenes.load import load_scene
    from golden.scenes.request import parse_request, resolve
    from golden.training.plots import read_log

    fern, source = tmp_path / "fern", data_dir / "posed" / "fern"
    fern.mkdir()
    (fern / "images_8").symlink_to(source / "images_8")
    (fern / "poses_bounds.npy").symlink_to(source / "poses_bounds.npy")
    scene = load_training_scene(fern, (84, 63))
    assert scene.random_start and len(scene.points) == 10_000
    argv = [str(fern), "--size", "84x63", "--iterations", "200", "--max-points", "4000", "--device", "cpu"]
    assert main([*argv, "--out", str(tmp_path / "out")]) == 0
    assert "fern has no points of structure from motion; 10,000 random ones" in capsys.readouterr().err
    psnr = [record["psnr"] for record in read_log(tmp_path / "out" / "log.jsonl") if record["stage"] == "dense"]
    assert np.mean(psnr[-20:]) > max(20, np.mean(psnr[:20]) + 2)
    found = load_scene(tmp_path / "out" / "model.ply")
    for got, want in zip(found.cameras, scene.cameras, strict=True):
        np.testing.assert_allclose(got.rotation, want.rotation, atol=1e-12)
        np.testing.assert_allclose(got.translation, want.translation, atol=1e-9)
        assert (got.name, got.width, got.fx, got.cx, got.cy) == (want.name, want.width, want.fx, want.cx, want.cy)
    request = resolve(parse_request(str(tmp_path / "out" / "model.ply"), "--camera", "3"))
    assert request.camera.name == "image003.png" and request.record["size"] == [84, 63]
