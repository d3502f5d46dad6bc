"""Where files are: the project's own, what commands write, and what is kept to save time. No other file derives a folder.

The project runs from a checkout or from an installed wheel. A checkout keeps its outputs in its own `build/` and its reports in
`reports/`. An installed wheel writes to `build/` below the current folder, and it brings the reports' numbers with it.
Caches are in the user's cache folder in both cases, so that checkouts share them and site-packages stays as it was installed.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
"""The folder that holds `spec`: a checkout, or site-packages."""

IN_CHECKOUT = (ROOT / "pyproject.toml").is_file()
"""Whether the project runs from a checkout."""

BUILD = (ROOT if IN_CHECKOUT else Path.cwd()) / "build"
"""The folder that commands write to unless they are told otherwise. Everything in it can be made again."""

REPORTS = ROOT / "reports" if IN_CHECKOUT else ROOT / "msv2" / "reports"
"""The reports that studies wrote and the project keeps. An installed wheel has their numbers (`*.json`) only."""

DOCS = ROOT / "docs"
"""The pages of the documentation, some of which are generated. Only a checkout has them."""


def cache_folder(*parts: str) -> Path:
    """The folder of one kind of cache, such as compiled kernels, emitted Verilog or traces. It need not exist.

    It lies in the folder that the variable MSV2_CACHE names, else in `msv2` below XDG_CACHE_HOME or ~/.cache.
    """
    own, shared = os.environ.get("MSV2_CACHE"), os.environ.get("XDG_CACHE_HOME", "")
    if own:
        base = Path(own).absolute()
    elif os.path.isabs(shared):  # the standard has relative paths ignored
        base = Path(shared) / "msv2"
    else:
        try:
            base = Path.home() / ".cache" / "msv2"
        except RuntimeError:  # a user without a home
            base = Path(tempfile.gettempdir()) / f"msv2-{os.getuid()}"
    return base.joinpath(*parts)


def data_folder() -> Path:
    """The folder of captured scenes that MSV2_DATA names; without it, shared/data beside the checkout."""
    return Path(os.environ.get("MSV2_DATA") or ROOT.parent / "shared" / "data")


def short_path(path: Path) -> str:
    """A path as messages print it: relative to the current folder where it lies in it."""
    path, here = path.absolute(), Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
