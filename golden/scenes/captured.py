"""Where captured scenes are: files and folders below MSV2_DATA, by the names that reports use."""

from __future__ import annotations

from pathlib import Path

from golden.scenes.load import PROJECT_SCENES
from spec.paths import data_folder

CAPTURED = {
    "truck": "trained/truck.splat", "rock_sh3": "trained/rock_sh3", "garden_large": "trained/garden_large",
    "fern": "posed/fern", "cones": "stereo/cones"}
"""Place below `spec.paths.data_folder` by name: models that others trained, posed photographs, a stereo pair."""


def captured_path(name: str) -> Path | None:
    """Where the captured scene of this name is; None where it is not there.

    Raises:
        KeyError: no scene of CAPTURED has this name.
    """
    path = data_folder() / CAPTURED[name]
    return path if path.exists() else None


def scene_argument(name: str) -> str | None:
    """A scene as the commands take it: the name of one of the project's own, or the path of a captured scene; None where that
    is not there.

    Raises:
        KeyError: no scene has this name.
    """
    if name in PROJECT_SCENES:
        return name
    path = captured_path(name)
    return None if path is None else str(path)
