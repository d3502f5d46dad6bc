"""Quality and cost of levels: HVSQ of each level and of each region of a foveated frame, and the intersections of a frame.

The measures are the same for the nested levels of one model and for separate models, one for each level.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch

from golden.diff.gaussians import Gaussians, to_model
from golden.diff.render import render, render_foveated
from golden.host.quantise import quantise_model
from golden.host.registers import frame_registers
from golden.metrics.hvsq import Hvsq, foveated
from golden.metrics.level_pooling import LevelPooling
from golden.msv2_ref import projection, sort, tile_merge, tile_test
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, FoveationMap, foveation_map, no_foveation, region_level
from golden.scenes.model import GaussianModel
from golden.training.foveated import FoveatedModel, Storage, level_alpha_max
from spec.config import PAPER, AcceleratorConfig
from spec.constants import ALPHA_MAX_L1

if TYPE_CHECKING:
    from golden.training.scene import TrainingScene


class Levels(Protocol):
    """One to four levels: a `FoveatedModel` or `SeparateModels`."""

    @property
    def levels(self) -> int:
        """Number of levels."""

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of points of each level."""

    @property
    def storage(self) -> Storage:
        """Storage in bytes."""

    def level(self, index: int) -> Gaussians:
        """The Gaussians of a level (0-based)."""


@dataclass(frozen=True)
class FrameCost:
    """The cost of a foveated frame on the machine.

    Attributes:
        entries: number of intersections. In a tile that blends two levels, a splat counts once for nested levels, and once for
            each model for separate ones.
        groups: number of merged groups of tiles that have intersections.
        projected: number of Gaussians read and projected.
    """

    entries: int
    groups: int
    projected: int


def reference_image(
    scene: TrainingScene, view: int, dense: Gaussians | None, device: torch.device | str
) -> torch.Tensor:
    """(H, W, 3) float32 in 0..1: the photograph of a view or, if `dense` is given, that model's render, with the photograph's
    pixels where the view's mask hides them."""
    if dense is None:
        return scene.photograph(view).to(device)
    with torch.no_grad():
        return scene.unmasked(view, render(dense, scene.cameras[view], alpha_max=ALPHA_MAX_L1).image.clamp(0.0, 1.0).to(device))


def mean_hvsq(
    gaussians: Gaussians, scene: TrainingScene, views: Sequence[int], hvsq: Callable[[int], Hvsq], alpha_max: float
) -> tuple[float, float]:
    """Mean HVSQ of one level's whole images and its mean number of intersections per frame, see `view_hvsq`."""
    values, entries = view_hvsq(gaussians, scene, views, hvsq, alpha_max)
    return float(values.mean()), entries


def view_hvsq(
    gaussians: Gaussians, scene: TrainingScene, views: Sequence[int], hvsq: Callable[[int], Hvsq], alpha_max: float
) -> tuple[np.ndarray, float]:
    """(V,) HVSQ of one level's whole image in each view, clamped as on a display, and its mean number of intersections per
    frame.

    Args:
        gaussians: the level.
        scene: the scene.
        views: indices into the scene's cameras.
        hvsq: gives a view's `Hvsq` against its reference.
        alpha_max: upper bound of alpha.
    """
    values = []
    with torch.no_grad():
        for view in views:
            rendering = render(gaussians, scene.cameras[view], alpha_max=alpha_max)
            values.append((float(hvsq(view)(scene.unmasked(view, rendering.image.clamp(0.0, 1.0)))), rendering.entries))
    table = np.array(values)
    return table[:, 0], float(table[:, 1].mean())


def level_hvsq(
    levels: Levels, scene: TrainingScene, views: Sequence[int], dense: Gaussians | None = None,
    pooling: LevelPooling | None = None,
) -> tuple[float, ...]:
    """HVSQ of each level's whole images at its own pooling, mean over views: the rows of the paper's table.

    Args:
        levels: the levels.
        scene: the scene.
        views: indices into the scene's cameras.
        dense: a model whose renders are the reference instead of the photographs.
        pooling: HVSQ's pooling; None: the default of `LevelPooling`.
    """
    pooling = pooling or LevelPooling()
    return tuple(_one_level_hvsq(levels, level, scene, views, dense, pooling) for level in range(levels.levels))


