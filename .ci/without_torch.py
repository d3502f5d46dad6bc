"""An environment like this one, without torch: build/without-torch, whose packages are links to those of this environment.

The README promises that neither `make demo` nor `make test` needs torch. An import that is refused would look different to
`importlib.util.find_spec` and to processes that tests start; here torch is simply not installed. Prints the path of its Python.
"""

from __future__ import annotations

import shutil
import sys
import sysconfig
import venv
from pathlib import Path

NEEDS_TORCH = ("torch", "torchvision", "torchgen", "functorch", "gsplat", "odak", "lpips", "pyfvvdp", "nvidia", "triton")
"""Packages that are left out: torch, what it brings, and what imports it."""


def main() -> None:
    """Makes the environment anew."""
    if sys.prefix == sys.base_prefix:
        sys.exit("error: run this with the Python of a virtual environment")
    folder = Path(__file__).resolve().parents[1] / "build" / "without-torch"
    shutil.rmtree(folder, ignore_errors=True)
    venv.create(folder, with_pip=False, symlinks=True)
    python = folder / "bin" / "python"
    packages = next(folder.glob("lib/python*/site-packages"))
    for path in Path(sysconfig.get_path("purelib")).iterdir():
        if path.name.split("-")[0].split(".")[0] not in NEEDS_TORCH:
            (packages / path.name).symlink_to(path)
    (folder / "bin" / "ruff").symlink_to(Path(sys.prefix) / "bin" / "ruff")  # a program, which its package looks for there
    print(python)


if __name__ == "__main__":
    main()
