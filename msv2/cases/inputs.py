"""Cases 21 to 31: models and files that are broken, or look broken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from golden.msv2_ref.pipeline import render
from golden.scenes.load import load_model
from golden.scenes.model import GaussianModel
from golden.scenes.save import save_model
from msv2.cases.case import SMOOTH, Album, Case, Gradients, Renderer, Shot, Shots, close, require, scene_case
from msv2.cases.check import MACHINE
from msv2.cases.files import columns_of, in_a_file, loaded, ply_bytes, refused
from msv2.cases.makers import splats, view

COLOURS = np.array([(0.9, 0.2, 0.1), (0.1, 0.8, 0.3), (0.2, 0.3, 0.9), (0.8, 0.8, 0.1), (0.5, 0.1, 0.9)])
PLACES = [((x - 31.5) / 25, (y - 23.5) / 25, 2.0) for x, y in ((8, 8), (56, 8), (32, 24), (8, 40), (56, 40))]
"""Five means far apart at depth 2, which project onto the centres of pixels."""


def five(**options: object) -> GaussianModel:
    """Five splats at `PLACES`, each of its own colour."""
    return splats(*PLACES, colour=COLOURS, **{"scale": 0.05, "opacity": 0.9, **options})


def without(model: GaussianModel, *rows: int) -> GaussianModel:
    """The model without some rows."""
    return model.select(np.setdiff1d(np.arange(len(model)), rows))


def spoilt(changes: dict[str, tuple[int, float]]) -> GaussianModel:
    """`five()` with a broken number: for each named field, the last component of a row is replaced."""
    model = five()
    for name, (row, value) in changes.items():
        values = getattr(model, name).copy()
        values[row].flat[-1] = value
        model = replace(model, **{name: values})
    return model


def _cleaned(changes: dict[str, tuple[int, float]], dropped: dict[str, int]) -> Callable[[Renderer], Shots]:
    """Shots of the broken model after loading it from a file, and of the correct rows alone. The oracle and the differentiable
    renderer also get the broken model directly."""
    def shots(renderer: Renderer) -> Shots:
        broken = spoilt(changes)
        model = loaded(columns_of(broken))
        require(model.dropped == dropped, f"the loader must count {dropped}, not {model.dropped}")
        right = without(loaded(columns_of(five())), *(row for row, _ in changes.values()))
        found = {"loaded": Shot(model, view()), "right": Shot(right, view())}
        return found if renderer.name == "golden" else {**found, "unfiltered": Shot(broken, view())}
    return shots


def _dropped_and_counted(album: Album, renderer: Renderer, shots: Shots) -> None:
    """The frame must equal that of the correct rows, bit by bit."""
    right = album["right"]
    require(right.image.any(), "the rows that are right must show")
    require(np.array_equal(album["loaded"].image, right.image), "loaded: the image must be that of the rows that are right")
    if "unfiltered" in album:  # this model is in float64, whereas files hold float32
        close("unfiltered: image", album["unfiltered"].image, right.image, max(1e-4, renderer.error))
    if renderer.name == "oracle":
        wanted = len(five()) - len(shots["right"].model)
        got = album["unfiltered"].frame.culled["non_finite"]
        require(got == wanted, f"non_finite must be {wanted}, not {got}")


def _refused_by_hand(changes: dict[str, tuple[int, float]]) -> None:
    """The integer renderer must refuse a NaN that no loader has dropped, in each field."""
    for name, change in changes.items():
        try:
            render(spoilt({name: change}), view(), config=MACHINE)
        except ValueError as error:
            require("NaN" in str(error), f"{name}: the refusal must say NaN, not {error}")
        else:
            require(False, f"{name}: a NaN must be refused")


def _broken(number: int, name: str, what: str, changes: dict[str, tuple[int, float]], dropped: dict[str, int]) -> Case:
    gone = tuple(sorted({row for row, _ in changes.values()}))
    kept = tuple(set(range(5)) - set(gone))
    return scene_case(
        number, name, what, "dropped and counted by the loader; the others look, bit by bit, as without them",
        shots=_cleaned(changes, dropped), gradients=(Gradients("unfiltered", zero=gone, lit=kept, compared=()),),
        checks={"golden": partial(_refused_by_hand, {name: c for name, c in changes.items() if np.isnan(c[1])})},
    )(_dropped_and_counted)


NAN, INF = np.nan, np.inf
NAN_POSITION = _broken(21, "nan-position", "a NaN in a position", {"means": (2, NAN)}, {"nan position": 1})
NAN_SHAPE = _broken(
    22, "nan-scale-or-rotation", "a NaN in a scale and in a quaternion",
    {"log_scales": (1, NAN), "quats": (3, NAN)}, {"nan scale": 1, "nan rotation": 1})
INFINITE = _broken(
    23, "infinite-fields", "an infinite scale, position, rotation and colour, a row each",
    {"log_scales": (0, INF), "means": (1, INF), "quats": (2, -INF), "sh_dc": (3, INF)},
    {"infinite position": 1, "infinite scale": 1, "infinite rotation": 1, "infinite colour": 1})


def _aligned(renderer: Renderer) -> Shots:
    model = loaded(columns_of(spoilt({"means": (0, NAN), "quats": (2, NAN)})))
    return {"shot": Shot(model, view())}


@scene_case(
    24, "fields-stay-aligned", "rows dropped from the start and the middle of a model whose every row has its own colour",
    "each place that is left shows its own colour", shots=_aligned, gradients=(Gradients("shot", lit=(0, 1, 2)),))
def FIELDS_STAY_ALIGNED(album, renderer, shots):
    for row, (x, y) in {1: (56, 8), 3: (8, 40), 4: (56, 40)}.items():
        close(f"colour of row {row}", album["shot"].image[y, x], 0.9 * COLOURS[row], 3 * renderer.error + 1e-6)
    require(not album["shot"].coverage[24, 32], "the row that was dropped must not show")


def _infinite_logits(renderer: Renderer) -> Shots:
    columns = columns_of(five())
    columns["opacity"] = np.array([INF, -INF, 0.0, INF, -INF])
    model = loaded(columns)
    require(not model.dropped, f"nothing must be dropped, not {model.dropped}")
    require(model.opacity[:, 0].tolist() == [1, 0, 0.5, 1, 0], f"opacities must be 1, 0, 0.5, not {model.opacity[:, 0]}")
    return {"shot": Shot(model, view())}


@scene_case(
    25, "infinite-logit", "opacity logits of +inf and -inf in a file", "valid: opacities of 1 and of 0", shots=_infinite_logits,
    gradients=(Gradients("shot", zero=(1, 4), lit=(0, 2, 3), compared=()),))
def INFINITE_LOGIT(album, renderer, shots):
    album["shot"].counts(faint=2)
    got = [album["shot"].at(x, y) for x, y in ((8, 8), (56, 8), (32, 24), (8, 40), (56, 40))]
    close("coverage", got, [0.99, 0, 0.5, 0.99, 0], 3 * renderer.error + 1e-6)


def _exported(model: GaussianModel) -> GaussianModel:
    def use(path):
        save_model(model, path)
        content = path.read_bytes()
        table = np.frombuffer(content[content.index(b"end_header") + len(b"end_header\n") :], "<f4")
        require(np.isfinite(table).all(), "every number of the file must be finite")
        return load_model(path)
    return in_a_file(b"", use)


def _opaque_export(renderer: Renderer) -> Shots:
    model = five(opacity=[1.0, 0.0, 1.0, 0.5, 1.0])
    model = replace(model, **{name: getattr(model, name).astype(np.float32).astype(float) for name in (
        "means", "log_scales", "quats", "sh_dc")})
    return {"before": Shot(model, view()), "after": Shot(_exported(model), view())}


@scene_case(
    26, "logit-of-one", "opacities of exactly 1 and 0, saved and loaded", "the file is finite, the frame the same bit by bit",
    shots=_opaque_export, gradients=(Gradients("after", lit=(0, 2, 4), zero=(1,), compared=()),))
def LOGIT_OF_ONE(album, renderer, shots):
    require(shots["after"].model.opacity[:, 0].tolist() == [1, 0, 1, 0.5, 1], "opacities must come back as they were")
    require(np.array_equal(album["before"].image, album["after"].image), "the frame must not change")


def _zero_rotation(renderer: Renderer) -> Shots:
    broken = replace(five(), quats=np.where(np.arange(5)[:, None] == 2, 0.0, five().quats))
    model = loaded(columns_of(broken))
    require(model.dropped == {"zero rotation": 1}, f"the loader must count a zero rotation, not {model.dropped}")
    found = {"loaded": Shot(model, view()), "right": Shot(without(loaded(columns_of(five())), 2), view())}
    return {**found, "unfiltered": Shot(broken, view(), rim=None)}


@scene_case(
    27, "zero-quaternion", "a quaternion of four zeros",
    "dropped and counted by the loader and by the oracle; made by hand, the integer renderer takes it for no rotation",
    shots=_zero_rotation, gradients=(Gradients("unfiltered", zero=(2,), lit=(0, 1, 3, 4), compared=()),))
def ZERO_QUATERNION(album, renderer, shots):
    require(np.array_equal(album["loaded"].image, album["right"].image), "the image must be that of the rows that are right")
    shown = album["unfiltered"].coverage[24, 32] > 0
    require(shown == (renderer.name == "golden"), f"the row by hand must {'' if renderer.name == 'golden' else 'not '}show")


def _lengths(renderer: Renderer) -> Shots:
    model = five(scale=(0.3, 0.05, 0.1), quat=(0.9, 0.1, 0.3, 0.2))
    return {f"length {length:g}": Shot(replace(model, quats=model.quats * length), view())
            for length in (1.0, 1e-12, 0.5, 37.0, 1e12)}


@scene_case(
    28, "quaternions-of-any-length", "quaternions of lengths 1e-12 to 1e12", "normalised: the frame of those of length 1",
    shots=_lengths, gradients=(Gradients("length 37", lit=(0, 1, 2, 3, 4), compared=SMOOTH),))
def QUATERNIONS_OF_ANY_LENGTH(album, renderer, shots):
    for name, seen in album.items():
        close(name, seen.image, album["length 1"].image, 2 * renderer.error)


def _activated() -> None:
    rng = np.random.default_rng(0)
    columns = columns_of(splats(*rng.uniform(-1, 1, (200, 3)), opacity=0.5))
    columns |= {f"scale_{i}": rng.uniform(0.001, 0.9, 200) for i in range(3)}
    refused(ply_bytes({**columns, "opacity": rng.uniform(0, 1, 200)}), "look activated already")
    refused(ply_bytes({**columns, "opacity": rng.normal(0, 4, 200)}), "look activated already")
    in_a_file(ply_bytes(columns_of(five())), load_model)  # a correct file must load


def _degrees() -> None:
    columns = columns_of(five())
    for count in (9, 24, 45):
        rest = {f"f_rest_{i}": np.full(5, 0.01 * i) for i in range(count)}
        model = loaded({**columns, **rest})
        wanted = np.arange(count).reshape(3, -1).T * 0.01
        close(f"{count} coefficients", model.sh_rest[0], wanted, 1e-6)
    for count in (1, 8, 10, 44, 46):
        refused(ply_bytes({**columns, **{f"f_rest_{i}": np.zeros(5) for i in range(count)}}), "f_rest")
    require(loaded(columns).sh_degree == 0, "no coefficients are degree 0")
    refused(ply_bytes({name: values for name, values in columns.items() if name != "f_dc_1"}), "f_dc_1")


def _files() -> None:
    whole = ply_bytes(columns_of(five()))
    refused(b"", "empty")
    refused(b"", "empty", "model.splat")
    for size in (len(whole) - 1, len(whole) - 200, whole.index(b"end_header")):
        refused(whole[:size], "")
    refused(ply_bytes(columns_of(five()), rows=0), "")
    refused(ply_bytes(columns_of(five()), rows=10**9), "")
    refused(ply_bytes(columns_of(five()), kind="double"), "")
    refused(ply_bytes(columns_of(five()), kind="colour"), "")
    refused(b"PNG\x0d\x0a" + whole, "no known model format", "model.bin")
    refused(whole[:77], "", "model.splat")


_LOADER = dict.fromkeys(("golden", "gradient", "rtl"), "one loader for all renderers, in the oracle's column")
ACTIVATED = Case(
    29, "activated-already", "opacities and scales that were stored as they are rendered",
    "refused with what was found and what is accepted", checks={"oracle": _activated}, absent=_LOADER, rtl=False)
DEGREES = Case(
    30, "odd-sh-degree", "a PLY with 1, 8, 10, 44 or 46 coefficients a point in place of 0, 9, 24 or 45; one without f_dc_1",
    "the right ones load in order, the others are refused by name", checks={"oracle": _degrees}, absent=_LOADER, rtl=False)
FILES = Case(
    31, "broken-files", "empty, truncated and mistyped files, and headers that promise other rows",
    "refused with an InputError, never half a model", checks={"oracle": _files}, absent=_LOADER, rtl=False)

CASES = (NAN_POSITION, NAN_SHAPE, INFINITE, FIELDS_STAY_ALIGNED, INFINITE_LOGIT, LOGIT_OF_ONE, ZERO_QUATERNION,
         QUATERNIONS_OF_ANY_LENGTH, ACTIVATED, DEGREES, FILES)
