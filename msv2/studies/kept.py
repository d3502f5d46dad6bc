"""Keeps measurements in a folder, under keys that cover all their inputs, so that an interrupted study can continue."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from golden.scenes.camera import Camera
from golden.scenes.files import read_json
from golden.scenes.model import GaussianModel
from golden.scenes.request import make_folder, write_json
from spec import sources
from spec.errors import InputError


def fingerprint(modules: Iterable[str], *parts: object) -> str:
    """A hash of 16 hexadecimal digits that changes with any source file on which the modules depend, and with the parts.

    Args:
        modules: dotted names; everything of the project that they import counts too.
        parts: models and cameras count by their contents, anything else by its `repr`.
    """
    names = tuple(modules)
    return sources.fingerprint(sources.sources_of(*names) if names else (), *map(_contents, parts))


def _contents(part: object) -> object:
    if isinstance(part, GaussianModel):
        state = hashlib.sha256()
        for name in ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound"):
            state.update(np.ascontiguousarray(getattr(part, name)).tobytes())
        return state.hexdigest()
    if isinstance(part, Camera):
        return [value.tolist() if isinstance(value, np.ndarray) else value for value in vars(part).values()]
    return part


def kept(folder: Path, key: str, make: Callable[[], dict[str, object]]) -> dict[str, object]:
    """The row in KEY.json of the folder. Where that is missing or damaged, `make` makes the row, and it is written there."""
    path = make_folder(folder) / f"{key}.json"
    if path.exists():
        try:
            return read_json(path)
        except InputError:
            pass  # the file is damaged, so the row is made again
    row = make()
    write_json(path, row)
    return row
