"""What was measured before, kept in a folder by everything that it depends on, so that an interrupted study goes on."""

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
    """16 hexadecimal digits that change with anything that the modules rest on, and with models, cameras and settings.

    Args:
        modules: dotted names; everything of the project that they import counts.
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
    """The row KEY.json of the folder; where there is none, or a damaged one, `make` makes it and it is written there."""
    path = make_folder(folder) / f"{key}.json"
    if path.exists():
        try:
            return read_json(path)
        except InputError:
            pass  # damaged: made anew
    row = make()
    write_json(path, row)
    return row
