"""Small frames of two eyes: their target pixels are rendered, warped, filled or left as holes in every combination."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from golden.msv2_ref.eyes import render_stereo
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.model import GaussianModel
from golden.scenes.stereo import stereo_pair
from spec.config import AcceleratorConfig
from spec.constants import ECC_THRESHOLD_DEG
from tb.top.stimuli import Case, camera_of, cloud, clusters, crowd


def stereo_case(
    config: AcceleratorConfig, name: str, model: GaussianModel, size: tuple[int, int], *, baseline: float = 0.1,
    source_eye: str = "left", threshold_deg: float = ECC_THRESHOLD_DEG, gaze: tuple[float, float] | None = None,
    gaze_target: tuple[float, float] | None = None, beta: int | None = None, obb: bool = False,
    background: tuple[float, float, float] = (0.2, 0.5, 1.0),
) -> Case:
    """The golden frame of a model. A `gaze` in pixels turns foveation on in both eyes; `baseline` is in world units."""
    foveation = None if gaze is None else foveation_map(Display(*size), gaze, model.levels)
    pair = stereo_pair(camera_of(*size), ipd_metres=baseline, source_eye=source_eye)
    frame = render_stereo(
        model, pair, config=config, foveation=foveation, threshold_deg=threshold_deg, gaze_target=gaze_target,
        background=background, beta=beta, obb=obb)
    return Case(name, frame, beta, obb)


def wall(rng: np.random.Generator, count: int, levels: int) -> GaussianModel:
    """A slightly oblique wall without gaps and `count` blobs in front of it, so that both eyes see mostly the same surfaces."""
    model = cloud(rng, 24 * 16 + count, levels=levels, sh=1)
    x, y = (grid.reshape(-1) for grid in np.meshgrid(np.linspace(-9, 9, 24), np.linspace(-7, 7, 16)))
    front = rng.uniform((-3, -2, 2), (3, 2, 4), (count, 3))
    means = np.concatenate([np.stack([x, y, 7 + 0.1 * x + rng.normal(0, 0.02, x.shape)], 1), front])
    log_scales = np.log(np.where(np.arange(len(means)) < len(x), 0.7, 0.12))[:, None].repeat(3, 1)
    bound = np.where(np.arange(len(means)) % 3 == 0, model.quality_bound, levels).astype(np.uint8)
    return replace(model, means=means, log_scales=log_scales, opacity=np.full_like(model.opacity, 0.97), quality_bound=bound)


def veil(rng: np.random.Generator) -> GaussianModel:
    """A faint layer in front of everything, which makes pixels that are neither background nor solid."""
    model = cloud(rng, 3)
    return replace(
        model, means=np.array([[0.1, -0.2, 3.0]] * 3), log_scales=np.full((3, 3), 2.0),
        opacity=np.full_like(model.opacity, 0.1))


def aside(model: GaussianModel, baseline: float) -> GaussianModel:
    """The model, moved so that the right eye sees it where the left eye would have seen it; the left eye does not see it."""
    rotation = camera_of(16, 16).rotation
    return replace(model, means=model.means + baseline * rotation[0])


def stereo_cases(config: AcceleratorConfig, seed: int) -> list[Case]:
    """Small frames of two eyes, of every kind."""
    rng, levels = np.random.default_rng(seed), config.levels
    chunk, widest = config.sort_chunk, config.row_width
    scene, plain, solid = cloud(rng, 250, levels=levels, sh=1), cloud(rng, 120, sh=1), wall(rng, 4, levels)

    def make(name: str, model: GaussianModel = scene, size: tuple[int, int] = (90, 60), **options: object) -> Case:
        return stereo_case(config, name, model, size, **options)

    chunks = []
    if config.chunks:
        chunks = [make("clusters", clusters(rng, 40, 70, levels), gaze=(45, 30), baseline=0.4, threshold_deg=20)]
    return [
        *chunks,
        make("gaze in the middle", solid, gaze=(45, 30)),
        make("right eye first, gaze at the side", solid, gaze=(80, 20), source_eye="right"),
        make("two gazes", solid, gaze=(5, 5), gaze_target=(70, 50), baseline=0.2),
        make("all may be warped", solid, threshold_deg=0, gaze=(45, 30), baseline=0.3),
        make("hardly any disparity", solid, threshold_deg=0, baseline=0.01),
        make("holes everywhere", gaze=(45, 30)),
        make("right eye first, all may be warped", plain, threshold_deg=0, source_eye="right", beta=0),
        make("nothing may be warped", plain, threshold_deg=180, beta=60),
        make("no depth", veil(rng), (70, 40)),
        make("no Gaussians, nothing rendered", cloud(rng, 0), (70, 40), threshold_deg=0),
        make("no Gaussians", cloud(rng, 0), (40, 40), threshold_deg=30),
        make("disparities beyond the frame", plain, (70, 40), baseline=30.0, threshold_deg=10),
        make("disparities of nothing", plain, (70, 40), baseline=1e-6, threshold_deg=10),
        make("one pixel", plain, (1, 1), threshold_deg=0),
        make("odd size", plain, (17, 19), threshold_deg=20, obb=True),
        make("widest row", solid, (widest, 20), threshold_deg=15),
        make("one column", plain, (3, 70), threshold_deg=25),
        make("groups that spill in the target eye", aside(crowd(rng, 3 * chunk), 1.0), (48, 32), baseline=1.0,
             threshold_deg=180),
        make("groups that spill in the source eye", crowd(rng, 2 * chunk + 5), (48, 32), baseline=0.01, threshold_deg=0),
    ]
