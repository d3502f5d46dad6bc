"""Sample models and files for the tests of the loaders, written here independently of the code under test."""

from pathlib import Path

import numpy as np

from golden.scenes.model import GaussianModel

PLY_TYPES = {"<f4": "float", ">f4": "float", "<f8": "double", "u1": "uchar", "<i4": "int", "<u4": "uint"}


def ply_columns(n: int = 5, sh_degree: int = 0, seed: int = 0) -> dict[str, np.ndarray]:
    """Columns of a 3DGS PLY with values as training leaves them, in INRIA's order."""
    rng = np.random.default_rng(seed)
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{i}" for i in range(3 * ((sh_degree + 1) ** 2 - 1))]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    columns = {name: rng.normal(size=n).astype(np.float32) for name in names}
    for axis in range(3):
        columns[f"scale_{axis}"] -= np.float32(4)
    return columns


def write_ply(path: Path, columns: dict[str, np.ndarray], *, encoding: str = "binary_little_endian", dtype: str = "<f4",
              before: str = "", comment: str = "by a test") -> Path:
    """A PLY file of one `vertex` element; `before` is header text of elements without rows in front of it."""
    n = len(next(iter(columns.values())))
    header = f"ply\nformat {encoding} 1.0\ncomment {comment}\n{before}element vertex {n}\n"
    header += "".join(f"property {PLY_TYPES[dtype]} {name}\n" for name in columns) + "end_header\n"
    table = np.stack(list(columns.values()), axis=1)
    if encoding == "ascii":
        body = "\n".join(" ".join(repr(float(x)) for x in row) for row in table).encode() + b"\n"
    else:
        body = table.astype(dtype).tobytes()
    path.write_bytes(header.encode() + body)
    return path


def float32_model(n: int = 20, levels: int = 4, sh_degree: int = 2, seed: int = 1) -> GaussianModel:
    """A foveated model whose every value is a float32, with amplified opacities above 1 and a degenerate axis."""
    rng = np.random.default_rng(seed)

    def normal(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(np.float32).astype(np.float64)

    log_scales = (normal(n, 3) - 4).astype(np.float32).astype(np.float64)
    log_scales[0, 2] = -np.inf
    opacity = (rng.random((n, levels)) * 128).astype(np.float32).astype(np.float64)
    opacity[1] = 0
    opacity[2] = 1
    return GaussianModel(
        means=normal(n, 3), log_scales=log_scales, quats=normal(n, 4), opacity=opacity, sh_dc=normal(n, levels, 3),
        sh_rest=normal(n, (sh_degree + 1) ** 2 - 1, 3), quality_bound=rng.integers(1, levels + 1, n).astype(np.uint8),
        up=np.array([0.0, 0.6, -0.8]),
    )
