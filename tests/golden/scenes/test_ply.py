"""INRIA PLY in, foveated PLY out."""

import numpy as np
import pytest

from golden.scenes.levels import smfr_levels
from golden.scenes.load import load_model
from golden.scenes.save import save_model
from spec.errors import InputError
from tests.helpers.scenes_samples import float32_model, ply_columns, write_ply

ARRAYS = ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound")


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_every_property_arrives_at_its_place(tmp_path, degree):
    columns = ply_columns(7, degree)
    model = load_model(write_ply(tmp_path / "scene.ply", columns))
    coefficients = (degree + 1) ** 2 - 1
    assert (len(model), model.sh_degree, model.levels, model.name) == (7, degree, 1, "scene")
    for axis in range(3):
        np.testing.assert_array_equal(model.means[:, axis], columns["xyz"[axis]])
        np.testing.assert_array_equal(model.log_scales[:, axis], columns[f"scale_{axis}"])
        np.testing.assert_array_equal(model.sh_dc[:, 0, axis], columns[f"f_dc_{axis}"])
        for k in range(coefficients):  # all of red first, then green, then blue
            np.testing.assert_array_equal(model.sh_rest[:, k, axis], columns[f"f_rest_{axis * coefficients + k}"])
    for i in range(4):
        np.testing.assert_array_equal(model.quats[:, i], columns[f"rot_{i}"])
    np.testing.assert_allclose(model.opacity[:, 0], 1 / (1 + np.exp(-columns["opacity"].astype(float))), rtol=1e-12)
    assert (model.quality_bound == 1).all() and model.dropped == {}
    np.testing.assert_array_equal(model.up, [0, -1, 0])


@pytest.mark.parametrize(("encoding", "dtype"), [
    ("binary_little_endian", "<f4"), ("binary_little_endian", "<f8"), ("binary_big_endian", ">f4"), ("ascii", "<f4"),
])
def test_order_and_encoding_do_not_matter(tmp_path, encoding, dtype):
    columns = ply_columns(6, 1)
    want = load_model(write_ply(tmp_path / "a.ply", columns))
    shuffled = {name: columns[name] for name in np.random.default_rng(3).permutation(list(columns))}
    shuffled["unknown"] = np.arange(6.0)
    got = load_model(write_ply(tmp_path / "b.ply", shuffled, encoding=encoding, dtype=dtype))
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(got, name), getattr(want, name))


def test_windows_line_ends_and_other_elements(tmp_path):
    path = write_ply(tmp_path / "a.ply", ply_columns(4), before="element camera 0\nproperty float f\n")
    want = load_model(path).means
    head, body = path.read_bytes().split(b"end_header\n")
    path.write_bytes(head.replace(b"\n", b"\r\n") + b"end_header\r\n" + body)
    np.testing.assert_array_equal(load_model(path).means, want)


def broken(path, how):
    """The bytes of a good file, spoilt."""
    data = path.read_bytes()
    head = data.index(b"end_header") + len(b"end_header\n")
    return {
        "truncated body": (data[:-1], "truncated"),
        "truncated header": (data[: head - 20], "end of header"),
        "no body": (data[:head], "truncated"),
        "no vertices": (data.replace(b"vertex 5", b"vertex 0"), "0 vertices"),
        "count is no number": (data.replace(b"vertex 5", b"vertex -5"), "'element vertex -5'"),
        "no position": (data.replace(b"float x\n", b"float w\n"), "'x'"),
        "no opacity": (data.replace(b" opacity\n", b" opocity\n"), "'opacity'"),
        "no DC": (data.replace(b" f_dc_1\n", b" f_dc_7\n"), "'f_dc_1'"),
        "odd SH": (data.replace(b" nx\n", b" f_rest_0\n"), "1 f_rest"),
        "twice": (data.replace(b" nx\n", b" x\n"), "'x' appears 2 times"),
        "unknown type": (data.replace(b"float nx", b"fload nx"), "fload nx"),
        "unknown format": (data.replace(b"little_endian 1.0", b"middle_endian 1.0"), "binary_middle_endian"),
        "list": (data.replace(b"property float nx", b"property list uchar int nx"), "list"),
        "not PLY": (b"solid stl\n" + data, "solid st"),
        "empty": (b"", "empty"),
    }[how]


@pytest.mark.parametrize("how", [
    "truncated body", "truncated header", "no body", "no vertices", "count is no number", "no position", "no opacity", "no DC",
    "odd SH", "twice", "unknown type", "unknown format", "list", "not PLY", "empty",
])
def test_broken_files_are_named(tmp_path, how):  # hard cases 30, 31
    path = write_ply(tmp_path / "scene.ply", ply_columns())
    data, message = broken(path, how)
    path.write_bytes(data)
    with pytest.raises(InputError, match=message) as caught:
        load_model(path)
    assert "scene.ply" in str(caught.value)


