"""Files that lie, never end or explode: every loader ends with a clear error, in little time and memory."""

from __future__ import annotations

import gzip
import json
import os
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from golden.host.quantise import quantise_model
from golden.host.registers import frame_registers
from golden.scenes import limited
from golden.scenes.camera import Camera, checked
from golden.scenes.camera_file import camera_text, load_camera
from golden.scenes.dataset import Dataset, image_size
from golden.scenes.datasets import load_dataset
from golden.scenes.expansion import VARIABLE, check_expansion, check_gzip, expansion
from golden.scenes.files import only_inside, read_any_json, read_bytes
from golden.scenes.gaze import Display, no_foveation
from golden.scenes.load import load_model, load_scene
from golden.scenes.orbit import orbit_camera
from golden.scenes.transforms import load_inria_cameras
from spec.config import TINY
from spec.errors import InputError
from tests.helpers.scenes_samples import ply_columns, write_ply
from tests.helpers.sog_samples import sog

CAMERA = Camera(np.eye(3), np.zeros(3), 50.0, 50.0, 32.0, 24.0, 64, 48)


def sleep_for_ever(path: Path) -> None:
    while True:
        path.exists()


def take_memory(path: Path) -> int:
    return len(bytearray(1 << 42))


def die(path: Path) -> None:
    os.abort()


def say(path: Path) -> str:
    return f"read {path.name}"


# A reader in a process of its own


def test_a_limited_reader_returns_what_the_function_returns(tmp_path):
    assert limited.read(f"{__name__}:say", tmp_path / "a", 10) == "read a"


@pytest.mark.parametrize(("function", "message"), [("sleep_for_ever", "CPU time"), ("die", "died"), ("take_memory", "memory")])
def test_a_limited_reader_ends(tmp_path, monkeypatch, function, message):
    monkeypatch.setattr(limited, "SECONDS", 1)
    with pytest.raises(InputError, match=message):
        limited.read(f"{__name__}:{function}", tmp_path / "a", 10)


# COLMAP


@pytest.mark.parametrize(("table", "data", "message"), [
    ("images", b"", "empty"), ("images", b"123", "truncated"), ("cameras", struct.pack("<Q", 1 << 40), "1099511627776 rows"),
    ("points3D", struct.pack("<Q", 2) + bytes(60), "2 rows of at least 51"),
])
def test_colmap_tables_that_lie(tmp_path, table, data, message):
    pytest.importorskip("pycolmap")
    model = tmp_path / "sparse" / "0"
    model.mkdir(parents=True)
    for name in ("cameras", "images", "points3D"):
        (model / f"{name}.bin").write_bytes(data if name == table else struct.pack("<Q", 0))
    with pytest.raises(InputError, match=message):
        load_dataset(tmp_path)


def colmap_text(folder: Path, observation: str) -> None:
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text("1 PINHOLE 64 48 50 50 32 24\n")
    (model / "images.txt").write_text(f"1 1 0 0 0 0 0 0 1 a.png\n{observation}\n")
    (model / "points3D.txt").write_text("7 0 0 3 255 0 0 0.1 1 0\n")


def test_a_colmap_image_may_not_name_a_missing_point(tmp_path):
    pytest.importorskip("pycolmap")
    colmap_text(tmp_path / "good", "32 24 7")
    assert load_dataset(tmp_path / "good").pose_error[0] == pytest.approx(0.0)
    colmap_text(tmp_path / "bad", "32 24 99")
    with pytest.raises(InputError, match="COLMAP model"):
        load_dataset(tmp_path / "bad")


# Compressed models


def test_a_gzip_bomb_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    data = gzip.compress(struct.pack("<4sI", b"NGSP", 2) + bytes(200 << 20))
    assert len(data) < 1 << 20
    (tmp_path / "a.spz").write_bytes(data)
    with pytest.raises(InputError, match=r"would become .*MSV2_EXPANSION"):
        load_model(tmp_path / "a.spz")
    monkeypatch.setenv(VARIABLE, "100000")
    check_gzip(tmp_path / "a.spz", data)


def test_bytes_behind_a_gzip_and_early_ends_are_refused():
    data = gzip.compress(b"abc")
    check_gzip(Path("a"), data)
    for spoilt, message in ((data + b"x", "1 bytes follow"), (data[:-9], "whole"), (data[:3], "whole")):
        with pytest.raises(InputError, match=message):
            check_gzip(Path("a"), spoilt)


