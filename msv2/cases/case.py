"""The definition of a hard case: frames that any renderer can take, and what they must show."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, FoveationMap, foveation_map, no_foveation
from golden.scenes.model import GaussianModel
from spec.config import DEFAULT
from spec.constants import MAX_LEVELS

COLUMNS = ("oracle", "golden", "gradient", "rtl")
"""The renderers that take part: the float64 one, the integer one, the differentiable one, and the hardware."""

RIM = 2.8 / 255
"""The opacity that an alpha of 1 has at the rim of a support of 3 sigma. Two renderers may differ by it in a pixel on the
rim."""


class CaseFailure(AssertionError):
    """A case's expectation does not hold; the message says what was expected and what was seen."""


def require(holds: object, message: str) -> None:
    """Raises CaseFailure unless `holds`."""
    if not holds:
        raise CaseFailure(message)


def close(what: str, got: ArrayLike, wanted: ArrayLike, within: float) -> float:
    """The largest difference. Raises CaseFailure where it is above `within`, or where a value is not finite."""
    got, wanted = np.asarray(got, float), np.asarray(wanted, float)
    got, wanted = np.broadcast_arrays(got, wanted)
    off = np.abs(got - wanted)
    if np.isfinite(off).all() and off.max(initial=0.0) <= within:
        return float(off.max(initial=0.0))
    worst = np.unravel_index(np.where(np.isfinite(off), off, np.inf).argmax(), off.shape)
    where = f" at {list(map(int, worst))}" if worst else ""
    raise CaseFailure(f"{what} must be within {within:.3g} of {wanted[worst]:.6g}, not {got[worst]:.6g}{where}")


@dataclass(frozen=True)
class Renderer:
    """A renderer and its accuracy.

    Attributes:
        name: one of COLUMNS.
        error: the largest error of a colour in 0..1 or of a coverage, away from the rims of footprints.
        ulp: the relative step of a camera-space depth.
        depth: the largest relative error of a pixel's depth.
        largest_colour: colours above this value are clamped to it.
        weights: how blend tiles weigh their levels: by each pixel's `exact` eccentricity, or by the tile's `plane`.
    """

    name: str
    error: float
    ulp: float
    depth: float
    largest_colour: float = math.inf
    weights: str = "plane"


_N = DEFAULT.formats
ORACLE = Renderer("oracle", 1e-9, 2.0**-52, 1e-9)
GOLDEN = Renderer("golden", 0.5 / 255, 2.0 ** (1 - _N.view.sig_bits), 2e-3, _N.colour.to_float(_N.colour.raw_max))
GRADIENT = Renderer("gradient", 2e-5, 2.0**-23, 1e-5, weights="exact")
RENDERERS = {renderer.name: renderer for renderer in (ORACLE, GOLDEN, GRADIENT)}


@dataclass(frozen=True)
class Shot:
    """A frame that a case asks a renderer for.

    Attributes:
        model, camera: the model and the camera.
        gaze: the gaze in pixels, with which the model's levels are used; None for level 1 everywhere, or level 2 with `outer`.
        outer: level 2 everywhere, where alpha may reach 1; this needs a model of two levels.
        background: red, green, blue.
        beta, obb: arguments of the integer renderer.
        rim: bound of the difference between two renderers in any pixel; None if they are not compared.
        empty: whether nothing is meant to be covered; otherwise a frame without coverage fails.
    """

    model: GaussianModel
    camera: Camera
    gaze: tuple[float, float] | None = None
    outer: bool = False
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    beta: int | None = None
    obb: bool = False
    rim: float | None = RIM
    empty: bool = False

    @property
    def foveation(self) -> FoveationMap:
        """The levels that the tiles show."""
        display = Display(self.camera.width, self.camera.height)
        if self.gaze is not None:
            return foveation_map(display, self.gaze, min(self.model.levels, MAX_LEVELS))
        plain = no_foveation(display)
        return replace(plain, levels=2, tile_level=np.ones_like(plain.tile_level)) if self.outer else plain


