"""The embedded scene's model is the same on every CPU: its arithmetic, and whole models under other instruction sets."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from golden.scenes.embedded.portable import on_grid, on_relative_grid, symmetric_eigen
from golden.scenes.embedded.scene import embedded_model
from golden.scenes.model import GaussianModel

COUNT = 900
PINNED = "cdaa786ee339884b"
"""First digits of the SHA-256 of a model of COUNT points; a change of the scene changes it, a change of the CPU must not."""


def digest(model: GaussianModel) -> str:
    arrays = (getattr(model, field.name) for field in fields(model))
    return hashlib.sha256(b"".join(a.tobytes() for a in arrays if isinstance(a, np.ndarray))).hexdigest()[:16]


def test_the_model_is_the_one_that_the_reports_were_measured_on():
    assert digest(embedded_model(COUNT)) == PINNED


def test_other_instruction_sets_give_the_same_model():
    from numpy._core import _multiarray_umath as umath

    optional = [name for name in umath.__cpu_dispatch__ if umath.__cpu_features__.get(name)]
    if not optional:
        pytest.skip("numpy has no instructions here that could be switched off")
    command = f"from tests.golden.scenes.test_embedded_portable import *; print(digest(embedded_model({COUNT})))"
    environment = os.environ | {"NPY_DISABLE_CPU_FEATURES": " ".join(optional), "OPENBLAS_CORETYPE": "Nehalem"}
    done = subprocess.run([sys.executable, "-c", command], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == PINNED


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["full", "flat", "equal", "needle", "diagonal"]))
def test_eigenvectors_are_those_of_the_matrix(seed, kind):
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(20, 3, 3)))[0]
    size = {"full": rng.uniform(0.1, 3.0, (20, 3)), "flat": np.tile([1.0, 1.0, 0.0], (20, 1)), "equal": np.ones((20, 3)),
            "needle": np.tile([1e-9, 1e-9, 1.0], (20, 1)), "diagonal": rng.uniform(0.1, 3.0, (20, 3))}[kind]
    if kind == "diagonal":
        turn = np.tile(np.eye(3), (20, 1, 1))
    matrices = np.einsum("nik,nk,njk->nij", turn, size, turn)
    values, axes = symmetric_eigen((matrices + matrices.transpose(0, 2, 1)) / 2)
    assert (np.diff(values, axis=1) >= 0.0).all()
    np.testing.assert_allclose(values, np.sort(size, axis=1), atol=1e-14)
    np.testing.assert_allclose(np.einsum("nik,nk,njk->nij", axes, values, axes), matrices, atol=1e-14)
    np.testing.assert_allclose(axes.transpose(0, 2, 1) @ axes, np.tile(np.eye(3), (20, 1, 1)), atol=1e-14)
    assert (np.linalg.det(axes) > 0.0).all()


def test_a_zero_matrix_has_the_worlds_axes():
    values, axes = symmetric_eigen(np.zeros((1, 3, 3)))
    assert not values.any() and np.array_equal(axes[0], np.eye(3))


def test_grids_round_ties_to_even_and_keep_what_lies_on_them():
    assert on_grid(np.array([0.125, 0.375, 0.25, -0.125]), 2).tolist() == [0.0, 0.5, 0.25, 0.0]
    big, small = np.full((1, 3, 3), 3.0), np.full((1, 3, 3), 2.0**-40)
    assert np.array_equal(on_relative_grid(big, 4), big) and np.array_equal(on_relative_grid(small, 4), small)
    assert on_relative_grid(big + 0.1, 4)[0, 0, 0] == 3.0 and not on_relative_grid(np.zeros((1, 3, 3)), 4).any()
