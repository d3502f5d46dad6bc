"""Reads antimatter15's .splat format: 32 bytes for each splat, no header, SH degree 0."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from golden.scenes.clean import Fields, build_model
from golden.scenes.conventions import UP_BY_FORMAT, colour_to_sh_dc, log_of_linear_scales, quats_from_splat_bytes
from golden.scenes.files import read_bytes
from golden.scenes.model import GaussianModel
from spec.errors import InputError

ROW = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])


def load_splat(path: Path, name: str) -> GaussianModel:
    """Loads the model in a .splat file.

    Raises:
        InputError: the file is empty, its size is not a whole number of splats, or it is no .splat file. The format has no
            magic number, so a file is refused when more than half of its rows have a scale that is negative or not finite.
    """
    data = read_bytes(path)
    if len(data) % ROW.itemsize:
        raise InputError(f"{path}: {len(data)} bytes; a .splat file has a multiple of {ROW.itemsize} (truncated?)")
    rows = np.frombuffer(data, ROW)
    fields = Fields(
        means=rows["position"].astype(np.float64), log_scales=log_of_linear_scales(rows["scale"]),
        quats=quats_from_splat_bytes(rows["quat"]), opacity=rows["rgba"][:, 3:] / 255.0,
        sh_dc=colour_to_sh_dc(rows["rgba"][:, None, :3] / 255.0), sh_rest=np.empty((len(rows), 0, 3)),
    )
    model = build_model(fields, path=path, name=name, up=UP_BY_FORMAT["splat"], up_source="splat")
    if 2 * len(model) < len(rows):
        bad = len(rows) - len(model)
        raise InputError(f"{path}: {bad} of {len(rows)} rows are no splats ({model.dropped}); is it a .splat file?")
    return model
