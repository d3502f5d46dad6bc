"""PLY files of the cases, written here and not by the project's exporter, so that they can be wrong."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from golden.scenes.load import load_model
from golden.scenes.model import GaussianModel
from msv2.cases.case import require
from spec.errors import InputError


def columns_of(model: GaussianModel) -> dict[str, np.ndarray]:
    """Columns of a 3DGS PLY of a model of one level, as they are: nothing is clipped, refused or dropped."""
    columns = dict(zip("xyz", model.means.T, strict=True)) | {f"f_dc_{c}": model.sh_dc[:, 0, c] for c in range(3)}
    rest = model.sh_rest.transpose(0, 2, 1).reshape(len(model), -1)
    columns |= {f"f_rest_{i}": values for i, values in enumerate(rest.T)}
    with np.errstate(divide="ignore", invalid="ignore"):
        columns["opacity"] = np.log(model.opacity[:, 0]) - np.log1p(-model.opacity[:, 0])
    columns |= {f"scale_{i}": model.log_scales[:, i] for i in range(3)}
    return columns | {f"rot_{i}": model.quats[:, i] for i in range(4)}


def ply_bytes(columns: Mapping[str, np.ndarray], kind: str = "float", rows: int | None = None) -> bytes:
    """A little-endian PLY of float32 columns; `kind` and `rows` are what its header says."""
    count = len(next(iter(columns.values())))
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count if rows is None else rows}"]
    header += [f"property {kind} {name}" for name in columns] + ["end_header", ""]
    return "\n".join(header).encode() + np.stack(list(columns.values()), 1).astype("<f4").tobytes()


def in_a_file(content: bytes, use: Callable[[Path], object], name: str = "model.ply") -> object:
    """What `use` makes of a file of that content."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        return use(path)


def loaded(columns: Mapping[str, np.ndarray]) -> GaussianModel:
    """The model that a PLY of these columns loads as."""
    return in_a_file(ply_bytes(columns), load_model)


def refused(content: bytes, words: str, name: str = "model.ply") -> None:
    """CaseFailure unless the file is refused by an InputError with these words in it."""
    try:
        model = in_a_file(content, load_model, name)
    except InputError as error:
        require(words in str(error), f"the refusal must say {words!r}, not {error}")
    else:
        require(False, f"a file that must be refused ({words}) loads as {len(model)} points")
