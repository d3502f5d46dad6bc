""".splat, compressed PLY, SPZ and SOG against plain numpy readers, written here from the formats' own descriptions."""

import gzip
import json
import struct
import sys
import zipfile

import numpy as np
import pytest

from golden.scenes.load import load_model, load_scene
from spec.errors import InputError
from tests.helpers.scenes_samples import float32_model, ply_columns, write_ply
from tests.helpers.sog_samples import smallest_three, sog, webp, write_folder

C0 = 0.28209479177387814
RNG = np.random.default_rng(7)


def check(model, *, means, log_scales, quats, opacity, dc, rest=None):
    np.testing.assert_allclose(model.means, means, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(model.log_scales, log_scales, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(model.quats, quats, atol=1e-5)
    np.testing.assert_allclose(model.opacity[:, 0], opacity, atol=1e-4)  # gsply clips logits at +-10 to +-13.8
    np.testing.assert_allclose(model.sh_dc[:, 0], dc, rtol=1e-5, atol=1e-5)
    if rest is not None:
        np.testing.assert_allclose(model.sh_rest, rest, rtol=1e-5, atol=1e-6)


# .splat


def splat_bytes(n=6):
    rows = np.zeros(n, [("p", "<f4", 3), ("s", "<f4", 3), ("c", "u1", 4), ("q", "u1", 4)])
    rows["p"], rows["s"] = RNG.normal(size=(n, 3)), np.exp(RNG.normal(size=(n, 3)) - 4)
    rows["c"], rows["q"] = RNG.integers(0, 256, (n, 4)), RNG.integers(0, 256, (n, 4))
    return rows


def test_splat(tmp_path):
    rows = splat_bytes()
    rows["s"][0, 1] = 0
    rows["c"][:2, 3] = 0, 255
    (tmp_path / "a.splat").write_bytes(rows.tobytes())
    model = load_model(tmp_path / "a.splat")
    assert model.opacity[0, 0] == 0 and model.opacity[1, 0] == 1 and model.log_scales[0, 1] == -np.inf
    with np.errstate(divide="ignore"):
        check(model, means=rows["p"], log_scales=np.log(rows["s"].astype(float)), quats=(rows["q"] / 1.0 - 128) / 128,
              opacity=rows["c"][:, 3] / 255, dc=(rows["c"][:, :3] / 255 - 0.5) / C0)
    np.testing.assert_array_equal(model.up, [0, -1, 0])


def test_splat_drops_what_cannot_be_drawn(tmp_path):
    rows = splat_bytes(9)
    rows["p"][0, 0], rows["s"][1, 0], rows["s"][2, 0], rows["q"][3] = np.nan, np.inf, -1, 128
    (tmp_path / "a.splat").write_bytes(rows.tobytes())
    assert load_model(tmp_path / "a.splat").dropped == {
        "nan position": 1, "nan scale": 1, "infinite scale": 1, "zero rotation": 1}


@pytest.mark.parametrize("data", [b"", b"x" * 33, splat_bytes().tobytes()[:-1], RNG.normal(size=400).astype("<f4").tobytes()])
def test_splat_that_is_none(tmp_path, data):
    (tmp_path / "a.splat").write_bytes(data)
    with pytest.raises(InputError, match=r"a\.splat"):
        load_model(tmp_path / "a.splat")


# compressed PLY


def compressed_ply(path, n=300, degree=1):
    """A compressed PLY of random words, and what they mean."""
    chunks = -(-n // 256)
    bounds = np.sort(RNG.normal(size=(chunks, 6, 3, 2)), axis=-1).astype("<f4")[:, :3]  # chunk, group, axis, min and max
    words = RNG.integers(0, 2**32, (n, 4), dtype=np.uint64).astype("<u4")
    sh = RNG.integers(0, 256, (n, 3 * ((degree + 1) ** 2 - 1)), dtype=np.uint8)
    groups = ("", "scale_", "")
    names = [f"{edge}_{group}{axis}" for g, group in enumerate(groups) for edge in ("min", "max")
             for axis in ("rgb" if g == 2 else "xyz")]
    header = f"ply\nformat binary_little_endian 1.0\nelement chunk {chunks}\n" + "".join(f"property float {x}\n" for x in names)
    packed = ("position", "rotation", "scale", "color")
    header += f"element vertex {n}\n" + "".join(f"property uint packed_{x}\n" for x in packed)
    header += f"element sh {n}\n" + "".join(f"property uchar f_rest_{i}\n" for i in range(sh.shape[1])) + "end_header\n"
    body = bounds.transpose(0, 1, 3, 2).tobytes() + words.tobytes() + sh.tobytes()
    path.write_bytes(header.encode() + body)

    def between(group, unit):
        low, high = bounds[np.arange(n) // 256, group].astype(float).transpose(2, 0, 1)
        return low + unit * (high - low)

    def bits(word, *widths):
        shifts = 32 - np.cumsum(widths)
        return np.stack([(words[:, word] >> s & (2**w - 1)) / (2**w - 1) for s, w in zip(shifts, widths, strict=True)], axis=1)

    colour = bits(3, 8, 8, 8, 8)
    want = {
        "means": between(0, bits(0, 11, 10, 11)), "log_scales": between(1, bits(2, 11, 10, 11)),
        "quats": smallest_three(words[:, 1] >> 30, (bits(1, 2, 10, 10, 10)[:, 1:] - 0.5) * np.sqrt(2)),
        "opacity": colour[:, 3], "dc": (between(2, colour[:, :3]) - 0.5) / C0,
        "rest": (sh.reshape(n, 3, -1).transpose(0, 2, 1) - 127.5) / 32,
    }
    return path, want


def test_compressed_ply(tmp_path):
    pytest.importorskip("gsply")
    path, want = compressed_ply(tmp_path / "a.compressed.ply")
    model = load_model(path)
    assert model.name == "a"
    check(model, **want)


@pytest.mark.parametrize("spoil", [lambda d: d[:-1], lambda d: d[:700], lambda d: d.replace(b"chunk 2", b"chunk 1")])
def test_broken_compressed_ply(tmp_path, spoil):
    path, _ = compressed_ply(tmp_path / "a.ply")
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(InputError, match=r"a\.ply"):
        load_model(path)


# SPZ


def spz(path, version=3, n=5, degree=2, fraction=12):
    """An SPZ file of random bytes, and what they mean."""
    coefficients = (degree + 1) ** 2 - 1
    fixed = RNG.integers(-(2**23), 2**23, (n, 3))
    alpha, colour, scale = (RNG.integers(0, 256, (n, k), dtype=np.uint8) for k in (1, 3, 3))
    if version == 3:
        rotation = RNG.integers(0, 2**32, n, dtype=np.uint64).astype("<u4")
    else:
        rotation = RNG.integers(64, 192, (n, 3), np.uint8)
    sh = RNG.integers(0, 256, (n, coefficients, 3), dtype=np.uint8)
    positions = (fixed & 0xFFFFFF).astype("<u4").reshape(-1, 1).view(np.uint8)[:, :3]
    header = struct.pack("<4sIIBBBB", b"NGSP", version, n, degree, fraction, 0, 0)
    body = b"".join(x.tobytes() for x in (positions, alpha, colour, scale, rotation, sh))
    path.write_bytes(gzip.compress(header + body))
    if version == 3:  # xyzw; the largest in the top bits, then the others from the first down, sign and 9 bits each
        fields = np.stack([rotation >> shift & 0x3FF for shift in (20, 10, 0)], axis=1).astype(int)
        xyzw = smallest_three(rotation >> 30, np.where(fields & 512, -1, 1) * (fields & 511) / 511 / np.sqrt(2))
    else:
        xyz = rotation / 127.5 - 1
        xyzw = np.column_stack([xyz, np.sqrt(np.maximum(0, 1 - (xyz**2).sum(axis=1)))])
    want = {
        "means": fixed / 2**fraction, "log_scales": scale / 16 - 10, "quats": xyzw[:, [3, 0, 1, 2]],
        "opacity": alpha[:, 0] / 255, "dc": (colour / 255 - 0.5) / 0.15, "rest": (sh - 128.0) / 128,
    }
    return path, want


@pytest.mark.parametrize("version", [2, 3])
def test_spz(tmp_path, version):
    pytest.importorskip("gsply")
    path, want = spz(tmp_path / "a.spz", version)
    model = load_model(path)
    check(model, **want)
    np.testing.assert_array_equal(model.up, [0, 1, 0])


@pytest.mark.parametrize(("spoil", "message"), [
    (lambda d: d[: len(d) // 2], "whole"), (lambda d: gzip.compress(gzip.decompress(d)[:-1]), "too small"),
    (lambda d: d[:3], "whole"),
    (lambda d: gzip.compress(b"NGSP\x01" + gzip.decompress(d)[5:]), "version 1"), (lambda d: gzip.compress(b"x" * 99), "xxxx"),
    (lambda d: b"x" * 99, "xxxx"),
])
def test_broken_spz(tmp_path, spoil, message):
    pytest.importorskip("gsply")
    path, _ = spz(tmp_path / "a.spz")
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(InputError, match=message) as caught:
        load_model(path)
    assert "a.spz" in str(caught.value)


# SOG


@pytest.mark.parametrize("version", [1, 2])
def test_sog(tmp_path, version):
    pytest.importorskip("imagecodecs")
    parts, want = sog(version)
    folder = write_folder(tmp_path / "scene", parts)
    with zipfile.ZipFile(tmp_path / "scene.sog", "w") as bundle:
        for name, data in parts.items():
            bundle.writestr(name, data)
    for path in (folder, folder / "meta.json", tmp_path / "scene.sog"):
        model = load_model(path)
        assert (model.name, model.sh_degree) == ("scene", 1)
        check(model, **want)


def test_a_folder_of_sog_folders_is_one_scene_in_name_order(tmp_path):
    pytest.importorskip("imagecodecs")
    (first, a), (second, b) = sog(2, n=11), sog(2, n=40)
    write_folder(tmp_path / "big" / "2_1", second)
    write_folder(tmp_path / "big" / "2_0", first)
    check(load_model(tmp_path / "big"), **{key: np.concatenate([a[key], b[key]]) for key in a})


def test_parts_must_match(tmp_path):
    pytest.importorskip("imagecodecs")
    write_folder(tmp_path / "a", sog(1, bands=1)[0])
    write_folder(tmp_path / "b", sog(1, bands=2)[0])
    with pytest.raises(InputError, match=r"sh_degree \[1, 2\]"):
        load_model(tmp_path)


@pytest.mark.parametrize(("name", "data"), [
    ("meta.json", b""), ("meta.json", b"{"), ("meta.json", b"{}"), ("meta.json", b"[1]"), ("l.webp", b"RIFF"), ("q.webp", None),
    ("s.webp", webp(np.zeros((4, 4), np.uint8), 2)),
])
def test_broken_sog(tmp_path, name, data):
    pytest.importorskip("imagecodecs")
    folder = write_folder(tmp_path / "scene", sog(2)[0])
    (folder / name).unlink()
    if data is not None:
        (folder / name).write_bytes(data)
    with pytest.raises(InputError, match="scene"):
        load_model(folder)


# Which reader


@pytest.mark.parametrize("make", [lambda p: spz(p / "a.spz")[0], lambda p: write_folder(p / "sog", sog(2)[0])])
def test_without_the_extra(tmp_path, monkeypatch, make):
    path = make(tmp_path)
    monkeypatch.setitem(sys.modules, "gsply", None)
    with pytest.raises(InputError, match="'models'"):
        load_model(path)


def test_embedded_is_a_name(monkeypatch):
    from golden.scenes.embedded import scene as embedded

    model = float32_model()
    monkeypatch.setattr(embedded, "cached_embedded_model", lambda: model)
    scene = load_scene("embedded")
    assert scene.model is model and len(scene.cameras) > 0


def test_content_wins_over_extension(tmp_path):
    path = write_ply(tmp_path / "a.ply", ply_columns())
    want = load_model(path)
    path.rename(tmp_path / "b.splat")
    np.testing.assert_array_equal(load_model(tmp_path / "b.splat").means, want.means)


def test_paths_that_are_no_model(tmp_path):
    (tmp_path / "text.txt").write_text("hello")
    (tmp_path / "empty.bin").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    messages = {"absent.ply": "does not exist", "text.txt": "hello", "empty.bin": "empty", "folder": "0 model files"}
    for name, message in messages.items():
        with pytest.raises(InputError, match=message) as caught:
            load_scene(tmp_path / name)
        assert name in str(caught.value)


def test_training_folder_gives_the_last_iteration_and_its_cameras(tmp_path):
    for iteration, n in ((7000, 3), (30000, 4)):
        folder = tmp_path / "point_cloud" / f"iteration_{iteration}"
        folder.mkdir(parents=True)
        write_ply(folder / "point_cloud.ply", ply_columns(n))
    camera = {"id": 0, "img_name": "00001", "width": 640, "height": 480, "fx": 500.0, "fy": 510.0, "position": [1, 2, 3],
              "rotation": [[0, 0, 1], [1, 0, 0], [0, 1, 0]]}  # its columns are the camera's axes in the world: x forward
    (tmp_path / "cameras.json").write_text(json.dumps([camera]))
    scene = load_scene(tmp_path)
    assert len(scene.model) == 4 and scene.model.name == tmp_path.name
    np.testing.assert_allclose(scene.cameras[0].position, [1, 2, 3])
    np.testing.assert_allclose(scene.cameras[0].rotation[2], [1, 0, 0])
    early = load_scene(tmp_path / "point_cloud" / "iteration_7000" / "point_cloud.ply")
    assert len(early.model) == 3 and early.cameras[0].name == "00001"
