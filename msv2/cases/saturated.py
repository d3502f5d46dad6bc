"""Case 33, the counters: values beyond their formats are clamped, and each kind is counted."""

from __future__ import annotations

from golden.msv2_ref.saturations import frame_saturations
from msv2.cases.case import Renderer, Shot, Shots, require, scene_case
from msv2.cases.makers import splats, view
from spec.saturations import SATURATIONS

WANTED = {
    "none": {},
    "colours": {"saturated_colours": 3, "saturated_depths": 1},
    "next level's colours": {"saturated_colours": 2, "saturated_depths": 2},
    "depths": {"saturated_depths": 2},
    "keys": {"saturated_depths": 1, "saturated_keys": 2},
    "means": {"saturated_means": 3, "saturated_depths": 1},
    "culled": {"saturated_depths": 1},
}
"""Counts by shot, of those that are not 0. The farthest visible splat has the largest depth unless an outlier lies behind
it."""


def _levels_apart() -> Shot:
    """Two splats in tiles of levels 1 and 2. One is too bright at level 2, which its splat records of both levels contain."""
    model = splats((-0.2, 0, 2), (0.2, 0, 2), scale=4.0, opacity=0.5, colour=0.5, levels=2)
    model.sh_dc[0, 1] = 20.0
    return Shot(model, view(512, 16), gaze=(10.0, 8.0), rim=None)


def _shots(renderer: Renderer) -> Shots:
    bright = splats((0, 0, 2), (0.3, 0, 3), (-0.3, 0, 3), (0, 0, 4), scale=0.4, opacity=0.5,
                    colour=((40, 0.5, 0.5), (0.5, -3, 2), (0.5, 0.5, 1.9), (0, 9, 9)))
    near = splats((0, 0, 2), (0, 0, 3), scale=0.4, opacity=((0.8,), (0.001,)))
    # The scale of depths is fitted to the splats inside the frame. The last one lies beside it and reaches in, beyond the
    # scale.
    far = splats((0, 0, 2), (0, 0, 3), (0, 0, 50), (60, 0, 50), scale=[[0.4] * 3] * 2 + [[12.5] * 3] * 2, opacity=0.5)
    farther = splats(*[(0, 0, z) for z in (2, 2, 3, 1e12, 1e30)], scale=0.4, opacity=0.5)
    aside = splats((0, 0, 2), (110, 0, 0.3), (-110, 0, 0.3), (0, -110, 0.3), (10, 0, 0.3), scale=[[0.5] * 3, *[[60] * 3] * 4],
                   opacity=0.5)
    unseen = splats((0, 0, 2), (110, 0, 0.3), (0, 0, -1e30), (3e30, 0, 1e30), scale=0.1, colour=((1, 1, 1), *[(9, 9, 9)] * 3))
    models = {"none": near, "colours": bright, "depths": far, "keys": farther,
              "means": aside, "culled": unseen}
    shots = {name: Shot(model, view(), rim=None) for name, model in models.items()}
    return {**shots, "next level's colours": _levels_apart()}


@scene_case(
    33, "saturations-are-counted", "colours, depths, depth keys and means beyond the largest that their formats hold",
    "as many as there are, by kind, once for each splat or view; none of culled points", shots=_shots, columns=("golden",),
    absent={"oracle": "has no formats", "gradient": "has no formats"})
def SATURATIONS_ARE_COUNTED(album, renderer, shots):
    for name, seen in album.items():
        wanted = {saturation.name: 0 for saturation in SATURATIONS} | WANTED[name]
        got = frame_saturations(seen.frame)
        require(got == wanted, f"{name}: counts must be {wanted}, not {got}")


CASES = (SATURATIONS_ARE_COUNTED,)
