"""Every format of posed photographs, written from one little scene: a grid of coloured dots that must land on its pixels."""

import json
import struct
import sys

import numpy as np
import pytest
from PIL import Image

from golden.scenes.camera import Camera
from golden.scenes.colmap import read_points
from golden.scenes.datasets import load_dataset
from golden.scenes.load import load_scene
from golden.scenes.orbit import look_at
from spec.errors import InputError
from tests.helpers.scenes_samples import ply_columns, write_ply

WIDTH, HEIGHT, VIEWS = 60, 40, 9
COLOURS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0], [0, 255, 255]], np.uint8)


def little_scene() -> tuple[list[Camera], np.ndarray]:
    """Cameras around an upright z axis, slightly rolled by where they stand, and five points."""
    points = np.array([[0.03, 0.02, 0.02], [0.7, 0.05, 0.1], [0.04, 0.6, -0.2], [-0.5, -0.3, 0.5], [0.2, -0.6, -0.4]])
    angles = np.arange(VIEWS) * 2 * np.pi / VIEWS
    cameras = [look_at(np.array([4 * np.cos(a), 4 * np.sin(a), 1.5]), np.zeros(3), np.array([0.0, 0, 1]), WIDTH, HEIGHT, 50.0,
                       name=f"view_{i:02d}.png") for i, a in enumerate(angles)]
    return cameras, points


