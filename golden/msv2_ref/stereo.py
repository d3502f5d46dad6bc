"""A frame of two eyes: the source rendered, its pixels warped, the target's fovea and holes rendered over them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from golden.msv2_ref import pipeline, warp_unit
from golden.msv2_ref.quantise import GaussianWords, quantise_model
from golden.msv2_ref.registers import FrameRegisters
from golden.msv2_ref.views import display_pixels, frame_pixels
from golden.scenes.gaze import Display, FoveationMap, foveation_map, no_foveation
from golden.scenes.model import GaussianModel
from golden.scenes.stereo import StereoPair, check_gaze, target_gaze, warpable_tiles
from spec.config import AcceleratorConfig
from spec.constants import ECC_THRESHOLD_DEG, TILE
from spec.errors import InputError
from spec.formats import Rounding
from spec.stereo import (
    DISPARITY_SCALE_BITS,
    DISPARITY_SCALE_FRAC,
    background_transmittance,
    reach,
    solid_transmittance,
)

RENDERED, RERENDERED, WARPED, BACKGROUND, FILLED = range(5)
"""Where a pixel of the target comes from: a tile that had to be rendered, one rendered for its holes, the source, the source's
background, its neighbours."""

KINDS = {"rendered": RENDERED, "rerendered": RERENDERED, "warped": WARPED, "background": BACKGROUND, "filled": FILLED}


@dataclass(frozen=True)
class StereoRegisters:
    """What the host writes besides the source eye's registers.

    Attributes:
        target: the target eye's registers: the source's with its own position and table.
        warp: (tiles,) int64, bit `warp` of the target's table.
        disparity_scale: disparity in pixels where depth saturates, raw.
        source_right: the source is the right eye.
    """

    target: FrameRegisters
    warp: np.ndarray
    disparity_scale: int
    source_right: bool


@dataclass(frozen=True)
class StereoFrame:
    """A frame of two eyes.

    Attributes:
        pair: the cameras.
        registers: what the host wrote for the second eye.
        source: the source eye's frame.
        warped: what the warp unit made of it.
        rendered: (tiles,) bool, tiles of the target that were rendered.
        target: the target eye's frame, of those tiles alone.
        gaze: the source's and the target's gaze in pixels.
        foveation: the target's tile levels and planes.
        threshold_deg: eccentricity beyond which tiles may be warped.
        warnings: what the user should know.
    """

    pair: StereoPair
    registers: StereoRegisters
    source: pipeline.Frame
    warped: warp_unit.WarpedFrame
    rendered: np.ndarray
    target: pipeline.Frame
    gaze: tuple[tuple[float, float], tuple[float, float]]
    foveation: FoveationMap
    threshold_deg: float
    warnings: tuple[str, ...]

    @property
    def source_pixels(self) -> np.ndarray:
        """(H, W) DisplayPixel records of the source eye."""
        return display_pixels(self.source)

    @cached_property
    def target_pixels(self) -> np.ndarray:
        """(H, W) DisplayPixel records of the target eye: rendered tiles over warped ones."""
        return np.where(self._per_pixel(self.rendered), display_pixels(self.target), self.warped.pixels)

    @cached_property
    def origin(self) -> np.ndarray:
        """(H, W) uint8: where each pixel of the target comes from, one of KINDS."""
        of_warped = np.array([RERENDERED, WARPED, BACKGROUND, FILLED], np.uint8)[self.warped.origin]
        foveal = self._per_pixel(self.registers.warp == 0)
        again = self._per_pixel(self.rendered) & ~foveal
        return np.where(foveal, RENDERED, np.where(again, RERENDERED, of_warped)).astype(np.uint8)

    @property
    def shares(self) -> dict[str, float]:
        """Share of the target's pixels of each kind, and of its tiles that are rendered."""
        counts = np.bincount(self.origin.reshape(-1), minlength=len(KINDS)) / self.origin.size
        return {**{name: float(counts[kind]) for name, kind in KINDS.items()},
                "tiles_foveal": float((self.registers.warp == 0).mean()),
                "tiles_rerendered": float((self.rendered & (self.registers.warp == 1)).mean())}

    @property
    def images(self) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 3) uint8 of the left and of the right eye."""
        pictures = (pixels["colour"].astype(np.uint8) for pixels in (self.source_pixels, self.target_pixels))
        return self.pair.left_right(*pictures)

    @property
    def events(self) -> dict[str, int]:
        """What the machine counts of stereo, by the names of `spec.registers.STEREO_EVENTS`."""
        return {**self.warped.events, "target_tiles": int(self.rendered.sum())}

    def _per_pixel(self, tiles: np.ndarray) -> np.ndarray:
        r = self.source.registers
        expanded = tiles.reshape(r.tiles_y, r.tiles_x).repeat(TILE, axis=0).repeat(TILE, axis=1)
        return expanded[: r.height, : r.width]


def disparity_scale(config: AcceleratorConfig, pair: StereoPair, depth_far: float) -> int:
    """The setting of that name: HALF_UP of the disparity at full depth.

    Args:
        config: the machine.
        pair: the eyes.
        depth_far: z depth at which the source's depth saturates.

    Raises:
        InputError: more than the setting holds, where that would change a pixel.
    """
    most = (1 << DISPARITY_SCALE_BITS) - 1
    pixels = float(pair.disparity(depth_far))
    scale = int(np.floor(min(np.ldexp(pixels, DISPARITY_SCALE_FRAC) + 0.5, 2.0 * most)))
    wide = min(pair.source.width, reach(config) + 1)
    if scale > most and wide > most >> DISPARITY_SCALE_FRAC:  # narrower: all are dropped either way
        raise InputError(f"disparities of {pixels:.4g} pixels and more in frames {pair.source.width} wide are not accepted: "
                         f"check the IPD of {pair.baseline:g} world units")
    return min(scale, most)


def stereo_registers(
    config: AcceleratorConfig, source: FrameRegisters, words: GaussianWords, pair: StereoPair, foveation: FoveationMap,
    warp: np.ndarray,
) -> StereoRegisters:
    """What the host writes for the second eye; depth scale, limits and the rest are the source's.

    Args:
        config: the machine.
        source: the source eye's registers.
        words: the DRAM image.
        pair: the eyes.
        foveation: the target's.
        warp: (tiles_y, tiles_x) bool: the tile may be warped.
    """
    n = config.formats
    level, blend = foveation.tile_level.reshape(-1).astype(np.int64), foveation.blend.reshape(-1).astype(np.int64)
    target = replace(
        source, position=n.view.round(pair.target.position - words.origin),
        header=np.stack([level, blend, (level > 0).astype(np.int64)], 1),
        plane=n.plane.quantise(foveation.plane.reshape(-1, 3), Rounding.HALF_UP))
    return StereoRegisters(target, warp.reshape(-1).astype(np.int64), disparity_scale(config, pair, source.depth_far),
                           pair.source_eye == "right")


def _warnings(frame: pipeline.Frame, pair: StereoPair, moved: np.ndarray) -> list[str]:
    """Of a source frame whose depth is of no use, or that is too narrow for its disparities."""
    n, t = frame.config.formats, frame_pixels(frame)["transmittance"]
    solid, background = t <= solid_transmittance(n), t >= background_transmittance(n)
    found = []
    if not solid.any() and not background.all() and not frame.config.warp_veiled:
        found.append("no pixel of the source eye has a depth: every tile with holes is rendered")
    dropped, most = solid & (moved["keep"] == 0), reach(frame.config)
    disparity = pair.disparity(np.where(solid, frame.depth, np.inf))
    far = dropped & (disparity >= pair.source.width)
    if far.any():
        found.append(f"{int(far.sum())} pixels have disparities wider than the frame's {pair.source.width} pixels: they are "
                     "dropped; check IPD and scale")
    beyond = int((dropped & ~far & (disparity >= most + 1)).sum())
    if beyond:
        found.append(f"{beyond} pixels have disparities wider than the {most} pixels that the machine moves them by: "
                     "they are dropped; check IPD and scale")
    return found


def render_stereo(
    model: GaussianModel | GaussianWords, pair: StereoPair, *, config: AcceleratorConfig, foveation: FoveationMap | None = None,
    threshold_deg: float = ECC_THRESHOLD_DEG, gaze: tuple[float, float] | None = None,
    gaze_target: tuple[float, float] | None = None, background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    beta: int | None = None, obb: bool = False, source: pipeline.Frame | None = None,
) -> StereoFrame:
    """Renders a frame of two eyes.

    Args:
        model: the Gaussians, or their words when several frames share them.
        pair: the eyes.
        config: a machine with stereo.
        foveation: the source eye's tile levels and planes; None renders level 1 everywhere, in both eyes.
        threshold_deg: tiles with all pixels beyond may be warped.
        gaze: where the source eye looks, where `foveation` does not say it; None: at the frame's centre.
        gaze_target: where the target eye looks; None: at the same point, by the depth there.
        background, beta, obb: see `pipeline.render`.
        source: the source eye's frame, where it is there already.

    Raises:
        ValueError: a machine without stereo.
        InputError: as `pipeline.render`; a gaze off-screen, or a threshold out of range.
    """
    if not config.stereo:
        raise ValueError(f"config must be a machine with stereo, not {config!r}")
    camera = pair.source
    display = Display(camera.width, camera.height)
    gaze = (foveation and foveation.gaze_xy) or gaze or (camera.width / 2, camera.height / 2)
    check_gaze(f"{pair.source_eye} (source)", gaze, camera)
    if gaze_target is not None:
        check_gaze(f"{pair.target_eye} (target)", gaze_target, camera)
    warpable_tiles(display, gaze, threshold_deg)  # refuses the threshold before anything is rendered
    words = model if isinstance(model, GaussianWords) else quantise_model(config, model)
    source = source or pipeline.render(
        words, camera, config=config, foveation=foveation, background=background, beta=beta, obb=obb,
        baseline_px=float(pair.disparity(1.0)))

    warnings: list[str] = []
    if gaze_target is None:
        column, row = min(int(gaze[0]), camera.width - 1), min(int(gaze[1]), camera.height - 1)
        gaze_target, warning = target_gaze(pair, gaze, float(source.depth[row, column]))
        warnings += [warning] if warning else []
    foveated = foveation is not None and foveation.gaze_xy is not None
    target_foveation = foveation_map(display, gaze_target, foveation.levels) if foveated else no_foveation(display)
    warp = warpable_tiles(display, gaze_target, threshold_deg)
    registers = stereo_registers(config, source.registers, words, pair, target_foveation, warp)

    warped = warp_unit.warp(config, frame_pixels(source), registers.disparity_scale, registers.source_right)
    warnings += _warnings(source, pair, warped.moved)
    rendered = (registers.warp == 0) | warped.invalid
    target = pipeline.render_frame(config, words, registers.target, beta=beta, obb=obb, rendered=rendered)
    return StereoFrame(pair, registers, source, warped, rendered, target, (gaze, gaze_target), target_foveation, threshold_deg,
                       tuple(warnings))
