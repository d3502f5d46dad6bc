"""Small scenes that exercise all features of the machine, and their golden frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from golden.msv2_ref import pipeline
from golden.msv2_ref.eyes import StereoFrame
from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.joint_warp import WarpedJointFrame
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.model import SH_REST_COUNT, GaussianModel
from spec.chunks import CHUNK
from spec.config import AcceleratorConfig


@dataclass(frozen=True)
class Case:
    """A golden frame, of one eye or of two, and the parameters with which it was rendered.

    Attributes:
        name: the case's name, for messages.
        frame: the golden frame.
        beta: the merge threshold; None for the automatic one.
        obb: whether bounding boxes replace the exact tile test.
    """

    name: str
    frame: pipeline.Frame | StereoFrame | JointFrame | WarpedJointFrame
    beta: int | None
    obb: bool


def camera_of(width: int, height: int) -> Camera:
    """A slightly turned camera whose principal point is off the centre."""
    turn = np.deg2rad(7)
    rotation = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    focal = 0.8 * max(width, height, 16)
    return Camera(rotation, np.array([0.1, -0.2, 0.3]), focal, 1.1 * focal, 0.55 * width, 0.45 * height, width, height)


def cloud(rng: np.random.Generator, count: int, *, levels: int = 1, sh: int = 0, wild: bool = False) -> GaussianModel:
    """Gaussians in front of the camera and some behind it, some with equal depths. `wild` ones range from needles to giants."""
    means = rng.uniform((-4, -3, -1), (4, 3, 9), (count, 3))
    means[: count // 4, 2] = np.round(means[: count // 4, 2])
    return _model(rng, means, rng.uniform(np.log(1e-6), np.log(1e2), (count, 3)) if wild else rng.normal(-2, 0.8, (count, 3)),
                  levels, sh)


def crowd(rng: np.random.Generator, count: int) -> GaussianModel:
    """Small faint Gaussians that all lie behind each other."""
    z = np.exp(rng.uniform(np.log(1), np.log(50), count))
    means = np.stack([rng.normal(0, 0.02, count) * z, rng.normal(0, 0.02, count) * z, z], 1)
    return _model(rng, means, np.log(0.02 * z)[:, None] + rng.normal(0, 0.2, (count, 3)), 1, 0, faint=True)


def clusters(rng: np.random.Generator, count: int, size: int, levels: int) -> GaussianModel:
    """`count` tight clusters of `size` Gaussians in all directions from the camera, near and far, so that whole chunks lie
    behind it, beside the frame, in tiles whose level none of their Gaussians has, and around the camera itself."""
    centres = camera_of(16, 16).position + rng.uniform((-9, -7, -6), (9, 7, 12), (count, 3))
    centres[0] = camera_of(16, 16).position
    means = (centres[:, None] + rng.normal(0, 0.15, (count, size, 3))).reshape(-1, 3)
    model = _model(rng, means, rng.normal(-3, 0.5, (len(means), 3)), levels, 1)
    return replace(model, quality_bound=np.repeat(model.quality_bound[:count], size))


def _model(rng: np.random.Generator, means: np.ndarray, log_scales: np.ndarray, levels: int, sh: int,
           faint: bool = False) -> GaussianModel:
    count = len(means)
    opacity = rng.uniform(0.01, 0.05 if faint else 1, (count, levels)) * np.geomspace(1, 8, levels)
    return GaussianModel(
        means=means, log_scales=log_scales, quats=rng.normal(size=(count, 4)), opacity=opacity,
        sh_dc=rng.normal(0, 1.2, (count, levels, 3)), sh_rest=rng.normal(0, 0.2, (count, SH_REST_COUNT[sh], 3)),
        quality_bound=rng.integers(1, levels + 1, count).astype(np.uint8))


def case(
    config: AcceleratorConfig, name: str, model: GaussianModel, size: tuple[int, int], *, beta: int | None = None,
    gaze: tuple[float, float] | None = None, background: tuple[float, float, float] = (0.2, 0.5, 1.0), obb: bool = False,
) -> Case:
    """The golden frame of a model. A `gaze` in pixels turns foveation on."""
    foveation = None if gaze is None else foveation_map(Display(*size), gaze, model.levels)
    frame = pipeline.render(
        model, camera_of(*size), config=config, foveation=foveation, background=background, beta=beta, obb=obb)
    return Case(name, frame, beta, obb)


def chunk_cases(config: AcceleratorConfig, rng: np.random.Generator) -> list[Case]:
    """Frames of models with many chunks: most are read, few, or none."""
    levels = config.levels
    scene, full = clusters(rng, 40, 70, levels), clusters(rng, 6, CHUNK, 1)
    giant = replace(scene, log_scales=np.where(np.arange(len(scene))[:, None] % 500 == 3, 2.0, scene.log_scales))
    behind = replace(full, means=full.means - [0, 0, 1e3])
    faint = replace(full, opacity=np.zeros_like(full.opacity))
    return [
        case(config, "clusters", scene, (64, 48)),
        case(config, "clusters, gaze", scene, (90, 60), **({"gaze": (80, 10)} if levels > 1 else {})),
        case(config, "clusters with giants", giant, (64, 48)),
        case(config, "full chunks", full, (64, 48)),
        case(config, "all behind", behind, (40, 20)),
        case(config, "all faint", faint, (40, 20)),
    ]


def small_cases(config: AcceleratorConfig, seed: int) -> list[Case]:
    """Small frames of every kind."""
    rng, levels = np.random.default_rng(seed), config.levels
    chunk, widest = config.sort_chunk, config.row_width
    cases = [case(config, f"SH degree {sh}", cloud(rng, 150, sh=sh), (48, 33)) for sh in SH_REST_COUNT]
    scene = cloud(rng, 250, levels=levels, sh=1)
    gazes = {"in a corner": (0, 0), "in the middle": (45, 30), "at the side": (89, 20)} if levels > 1 else {}
    cases += [case(config, f"gaze {place}", scene, (90, 60), gaze=gaze) for place, gaze in gazes.items()]
    cases += [case(config, f"beta {beta}", scene, (90, 60), beta=beta) for beta in (0, 1, 60, 100_000)]
    cases += chunk_cases(config, rng) if config.chunks else []
    cases += [
        case(config, "bounding boxes", scene, (90, 60), obb=True),
        case(config, "needles and giants", cloud(rng, 120, wild=True), (64, 64)),
        case(config, "no Gaussians", cloud(rng, 0), (40, 20)),
        case(config, "one Gaussian", crowd(rng, 1), (40, 20)),
        case(config, "none in view", cloud(rng, 70).select(np.zeros(70, np.intp)), (16, 16)),
        case(config, "one pixel", cloud(rng, 60), (1, 1)),
        case(config, "odd size", cloud(rng, 60), (17, 19)),
        case(config, "widest row", cloud(rng, 80), (widest, 5)),
        case(config, "highest column", cloud(rng, 80), (3, min(widest, 512))),
        case(config, "a chunk and one more", crowd(rng, chunk + 1), (16, 16)),
        case(config, "groups that spill", crowd(rng, 3 * chunk + chunk // 3), (48, 32)),
    ]
    return cases