def paint(camera: Camera, points: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8: black, with every point's pixel in its colour; pixel (i, j) covers [i, i+1) x [j, j+1)."""
    image = np.zeros((camera.height, camera.width, 3), np.uint8)
    x, y, z = (points @ camera.rotation.T + camera.translation).T
    image[(camera.fy * y / z + camera.cy).astype(int), (camera.fx * x / z + camera.cx).astype(int)] = COLOURS
    return image


def save_images(folder, cameras, points):
    folder.mkdir(parents=True)
    for camera in cameras:
        Image.fromarray(paint(camera, points)).save(folder / camera.name)


def opengl_pose(camera: Camera) -> list[list[float]]:
    pose = np.eye(4)
    pose[:3, :3] = camera.rotation.T @ np.diag([1, -1, -1])
    pose[:3, 3] = camera.position
    return pose.tolist()


def write_colmap(root, cameras, points):
    """COLMAP's text model, by its documentation: world to camera, wxyz, pixel centres at + 0.5."""
    model = root / "sparse" / "0"
    model.mkdir(parents=True)
    c = cameras[0]
    (model / "cameras.txt").write_text(f"1 PINHOLE {c.width} {c.height} {c.fx!r} {c.fy!r} {c.cx!r} {c.cy!r}\n")
    lines = []
    for i, camera in reversed(list(enumerate(cameras))):  # names, not ids, give the order
        w = np.sqrt(max(0, 1 + np.trace(camera.rotation))) / 2
        r = camera.rotation
        q = [w, *(np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / (4 * w))]
        numbers = [VIEWS - i, *map(float, q), *map(float, camera.translation), 1]
        lines.append(" ".join(map(repr, numbers)) + f" {camera.name}\n\n")
    (model / "images.txt").write_text("".join(lines))
    (model / "points3D.txt").write_text("".join(
        " ".join(map(str, [i + 1, *map(float, p), *map(int, colour), 0.5])) + "\n"
        for i, (p, colour) in enumerate(zip(points, COLOURS, strict=True))))


def write_llff(root, cameras, points):
    rows = []
    for camera in cameras:
        right, down, forward = camera.rotation
        hwf = [camera.height * 4, camera.width * 4, camera.fx * 4]  # of the photographs before they were reduced
        rows.append([*np.stack([down, right, -forward, camera.position, hwf], axis=1).ravel(), 1.0, 9.0])
    np.save(root / "poses_bounds.npy", np.array(rows))
    (root / "sparse" / "0").mkdir(parents=True)
    with (root / "sparse" / "0" / "points3D.bin").open("wb") as file:
        file.write(struct.pack("<Q", len(points)))
        for i, (point, colour) in enumerate(zip(points, COLOURS, strict=True)):
            file.write(struct.pack("<Q3d3BdQ", i, *point, *colour, 0.1, i) + bytes(8 * i))


def write_nerfstudio(root, cameras, points):
    write_ply(root / "sparse.ply", dict(zip(("x", "y", "z"), points.T, strict=True)) | dict(
        zip(("red", "green", "blue"), COLOURS.T, strict=True)), encoding="ascii")
    c = cameras[0]
    meta = {"w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy, "camera_model": "OPENCV", "k1": 0,
            "ply_file_path": "sparse.ply", "frames": [
                {"file_path": f"images/{camera.name}", "transform_matrix": opengl_pose(camera)}
                for camera in reversed(cameras)]}
    (root / "transforms.json").write_text(json.dumps(meta))


def write_blender(root, cameras, points):
    angle = 2 * np.arctan(WIDTH / 2 / cameras[0].fx)
    meta = {"camera_angle_x": angle, "frames": [
        {"file_path": f"./images/{camera.name[:-4]}", "transform_matrix": opengl_pose(camera)} for camera in cameras]}
    (root / "transforms_train.json").write_text(json.dumps(meta))


def write_set(kind, root):
    cameras, points = little_scene()
    save_images(root / ("images_4" if kind == "llff" else "images"), cameras, points)
    {"colmap": write_colmap, "llff": write_llff, "nerfstudio": write_nerfstudio, "blender": write_blender}[kind](
        root, cameras, points)
    return cameras, points


@pytest.mark.parametrize("kind", ["colmap", "llff", "nerfstudio", "blender"])
def test_points_land_on_their_pixels(tmp_path, kind):
    if kind == "colmap":
        pytest.importorskip("pycolmap")
    cameras, points = write_set(kind, tmp_path)
    data = load_dataset(tmp_path)
    assert (len(data), data.test_views) == (VIEWS, (0, 8))
    if kind != "blender":
        order = np.lexsort(data.points.T)
        np.testing.assert_allclose(data.points[order], points[np.lexsort(points.T)], atol=1e-6)
        np.testing.assert_array_equal(data.point_colours[order], COLOURS[np.lexsort(points.T)])
    assert data.up @ [0, 0, 1] > 0.9
    for i, (got, want) in enumerate(zip(data.cameras, cameras, strict=True)):
        assert got.name == want.name and (got.width, got.height) == (WIDTH, HEIGHT)
        np.testing.assert_allclose(got.rotation, want.rotation, atol=1e-9)
        np.testing.assert_allclose(got.translation, want.translation, atol=1e-9)
        np.testing.assert_allclose([got.fx, got.fy, got.cx, got.cy], [want.fx, want.fy, want.cx, want.cy])
        photograph = data.photograph(i)
        assert photograph.dtype == np.float32
        np.testing.assert_array_equal(photograph, paint(got, points) / np.float32(255))


def test_cameras_without_photographs(tmp_path):
    pytest.importorskip("pycolmap")
    cameras, points = little_scene()
    write_colmap(tmp_path, cameras, points)
    data = load_dataset(tmp_path)
    assert data.images is None and len(data) == VIEWS
    with pytest.raises(InputError, match="no photographs"):
        data.photograph(0)


def test_reduced_photographs_reduce_the_intrinsics(tmp_path):
    pytest.importorskip("pycolmap")
    cameras, points = little_scene()
    write_colmap(tmp_path, [camera.resized(4 * WIDTH, 4 * HEIGHT) for camera in cameras], points)
    save_images(tmp_path / "images_4", cameras, points)
    camera = load_dataset(tmp_path).cameras[0]
    np.testing.assert_allclose([camera.fx, camera.cx, camera.cy, camera.width], [cameras[0].fx, WIDTH / 2, HEIGHT / 2, WIDTH])


def test_a_model_in_a_data_set_has_its_cameras(tmp_path):
    write_set("nerfstudio", tmp_path)
    (tmp_path / "sparse.ply").rename(tmp_path / "points.txt")
    meta = (tmp_path / "transforms.json").read_text()
    (tmp_path / "transforms.json").write_text(meta.replace("sparse.ply", "points.txt"))
    write_ply(tmp_path / "model.ply", ply_columns())
    assert len(load_scene(tmp_path).cameras) == VIEWS
    assert load_scene(tmp_path / "model.ply").cameras == ()


def npz_arrays():
    cameras, points = little_scene()
    views = np.tile(np.eye(4, dtype=np.float32), (VIEWS, 1, 1))
    views[:, :3, :3] = [camera.rotation for camera in cameras]
    views[:, :3, 3] = [camera.translation for camera in cameras]
    c = cameras[0]
    intrinsics = np.tile(np.array([[c.fx, 0, c.cx], [0, c.fy, c.cy], [0, 0, 1]], np.float32), (VIEWS, 1, 1))
    return {"means3d": points.astype(np.float32), "colors": COLOURS, "viewmats": views, "Ks": intrinsics, "width": WIDTH,
            "height": HEIGHT}


def test_npz(tmp_path):
    np.savez(tmp_path / "set.npz", **npz_arrays())
    data = load_dataset(tmp_path / "set.npz")
    cameras, points = little_scene()
    assert data.images is None and data.name == "set" and data.up @ [0, 0, 1] > 0.9
    np.testing.assert_allclose(data.points, points, atol=1e-6)
    for got, want in zip(data.cameras, cameras, strict=True):
        np.testing.assert_allclose(got.position, want.position, atol=1e-5)
        np.testing.assert_array_equal(paint(got, points), paint(want, points))


@pytest.mark.parametrize(("key", "value"), [
    ("means3d", None), ("viewmats", np.eye(4)), ("Ks", np.zeros((2, 3, 3))), ("width", [1, 2]),
])
def test_broken_npz(tmp_path, key, value):
    arrays = npz_arrays()
    del arrays[key]
    np.savez(tmp_path / "set.npz", **arrays, **({} if value is None else {key: value}))
    with pytest.raises(InputError, match=key):
        load_dataset(tmp_path / "set.npz")


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04", b"nonsense"])
def test_npz_that_is_none(tmp_path, data):
    (tmp_path / "set.npz").write_bytes(data)
    with pytest.raises(InputError, match=r"set\.npz"):
        load_dataset(tmp_path / "set.npz")


def test_broken_llff(tmp_path):
    write_set("llff", tmp_path)
    path = tmp_path / "poses_bounds.npy"
    good = np.load(path)
    for bad in (good[:, :16], good[:5], np.where(good == good[0, 0], np.nan, good), np.array("text"), np.zeros((9, 17))):
        np.save(path, bad)
        with pytest.raises(InputError, match="poses_bounds"):
            load_dataset(tmp_path)
    np.save(path, good)
    for data in (b"", path.read_bytes()[:-9]):
        path.write_bytes(data)
        with pytest.raises(InputError, match="poses_bounds"):
            load_dataset(tmp_path)


@pytest.mark.parametrize(("change", "message"), [
    ({"frames": []}, "frames"), ({"frames": 3}, "frames"), ({"fl_x": "wide"}, "'wide'"), ({"fl_x": -1}, "-1"),
    ({"k1": "strong"}, "'strong'"), ({"k4": 0.1}, "k4 = 0.1"), ({"k1": -30}, "view_00.*k1 -30"),
    ({"camera_model": "OPENCV_FISHEYE"}, "fisheye"), ({"fl_x": float("nan")}, "nan"),
])
def test_broken_transforms(tmp_path, change, message):
    write_set("nerfstudio", tmp_path)
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=message):
        load_dataset(path)


