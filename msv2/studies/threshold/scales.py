"""Units per metre of scenes whose scale nobody measured: assumed from the size of a known thing in them.

Structure from motion has no scale, and disparities follow from it alone. `msv2/studies/metric_scale/study.py` computes it
where a metric depth map is there; where none is, the table takes these, by the scene's name, and its JSON says so.
"""

from __future__ import annotations

from golden.scenes.stereo import scene_scale

ASSUMED = {
    "truck": (0.15, "front bumper 0.29 units, taken for 1.9 m; wheels 0.117 units, taken for 0.78 m"),
    "garden_large": (1.0, "the ground lies 1.4 units below the capture's origin, a hand-held scanner's height: metres"),
    "bonsai": (6.0, "the bicycle's wheel, 0.67 m, is 2.5 units from view 216 and 6.3 from view 0: the reconstruction has no "
                    "one scale; between 3.8 and 9.4 units per metre"),
}
"""By name: units per metre, and what they rest on."""


def table_scale(scene: str, given: float | None) -> dict[str, object]:
    """Units per metre of a scene and where they come from: "given", "known" or "assumed", and why.

    Args:
        scene: its name.
        given: what the user says, if anything.
    """
    if given is None and scene in ASSUMED:
        units, reason = ASSUMED[scene]
        return {"units_per_metre": units, "scale": "assumed", "reason": reason}
    units, warning = scene_scale(scene, given)
    if given is not None:
        return {"units_per_metre": units, "scale": "given", "reason": None}
    return {"units_per_metre": units, "scale": "assumed" if warning else "known", "reason": warning}
