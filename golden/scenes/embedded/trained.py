"""The trained foveated model of the embedded scene that ships with the project: scene `embedded_trained`.

`msv2 train embedded --ship` makes `trained.npz` and, beside it, `trained.json`, which says how it was made and how good it is.
Reading takes numpy alone. The fields of a splat are whole numbers of 8 or 16 bits between the extremes of their columns:

- `means`: 16 bits of sign(x) log(1 + |x|), which is fine in the room and reaches to the sky;
- `log_scales`, `quats` (normalised, w >= 0), `sh_dc` of level 1: 10 bits; `sh_rest`: 8 bits;
- `log_opacity` of level 1: 10 bits of the natural logarithm of the amplified opacity;
- `log_opacity_steps`, `sh_dc_steps`: what each level adds to the level before; zero for splats that it does not use;
- `quality_bound`: as it is.

Columns are stored one after the other, because they compress better than splats do.
"""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import numpy as np

from golden.scenes.embedded.views import UP
from golden.scenes.files import read_bytes, read_json
from golden.scenes.model import GaussianModel
from spec.constants import AMP_MAX
from spec.errors import InputError

NAME = "embedded_trained"
FILE = Path(__file__).with_name("trained.npz")
RECORD = FILE.with_suffix(".json")

BITS = {"means": 16, "log_scales": 10, "quats": 10, "log_opacity": 10, "log_opacity_steps": 10, "sh_dc": 10, "sh_dc_steps": 10,
        "sh_rest": 8}
"""Bits of each field."""

MIN_OPACITY = 1e-4
"""Smallest stored opacity; the renderers drop fainter splats."""


def packed(model: GaussianModel) -> bytes:
    """A foveated model as the content of a compressed .npz; `load_trained` returns it with the errors of the fields' bits."""
    quats = model.quats / np.linalg.norm(model.quats, axis=1, keepdims=True)
    log_opacity = np.log(np.maximum(model.opacity, MIN_OPACITY))
    fields = {
        "means": np.sign(model.means) * np.log1p(np.abs(model.means)),
        "log_scales": model.log_scales, "quats": np.where(quats[:, :1] < 0, -quats, quats),
        "log_opacity": log_opacity[:, :1], "log_opacity_steps": np.diff(log_opacity, axis=1),
        "sh_dc": model.sh_dc[:, 0], "sh_dc_steps": np.diff(model.sh_dc, axis=1).reshape(len(model), -1),
        "sh_rest": model.sh_rest.reshape(len(model), -1),
    }
    arrays: dict[str, np.ndarray] = {"quality_bound": model.quality_bound}
    for name, values in fields.items():
        low, high = values.min(axis=0), values.max(axis=0)
        step = np.where(high > low, high - low, 1.0) / (2 ** BITS[name] - 1)
        whole = np.round((values - low) / step).astype(np.uint8 if BITS[name] <= 8 else np.uint16)
        arrays |= {name: np.ascontiguousarray(whole.T), f"{name}_range": np.stack([low, step]).astype(np.float64)}
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    return content.getvalue()


def load_trained(path: Path = FILE) -> GaussianModel:
    """The shipped model.

    Raises:
        InputError: the file is missing or not whole.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        fields = {name: _values(arrays, name) for name in BITS}
        bound = arrays["quality_bound"]
    except Exception as error:  # numpy, zipfile and zlib raise nearly anything on a broken file
        raise InputError(f"{path}: is not the whole model of the scene {NAME!r} ({error}); install the project again, or make "
                         "the model by msv2 train embedded --ship") from error
    n = len(bound)
    means, dc = fields["means"], np.concatenate([fields["sh_dc"], fields["sh_dc_steps"]], axis=1)
    opacity = np.exp(np.cumsum(np.concatenate([fields["log_opacity"], fields["log_opacity_steps"]], axis=1), axis=1))
    return GaussianModel(
        means=np.sign(means) * np.expm1(np.abs(means)), log_scales=fields["log_scales"], quats=fields["quats"],
        opacity=np.minimum(opacity, AMP_MAX), sh_dc=np.cumsum(dc.reshape(n, -1, 3), axis=1),
        sh_rest=fields["sh_rest"].reshape(n, -1, 3), quality_bound=bound, up=UP.copy(), name=NAME)


def _values(arrays: dict[str, np.ndarray], name: str) -> np.ndarray:
    """(N, columns) float64 values of a field."""
    low, step = arrays[f"{name}_range"]
    return arrays[name].T * step + low


def record() -> dict[str, object]:
    """How the shipped model was made, and how good it is: the content of trained.json.

    Raises:
        InputError: the file is missing, or does not belong to the model beside it.
    """
    content = read_json(RECORD)
    if content.get("sha256") != sha256(FILE):
        raise InputError(f"{RECORD}: its sha256 is not that of {FILE.name}; install the project again")
    return content


def sha256(path: Path) -> str:
    """The SHA-256 of a file in hexadecimal.

    Raises:
        InputError: the file is not readable.
    """
    return hashlib.sha256(read_bytes(path)).hexdigest()