@pytest.mark.parametrize("matrix", [
    None, [[1, 2], [3, 4]], "eye", np.diag([1, 1, -1, 1]).tolist(), np.diag([2, 2, 2, 1]).tolist(),
])
def test_broken_transform_matrix(tmp_path, matrix):
    write_set("blender", tmp_path)
    path = tmp_path / "transforms_train.json"
    meta = json.loads(path.read_text())
    meta["frames"][0]["transform_matrix"] = matrix
    path.write_text(json.dumps(meta))
    with pytest.raises(InputError, match="transform_matrix"):
        load_dataset(tmp_path)


def test_a_missing_photograph_is_named(tmp_path):
    write_set("nerfstudio", tmp_path)
    (tmp_path / "images" / "view_03.png").unlink()
    with pytest.raises(InputError, match=r"view_03\.png"):
        load_dataset(tmp_path)


def test_broken_photographs(tmp_path):
    write_set("nerfstudio", tmp_path)
    data = load_dataset(tmp_path)
    data.images[0].write_bytes(b"not an image")
    Image.new("RGB", (3, 3)).save(data.images[1])
    with pytest.raises(InputError, match="readable"):
        data.photograph(0)
    with pytest.raises(InputError, match="3x3"):
        data.photograph(1)


def test_transparent_photographs_lie_on_black(tmp_path):
    write_set("blender", tmp_path)
    data = load_dataset(tmp_path)
    Image.new("RGBA", (WIDTH, HEIGHT), (255, 0, 0, 51)).save(data.images[0])
    np.testing.assert_allclose(data.photograph(0)[0, 0], [0.2, 0, 0], atol=1e-6)


