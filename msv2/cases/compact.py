"""Cases 64 to 69: models that a codec of records can get wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from golden.msv2_ref.pipeline import Frame
from golden.oracle.render import render as render_oracle
from golden.scenes.model import GaussianModel
from msv2.cases.case import RIM, Case, close, require
from msv2.cases.chunks import InChunks
from msv2.cases.makers import random_model, splats, view
from spec.constants import SH_C0

BACKGROUND = (0.25, 0.5, 0.75)
"""The background of `InChunks`."""

PLACES = [((x - 31.5) / 25, (y - 23.5) / 25, 2.0) for y in (6, 18, 30, 42) for x in (8, 24, 40, 56)]
"""Sixteen means far apart at depth 2, which project onto the centres of pixels."""


@dataclass(frozen=True)
class Packed(InChunks):
    """A frame of compact records that must look as the oracle's does.

    Attributes:
        within: the largest difference of a pixel's colour to the oracle's.
    """

    within: float = RIM

    def check(self, name: str) -> Frame:
        frame = super().check(name)
        exact = np.minimum(render_oracle(self.model, view(), background=BACKGROUND).image, 2.0)
        close(f"{name}: image", np.minimum(frame.image, 2.0), exact, self.within)
        return frame


def _two_widths(model: GaussianModel, **options: object) -> Mapping[str, Packed]:
    """A model of one level, whose fields are fine, and the same with four equal levels, whose fields are coarse."""
    four = replace(
        model, opacity=np.repeat(model.opacity[:, :1], 4, axis=1), sh_dc=np.repeat(model.sh_dc[:, :1], 4, axis=1),
        quality_bound=np.full(len(model), 4, np.uint8))
    return {"fine": Packed(model, **options), "coarse": Packed(four, **options)}


def _far_splat() -> Mapping[str, Packed]:
    """Sixteen small splats and one at 1e6, of the same size, beside which all would be moved to one place."""
    return _two_widths(splats(*PLACES, (1e6, 1e6, 1e6), scale=0.05), chunks=2, read=1, drawn=16)


def _sizes() -> Mapping[str, Packed]:
    """Sixteen splats of five sizes from 2^-20 to 2^4, some of them needles and discs, which no chunk holds together; and
    sixteen small splats before one that is 2^18 times as large."""
    size = np.array([2.0**-20, 2.0**-14, 2.0**-8, 2.0**-4, 2.0**4])[np.arange(16) % 5]
    shape = np.array([(1, 1, 1), (1, 1, 2.0**-7), (1, 2.0**-7, 2.0**-9), (1, 1, 0)])[np.arange(16) % 4]
    turned = splats(*PLACES, scale=size[:, None] * shape, opacity=0.5)
    turned.quats[:] = np.random.default_rng(3).normal(size=(16, 4))
    giant = splats(*PLACES, (0, 0, 2), scale=[[2.0**-6] * 3] * 16 + [[2.0**12] * 3], opacity=[0.5] * 16 + [0.2])
    return {**_two_widths(turned, chunks=12, read=12, drawn=16),
            **{f"giant, {name}": packed for name, packed in _two_widths(giant, chunks=2, read=2, drawn=17).items()}}


def _turns() -> Mapping[str, Packed]:
    """Flat splats whose quaternions have two, three and four components of equal magnitude, of all signs, or one alone."""
    quats = [(1, 1, 0, 0), (1, 0, -1, 0), (0, 1, 0, 1), (-1, 1, 0, 0), (1, 1, 1, 0), (1, -1, 0, 1), (0, -1, 1, 1), (1, 1, 1, 1),
             (1, -1, 1, -1), (-1, 1, 1, 1), (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 0, -1), (0, 0, -1, 0), (1, 1e-4, 0, 0),
             (3, -4, 0, 5)]
    model = splats(*PLACES, scale=[[0.15, 0.06, 0.02]] * 16)
    model.quats[:] = quats
    return _two_widths(model, chunks=1, read=1, drawn=16, within=4 / 255)


def _brightness() -> Mapping[str, Packed]:
    """Base colours from -3 to 1.9 beside each other, and opacities of 0, around 1/255, and up to 1."""
    colour = np.linspace(-3, 1.9, 48).reshape(16, 3)[np.random.default_rng(1).permutation(16)]
    opacity = [0.0, 0.003, 0.0041, 0.006, 0.02, 0.1, 0.25, 0.5, 0.75, 0.9, 0.99, 1.0, 0.33, 0.66, 0.8, 0.5]
    model = splats(*PLACES, scale=0.06, opacity=opacity, colour=colour)
    model.sh_dc[5:7, 0] = (np.array([[0.1, 0.9, 0.4], [1.0, 0.0, 0.5]]) - 0.5) / SH_C0
    return _two_widths(model, chunks=1, read=1, drawn=14)


def _planet() -> Mapping[str, Packed]:
    """The splats 6,371,000 units from the origin in each axis, and one at the origin. The camera is moved along: by the model's
    median, which the host subtracts."""
    model = splats(*PLACES, scale=0.08)
    base = np.median(model.means, axis=0)
    moved = replace(model, means=model.means - base)
    more = {name: np.concatenate([getattr(moved, name), getattr(moved, name)[:1]]) for name in (
        "means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound")}
    more["means"][:16] += base
    more["means"][16] = -6.371e6
    return _two_widths(replace(moved, **more), chunks=2, read=1, drawn=16)


def _shuffled() -> Mapping[str, InChunks]:
    """A model with coincident points, in two orders. Which of two coincident splats is in front depends on their new order, so
    the oracle's image is another."""
    model = random_model(np.random.default_rng(8), 150, sh=1)
    fields = ("means", "log_scales", "quats", "opacity")
    for name in fields:
        getattr(model, name)[100:] = getattr(model, name)[50:100]
    other = model.select(np.random.default_rng(9).permutation(150))
    return {name: InChunks(each, 3, 3, 74) for name, each in (("one order", model), ("another", other))}