def test_an_spz_that_announces_too_many_splats_is_refused(tmp_path):
    head = struct.pack("<4sII", b"NGSP", 2, 1 << 30)
    (tmp_path / "a.spz").write_bytes(gzip.compress(head + bytes(64)))
    with pytest.raises(InputError, match="would become"):
        load_model(tmp_path / "a.spz")


def png_header(width: int, height: int) -> bytes:
    """A PNG with the header of a picture of that size, and nearly no data."""
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(b"\0" * 100)))


def test_a_sog_bundle_whose_members_name_is_no_text_is_refused(tmp_path):
    """The directory at the end of a zip file repeats the names; the one before the member has the flag of UTF-8."""
    path = tmp_path / "a.sog"
    with zipfile.ZipFile(path, "w") as bundle:
        for member, content in sog(2)[0].items():
            bundle.writestr(f"\u00e9{member}", content)
    data = path.read_bytes()
    path.write_bytes(data.replace("\u00e9".encode(), b"\xc3\xff", 1))
    with pytest.raises(InputError, match=r"a\.sog: is not a whole SOG bundle"):
        load_model(path)


def test_sog_bundles_that_explode_are_refused(tmp_path):
    parts = sog(2)[0]
    for name, extra in (("zip", {"more.bin": bytes(100 << 20)}), ("image", {"more.webp": png_header(30000, 30000)})):
        with zipfile.ZipFile(tmp_path / f"{name}.sog", "w", zipfile.ZIP_DEFLATED) as bundle:
            for part, data in (parts | extra).items():
                bundle.writestr(part, data)
        with pytest.raises(InputError, match="would become"):
            load_model(tmp_path / f"{name}.sog")


@pytest.mark.parametrize("value", ["0", "-1", "1e3", "", "9" * 400, "\u00b2"])
def test_the_budgets_variable_must_be_a_number(monkeypatch, value):
    monkeypatch.setenv(VARIABLE, value)
    with pytest.raises(InputError, match=VARIABLE):
        expansion()


def test_small_files_may_grow_to_the_floor():
    check_expansion(Path("a"), 1, 64 << 20)
    with pytest.raises(InputError):
        check_expansion(Path("a"), 1, (64 << 20) + 1)


# Photographs, JSON, and what is no file


def test_a_png_header_of_billions_of_pixels_is_no_photograph(tmp_path):
    (tmp_path / "a.png").write_bytes(png_header(60000, 60000))
    with pytest.raises(InputError, match="readable photograph"):
        image_size(tmp_path / "a.png")


def test_a_photograph_that_needs_more_memory_than_there_is_is_unreadable(tmp_path, monkeypatch):
    """Pillow asks for as many bytes as a damaged part of a PNG announces, which is up to two gigabytes."""
    def refused(image, mode):
        raise MemoryError

    Image.new("RGB", (CAMERA.width, CAMERA.height)).save(tmp_path / "a.png")
    none = np.empty((0, 3))
    data = Dataset((CAMERA,), (tmp_path / "a.png",), none, none.astype(np.uint8), np.array([0.0, 1.0, 0.0]), "a")
    assert data.pixels(0).shape == (CAMERA.height, CAMERA.width, 4)
    monkeypatch.setattr(Image.Image, "convert", refused)
    with pytest.raises(InputError, match="readable photograph"):
        data.pixels(0)


def test_pipes_and_devices_are_not_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.png")
    for path in (tmp_path / "pipe.png", Path("/dev/zero")):
        with pytest.raises(InputError, match="regular file"):
            read_bytes(path)
        with pytest.raises(InputError, match="regular file"):
            image_size(path)


def test_names_that_no_file_can_have_are_errors():
    for path in (Path("x" * 6000), Path("a\0b")):
        with pytest.raises(InputError):
            read_bytes(path)


def test_json_that_is_nested_too_deeply(tmp_path):
    (tmp_path / "a.json").write_text("[" * 200_000)
    with pytest.raises(InputError, match="nested"):
        read_any_json(tmp_path / "a.json")


