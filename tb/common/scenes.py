"""Frames of real scenes, rendered by the golden renderer, from which units get realistic stimuli."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from golden.msv2_ref.joint import JointFrame, render_joint
from golden.msv2_ref.pipeline import Frame, render
from golden.scenes.captured import scene_argument
from golden.scenes.level_source import RANDOM
from golden.scenes.request import parse_request, resolve
from golden.scenes.stereo import stereo_pair
from spec.config import AcceleratorConfig

TRAINED = ("truck", "rock_sh3")
"""Captured scenes whose frames the suites play if they are present."""


def traced_frame(
    config: AcceleratorConfig, scene: str, size: str, gaze: str = "none", levels: int | None = None,
) -> tuple[str, Frame]:
    """The name and the frame of a scene at a size such as "640x360". `gaze` is "x,y" or "none".

    `scene` is what golden.scenes.captured.scene_argument returns.
    """
    more = () if levels is None else ("--levels", str(levels), "--levels-from", RANDOM)
    request = resolve(parse_request(scene, "--size", size, "--gaze", gaze, "--background", "0.2,0.5,0.9", *more))
    return f"{Path(scene).stem} {size}{', foveated' * (gaze != 'none')}", render(
        request.model, request.camera, config=config, foveation=request.foveation, background=request.background)


@cache
def traced_frames(config: AcceleratorConfig, size: str, trained: tuple[str, ...] = TRAINED) -> dict[str, Frame]:
    """Frames by name: of the embedded scene and of those trained scenes that are present, each without foveation and, where the
    configuration has more than one level, with it."""
    gazes = (("none", None), ("50,40", config.levels))[: 1 + (config.levels > 1)]
    paths = filter(None, map(scene_argument, ("embedded", *trained)))
    return dict(traced_frame(config, path, size, *gaze) for path in paths for gaze in gazes)


def traced_joint_frames(config: AcceleratorConfig, size: str) -> dict[str, JointFrame]:
    """Joint frames of the embedded scene by name: with colours of each eye and without foveation, and with the source's colours
    and with foveation where the configuration has more than one level; each with another shift."""
    found = {}
    for gaze, shared, shift in ((("none", None), False, None), (("50,40", config.levels), True, 3)):
        more = () if gaze[1] is None else ("--levels", str(gaze[1]), "--levels-from", RANDOM)
        request = resolve(parse_request("embedded", "--size", size, "--gaze", gaze[0], "--background", "0.2,0.5,0.9", *more))
        found[f"joint embedded {size}{', foveated' * shared}"] = render_joint(
            request.model, stereo_pair(request.camera), config=config, foveation=request.foveation,
            background=request.background, shared_colour=shared, shift=shift)
    return found


def traced_size(config: AcceleratorConfig, size: str, small: str = "160x96") -> str:
    """The size of a suite's traced frames: `small` where the machine's rows are short, `size` otherwise."""
    return small if config.row_width < 640 else size