def _same_image(frames: Mapping[str, Frame]) -> None:
    first, *others = frames.values()
    for other in others:
        require(np.array_equal(first.image, other.image), "the order of the model's points must not change a bit")
        require(np.array_equal(first.entries.splat, other.entries.splat), "every list must be the same")


def _case(
    number: int, name: str, what: str, expected: str, frames: Callable[[], Mapping[str, InChunks]],
    further: Callable[[Mapping[str, Frame]], None] | None = None,
) -> Case:
    def check() -> None:
        seen = {label: packed.check(label) for label, packed in frames().items()}
        if further:
            further(seen)

    return Case(number, name, what, expected, checks={"golden": check}, chunks=frames,
                absent={"oracle": "its frames are the measure", "gradient": "it reads no records"})


FAR_SPLAT = _case(
    64, "far-splat-beside-near-ones", "sixteen splats and one a million units away, in one chunk if it could hold them",
    "the far one gets a chunk of its own, the others stay at their places", _far_splat)
SIZES = _case(
    65, "sizes-of-24-octaves", "splats of 2^-20 to 2^4, needles, discs, axes of 0, and a giant behind small splats",
    "no splat is flattened beside a larger one", _sizes)
TURNS = _case(
    66, "equal-quaternion-components", "quaternions whose largest components are equal, of all signs",
    "flat splats lie as the oracle's do", _turns)
BRIGHTNESS = _case(
    67, "ranges-of-colours-and-opacities", "base colours from -3 to 1.9 and opacities from 0 to 1, side by side",
    "within a few grey levels; what an alpha of 1/255 cannot show is not drawn", _brightness)
PLANET = _case(
    68, "compact-planetary-coordinates", "a small object, and a point 6,371 km away",
    "the far point gets a chunk of its own, the object keeps its shape", _planet)
SHUFFLED = _case(
    69, "shuffled-coincident-points", "a model in two orders, a third of whose points coincide",
    "the same lists and the same pixels, bit by bit", _shuffled, _same_image)

CASES = (FAR_SPLAT, SIZES, TURNS, BRIGHTNESS, PLANET, SHUFFLED)
