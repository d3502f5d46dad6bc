"""Measures a setting on a scene: quality of its frames, cycles by the model, and energy."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.util import find_spec

import numpy as np

from golden.metrics.image import max_abs_error, psnr, psnr_vs, ssim
from golden.metrics.rings import ring_errors
from golden.msv2_ref import pipeline
from golden.msv2_ref.eyes import render_stereo
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.stereo import stereo_pair
from msv2.studies.energy.frame import load_table
from msv2.studies.energy.modelled import modelled_energy
from msv2.studies.memory import IDEAL, IDEAL_CYCLES, LPDDR3, memory_arguments
from msv2.studies.tradeoff.knobs import Setting
from msv2.studies.tradeoff.scene import SceneRequest, TradeoffScene, load
from perf.frames import simulate, trace_of
from perf.model import MemoryModel
from spec.constants import REGION_START_DEG

CLOCK_HZ = 1e9


def measure(request: SceneRequest, setting: Setting) -> dict[str, object]:
    """The means of a setting over the request's cameras.

    Returns:
        psnr_oracle_db, max_abs_error: against the float64 renderer's level 1; for two eyes, of the second eye alone.
        psnr_photo_db, ssim_photo: against the photographs; None without them.
        hvsq, hvsq_regions: of the frame, and by region around its middle, against the photographs, or else against the float64
            renderer; None without torch.
        ring_psnr_db, ring_max_error: by eccentricity, against the float64 renderer.
        cycles, entries, fps, chip_mj, dram_mj: of a frame, by the cycle model with LPDDR3.
        ideal_cycles: of the same frame with the ideal memory, a bound.
    """
    scene = load(request)
    rows = [_view(scene, view, setting) for view in range(len(scene.cameras))]
    return {name: _mean([row[name] for row in rows]) for name in rows[0]}


def tried(request: SceneRequest, setting: Setting) -> dict[str, object]:
    """The result of `measure`, or the reason why the setting cannot be measured."""
    try:
        return measure(request, setting)
    except (ValueError, AssertionError, OverflowError) as failure:  # formats that do not fit together are a result, too
        return {"error": f"{type(failure).__name__}: {failure}"}


def _mean(values: Iterable[object]) -> object:
    values = list(values)
    if isinstance(values[0], list):
        return [_mean(column) for column in zip(*values, strict=True)]
    if any(value is None for value in values):
        return None
    return float(np.mean(values))


def _view(scene: TradeoffScene, view: int, setting: Setting) -> dict[str, object]:
    source = scene.cameras[view]
    display = Display(source.width, source.height)
    centre = source.width / 2, source.height / 2
    model = scene.model(setting.variant, setting.levels, setting.sh_degree)
    foveation = foveation_map(display, centre, setting.levels) if setting.levels > 1 else None
    camera = source
    if setting.threshold_deg is None:
        frame = pipeline.render(model, source, config=setting.config, foveation=foveation, obb=setting.obb)
        image = frame.image
    else:
        pair = stereo_pair(source, units_per_metre=scene.request.units_per_metre)
        frame = render_stereo(model, pair, config=setting.config, threshold_deg=setting.threshold_deg, gaze=centre)
        image, camera = frame.target_pixels["colour"] / 255.0, pair.target
    trace = trace_of(frame)
    cycles, ideal = (simulate(trace, setting.config, memory=MemoryModel(**memory_arguments(memory)))
                     for memory in (LPDDR3, IDEAL))
    energy = modelled_energy(trace, cycles, setting.config, load_table(), clock_hz=CLOCK_HZ)
    return {
        **quality(image, scene.ideal(camera, setting.variant), scene.photograph(view, camera), display.eccentricity(centre)),
        "cycles": cycles.total, IDEAL_CYCLES: ideal.total, "geometry_cycles": cycles.phases["geometry"],
        "render_cycles": cycles.phases["render"], "entries": cycles.entries, "fps": CLOCK_HZ / cycles.total,
        "chip_mj": energy.chip_mj, "dram_mj": energy.sum_mj("dram")}


def quality(
    image: np.ndarray, ideal: np.ndarray, photograph: np.ndarray | None, eccentricity_deg: np.ndarray,
) -> dict[str, object]:
    """The quality of an image, under the keys of `measure`. Images are (H, W, 3) floats in 0..1, eccentricities (H, W)."""
    shown = np.clip(image, 0.0, 1.0)
    rings = ring_errors(image, ideal, eccentricity_deg)
    out = {
        "psnr_oracle_db": min(psnr_vs(image, ideal), 200.0), "max_abs_error": max_abs_error(image, ideal),
        "psnr_photo_db": None, "ssim_photo": None, "hvsq": None, "hvsq_regions": [None] * len(REGION_START_DEG),
        "ring_psnr_db": [None if np.isnan(ring.psnr_db) else min(ring.psnr_db, 200.0) for ring in rings],
        "ring_max_error": [None if np.isnan(ring.max_abs_error) else ring.max_abs_error for ring in rings]}
    if photograph is not None:
        out["psnr_photo_db"], out["ssim_photo"] = psnr(shown, photograph), ssim(shown, photograph)
    if find_spec("torch") is not None and min(image.shape[:2]) >= 32:
        from golden.metrics.regions import region_hvsq

        truth = ideal if photograph is None else photograph
        out["hvsq"], out["hvsq_regions"] = region_hvsq(image, truth, eccentricity_deg, REGION_START_DEG)
    return out


