"""The pictures of the gallery: a frame of a scene, plain, foveated, with its levels, its depth, for two eyes, and its error."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from golden.metrics.image import max_abs_error, psnr_vs
from golden.msv2_ref import pipeline
from golden.msv2_ref.eyes import render_stereo
from golden.oracle.render import render as render_oracle
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.level_source import ENHANCED
from golden.scenes.model import GaussianModel
from golden.scenes.pictures import depth_picture, levels_picture
from golden.scenes.request import parse_request, resolve
from golden.scenes.stereo import scene_scale, stereo_pair
from msv2.studies.tradeoff.scene import first_level
from spec.config import PAPER
from spec.constants import ECC_THRESHOLD_DEG, MAX_LEVELS

ERROR_GAIN = 255
"""The picture of the error shows the difference times this."""


@dataclass(frozen=True)
class Shown:
    """A picture of the gallery.

    Attributes:
        name: `plain`, `foveated`, `levels`, `depth`, `stereo` or `error`.
        image: (H, W, 3) float in 0..1.
        caption: what it shows, with its numbers, as Markdown.
        options: what draws it with `msv2 render SCENE`.
    """

    name: str
    image: np.ndarray
    caption: str
    options: str

    @property
    def title(self) -> str:
        """The heading of the picture."""
        return {"stereo": "Two eyes"}.get(self.name, self.name.capitalize())


@dataclass(frozen=True)
class Subject:
    """A scene as the gallery draws it: its name, its model with four levels, whether these were trained, and the camera."""

    name: str
    model: GaussianModel
    trained: bool
    camera: Camera

    @property
    def gaze(self) -> tuple[float, float]:
        """The gazed pixel: the centre of the frame."""
        return self.camera.width / 2, self.camera.height / 2


def load_subject(scene: str, size: str, camera: str) -> Subject:
    """The scene at a path, or of a name. A model without levels gets the levels that `msv2 render` fits to its own pictures.

    Raises:
        InputError: there is no such scene or camera, or the size is not valid.
    """
    asked = resolve(parse_request(
        scene, "--size", size, "--camera", camera, "--levels", str(MAX_LEVELS), "--levels-from", ENHANCED))
    trained = "levels_from" not in asked.record
    return Subject(Path(scene).name.partition(".")[0] or asked.model.name, asked.model, trained, asked.camera)


def pictures(subject: Subject) -> Iterator[Shown]:
    """Renders the pictures one after the other."""
    camera, flat = subject.camera, first_level(subject.model)
    size = f"--size {camera.width}x{camera.height}"
    gazed = f"{size} --gaze {subject.gaze[0]:g},{subject.gaze[1]:g}"
    plain = pipeline.render(flat, camera, config=PAPER)
    yield Shown("plain", plain.image, f"All {len(flat):,} splats of {subject.name}: {len(plain.entries.splat):,} intersections "
                "of splats and tiles, drawn by the integer renderer, whose every bit is the hardware's.", size)
    yield from _foveated(subject, plain, f"{gazed} --levels {MAX_LEVELS}")
    valid = plain.depth[np.isfinite(plain.depth) & (plain.depth > 0)]
    span = f", {np.percentile(valid, 1):.3g} to {np.percentile(valid, 99):.3g} units of the scene" if valid.size else ""
    yield Shown("depth", depth_picture(plain.depth), "The depth of each pixel, which warping needs: yellow is near and violet "
                f"is far{span}.", f"{size} --depth")
    yield _two_eyes(subject, f"{gazed} --stereo")
    oracle = render_oracle(flat, camera).image
    yield Shown("error", ERROR_GAIN * np.abs(plain.image - oracle), "The difference of the integer renderer from the float64 "
                f"reference. A difference of 1/255 has full brightness here; the largest one is "
                f"{255 * max_abs_error(plain.image, oracle):.1f}/255, and the PSNR is {psnr_vs(plain.image, oracle):.1f} dB.",
                f"{size} --compare oracle")


def _foveated(subject: Subject, plain: pipeline.Frame, options: str) -> Iterator[Shown]:
    """The foveated frame, and the levels of its tiles."""
    foveation = foveation_map(Display(subject.camera.width, subject.camera.height), subject.gaze)
    frame = pipeline.render(subject.model, subject.camera, config=PAPER, foveation=foveation)
    share = 100 * len(frame.entries.splat) / max(1, len(plain.entries.splat))
    how = ("trained with the model" if subject.trained else
           "fitted to the model's own pictures, without photographs")
    yield Shown("foveated", frame.image, f"{subject.model.levels} quality levels around a gaze in the centre, with "
                f"{share:.0f} % of the intersections. The levels are {how}. Its PSNR against the plain frame is "
                f"{psnr_vs(frame.image, plain.image):.1f} dB.", options)
    yield Shown("levels", levels_picture(frame.image, foveation), "The level of each tile of the foveated frame: red is the "
                "fovea, then yellow, green and blue. A mixed colour marks a tile that blends two levels.", options)


def _two_eyes(subject: Subject, options: str) -> Shown:
    """Both eyes beside each other."""
    units, assumed = scene_scale(subject.name, None)
    pair = stereo_pair(subject.camera, units_per_metre=units)
    eyes = render_stereo(first_level(subject.model), pair, config=PAPER.with_(stereo=True), gaze=subject.gaze)
    shares = eyes.shares
    scale = " One unit of the scene is taken as a metre, because its scale is not known." if assumed else ""
    return Shown("stereo", np.concatenate(eyes.images, axis=1) / 255.0, "The left eye is rendered. The right eye is warped "
                 f"from it beyond {ECC_THRESHOLD_DEG:g} degrees of eccentricity, where this leaves no hole, and rendered "
                 f"elsewhere: {100 * shares['warped']:.0f} % of its pixels are warped, and {100 * shares['filled']:.0f} % are "
                 f"filled from their neighbours.{scale}", options)