@pytest.mark.parametrize("spoil", [lambda d: d[:-1], lambda d: d[:30], lambda d: b"", lambda d: b"\xff" * 8 + d[8:]])
def test_broken_points(tmp_path, spoil):
    write_set("llff", tmp_path)
    path = tmp_path / "sparse" / "0" / "points3D.bin"
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(InputError, match="points3D"):
        read_points(path)


def test_colmap_says_how_far_keypoints_are_from_their_points(tmp_path):
    pytest.importorskip("pycolmap")
    cameras, points = write_set("colmap", tmp_path)
    path, off = tmp_path / "sparse" / "0" / "images.txt", [0.25 * i for i in range(VIEWS)]
    lines = path.read_text().splitlines()
    for k, i in enumerate(range(VIEWS - 1, -1, -1)):  # the file goes backwards
        local = points @ cameras[i].rotation.T + cameras[i].translation
        keypoints = local[:, :2] / local[:, 2:] * (cameras[i].fx, cameras[i].fy) + (cameras[i].cx, cameras[i].cy)
        keypoints[:, 0] += off[i] * np.where(np.arange(len(points)) % 2, 1, -1)
        lines[2 * k + 1] = " ".join(f"{x!r} {y!r} {n + 1}" for n, (x, y) in enumerate(keypoints.tolist())) if i != 2 else ""
    path.write_text("\n".join(lines) + "\n")
    error = load_dataset(tmp_path).pose_error
    assert np.isnan(error[2])
    assert np.delete(error, 2) == pytest.approx(np.delete(off, 2), abs=1e-6)


def test_broken_or_distorted_colmap(tmp_path):
    pytest.importorskip("pycolmap")
    write_set("colmap", tmp_path)
    path = tmp_path / "sparse" / "0" / "cameras.txt"
    c = little_scene()[0][0]
    path.write_text(f"1 SIMPLE_RADIAL_FISHEYE {WIDTH} {HEIGHT} {c.fx} {c.cx} {c.cy} 0.1\n")
    with pytest.raises(InputError, match=r"view_00\.png is SIMPLE_RADIAL_FISHEYE; SIMPLE_PINHOLE, .*colmap image_undistorter"):
        load_dataset(tmp_path)
    path.write_text(f"1 SIMPLE_RADIAL {WIDTH} {HEIGHT} {c.fx} {c.cx} {c.cy} 0\n")
    assert load_dataset(tmp_path).cameras[0].fy == pytest.approx(c.fx)
    path.unlink()
    with pytest.raises(InputError, match="sparse"):
        load_dataset(tmp_path)


def test_without_the_extra(tmp_path, monkeypatch):
    write_set("colmap", tmp_path)
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(InputError, match="'models'"):
        load_dataset(tmp_path)


def test_paths_that_are_no_set(tmp_path):
    (tmp_path / "a.txt").write_text("hello")
    for path in (tmp_path, tmp_path / "absent", tmp_path / "a.txt"):
        with pytest.raises(InputError, match=path.name):
            load_dataset(path)