@dataclass(frozen=True)
class Seen:
    """A renderer's result for a shot. Values that a renderer does not provide are None.

    Attributes:
        image: (H, W, 3) float64, not clamped.
        coverage: (H, W) float64, 1 - T.
        depth: (H, W) float64 in world units, NaN where it is invalid.
        near, faint: the numbers of points culled at the near plane and for their opacity.
        drawn: the number of splats with an intersection.
        entries: the number of intersections.
        tile_intersections: (tiles,) int64, the intersections of each tile.
        frame: the object that the renderer returned.
    """

    image: np.ndarray
    coverage: np.ndarray | None
    depth: np.ndarray | None
    near: int | None
    faint: int | None
    drawn: int | None
    entries: int | None
    tile_intersections: np.ndarray | None
    frame: object = None

    def counts(self, **wanted: int) -> None:
        """Raises CaseFailure where a count that the renderer provides differs."""
        for name, value in wanted.items():
            got = getattr(self, name)
            require(got is None or got == value, f"{name} must be {value}, not {got}")

    def at(self, x: int, y: int) -> float:
        """The coverage of a pixel."""
        return float(self.coverage[y, x])


Shots = Mapping[str, Shot]
Album = Mapping[str, Seen]


FIELDS = ("sh_dc", "opacity", "means", "log_scales", "quats")
"""The fields whose gradients are compared."""

SMOOTH = ("sh_dc", "opacity", "log_scales")
"""Those fields on which no depth depends."""


@dataclass(frozen=True)
class Gradients:
    """The expected gradients of the shot named `shot`. All gradients must also be finite and agree with the oracle.

    Attributes:
        shot: the name of the shot.
        zero: rows of which every gradient must be exactly 0.
        lit: rows whose colour must have a gradient other than 0.
        moved: rows whose position must have a gradient other than 0.
        compared: the fields whose directional derivatives are compared with finite differences of the oracle. Fields along
            which an order, a cut or the near plane changes within the step must be left out.
    """

    shot: str
    zero: tuple[int, ...] = ()
    lit: tuple[int, ...] = ()
    moved: tuple[int, ...] = ()
    compared: tuple[str, ...] = FIELDS


@dataclass(frozen=True)
class Case:
    """A hard case.

    Attributes:
        number: its number in the list in docs/stability.md.
        name: its name in tests and on command lines.
        what: a description of the case.
        expected: a description of the expected result.
        shots: the frames for a renderer; None for cases about something else.
        expect: raises CaseFailure where the frames are not as they must be.
        gradients: the requirements on the differentiable renderer; empty if the case does not concern it.
        columns: the renderers that take the shots.
        checks: by column, a further check, which returns the worst error or None.
        absent: by column, the reason why the case has no part there.
        rtl: whether the integer renderer's frames are played through the machine.
        eyes: by name, the frames of two eyes (`msv2.cases.eyes.TwoEyes`) that the machine plays; None if the case has none.
        chunks: by name, the frames of models in chunks (`msv2.cases.chunks.InChunks`); None if the case has none.
        supertiles: by name, the frames of super-tiles (`msv2.cases.supertiles.InSuperTiles`); None if the case has none.
        raw: by name, the frames of words from elsewhere (`msv2.cases.raw_words.RawWords`); None if the case has none.
    """

    number: int
    name: str
    what: str
    expected: str
    shots: Callable[[Renderer], Shots] | None = None
    expect: Callable[[Album, Renderer, Shots], None] | None = None
    gradients: tuple[Gradients, ...] = ()
    columns: tuple[str, ...] = ("oracle", "golden", "gradient")
    checks: Mapping[str, Callable[[], float | None]] = field(default_factory=dict)
    absent: Mapping[str, str] = field(default_factory=dict)
    rtl: bool = True
    eyes: Callable[[], Mapping[str, Any]] | None = None
    chunks: Callable[[], Mapping[str, Any]] | None = None
    supertiles: Callable[[], Mapping[str, Any]] | None = None
    raw: Callable[[], Mapping[str, Any]] | None = None

    @property
    def id(self) -> str:
        """Number and name of the case."""
        return f"{self.number:02d}-{self.name}"


def scene_case(number: int, name: str, what: str, expected: str, **options: object) -> Callable[[Callable], Case]:
    """Turns a function `expect(album, renderer, shots)` into a case; `options` are further arguments of Case."""
    def made(expect: Callable[[Album, Renderer, Shots], None]) -> Case:
        return Case(number, name, what, expected, expect=expect, **options)
    return made
