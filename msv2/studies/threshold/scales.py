"""Assumed units per metre of scenes whose scale was never measured, from the size of a known object in them.

Structure from motion gives no scale, but disparities depend on it. `msv2/studies/metric_scale/study.py` computes the scale if
there is a metric depth map. Otherwise the table uses the values here, by the scene's name, and its JSON says so.
"""

from __future__ import annotations

from golden.scenes.stereo import scene_scale

ASSUMED = {
    "truck": (0.15, "front bumper 0.29 units, taken for 1.9 m; wheels 0.117 units, taken for 0.78 m"),
    "garden_large": (1.0, "the ground lies 1.4 units below the capture's origin, a hand-held scanner's height: metres"),
    "bonsai": (6.0, "the bicycle's wheel, 0.67 m, is 2.5 units from view 216 and 6.3 from view 0: the reconstruction has no "
                    "one scale; between 3.8 and 9.4 units per metre"),
}
"""By the scene's name, the units per metre and the reason for the value."""


def table_scale(scene: str, given: float | None) -> dict[str, object]:
    """The units per metre of a scene and their origin: "given", "known" or "assumed", with the reason.

    Args:
        scene: the scene's name.
        given: the value from the user, or None.
    """
    if given is None and scene in ASSUMED:
        units, reason = ASSUMED[scene]
        return {"units_per_metre": units, "scale": "assumed", "reason": reason}
    units, warning = scene_scale(scene, given)
    if given is not None:
        return {"units_per_metre": units, "scale": "given", "reason": None}
    return {"units_per_metre": units, "scale": "assumed" if warning else "known", "reason": warning}