def _one_level_hvsq(
    levels: Levels, level: int, scene: TrainingScene, views: Sequence[int], dense: Gaussians | None,
    pooling: LevelPooling,
) -> float:
    gaussians = levels.level(level)

    def hvsq(view: int) -> Hvsq:
        return pooling.hvsq(reference_image(scene, view, dense, gaussians.device), level)

    return mean_hvsq(gaussians, scene, views, hvsq, level_alpha_max(level))[0]


def region_hvsq(
    levels: Levels, scene: TrainingScene, views: Sequence[int], dense: Gaussians | None = None
) -> tuple[float, ...]:
    """HVSQ of each quality region of foveated frames, mean over views, with the gaze in the centre and pooling by eccentricity.

    It is nan for a region into which no pixel of the frame falls.

    Args:
        levels: the levels.
        scene: the scene.
        views: indices into the scene's cameras.
        dense: a model whose renders are the reference instead of the photographs.
    """
    camera = scene.cameras[views[0]]
    foveation = centre_foveation(camera, levels.levels)
    eccentricity = foveation.display.eccentricity(foveation.gaze_xy)
    shown, each = [levels.level(level) for level in range(levels.levels)], []
    region = torch.from_numpy(region_level(eccentricity, levels.levels)).to(shown[0].device)
    masks = {level: region == level for level in range(levels.levels) if bool((region == level).any())}
    for view in views:
        with torch.no_grad():
            image = scene.unmasked(view, render_foveated(shown, scene.cameras[view], foveation).clamp(0.0, 1.0))
            hvsq = foveated(reference_image(scene, view, dense, image.device), eccentricity)
            found = dict(zip(masks, hvsq.regions(image, list(masks.values())).tolist(), strict=True))
        each.append([found.get(level, np.nan) for level in range(levels.levels)])
    return tuple(np.mean(each, axis=0).tolist())


def centre_foveation(camera: Camera, levels: int) -> FoveationMap:
    """The foveation map of a frame with the gaze in its centre, on a display of its size."""
    return foveation_map(Display(camera.width, camera.height), (camera.width / 2, camera.height / 2), levels)


def frame_cost(levels: Levels, camera: Camera, config: AcceleratorConfig = PAPER) -> FrameCost:
    """Intersections and groups of a frame of the integer renderer, with the gaze in the centre.

    With separate models, each is projected on its own, and each lists its own Gaussians in the tiles that show its level.
    """
    foveation = centre_foveation(camera, levels.levels)
    up = np.array([0.0, -1.0, 0.0])  # required by the model, but renderers do not read it
    if isinstance(levels, FoveatedModel):
        counts = [_tile_counts(levels.to_model(up=up, name="levels"), camera, foveation, config)]
        projected = len(levels.base)
    else:
        counts, projected, plain = [], sum(levels.counts), no_foveation(foveation.display)
        for level in range(levels.levels):
            shown = (foveation.tile_level == level) | (foveation.blend & (foveation.tile_level + 1 == level))
            all_tiles = _tile_counts(to_model(levels.level(level), up=up, name="level"), camera, plain, config)
            counts.append(np.where(shown.ravel(), all_tiles, 0))
    groups = 0
    for tiles in counts:
        merged = tile_merge.merge_tiles(tiles, foveation.tiles_x, tile_merge.auto_beta(tiles, config))
        groups += len(np.unique(merged[tiles > 0]))
    return FrameCost(int(sum(tiles.sum() for tiles in counts)), groups, projected)


def _tile_counts(model: GaussianModel, camera: Camera, foveation: FoveationMap, config: AcceleratorConfig) -> np.ndarray:
    """(tiles,) int64 number of intersections in each tile of the integer renderer's frame; pixels are not computed."""
    words = quantise_model(config, model)
    registers = frame_registers(config, camera, words, foveation, (0.0, 0.0, 0.0))
    projected = projection.project(config, words, registers)
    order = sort.depth_order(projected.depth_key, projected.reason == projection.VISIBLE)
    opacity = tile_test.tested_opacity(config, words.geometry["log2_opacity"], words.decoded.opacity)
    entries = tile_test.tile_intersections(config, projected, opacity, words.geometry["bound"], registers, order)
    return np.diff(entries.start)
