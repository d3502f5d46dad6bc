"""PLY files for the cases. They are written here and not by the project's exporter, so that they can be wrong."""

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
    """The columns of a 3DGS PLY for a model of one level. Nothing is clipped, refused or dropped."""
    columns = dict(zip("xyz", model.means.T, strict=True)) | {f"f_dc_{c}": model.sh_dc[:, 0, c] for c in range(3)}
    rest = model.sh_rest.transpose(0, 2, 1).reshape(len(model), -1)
    columns |= {f"f_rest_{i}": values for i, values in enumerate(rest.T)}
    with np.errstate(divide="ignore", invalid="ignore"):
        columns["opacity"] = np.log(model.opacity[:, 0]) - np.log1p(-model.opacity[:, 0])
    columns |= {f"scale_{i}": model.log_scales[:, i] for i in range(3)}
    return columns | {f"rot_{i}": model.quats[:, i] for i in range(4)}


def ply_bytes(columns: Mapping[str, np.ndarray], kind: str = "float", rows: int | None = None) -> bytes:
    """A little-endian PLY of float32 columns. `kind` and `rows` are the type and the number of rows that its header states."""
    count = len(next(iter(columns.values())))
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count if rows is None else rows}"]
    header += [f"property {kind} {name}" for name in columns] + ["end_header", ""]
    return "\n".join(header).encode() + np.stack(list(columns.values()), 1).astype("<f4").tobytes()


def in_a_file(content: bytes, use: Callable[[Path], object], name: str = "model.ply") -> object:
    """The result of `use` for a temporary file with this content."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(content)
        return use(path)


def loaded(columns: Mapping[str, np.ndarray]) -> GaussianModel:
    """The model that the loader makes of a PLY with these columns."""
    return in_a_file(ply_bytes(columns), load_model)


def refused(content: bytes, words: str, name: str = "model.ply") -> None:
    """Raises CaseFailure unless the loader refuses the file with an InputError whose message contains `words`."""
    try:
        model = in_a_file(content, load_model, name)
    except InputError as error:
        require(words in str(error), f"the refusal must say {words!r}, not {error}")
    else:
        require(False, f"a file that must be refused ({words}) loads as {len(model)} points")
