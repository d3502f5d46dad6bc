"""Frames of real scenes, rendered by the golden renderer, from which units get realistic stimuli."""

from __future__ import annotations

import argparse
import os
from functools import cache
from pathlib import Path

from golden.msv2_ref.pipeline import Frame, render
from golden.scenes.request import resolve
from spec.config import AcceleratorConfig
from spec.paths import ROOT

TRAINED = ("truck.splat", "rock_sh3")


def scene_path(scene: str) -> str | None:
    """A scene's argument for commands: `embedded`, or the path of the trained scene of this name; None where it is missing."""
    path = Path(os.environ.get("MSV2_DATA", ROOT.parent / "shared" / "data")) / "trained" / scene
    return scene if scene == "embedded" else str(path) if path.exists() else None


def traced_frame(
    config: AcceleratorConfig, scene: str, size: str, gaze: str = "none", levels: int | None = None,
) -> tuple[str, Frame]:
    """The name and the frame of a scene (see `scene_path`) at a size such as "640x360".

    The frame is foveated where the gaze is "x,y", and not where it is "none".
    """
    request = resolve(argparse.Namespace(
        scene=scene, size=size, camera="orbit", gaze=gaze, levels=levels, background="0.2,0.5,0.9", seed=0))
    return f"{Path(scene).stem} {size}{', foveated' * (gaze != 'none')}", render(
        request.model, request.camera, config=config, foveation=request.foveation, background=request.background)


@cache
def traced_frames(config: AcceleratorConfig, size: str, trained: tuple[str, ...] = TRAINED) -> dict[str, Frame]:
    """Frames by name: of the embedded scene and of those trained scenes that are present, each without foveation and, where the
    configuration has more than one level, with it."""
    gazes = (("none", None), ("50,40", config.levels))[: 1 + (config.levels > 1)]
    paths = filter(None, map(scene_path, ("embedded", *trained)))
    return dict(traced_frame(config, path, size, *gaze) for path in paths for gaze in gazes)


def traced_size(config: AcceleratorConfig, size: str, small: str = "160x96") -> str:
    """The size of a suite's traced frames: `small` where the machine's rows are short, `size` otherwise."""
    return small if config.row_width < 640 else size
