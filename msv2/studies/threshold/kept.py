"""Rows that were measured before: kept in a folder by everything they depend on, so that an interrupted table goes on."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.files import read_json
from golden.scenes.model import GaussianModel
from golden.scenes.request import make_folder, write_json
from spec.errors import InputError
from spec.paths import ROOT

GOLDEN_SOURCES = (
    "spec/*.py", "golden/msv2_ref/*.py", "golden/metrics/*.py", "golden/scenes/gaze.py", "golden/scenes/stereo.py",
    "msv2/studies/training/frame_cycles.py", "msv2/studies/threshold/measure.py", "msv2/studies/threshold/cycles.py")
"""What a golden row is made by: it is measured again where any of it has changed."""

RTL_SOURCES = ("spec/*.py", "rtl/**/*.py", "golden/msv2_ref/*.py", "golden/scenes/gaze.py", "golden/scenes/stereo.py",
               "golden/msv2_ref/eyes_request.py", "tb/frame/*.py", "tb/top/[cdimps]*.py", "tb/top/memory.sv")
"""The same of a frame through the machine."""


def fingerprint(sources: Iterable[str], *parts: object) -> str:
    """Of files of the project by pattern, and of models, cameras and settings."""
    digest = hashlib.sha256()
    for path in sorted({p for pattern in sources for p in ROOT.glob(pattern)}):
        digest.update(path.read_bytes())
    for part in parts:
        if isinstance(part, GaussianModel):
            for name in ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound"):
                digest.update(np.ascontiguousarray(getattr(part, name)).tobytes())
        elif isinstance(part, Camera):
            digest.update(repr([value.tolist() if isinstance(value, np.ndarray) else value
                                for value in vars(part).values()]).encode())
        else:
            digest.update(repr(part).encode())
    return digest.hexdigest()[:16]


def kept(folder: Path, key: str, make: Callable[[], dict[str, object]]) -> dict[str, object]:
    """A row from the folder, or made and kept there."""
    path = make_folder(folder) / f"{key}.json"
    if path.exists():
        try:
            return read_json(path)
        except InputError:
            pass  # torn: made anew
    row = make()
    write_json(path, row)
    return row