@pytest.mark.parametrize("count", [1, 8, 10, 21, 46, 48])
def test_sh_of_odd_size(tmp_path, count):
    columns = ply_columns() | {f"f_rest_{i}": np.zeros(5, np.float32) for i in range(count)}
    with pytest.raises(InputError, match=f"{count} f_rest"):
        load_model(write_ply(tmp_path / "a.ply", columns))


def test_ascii_with_too_few_or_wrong_words(tmp_path):
    path = write_ply(tmp_path / "a.ply", ply_columns(), encoding="ascii")
    data = path.read_bytes()
    for spoilt in (data[: -len(data.split()[-1]) - 1], data[: data.index(b"end_header") + 11] + b"one two"):
        path.write_bytes(spoilt)
        with pytest.raises(InputError, match=r"a\.ply"):
            load_model(path)


@pytest.mark.parametrize("levels", [1, 2, 3, 4])
@pytest.mark.parametrize("degree", [0, 3])
def test_a_saved_model_comes_back_bit_for_bit(tmp_path, levels, degree):
    model = float32_model(levels=levels, sh_degree=degree)
    save_model(model, tmp_path / "a.ply")
    back = load_model(tmp_path / "a.ply")
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(back, name), getattr(model, name), err_msg=name)
    np.testing.assert_array_equal(back.up, model.up)
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]  # no temporary file is left


def test_saved_smfr_levels_come_back(tmp_path):
    model = smfr_levels(float32_model(n=200, levels=1))
    save_model(model, tmp_path / "a.ply")
    np.testing.assert_array_equal(load_model(tmp_path / "a.ply").quality_bound, model.quality_bound)


def test_other_tools_see_an_ordinary_file(tmp_path):
    gsply = pytest.importorskip("gsply")
    model = float32_model()
    save_model(model, tmp_path / "a.ply")
    other = gsply.plyread(tmp_path / "a.ply")
    np.testing.assert_array_equal(other.means, model.means)
    np.testing.assert_array_equal(other.quats, model.quats)
    np.testing.assert_array_equal(other.scales, model.log_scales)
    np.testing.assert_array_equal(other.sh0, model.sh_dc[:, 0])
    np.testing.assert_array_equal(other.shN, model.sh_rest)
    assert np.isfinite(other.opacities).all()  # hard case 26: logit(1), and amplified opacities, which have none
    np.testing.assert_allclose(1 / (1 + np.exp(-other.opacities.astype(float))), np.minimum(model.opacity[:, 0], 1), atol=1e-7)


@pytest.mark.parametrize(("column", "value", "message"), [
    ("quality_bound", 0, "quality_bound 0"), ("quality_bound", 5, "quality_bound 5"),
    ("quality_bound", 1.5, "quality_bound 1.5"),
    ("opacity_l2", -1, "opacity -1"), ("opacity_l2", 129, "opacity 129"), ("opacity_l2", np.inf, "opacity inf"),
])
def test_level_values_out_of_range(tmp_path, column, value, message):
    columns = ply_columns() | {"quality_bound": np.ones(5)}
    columns |= {f"opacity_l{level}": np.ones(5) for level in (1, 2)} | {f"f_dc_{c}_l2": np.ones(5) for c in range(3)}
    columns[column] = np.full(5, value)
    with pytest.raises(InputError, match=message):
        load_model(write_ply(tmp_path / "a.ply", columns))


@pytest.mark.parametrize("gone", ["quality_bound", "opacity_l1", "opacity_l2", "f_dc_1_l2"])
def test_incomplete_levels(tmp_path, gone):
    columns = ply_columns() | {"quality_bound": np.ones(5)}
    columns |= {f"opacity_l{level}": np.ones(5) for level in (1, 2, 3)}
    columns |= {f"f_dc_{c}_l{level}": np.ones(5) for c in range(3) for level in (2, 3)}
    del columns[gone]
    with pytest.raises(InputError, match=r"a\.ply"):
        load_model(write_ply(tmp_path / "a.ply", columns))


def test_saving_nowhere_and_nonsense(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        save_model(float32_model(), tmp_path / "absent" / "a.ply")
    model = float32_model()
    model.opacity[0, 0] = np.nan
    with pytest.raises(ValueError, match="not nan"):
        save_model(model, tmp_path / "a.ply")
    assert not list(tmp_path.iterdir())
