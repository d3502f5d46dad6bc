"""Case 75: words in memory that the host library never writes, but another host may."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from golden.host.quantise import GaussianWords, quantise_model
from golden.msv2_ref.pipeline import Frame, render
from golden.msv2_ref.projection import UNREAD
from golden.scenes.gaze import Display, foveation_map, no_foveation
from golden.scenes.model import GaussianModel
from msv2.cases.case import Case, require
from msv2.cases.check import MACHINE
from msv2.cases.makers import splats, view
from spec.constants import MAX_LEVELS
from spec.formats import Fixed, SmallFloat

_N = MACHINE.formats
FIELDS: Mapping[str, Fixed | SmallFloat] = {
    "mean": _N.position, "scale": _N.scale, "quat": _N.quaternion, "log2_opacity": _N.log2_opacity}
"""The numbers of a Gaussian's geometry, by field."""

OPACITIES = (7.0, 12.0, 14.5, 15.0, _N.log2_opacity.to_float(_N.log2_opacity.raw_max))
"""log2 of opacities. The host's largest is 7; from 14.49 on the array's `cut` saturates."""


@dataclass(frozen=True)
class RawWords:
    """A frame of words that were written without the host library.

    Attributes:
        words: what lies in memory.
        levels: the number of levels that the tiles show.
    """

    words: GaussianWords
    levels: int = 1

    @property
    def frame(self) -> Frame:
        """The frame of the integer renderer."""
        camera = view()
        display = Display(camera.width, camera.height)
        levels = no_foveation(display) if self.levels == 1 else foveation_map(display, (20, 10), self.levels)
        return render(self.words, camera, config=MACHINE, foveation=levels)

    def check(self, name: str) -> Frame:
        """The frame; CaseFailure where it is not one that a machine may show."""
        frame = self.frame
        covered = _coverage(frame)
        require(np.isfinite(frame.image).all() and (frame.image >= 0).all(), f"{name}: the image must be finite, not negative")
        require(((covered >= 0) & (covered <= 1)).all() and covered.any(), f"{name}: coverage must be in 0..1, and not 0")
        require((frame.projected.reason <= UNREAD).all(), f"{name}: every point must have a reason")
        return frame


def _coverage(frame: Frame) -> np.ndarray:
    return _N.transmittance.to_float(_N.transmittance.raw_max) - frame.transmittance


def _scene(rng: np.random.Generator, count: int) -> GaussianModel:
    """Splats of many sizes that fill the frame."""
    z = rng.uniform(1, 4, count)
    means = np.column_stack([rng.uniform(-0.6, 0.6, count) * z, rng.uniform(-0.45, 0.45, count) * z, z])
    return splats(*means, scale=rng.uniform(0.002, 0.1, (count, 3)), opacity=0.8, colour=rng.uniform(0, 1, (count, 3)),
                  quat=rng.normal(size=(count, 4)), levels=MAX_LEVELS)


def _opaque(log2_opacity: float, count: int) -> RawWords:
    """The first splats of a scene, with an opacity that the host library would have limited."""
    words = quantise_model(MACHINE, _scene(np.random.default_rng(75), 40).select(np.arange(count)))
    geometry = words.geometry.copy()
    geometry["log2_opacity"] = _N.log2_opacity.quantise(log2_opacity)
    return RawWords(replace(words, geometry=geometry))


def _raw_range(number: Fixed | SmallFloat) -> tuple[int, int]:
    """The smallest and largest raw word of a format."""
    return (number.raw_min, number.raw_max) if isinstance(number, Fixed) else (0, (1 << number.width) - 1)


def _random(*fields: str) -> RawWords:
    """A scene of which some fields of half of the splats have random bits."""
    rng = np.random.default_rng(76 + len("".join(fields)))
    words = quantise_model(MACHINE, _scene(rng, 60))
    geometry, rows = words.geometry.copy(), rng.permutation(60)[:30]
    for name in fields:
        low, high = _raw_range(FIELDS[name])
        geometry[name][rows] = rng.integers(low, high + 1, (30, *geometry[name].shape[1:]))
    return RawWords(replace(words, geometry=geometry), MAX_LEVELS)


def frames() -> dict[str, RawWords]:
    """The frames, by name."""
    return {**{f"log2 of the opacity {x:.2f}": _opaque(x, 40) for x in OPACITIES},
            **{f"random {name}": _random(name) for name in FIELDS}, "everything random": _random(*FIELDS)}


def _check() -> None:
    """Raises CaseFailure where a frame is not as it must be, or where a splat covers less than a fainter one does."""
    for name, raw in frames().items():
        raw.check(name)
    covered = [_coverage(_opaque(x, 1).frame) for x in OPACITIES]
    for x, less, more in zip(OPACITIES[1:], covered, covered[1:], strict=False):
        inside = less > 0
        require((more[inside] >= less[inside]).all(), f"log2 of the opacity {x:.2f}: no pixel may be covered less than before")


CASES = (Case(
    75, "words-of-another-host", "opacities up to 2^16, and random bits in means, scales, quaternions and opacities",
    "frames with finite pixels and coverages of at most 1, the same from the machine; more opacity never covers less",
    checks={"golden": _check}, raw=frames,
    absent={"oracle": "reads no words", "gradient": "reads no words"}),)