@pytest.mark.parametrize(("key", "value"), [
    ("file_path", "x" * 6000), ("ply_file_path", 3), ("ply_file_path", "x" * 6000), ("fl_x", 10**400), ("w", 10**400),
    ("cx", True), ("transform_matrix", [[10**400] * 4] * 4), ("camera_angle_x", 0), ("mask_path", "\0"),
])
def test_transforms_of_a_vandal(tmp_path, key, value):
    frame = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist(), "fl_x": 50.0, "w": 64, "h": 48}
    if key == "camera_angle_x":
        del frame["fl_x"]
    meta = {"frames": [frame | ({} if key == "ply_file_path" else {key: value})]}
    if key == "ply_file_path":
        meta[key] = value
    (tmp_path / "transforms.json").write_text(json.dumps(meta))
    try:
        data = load_dataset(tmp_path)
    except InputError:
        return
    assert key in ("file_path", "mask_path") and data.images is None, "a name without a file means a set without photographs"


# Cameras


@pytest.mark.parametrize("change", [
    {"width": 0}, {"height": -3}, {"width": 1 << 20}, {"fx": -50.0}, {"fy": 0.0}, {"fx": float("nan")}, {"cx": float("inf")},
    {"near": 0.0}, {"rotation": np.zeros((3, 3))}, {"rotation": -np.eye(3)}, {"rotation": 2 * np.eye(3)},
    {"translation": np.array([0.0, np.nan, 0.0])}, {"rotation": np.eye(2)},
])
def test_impossible_cameras_are_refused(change):
    assert checked(CAMERA, "a") is CAMERA
    with pytest.raises(InputError, match="where it is"):
        checked(Camera(**(vars(CAMERA) | change)), "where it is")


@pytest.mark.parametrize("change", [
    {"fx": float("nan")}, {"fx": -1}, {"width": 0}, {"position": [float("inf"), 0, 0]}, {"rotation": [[0, 0, 0]] * 3},
    {"fx": "x"}, {"fx": 10**400}, {"width": float("nan")}, {"rotation": None},
])
def test_cameras_json_of_a_vandal(tmp_path, change):
    entry = {"id": 0, "width": 64, "height": 48, "position": [0, 0, 0], "rotation": np.eye(3).tolist(), "fx": 50.0, "fy": 50.0}
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps([entry]))
    assert load_inria_cameras(path)[0].width == 64
    path.write_text(json.dumps([entry | change]))
    with pytest.raises(InputError, match=r"cameras\.json"):
        load_inria_cameras(path)


@pytest.mark.parametrize(("good", "bad"), [
    ('"fx": 50.0', '"fx": 1' + "0" * 400), ('"fx": 50.0', '"fx": 1' + "0" * 5000), ('"near": 0.2', '"near": 1e999'),
    ("[\n   1.0,", "[\n   1" + "0" * 400 + ","),
])
def test_a_camera_file_of_a_vandal(tmp_path, good, bad):
    text = camera_text(CAMERA)
    assert good in text
    (tmp_path / "a.json").write_text(text.replace(good, bad))
    with pytest.raises(InputError, match=r"a\.json"):
        load_camera(tmp_path / "a.json")


def test_points_at_the_end_of_float32_are_rendered(tmp_path):
    columns = {name: values * np.float32(1e38 if name in "xyz" else 1) for name, values in ply_columns(20).items()}
    scene = load_scene(write_ply(tmp_path / "a.ply", columns))
    camera = orbit_camera(scene.model, 0, 1, 64, 64)
    flat = no_foveation(Display(64, 64))
    registers = frame_registers(TINY, camera, quantise_model(TINY, scene.model), flat, np.zeros(3))
    assert 0 < registers.depth_scale < 1e-37 and np.isfinite(registers.depth_far)


# Files outside a scene's folder


@pytest.mark.parametrize("name", ["../secret.png", "{outside}/secret.png", "link.png"])
def test_files_outside_the_folder_are_refused_where_that_is_asked(tmp_path, name):
    inside = tmp_path / "scene"
    inside.mkdir()
    for folder in (tmp_path, inside):
        Image.new("RGB", (64, 48)).save(folder / ("secret.png" if folder == tmp_path else "a.png"))
    (inside / "link.png").symlink_to(tmp_path / "secret.png")

    def written(image: str) -> Path:
        frame = {"file_path": image, "transform_matrix": np.eye(4).tolist(), "fl_x": 50.0, "w": 64, "h": 48}
        (inside / "transforms.json").write_text(json.dumps({"frames": [frame]}))
        return inside

    with only_inside(inside):
        assert load_dataset(written("a.png")).images is not None
        with pytest.raises(InputError, match="--no-outside"):
            load_dataset(written(name.format(outside=tmp_path)))
        with pytest.raises(InputError, match="--no-outside"):
            read_bytes(tmp_path / "secret.png")
    assert load_dataset(written(name.format(outside=tmp_path))).images is not None
