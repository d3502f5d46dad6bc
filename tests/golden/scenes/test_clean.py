"""Splats that cannot be drawn, and values that are not what the file says (hard cases 21-29)."""

import numpy as np
import pytest

from golden.scenes.load import load_model
from spec.errors import InputError
from tests.helpers.scenes_samples import ply_columns, write_ply

FIELD = {"position": "x", "scale": "scale_1", "rotation": "rot_2", "opacity": "opacity", "colour": "f_dc_0"}


def spoilt(tmp_path, column, value, n=9, at=4, degree=1):
    columns = ply_columns(n, degree)
    columns[column][at] = value
    return columns, load_model(write_ply(tmp_path / "a.ply", columns))


@pytest.mark.parametrize("field", FIELD)
def test_nan_is_dropped_and_counted(tmp_path, field):
    _, model = spoilt(tmp_path, FIELD[field], np.nan)
    assert len(model) == 8 and model.dropped == {f"nan {field}": 1}


@pytest.mark.parametrize("field", ["position", "rotation", "colour"])
@pytest.mark.parametrize("value", [np.inf, -np.inf])
def test_infinity_is_dropped_and_counted(tmp_path, field, value):
    _, model = spoilt(tmp_path, FIELD[field], value)
    assert len(model) == 8 and model.dropped == {f"infinite {field}": 1}


@pytest.mark.parametrize("value", [np.inf, 89.0])  # exp(89) overflows float32
def test_infinite_scale_is_dropped(tmp_path, value):
    assert spoilt(tmp_path, "scale_0", value)[1].dropped == {"infinite scale": 1}


def test_higher_harmonics_are_colour_too(tmp_path):
    assert spoilt(tmp_path, "f_rest_5", np.nan)[1].dropped == {"nan colour": 1}


def test_degenerate_axis_stays(tmp_path):
    _, model = spoilt(tmp_path, "scale_2", -np.inf)
    assert model.dropped == {} and model.log_scales[4, 2] == -np.inf


@pytest.mark.parametrize(("value", "opacity"), [(np.inf, 1.0), (-np.inf, 0.0), (1000.0, 1.0), (-1000.0, 0.0)])
def test_infinite_logit_is_an_opacity(tmp_path, value, opacity):
    _, model = spoilt(tmp_path, "opacity", value)
    assert model.dropped == {} and model.opacity[4, 0] == opacity


def test_zero_quaternion_is_dropped_and_another_length_is_not(tmp_path):
    columns = ply_columns(9)
    for i in range(4):
        columns[f"rot_{i}"][2] = 0
        columns[f"rot_{i}"][3] *= 1e-6
    model = load_model(write_ply(tmp_path / "a.ply", columns))
    assert model.dropped == {"zero rotation": 1}
    np.testing.assert_array_equal(model.quats[2], [columns[f"rot_{i}"][3] for i in range(4)])


def test_fields_stay_aligned(tmp_path):  # hard case 24
    columns = ply_columns(50, 3)
    for at, column in zip(range(0, 50, 7), ["x", "scale_0", "rot_3", "opacity", "f_dc_2", "f_rest_44", "y", "z"], strict=True):
        columns[column][at] = np.nan
    kept = np.flatnonzero(np.arange(50) % 7)
    model = load_model(write_ply(tmp_path / "a.ply", columns))
    want = load_model(write_ply(tmp_path / "b.ply", {name: values[kept] for name, values in columns.items()}))
    assert sum(model.dropped.values()) == 8 and want.dropped == {}
    for name in ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound"):
        np.testing.assert_array_equal(getattr(model, name), getattr(want, name))


def test_a_splat_is_counted_once(tmp_path):
    columns = ply_columns(9)
    for column in ("x", "scale_0", "f_dc_1"):
        columns[column][1] = np.nan
    model = load_model(write_ply(tmp_path / "a.ply", columns))
    assert len(model) == 8 and model.dropped == {"nan position": 1}


def test_nothing_left(tmp_path):
    columns = ply_columns(3)
    columns["y"][:] = np.nan
    with pytest.raises(InputError, match="3 nan position"):
        load_model(write_ply(tmp_path / "a.ply", columns))


def activated(columns, opacity, scale):
    if opacity:
        columns["opacity"] = 1 / (1 + np.exp(-columns["opacity"]))
    if scale:
        for axis in range(3):
            columns[f"scale_{axis}"] = np.exp(columns[f"scale_{axis}"])
    return columns


@pytest.mark.parametrize(("n", "opacity", "scale"), [
    (1, True, True), (500, True, True), (500, True, False), (500, False, True),
])
def test_activated_values_are_refused(tmp_path, n, opacity, scale):  # hard case 29
    columns = ply_columns(n)
    columns["opacity"] *= 4
    with pytest.raises(InputError, match="activated already"):
        load_model(write_ply(tmp_path / "a.ply", activated(columns, opacity, scale)))


@pytest.mark.parametrize(("opacity", "scale"), [
    (None, 5.0),  # a scene in millimetres: every scale above 1, opacities as trained
    (0.5, None),  # a synthetic or fresh model: one opacity for all
    (np.inf, None),
])
def test_unusual_but_honest_values_pass(tmp_path, opacity, scale):
    columns = ply_columns(500)
    if opacity is not None:
        columns["opacity"][:] = opacity
    if scale is not None:
        for axis in range(3):
            columns[f"scale_{axis}"] = np.abs(columns[f"scale_{axis}"]) + np.float32(scale)
    assert len(load_model(write_ply(tmp_path / "a.ply", columns))) == 500
