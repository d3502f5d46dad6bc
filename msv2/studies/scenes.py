"""The scenes and frames that studies measure. The places of captured scenes are in golden/scenes/captured.py."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from golden.scenes.captured import scene_argument
from golden.scenes.level_source import RANDOM
from golden.scenes.load import EMBEDDED

MODELS = (EMBEDDED, "truck", "rock_sh3", "garden_large")
"""Scenes that need no training: the embedded scene, and three scenes that others captured and trained."""

TRAINED_HERE = ("fern", "bonsai")
"""Scenes that `make train` writes to build/train, with four trained levels."""


@dataclass(frozen=True)
class View:
    """A frame of a scene.

    Attributes:
        scene: `embedded`, or a name of golden.scenes.captured.CAPTURED.
        size: WxH in pixels.
        gaze: X,Y in pixels of a foveated frame of four levels; None for a frame without a gaze.
    """

    scene: str
    size: str
    gaze: str | None = None

    @property
    def arguments(self) -> tuple[str, ...]:
        """The size and the gaze as options of a command line."""
        return ("--size", self.size, *(("--gaze", self.gaze, "--levels", "4", "--levels-from", RANDOM) if self.gaze else ()))


def _views(size: str, gaze: str | None, *scenes: str) -> tuple[View, ...]:
    return tuple(View(scene, size, gaze) for scene in scenes)


EXACT = (View(EMBEDDED, "128x128", "64,64"), View("truck", "256x144", "128,72"), View("rock_sh3", "192x108", "96,54"))
"""Frames that are compared bit for bit, with and without their gaze, and with and without merging and pipelining."""

EXACT_LARGE = (View("garden_large", "320x180", "160,90"),)
"""Frames that are compared bit for bit, with and without their gaze, but only with merging and pipelining."""

SPEED = (
    *_views("640x360", "320,180", EMBEDDED), View("truck", "256x144", "128,72"), *_views("640x360", "320,180", "truck"),
    View("truck", "1280x720", "640,360"), *_views("640x360", "320,180", "rock_sh3"))
"""Foveated frames whose cycles are compared with and without merging and pipelining, at two memory bandwidths."""

ORDER = _views("640x360", None, *MODELS)
"""Frames whose order of splats is compared with the exact order."""

ENERGY = (*_views("640x360", "320,180", *MODELS), *_views("1920x1080", "960,540", *MODELS))
"""Frames whose energy is computed with the cycle model, in addition to those of reports/machine.json."""

BENCH = _views("640x360", None, EMBEDDED, "truck")
"""Frames on which the speed of the renderers is compared."""

SPLAT_CACHE = (
    View(EMBEDDED, "128x128"), View("truck", "256x144"), View("truck", "640x360"), View("truck", "1280x720"),
    View("garden_large", "320x180"), View("rock_sh3", "320x180"))
"""Frames on which splat caches are simulated, each without a gaze and with a gaze in its centre."""

TILE_SIZE = _views("640x360", "320,180", *MODELS)
"""Frames whose work is counted for tiles of other sizes."""

WRITE_COMBINING = (*_views("640x360", None, EMBEDDED, "truck"), *_views("1920x1080", None, EMBEDDED, "truck"))
"""Frames for which the writes of intersections that combining would save are counted."""

TRAINING = (EMBEDDED, "fern")
"""Scenes of the tables of training."""

FULL_HD = (EMBEDDED, "garden_large", "bonsai")
"""Scenes of the Full HD frames that are compared with a published chip."""


def places(views: Iterable[View]) -> list[str]:
    """The paths of the captured scenes of the views that are present, each path once."""
    paths = (scene_argument(name) for name in dict.fromkeys(view.scene for view in views) if name != EMBEDDED)
    return [path for path in paths if path is not None]


def available(views: Iterable[View]) -> Iterator[tuple[View, str]]:
    """The views whose scene is present, each with the argument that names the scene. For each other view a line is printed."""
    for view in views:
        path = scene_argument(view.scene)
        if path is None:
            print(f"skipped: {view.scene} (no such scene in MSV2_DATA)", flush=True)
        else:
            yield view, path
