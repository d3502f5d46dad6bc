"""Writes a model as PLY. Any 3DGS tool opens a foveated file as its level 1 (the layout is described in
`golden.scenes.ply`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from golden.scenes.conventions import logit, sh_rest_to_ply
from golden.scenes.files import atomic_output
from golden.scenes.model import GaussianModel
from spec.constants import AMP_MAX


def save_model(model: GaussianModel, path: Path | str) -> None:
    """Writes `model` as little-endian PLY; `load_model` returns every field bit for bit in float32.

    The amplified opacity of level 1 may exceed 1 and then has no logit. So `opacity` holds the clipped logit for other tools
    and `opacity_l1` holds the value itself. Normals are written as zeros because the INRIA trainer's layout has them.

    Raises:
        ValueError: an opacity lies outside 0..AMP_MAX, which no renderer here accepts.
        InputError: the folder does not exist or is not writable.
    """
    path = Path(path)
    if not ((model.opacity >= 0) & (model.opacity <= AMP_MAX)).all():
        raise ValueError(f"opacity must be within 0..{AMP_MAX:g}, not {model.opacity.min():g}..{model.opacity.max():g}")
    columns = _columns(model)
    rows = np.empty((len(model), len(columns)), "<f4")
    for i, values in enumerate(columns.values()):
        rows[:, i] = values
    up = " ".join(repr(float(x)) for x in model.up)
    header = ["ply", "format binary_little_endian 1.0", f"comment up {up}"]
    header += [] if model.up_source == "given" else [f"comment up_source {model.up_source}"]
    header += [f"element vertex {len(model)}"]
    header += [f"property float {name}" for name in columns] + ["end_header", ""]
    with atomic_output(path) as file:
        file.write("\n".join(header).encode())
        file.write(rows.tobytes())


def _columns(model: GaussianModel) -> dict[str, np.ndarray]:
    """(N,) arrays by property name: the standard properties in the INRIA trainer's order, then those of foveation."""
    columns = dict(zip("xyz", model.means.T, strict=True))
    columns |= dict.fromkeys(("nx", "ny", "nz"), np.zeros(len(model)))
    columns |= {f"f_dc_{c}": model.sh_dc[:, 0, c] for c in range(3)}
    columns |= {f"f_rest_{i}": values for i, values in enumerate(sh_rest_to_ply(model.sh_rest).T)}
    columns["opacity"] = logit(model.opacity[:, 0])
    columns |= {f"scale_{i}": model.log_scales[:, i] for i in range(3)}
    columns |= {f"rot_{i}": model.quats[:, i] for i in range(4)}
    columns["quality_bound"] = model.quality_bound
    columns |= {f"opacity_l{level + 1}": model.opacity[:, level] for level in range(model.levels)}
    columns |= {f"f_dc_{c}_l{level + 1}": model.sh_dc[:, level, c] for level in range(1, model.levels) for c in range(3)}
    return columns
