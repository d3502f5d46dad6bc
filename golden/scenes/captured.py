"""Where captured scenes are: files and folders below MSV2_DATA, by the names that reports use."""

from __future__ import annotations

import os
from pathlib import Path

from golden.scenes.load import EMBEDDED
from spec.paths import ROOT

CAPTURED = {
    "truck": "trained/truck.splat", "rock_sh3": "trained/rock_sh3", "garden_large": "trained/garden_large",
    "fern": "posed/fern", "cones": "stereo/cones"}
"""Place below `data_folder` by name: models that others trained, posed photographs, a pair of photographs with disparities."""


def data_folder() -> Path:
    """The folder that MSV2_DATA names; without it, shared/data beside the checkout."""
    return Path(os.environ.get("MSV2_DATA", ROOT.parent / "shared" / "data"))


def captured_path(name: str) -> Path | None:
    """Where the captured scene of this name is; None where it is not there.

    Raises:
        KeyError: no scene of CAPTURED has this name.
    """
    path = data_folder() / CAPTURED[name]
    return path if path.exists() else None


def scene_argument(name: str) -> str | None:
    """A scene as the commands take it: `embedded`, or the path of a captured scene; None where that is not there.

    Raises:
        KeyError: no scene has this name.
    """
    if name == EMBEDDED:
        return name
    path = captured_path(name)
    return None if path is None else str(path)
