"""Frames of scenes through the golden renderer: what units meet in earnest."""

from __future__ import annotations

import argparse
import os
from functools import cache
from pathlib import Path

from golden.msv2_ref.pipeline import Frame, render
from golden.scenes.request import resolve
from spec.config import AcceleratorConfig
from tb.common.runner import ROOT

TRAINED = ("truck.splat", "rock_sh3")


@cache
def traced_frames(config: AcceleratorConfig, size: str, trained: tuple[str, ...] = TRAINED) -> dict[str, Frame]:
    """Frames by name: of the embedded scene, and of those of the trained ones that are there, without a gaze and with one."""
    folder = Path(os.environ.get("MSV2_DATA", ROOT.parent / "shared" / "data")) / "trained"
    scenes = ["embedded", *(str(folder / name) for name in trained if (folder / name).exists())]
    frames = {}
    for scene in scenes:
        for gaze, levels in (("none", None), ("50,40", config.levels))[: 1 + (config.levels > 1)]:
            request = resolve(argparse.Namespace(
                scene=scene, size=size, camera="orbit", gaze=gaze, levels=levels, background="0.2,0.5,0.9", seed=0))
            name = f"{Path(scene).stem} {size}{', foveated' * (gaze != 'none')}"
            frames[name] = render(
                request.model, request.camera, config=config, foveation=request.foveation, background=request.background)
    return frames
