"""Good files of every format that the project reads, small, and how each is read."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from golden.host.quantise import quantise_model
from golden.host.registers import frame_registers
from golden.scenes.camera import Camera
from golden.scenes.camera_file import camera_text, file_gaze, load_camera
from golden.scenes.datasets import cameras_beside_model, load_dataset
from golden.scenes.gaze import Display, no_foveation
from golden.scenes.load import load_model
from golden.scenes.masks import read_mask
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import orbit_camera
from golden.scenes.save import save_model
from golden.scenes.splat import ROW
from golden.scenes.transforms import save_inria_cameras
from spec.config import TINY, TINY_V3

SPLATS, SIZE = 40, (8, 6)
"""Splats of a model, and the frame of a camera."""


@dataclass(frozen=True)
class Format:
    """A format.

    Attributes:
        files: the content of a good sample's files by name.
        read: reads the sample in a folder, as the project's commands do.
        share: how many of its cases are run for one of the others'; reading it may take a process of its own.
        needs: packages without which it cannot be read.
    """

    files: Callable[[], Mapping[str, bytes]]
    read: Callable[[Path], object]
    share: float = 1.0
    needs: tuple[str, ...] = ()


def _model(levels: int = 1, degree: int = 1, seed: int = 3) -> GaussianModel:
    rng = np.random.default_rng(seed)

    def normal(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(np.float32).astype(np.float64)

    return GaussianModel(
        means=normal(SPLATS, 3), log_scales=normal(SPLATS, 3) - 3, quats=normal(SPLATS, 4),
        opacity=rng.uniform(0.1, 1, (SPLATS, levels)), sh_dc=normal(SPLATS, levels, 3),
        sh_rest=0.1 * normal(SPLATS, (degree + 1) ** 2 - 1, 3), quality_bound=rng.integers(1, levels + 1, SPLATS),
        name="sample", up=np.array([0.0, 1.0, 0.0]), up_source="given")


def _camera(name: str = "a.png") -> Camera:
    return Camera(np.eye(3), np.array([0.0, 0.0, 4.0]), 9.0, 9.0, SIZE[0] / 2, SIZE[1] / 2, *SIZE, name=name)


def _written(write: Callable[[Path], object], suffix: str) -> bytes:
    """What a function writes to a path."""
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as folder:
        path = Path(folder) / f"sample{suffix}"
        write(path)
        return path.read_bytes()


def _png(seed: int = 0, mode: str = "RGB") -> bytes:
    values = np.random.default_rng(seed).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    out = io.BytesIO()
    Image.fromarray(values).convert(mode).save(out, "PNG")
    return out.getvalue()


def _ascii_ply() -> bytes:
    """A PLY of text, which some tools write."""
    binary = _written(lambda path: save_model(_model(), path), ".ply")
    head, _, body = binary.partition(b"end_header\n")
    names = [line.split()[2] for line in head.splitlines() if line.startswith(b"property")]
    rows = np.frombuffer(body, "<f4").reshape(-1, len(names))
    text = "\n".join(" ".join(f"{value:.6g}" for value in row) for row in rows)
    return head.replace(b"binary_little_endian", b"ascii") + b"end_header\n" + text.encode() + b"\n"


def _gsply_data() -> object:
    from gsply import GSData

    model = _model()
    single = {name: np.ascontiguousarray(value, np.float32) for name, value in (
        ("means", model.means), ("scales", model.log_scales), ("quats", model.quats),
        ("opacities", np.log(model.opacity[:, 0] / (1.001 - model.opacity[:, 0]))), ("sh0", model.sh_dc[:, 0]),
        ("shN", model.sh_rest))}
    return GSData(**single)


def _compressed_ply() -> bytes:
    import gsply

    return _written(lambda path: gsply.plywrite(path, _gsply_data(), compressed=True), ".compressed.ply")


def _spz(version: int) -> bytes:
    import gsply

    return _written(lambda path: gsply.write_spz(path, _gsply_data(), version=version), ".spz")


def _splat() -> bytes:
    rng, rows = np.random.default_rng(5), np.zeros(SPLATS, ROW)
    rows["position"], rows["scale"] = rng.normal(size=(SPLATS, 3)), rng.uniform(0.01, 0.1, (SPLATS, 3))
    rows["rgba"], rows["quat"] = rng.integers(1, 256, (2, SPLATS, 4))
    return rows.tobytes()


def _webp(values: np.ndarray) -> bytes:
    """(N, 3 or 4) bytes as a lossless picture, 8 wide."""
    pixels = np.zeros((-(-len(values) // 8) * 8, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(values), : values.shape[1]] = values
    out = io.BytesIO()
    Image.fromarray(pixels.reshape(-1, 8, 4)).save(out, "WEBP", lossless=True, exact=True)
    return out.getvalue()


def _sog_parts() -> dict[str, bytes]:
    """A SOG of version 2 without harmonics."""
    rng = np.random.default_rng(6)
    quats, colours = rng.integers(0, 256, (SPLATS, 4)), rng.integers(1, 256, (SPLATS, 4))
    quats[:, 3] = 252 + quats[:, 3] % 4
    table = np.linspace(-9.0, 1.0, 256).tolist()
    meta = {"version": 2, "count": SPLATS, "means": {"mins": [-2, -1, 0], "maxs": [2, 1, 3], "files": ["l.webp", "u.webp"]},
            "scales": {"codebook": table, "files": ["s.webp"]}, "quats": {"files": ["q.webp"]},
            "sh0": {"codebook": np.linspace(-2.0, 2.0, 256).tolist(), "files": ["c.webp"]}}
    bytes_ = rng.integers(0, 256, (3, SPLATS, 3))
    return {"meta.json": json.dumps(meta).encode(), "l.webp": _webp(bytes_[0]), "u.webp": _webp(bytes_[1]),
            "s.webp": _webp(bytes_[2]), "q.webp": _webp(quats), "c.webp": _webp(colours)}


def _sog_bundle() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as bundle:
        for name, data in _sog_parts().items():
            bundle.writestr(zipfile.ZipInfo(name), data)
    return out.getvalue()


def _streamed() -> dict[str, bytes]:
    lods = {"0": {"file": 0, "offset": 0, "count": SPLATS}, "1": {"file": 0, "offset": 1, "count": 3}}
    index = {"lodLevels": 2, "environment": None, "filenames": ["part/meta.json"], "tree": {"bound": {}, "lods": lods}}
    return {"lod-meta.json": json.dumps(index).encode(), **{f"part/{name}": data for name, data in _sog_parts().items()}}


def _transforms() -> dict[str, bytes]:
    frames = [{"file_path": f"images/{name}.png", "transform_matrix": np.eye(4).tolist(), "mask_path": f"{name}_mask.png"}
              for name in "ab"]
    meta = {"fl_x": 9.0, "fl_y": 9.0, "cx": 4.0, "cy": 3.0, "w": SIZE[0], "h": SIZE[1], "k1": 0.01,
            "ply_file_path": "points.ply", "frames": frames}
    points = b"".join(b"%g %g %g %d %d %d\n" % (x, -x, 2 * x, 9, 99, 200) for x in range(5))
    head = (b"ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
            b"property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n")
    return {"transforms.json": json.dumps(meta).encode(), "points.ply": head + points, "images/a.png": _png(1),
            "images/b.png": _png(2), "a_mask.png": _png(3, "L"), "b_mask.png": _png(4, "L")}


def _llff() -> dict[str, bytes]:
    pose = np.hstack([np.eye(3), np.zeros((3, 1)), [[SIZE[1]], [SIZE[0]], [9.0]]]).ravel()
    out = io.BytesIO()
    np.save(out, np.stack([np.append(pose, (1.0, 9.0))] * 2))
    return {"poses_bounds.npy": out.getvalue(), "images/a.png": _png(1), "images/b.png": _png(2)}


def _npz() -> bytes:
    out = io.BytesIO()
    intrinsics = np.array([[9.0, 0, 4], [0, 9, 3], [0, 0, 1]])
    np.savez(out, means3d=np.zeros((5, 3), np.float32), colors=np.zeros((5, 3), np.uint8), viewmats=np.stack([np.eye(4)] * 2),
             Ks=np.stack([intrinsics] * 2), width=np.array(SIZE[0]), height=np.array(SIZE[1]))
    return out.getvalue()


def _colmap_text() -> dict[str, bytes]:
    return {"sparse/0/cameras.txt": b"1 PINHOLE 8 6 9 9 4 3\n",
            "sparse/0/images.txt": b"1 1 0 0 0 0 0 0 1 a.png\n4 3 7\n2 1 0 0 0 0.1 0 0 1 b.png\n\n",
            "sparse/0/points3D.txt": b"7 0 0 3 255 0 0 0.1 1 0\n", "images/a.png": _png(1), "images/b.png": _png(2)}


def _colmap() -> dict[str, bytes]:
    cameras = struct.pack("<QIiQQ4d", 1, 1, 1, *SIZE, 9.0, 9.0, 4.0, 3.0)
    images = struct.pack("<QI7dI", 2, 1, 1, 0, 0, 0, 0, 0, 0, 1) + b"a.png\0" + struct.pack("<Qddq", 1, 4.0, 3.0, 7)
    images += struct.pack("<I7dI", 2, 1, 0, 0, 0, 0.1, 0, 0, 1) + b"b.png\0" + struct.pack("<Q", 0)
    points = struct.pack("<QQ3d3BdQII", 1, 7, 0, 0, 3, 255, 0, 0, 0.1, 1, 1, 0)
    return {"sparse/0/cameras.bin": cameras, "sparse/0/images.bin": images, "sparse/0/points3D.bin": points,
            "images/a.png": _png(1), "images/b.png": _png(2)}


def _checkpoint() -> Mapping[str, bytes]:
    from msv2.cases.fuzz.checkpoints import checkpoint_files  # needs torch

    return checkpoint_files()


def _read_model(name: str) -> Callable[[Path], object]:
    """Loads a model, and makes words, a camera and registers of it for a machine of each kind of lists."""
    def read(folder: Path) -> object:
        model = load_model(folder / name)
        camera = orbit_camera(model, 0, 8, *SIZE)
        for config in (TINY, TINY_V3):
            words = quantise_model(config, model)
            frame_registers(config, camera, words, no_foveation(Display(*SIZE)), np.zeros(3))
        return model

    return read


def _read_dataset(name: str = ".") -> Callable[[Path], object]:
    """Loads a data set with its photographs and masks."""
    def read(folder: Path) -> object:
        data = load_dataset(folder / name)
        for view in range(len(data.cameras)):
            if data.images is not None:
                data.photograph(view)
            mask = data.masks[view] if data.masks else None
            if mask is not None:
                read_mask(mask, data.cameras[view].width, data.cameras[view].height)
        return data

    return read


def _read_camera(folder: Path) -> object:
    camera = load_camera(folder / "camera.json")
    return camera, file_gaze(folder / "camera.json", camera)


def _read_checkpoint(folder: Path) -> object:
    from msv2.cases.fuzz.checkpoints import read_checkpoint  # needs torch

    return read_checkpoint(folder)


def _one(name: str, make: Callable[[], bytes]) -> Callable[[], Mapping[str, bytes]]:
    return lambda: {name: make()}


def _inria_cameras() -> bytes:
    return _written(lambda path: save_inria_cameras([_camera(), _camera("b.png")], path), ".json")


def _saved(levels: int, degree: int) -> bytes:
    return _written(lambda path: save_model(_model(levels, degree), path), ".ply")


FORMATS: dict[str, Format] = {
    "ply": Format(_one("a.ply", lambda: _saved(1, 3)), _read_model("a.ply")),
    "ply-levels": Format(_one("a.ply", lambda: _saved(4, 1)), _read_model("a.ply")),
    "ply-ascii": Format(_one("a.ply", _ascii_ply), _read_model("a.ply")),
    "ply-compressed": Format(_one("a.ply", _compressed_ply), _read_model("a.ply"), needs=("gsply",)),
    "spz": Format(_one("a.spz", lambda: _spz(3)), _read_model("a.spz"), needs=("gsply",)),
    "spz-4": Format(_one("a.spz", lambda: _spz(4)), _read_model("a.spz"), needs=("gsply", "zstandard")),
    "splat": Format(_one("a.splat", _splat), _read_model("a.splat")),
    "sog": Format(_one("a.sog", _sog_bundle), _read_model("a.sog"), needs=("gsply", "imagecodecs")),
    "sog-folder": Format(_sog_parts, _read_model("."), needs=("gsply", "imagecodecs")),
    "sog-streamed": Format(_streamed, _read_model("."), needs=("gsply", "imagecodecs")),
    "camera": Format(_one("camera.json", lambda: camera_text(_camera(), (3.0, 2.0)).encode()), _read_camera),
    "cameras": Format(_one("cameras.json", _inria_cameras), cameras_beside_model),
    "transforms": Format(_transforms, _read_dataset()),
    "llff": Format(_llff, _read_dataset()),
    "npz": Format(_one("a.npz", _npz), _read_dataset("a.npz")),
    "colmap": Format(_colmap, _read_dataset(), 0.02, ("pycolmap",)),
    "colmap-text": Format(_colmap_text, _read_dataset(), 0.02, ("pycolmap",)),
    "checkpoint": Format(_checkpoint, _read_checkpoint, 0.3, ("torch",)),
}
"""The formats by name."""
